"""Tangled meshes that can be made valid with the triangles they have, and the methods of `untangle`."""

import meshes

from torchmesh import UntangleOptions

METHODS = {
    "regularised": UntangleOptions(),
    "beta": UntangleOptions("beta", max_iterations=1000),
    "beta, single": UntangleOptions("beta", max_iterations=1000, single=True),
}

# Tangled by their interior vertices only, so that these triangles can be made valid.
MENDABLE = {
    "lightly jittered": lambda: meshes.jittered(8, 7, 0.35, 0),
    "jittered": lambda: meshes.jittered(8, 7, 0.5, 0),
    "disc": lambda: meshes.disturbed(meshes.disc(), 0.1, 2),
    "ring": lambda: meshes.disturbed(meshes.ring(), 0.08, 3),
    "interface": lambda: meshes.disturbed(meshes.l_shape(4), 0.12, 5),
}
