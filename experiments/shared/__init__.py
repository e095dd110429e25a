"""What the experiments share.

arguments    the parser, and the options that several scripts have
cache        arrays that are made once and kept in a file
tables       lines of a Markdown table
clocks       wall and processor time, and runs in a fresh process
outlines     closed polygons to be meshed: rectangles, circles, airfoils, letters, spirals
domains      circle, bar and gate of Kim 2017 in any size
tangles      families of tangled meshes, each with one number that makes it harder
certified    what checks certificates of impossible meshes, apart from torchmesh
peers        other tools on the same mesh; each is in torchmesh/bench/methods
"""
