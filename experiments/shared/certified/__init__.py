"""What checks certificates of impossible meshes: whole numbers and fractions alone, and nothing of torchmesh."""
