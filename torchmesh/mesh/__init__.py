"""What a mesh is: arrays and offsets, half-edges, exact signs, formulae of one triangle, measures of quality.

No algorithm that changes a mesh lives here.  Imports from `errors` and `status` only.
"""
