"""Step 1 of Kim 2017: rules that say which edges to flip, and rounds of flips that do not touch each other.

Imports from `mesh` and `optimising`.
"""
