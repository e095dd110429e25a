"""Mesh file formats, one module each: how a file is read and written, and what it can hold.

    registry.py   the table of formats and their extensions
    format.py     what a format is: `read`, `write`, `fit`, `left_behind`

A new format is a module with a subclass of `Format` (or a row in the table of `meshio_formats`) and one entry in
the table of `registry`.  Imports from `mesh`.
"""
