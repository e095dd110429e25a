"""Curved triangles and quads, whose sides are parabolas: which are valid, and where their mid-side nodes belong.

Imports from `mesh`, `kernels`, `errors` and `status`.
"""
