"""Meshes in the time loop of a simulation: what the ways to move them cost, and what they do to the solution."""
