"""What the experiments share.

arguments    the parser, and the options that several scripts have
cache        arrays that are made once and kept in a file
tables       lines of a Markdown table
clocks       wall and processor time, and runs in a fresh process
boundary     the edges and the closed curves of a mesh's boundary
exact_check  signs in exact arithmetic and incidence by counting, without torchmesh's own
outlines     closed polygons to be meshed: rectangles, circles, airfoils, letters, spirals
gmsh_mesher  the triangles that gmsh puts between such polygons
domains      circle, bar and gate of Kim 2017 in any size
tangles      families of tangled meshes, each with one number that makes it harder
peers        other tools on the same mesh
"""
