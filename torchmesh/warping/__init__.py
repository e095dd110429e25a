"""Moving a boundary: FEMWARP, stiffened or not, Dirichlet averaging, and how far a boundary may move in one step.

Imports from `mesh` and `optimising`.
"""
