"""Step 3 of Kim 2017: vertices move until triangles have good shapes; also along curves, and patch by patch.

Imports from `mesh`, `optimising`, `triangulating` and `flipping`.
"""
