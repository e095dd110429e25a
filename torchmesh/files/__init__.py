"""Meshes in files: formats, reading, writing with everything else of a file carried over, series, HDF5, PyG, PyVista.

Imports from `mesh`.
"""
