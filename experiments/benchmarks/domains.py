"""Tangled meshes to measure on: circle, bar and gate of Kim 2017 in any size, deformed harder than there.

     ________________________     ____________________     ____________________
    |                        |   |      _             |   |         ^          |
    |     o  - - ->          |   |     | | - ->       |   |        _|_         |
    |                        |   |     |_|            |   |       |   |        |
    |________________________|   |____________________|   |_______|   |________|
       circle: 4 - 8 diameters          bar: 0.5 - 1.1         gate: 0.1 -> 0.4 - 0.8

Dimensions are ours and, but for the variant with seed 0, drawn from a seeded generator, so that no
two meshes of a batch are alike.  gmsh triangulates the undeformed domain, FEMWARP carries the
interior along.  A mesh is made once and kept as an .npz file in the cache directory.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import torchmesh as tm

Array = np.ndarray
KINDS = ("circle", "bar", "gate")


@dataclass(frozen=True)
class Shape:
    """An undeformed domain and where its boundary goes.

    loops         closed polygons (N, 3), the outer one first: x, y, mesh size there over that far away
    area          of the domain, for the mesh size
    displacement  boundary points (N, 2) to their displacement (N, 2)
    """

    loops: list[Array]
    area: float
    displacement: Callable[[Array], Array]


@dataclass(frozen=True)
class Case:
    """One tangled mesh: `mesh` to be improved, `valid` (V, 2) where its points were before."""

    name: str
    mesh: tm.MeshBatch
    valid: Array

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """points (V, 2), triangles (T, 3) and fixed (V,), as the peers want them."""
        return self.mesh.points.numpy(), self.mesh.triangles.numpy(), self.mesh.fixed.numpy()


def case(kind: str, triangles: int, seed: int, cache: Path) -> Case:
    """The variant `seed` of `kind` with about that many triangles, from the cache or made now."""
    path = cache / f"{kind}-{triangles}-{seed}.npz"
    if not path.exists():
        cache.mkdir(parents=True, exist_ok=True)
        points, faces, tangled = _tangle(shape(kind, triangles, seed), triangles)
        partial = path.with_suffix(".partial.npz")
        np.savez(partial, points=points, triangles=faces, tangled=tangled)
        partial.rename(path)
    data = np.load(path)
    # The winding is known to be right before the deformation; `from_arrays` may not turn inverted triangles.
    upright = tm.MeshBatch.from_arrays(data["points"], data["triangles"])
    return Case(f"{kind} {seed}", upright.with_points(torch.from_numpy(data["tangled"])), data["points"])


def noisy(kind: str, triangles: int, seed: int, cache: Path, part: float = 0.465) -> tm.MeshBatch:
    """The undeformed variant, valid, with its free vertices thrown about by up to `part` of the local size.

    With 0.465 about 6 of 100 edges are no longer Delaunay: 90,000 of a mesh of 1,000,000 triangles.
    """
    valid = case(kind, triangles, seed, cache)
    faces, fixed = valid.mesh.triangles.numpy(), valid.mesh.fixed.numpy()
    points = valid.valid.copy()
    corner = faces.ravel()
    size = np.bincount(corner, np.repeat(double_areas(points, faces), 3)) / np.bincount(corner)
    rng = np.random.default_rng([seed, 5])
    angle, radius = rng.uniform(0, 2 * np.pi, len(points)), part * np.sqrt(size * rng.uniform(0, 1, len(points)))
    thrown = points + np.where(fixed, 0.0, radius)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    while True:
        inverted = double_areas(thrown, faces) <= 0
        if not inverted.any():
            return valid.mesh.with_points(torch.from_numpy(thrown))
        back = np.unique(faces[inverted])
        thrown[back] = points[back]


def double_areas(points: Array, triangles: Array) -> Array:
    """(T,) twice the signed areas."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def variants(count: int, triangles: int, cache: Path, first_seed: int = 0) -> list[Case]:
    """`count` unlike cases, circle, bar and gate in turn."""
    return [case(KINDS[i % 3], triangles, first_seed + i // 3, cache) for i in range(count)]


def shape(kind: str, triangles: int, seed: int) -> Shape:
    """The variant `seed` of circle, bar or gate."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])

    def draw(low: float, high: float, default: float) -> float:
        return float(rng.uniform(low, high)) if seed else default

    if kind == "circle":
        centre = draw(3.0, 4.5, 4.0), draw(3.2, 4.8, 4.0)
        return _circle(triangles, *centre, draw(4.0, 8.0, 6.0), draw(-1.0, 1.0, 0.0), draw(0.25, 1.0, 0.28))
    if kind == "bar":
        size = draw(0.05, 0.08, 0.06), draw(0.4, 0.55, 0.5)
        return _bar(draw(0.35, 0.6, 0.5), *size, draw(0.5, 1.1, 0.8), draw(0.4, 1.0, 0.4))
    return _gate(draw(0.7, 1.3, 1.0), draw(0.25, 0.35, 0.3), draw(0.4, 0.8, 0.7), draw(0.4, 1.0, 1.0))


def _circle(triangles: int, x: float, y: float, right: float, up: float, grading: float) -> Shape:
    length, height, radius = 20.0, 8.0, 0.5
    area = length * height - math.pi * radius**2
    sides = max(12, round(2 * math.pi * radius / (grading * mesh_size(area, triangles))))
    angle = 2 * np.pi * np.arange(sides) / sides
    hole = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), np.full(sides, grading)], 1)

    def displacement(points: Array) -> Array:
        on_hole = np.hypot(points[:, 0] - x, points[:, 1] - y) < 1.1 * radius
        return np.outer(on_hole, (right, up))

    return Shape([_rectangle(0, 0, length, height), hole], area, displacement)


def _bar(x: float, width: float, height: float, right: float, grading: float) -> Shape:
    left, bottom = x - width / 2, (1 - height) / 2

    def displacement(points: Array) -> Array:
        inner = (points[:, 0] > 1e-6) & (points[:, 0] < 2 - 1e-6) & (points[:, 1] > 1e-6) & (points[:, 1] < 1 - 1e-6)
        return np.outer(inner, (right, 0.0))

    hole = _rectangle(left, bottom, left + width, bottom + height, grading)
    return Shape([_rectangle(0, 0, 2, 1), hole], 2 - width * height, displacement)


def _gate(x: float, width: float, depth: float, grading: float) -> Shape:
    left, right, start = x - width / 2, x + width / 2, 0.1
    notch = [(left, 0.0, grading), (left, start, grading), (right, start, grading), (right, 0.0, grading)]
    outer = np.array([(0.0, 0.0, 1.0), *notch, (2.0, 0.0, 1.0), (2.0, 1.0, 1.0), (0.0, 1.0, 1.0)])

    def displacement(points: Array) -> Array:
        slack = 1e-6
        px, py = points.T
        on_gate = (px > left - slack) & (px < right + slack) & (py < start + slack)
        return np.outer(on_gate * py / start, (0.0, depth - start))

    return Shape([outer], 2 - width * start, displacement)


def _rectangle(left: float, bottom: float, right: float, top: float, grading: float = 1.0) -> Array:
    return np.array([(x, y, grading) for x, y in ((left, bottom), (right, bottom), (right, top), (left, top))])


def mesh_size(area: float, triangles: int) -> float:
    """The edge of an equilateral triangle, that many of which have this area together."""
    return math.sqrt(4 / math.sqrt(3) * area / triangles)


def _tangle(domain: Shape, triangles: int) -> tuple[Array, Array, Array]:
    """points, triangles and the points where FEMWARP carries them."""
    size = mesh_size(domain.area, triangles)
    # Boundary and grading make the count differ from what the size promises: again with what was learnt.
    for _ in range(2):
        points, faces = triangulate(domain, size)
        size *= math.sqrt(len(faces) / triangles)
    points, faces = triangulate(domain, size)
    mesh = tm.MeshBatch.from_arrays(points, faces)
    target = points.copy()
    boundary = mesh.fixed.numpy()
    target[boundary] += domain.displacement(points[boundary])
    return points, mesh.triangles.numpy(), tm.femwarp(mesh, torch.from_numpy(target)).points.numpy()


def triangulate(domain: Shape, size: float) -> tuple[Array, Array]:
    """Points (V, 2) and counter-clockwise triangles (T, 3) of an undeformed domain, by gmsh."""
    import gmsh

    gmsh.initialize(interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        gmsh.option.setNumber("Mesh.Algorithm", 6)  # frontal Delaunay
        loops = []
        for polygon in domain.loops:
            corners = [gmsh.model.geo.addPoint(x, y, 0.0, size * grading) for x, y, grading in polygon]
            sides = zip(corners, corners[1:] + corners[:1], strict=True)
            loops.append(gmsh.model.geo.addCurveLoop([gmsh.model.geo.addLine(a, b) for a, b in sides]))
        gmsh.model.geo.addPlaneSurface(loops)
        gmsh.model.geo.synchronize()
        gmsh.model.mesh.generate(2)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        _, _, (corner_tags,) = gmsh.model.mesh.getElements(2)
    finally:
        gmsh.finalize()
    used, faces = np.unique(corner_tags, return_inverse=True)
    row_of_tag = np.zeros(int(tags.max()) + 1, np.int64)
    row_of_tag[tags.astype(np.int64)] = np.arange(len(tags))
    points = coordinates.reshape(-1, 3)[row_of_tag[used.astype(np.int64)], :2]
    faces = faces.reshape(-1, 3).astype(np.int64)
    clockwise = double_areas(points, faces) < 0
    faces[clockwise] = faces[clockwise, ::-1]
    return points, faces
