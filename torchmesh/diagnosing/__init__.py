"""Can a valid mesh exist inside this boundary, and if not, where is the fault?

Imports from `mesh` and `triangulating`.
"""
