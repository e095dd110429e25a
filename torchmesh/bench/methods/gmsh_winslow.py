"""gmsh's UntangleMeshGeometry."""

from __future__ import annotations

import numpy as np
import torch

from .. import boundary
from ..stopwatch import Stopwatch
from .outcome import Outcome, need

Array = np.ndarray


def gmsh(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """gmsh's UntangleMeshGeometry (a Winslow functional), one call, on plane entities.

    On discrete entities it does nothing and does not say so.  Therefore every boundary vertex becomes a point and
    every boundary edge a line of a plane surface.  gmsh gives the nodes new numbers; they are read back entity by
    entity, where their order is kept.
    """
    need("gmsh")
    import gmsh as api

    loops = [loop.tolist() for loop in boundary.loops(torch.from_numpy(triangles))]
    # The outer loop comes first; it has the largest area.
    loops.sort(key=lambda loop: -abs(boundary.polygon_area(points[loop])))
    xyz = np.pad(points, ((0, 0), (0, 1)))
    api.initialize(interruptible=False)
    try:
        api.option.setNumber("General.Terminal", 0)
        api.option.setNumber("General.NumThreads", 1)
        point_of = {v: api.model.geo.addPoint(*xyz[v]) for loop in loops for v in loop}
        lines = {}
        curves = []
        for loop in loops:
            sides = list(zip(loop, loop[1:] + loop[:1], strict=True))
            for u, v in sides:
                lines[u, v] = api.model.geo.addLine(point_of[u], point_of[v])
            curves.append(api.model.geo.addCurveLoop([lines[side] for side in sides]))
        surface = api.model.geo.addPlaneSurface(curves)
        api.model.geo.synchronize()
        mesh = api.model.mesh
        for v, entity in point_of.items():
            mesh.addNodes(0, entity, [v + 1], xyz[v])
            mesh.addElementsByType(entity, 15, [], [v + 1])
        for (u, v), line in lines.items():
            mesh.addElementsByType(line, 1, [], [u + 1, v + 1])
        inner = np.setdiff1d(np.arange(len(points)), list(point_of))
        mesh.addNodes(2, surface, inner + 1, xyz[inner].ravel())
        mesh.addElementsByType(surface, 2, [], triangles.ravel() + 1)
        with Stopwatch() as watch:
            mesh.optimize("UntangleMeshGeometry")
        moved = points.copy()
        moved[inner] = mesh.getNodes(2, surface)[1].reshape(-1, 3)[:, :2]
    finally:
        api.finalize()
    return Outcome(moved, triangles, watch.seconds)
