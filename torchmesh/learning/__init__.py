"""For networks that move meshes: losses, differentiable layers, data sets, generated domains in motion.

Imports from `improving`, the steps and `files`.
"""
