"""How good the improved meshes are, and what they are worth."""
