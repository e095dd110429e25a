"""The whole job: options, the state of a batch on its way, stages, strategies, the report.

Imports from every step: `flipping`, `untangling`, `warping`, `diagnosing`, `smoothing`, `remeshing`.
"""
