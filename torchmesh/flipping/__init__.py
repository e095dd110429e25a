"""Step 1 of Kim 2017: rules that decide which edges to flip, and rounds of flips that share no triangle.

Imports from `mesh` and `optimising`.
"""
