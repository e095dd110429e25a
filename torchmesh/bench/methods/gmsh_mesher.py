"""The triangles that gmsh puts between closed polygons."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np

from ..exact_check import double_areas

Array = np.ndarray

# gmsh's numbers for its algorithms in the plane.
FRONTAL_DELAUNAY = 6
PACKING_OF_PARALLELOGRAMS = 9


def triangulate(
    loops: Sequence[Array],
    *,
    algorithm: int = FRONTAL_DELAUNAY,
    smoothing: int = 1,
    unsplit: Collection[int] = (),
) -> tuple[Array, Array]:
    """Points (V, 2) and counter-clockwise triangles (T, 3) of the domain inside the first loop and outside the others.

    loops      each (N, 3), the outer one first: x, y and the length of mesh edges there
    smoothing  gmsh's number of smoothing steps after meshing
    unsplit    numbers of the loops whose sides stay whole
    """
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        for name, value in (
            ("General.Terminal", 0),
            ("General.NumThreads", 1),
            ("Mesh.Algorithm", algorithm),
            ("Mesh.Smoothing", smoothing),
        ):
            gmsh.option.setNumber(name, value)
        geometry = gmsh.model.geo
        curves = []
        for number, loop in enumerate(loops):
            corners = [geometry.addPoint(x, y, 0.0, size) for x, y, size in loop.tolist()]
            sides = zip(corners, corners[1:] + corners[:1], strict=True)
            lines = [geometry.addLine(a, b) for a, b in sides]
            if number in unsplit:
                for side in lines:
                    geometry.mesh.setTransfiniteCurve(side, 2)
            curves.append(geometry.addCurveLoop(lines))
        geometry.addPlaneSurface(curves)
        geometry.synchronize()
        gmsh.model.mesh.generate(2)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        _, _, (corner_tags,) = gmsh.model.mesh.getElements(2)
    finally:
        gmsh.finalize()
    # gmsh numbers its nodes from 1 and may leave gaps; rows follow the numbers of the nodes that triangles have.
    used, triangles = np.unique(corner_tags.astype(np.int64), return_inverse=True)
    row_of_tag = np.zeros(int(tags.max()) + 1, np.int64)
    row_of_tag[tags.astype(np.int64)] = np.arange(len(tags))
    points = coordinates.reshape(-1, 3)[row_of_tag[used], :2]
    triangles = triangles.reshape(-1, 3).astype(np.int64)
    clockwise = double_areas(points, triangles) < 0
    triangles[clockwise] = triangles[clockwise, ::-1]
    return points, triangles


def triangulate_about(loops: Sequence[Array], area: float, triangles: int) -> tuple[Array, Array]:
    """About so many triangles of a domain of that area; sizes in `loops` are parts of the size far away."""
    size = edge_length(area, triangles)
    # The boundary and the grading make the count differ from what the size promises, so the size is corrected twice.
    for _ in range(2):
        found = len(triangulate(_scaled(loops, size))[1])
        size *= math.sqrt(found / triangles)
    return triangulate(_scaled(loops, size))


def edge_length(area: float, triangles: int) -> float:
    """The edge of an equilateral triangle, of which so many have that area together."""
    return math.sqrt(4 / math.sqrt(3) * area / triangles)


def _scaled(loops: Sequence[Array], size: float) -> list[Array]:
    return [np.concatenate([loop[:, :2], size * loop[:, 2:]], 1) for loop in loops]
