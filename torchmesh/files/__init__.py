"""Meshes in files.

    mesh_files     read and write one mesh, with everything else of the file carried over
    time_series    read and write many steps in one file
    formats/       the file formats, one module each
    documents      load and save a file of any format; the rest of the way from a file to a mesh and back:
                   source, content, fields; correspondence, carry_over
    hdf5           many meshes in one compressed file
    pyg, pyvista   meshes for other libraries
    atomic         files are written whole or not at all
    messages       what is said about files

Imports from `mesh`.
"""
