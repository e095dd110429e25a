"""The paper itself: its meshes, made anew, and its figure of the algorithm."""
