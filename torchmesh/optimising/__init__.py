"""Energies of shapes, what is meant by a good shape, and the minimisers over many meshes at once.

Nothing here knows when or why a mesh is optimised.  Imports from `mesh`.
"""
