"""What anybody may do who need not keep the mesh: throw the inside away, and mesh the boundary anew."""

from __future__ import annotations

import numpy as np

import torchmesh as tm
from torchmesh.bench.methods import tools
from torchmesh.bench.methods.outcome import Array, Outcome


def gmsh_anew(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """gmsh's mesh of the boundary with all its edges, by Frontal-Delaunay, as wide inside as the boundary's edges are.

    The vertices inside are other ones, so nothing that was known there has a place any more.
    """
    result = tools.gmsh_anew(tm.MeshBatch.from_arrays(points, triangles))
    made = result.mesh
    return Outcome(np.asarray(made.points), np.asarray(made.triangles), result.seconds, "all vertices inside are new")
