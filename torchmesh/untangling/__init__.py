"""Step 2 of Kim 2017 and what goes beyond it: no triangle stays inverted.

Untangle-beta and the regularised functional move vertices.  Averaging restores scrambled interiors.  Cavities are
re-triangulated exactly.  Imports from `mesh`, `optimising` and `triangulating`.
"""
