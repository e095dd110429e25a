"""What a network gains from the losses and the layer."""
