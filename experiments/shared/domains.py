"""Tangled meshes to measure on: circle, bar and gate of Kim 2017 in any size, deformed harder than there.

     ________________________     ____________________     ____________________
    |                        |   |      _             |   |         ^          |
    |     o  - - ->          |   |     | | - ->       |   |        _|_         |
    |                        |   |     |_|            |   |       |   |        |
    |________________________|   |____________________|   |_______|   |________|
       circle: 4 - 8 diameters          bar: 0.5 - 1.1         gate: 0.1 -> 0.4 - 0.8

The paper prints no dimensions, so these are ours.  The variant with seed 0 has fixed dimensions; those of other seeds
are drawn from a seeded generator, so that no two meshes of a batch are alike.  gmsh triangulates the undeformed domain,
and FEMWARP moves the interior with the boundary.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch

import torchmesh as tm
from experiments.shared import outlines
from experiments.shared.cache import cached
from torchmesh.bench.exact_check import double_areas
from torchmesh.bench.methods import gmsh_mesher

Array = np.ndarray
KINDS = ("circle", "bar", "gate")


@dataclass(frozen=True)
class Shape:
    """An undeformed domain and where its boundary moves.

    loops         (N, 3) each, the outer one first: x, y, mesh size there as a part of the size far away
    area          of the domain, for the mesh size
    displacement  maps boundary points (N, 2) to their displacements (N, 2)
    """

    loops: list[Array]
    area: float
    displacement: Callable[[Array], Array]


@dataclass(frozen=True)
class Case:
    """One tangled mesh.

    mesh   to be improved
    valid  (V, 2) its points before the deformation
    path   the file that holds it: points, triangles, and tangled, the points after the deformation
    """

    name: str
    mesh: tm.MeshBatch
    valid: Array
    path: Path

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """points (V, 2), triangles (T, 3) and fixed (V,), as the peers want them."""
        return self.mesh.points.numpy(), self.mesh.triangles.numpy(), self.mesh.fixed.numpy()


def case(kind: str, triangles: int, seed: int, cache: Path) -> Case:
    """The variant `seed` of `kind` with about that many triangles, from the cache or made now."""
    path = cache / f"{kind}-{triangles}-{seed}.npz"
    data = cached(path, partial(_tangled, kind, triangles, seed))
    # `from_arrays` turns clockwise triangles round; before the deformation there are none.
    undeformed = tm.MeshBatch.from_arrays(data["points"], data["triangles"])
    return Case(f"{kind} {seed}", undeformed.with_points(torch.from_numpy(data["tangled"])), data["points"], path)


def variants(count: int, triangles: int, cache: Path, first_seed: int = 0) -> list[Case]:
    """`count` cases with circle, bar and gate in turn, no two of them alike."""
    return [case(KINDS[i % 3], triangles, first_seed + i // 3, cache) for i in range(count)]


def noisy(kind: str, triangles: int, seed: int, cache: Path, part: float = 0.465) -> tm.MeshBatch:
    """The undeformed variant, its free vertices thrown by up to `part` of the local size, and still valid.

    With 0.465 about 6 of 100 edges are no longer Delaunay: 90,000 of a mesh of 1,000,000 triangles.
    """
    made = case(kind, triangles, seed, cache)
    points, faces, fixed = made.valid, made.mesh.triangles.numpy(), made.mesh.fixed.numpy()
    corner = faces.ravel()
    size = np.bincount(corner, np.repeat(double_areas(points, faces), 3)) / np.bincount(corner)
    rng = np.random.default_rng([seed, 5])
    angle, radius = rng.uniform(0, 2 * np.pi, len(points)), part * np.sqrt(size * rng.uniform(0, 1, len(points)))
    thrown = points + np.where(fixed, 0.0, radius)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    # Vertices of inverted triangles go back until there are none.
    while True:
        inverted = double_areas(thrown, faces) <= 0
        if not inverted.any():
            return made.mesh.with_points(torch.from_numpy(thrown))
        back = np.unique(faces[inverted])
        thrown[back] = points[back]


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
    sides = max(12, round(2 * math.pi * radius / (grading * gmsh_mesher.edge_length(area, triangles))))

    def displacement(points: Array) -> Array:
        on_hole = np.hypot(points[:, 0] - x, points[:, 1] - y) < 1.1 * radius
        return np.outer(on_hole, (right, up))

    hole = outlines.circle(x, y, radius, sides, grading)
    return Shape([outlines.rectangle(0, 0, length, height, 1.0), hole], area, displacement)


def _bar(x: float, width: float, height: float, right: float, grading: float) -> Shape:
    left, bottom = x - width / 2, (1 - height) / 2

    def displacement(points: Array) -> Array:
        inner = (points[:, 0] > 1e-6) & (points[:, 0] < 2 - 1e-6) & (points[:, 1] > 1e-6) & (points[:, 1] < 1 - 1e-6)
        return np.outer(inner, (right, 0.0))

    hole = outlines.rectangle(left, bottom, left + width, bottom + height, grading)
    return Shape([outlines.rectangle(0, 0, 2, 1, 1.0), hole], 2 - width * height, displacement)


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


def _tangled(kind: str, triangles: int, seed: int) -> dict[str, Array]:
    """The arrays that the cache keeps."""
    domain = shape(kind, triangles, seed)
    points, faces = gmsh_mesher.triangulate_about(domain.loops, domain.area, triangles)
    mesh = tm.MeshBatch.from_arrays(points, faces)
    target = points.copy()
    boundary = mesh.fixed.numpy()
    target[boundary] += domain.displacement(points[boundary])
    tangled = tm.femwarp(mesh, torch.from_numpy(target)).points.numpy()
    return {"points": points, "triangles": mesh.triangles.numpy(), "tangled": tangled}
