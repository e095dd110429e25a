"""Sizes of edges, and the splits and collapses that reach them; vertices that come, go or travel.

Imports from `mesh`, `optimising`, `flipping`, `untangling` and `smoothing`.
"""
