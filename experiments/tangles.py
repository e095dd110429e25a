"""Families of tangled meshes, each with one number that makes it harder.

    moved       a hole moved by so many of its diameters through a long channel and turned as it goes (`angle`),
                the interior carried by FEMWARP
    turned      an airfoil turned by so many degrees in its far field, carried by FEMWARP
    jittered    interior vertices thrown by so many local edge lengths
    scrambled   interior vertices 0 all in one point, 1 shuffled, 2 mirrored, 3 outside the domain
    mapped      a square's boundary mapped onto a letter or spiral of so many bends, the interior relaxed
    wound       a square's boundary mapped onto a round spiral of so many turns, likewise

gmsh triangulates the undeformed domains; meshes are kept as .npz files in a cache directory.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import torchmesh as tm
from torchmesh.mesh import connectivity

sys.path.insert(0, str(Path(__file__).parent / "benchmarks"))
from domains import Shape, double_areas, mesh_size, triangulate

Array = np.ndarray


@dataclass(frozen=True)
class Family:
    """A way to tangle: `make(mesh, value, angle, seed)` gives the new points (V, 2) of an undeformed mesh.

    values  the numbers that make it harder, in order
    unit    what they are, for a plot's axis
    turns   does an angle in degrees make it harder too?
    """

    name: str
    domain: Callable[[int, float], Shape]
    make: Callable[[tm.MeshBatch, float, float, int], torch.Tensor]
    values: tuple[float, ...]
    unit: str
    turns: bool = False


@dataclass(frozen=True)
class Tangle:
    """One case: the mesh before and after it was tangled."""

    name: str
    undeformed: tm.MeshBatch
    tangled: tm.MeshBatch


def tangle(
    family: str, value: float, triangles: int, grading: float, seed: int, cache: Path, angle: float = 0.0
) -> Tangle:
    """The case of that family and number; about so many triangles, `grading` the mesh size at the body over that
    far away."""
    kind = FAMILIES[family]
    shape = kind.domain(seed, grading)
    mesh = _undeformed(f"{kind.domain.__name__[1:]}-{triangles}-{grading:g}-{seed}", shape, triangles, cache)
    turned = f" and {angle:g} degrees" if angle else ""
    name = f"{family} {value:g}{turned}, {triangles} triangles, grading {grading:g}, seed {seed}"
    return Tangle(name, mesh, mesh.with_points(kind.make(mesh, value, angle, seed)))


def simple(mesh: tm.MeshBatch) -> bool:
    """Is the boundary a simple polygon with simple, disjoint holes inside it?  By shapely, without torchmesh's own
    diagnosis."""
    import shapely

    twin = connectivity.twins(mesh.triangles)
    loops = connectivity.boundary_loops(connectivity.boundary_edges(mesh.triangles, twin))
    rings = [shapely.LinearRing(mesh.points[loop].numpy()) for loop in loops]
    rings.sort(key=lambda ring: -shapely.Polygon(ring).area)
    return all(ring.is_simple for ring in rings) and bool(shapely.Polygon(rings[0], rings[1:]).is_valid)


def _undeformed(name: str, shape: Shape, triangles: int, cache: Path) -> tm.MeshBatch:
    path = cache / f"{name}.npz"
    if not path.exists():
        cache.mkdir(parents=True, exist_ok=True)
        size = mesh_size(shape.area, triangles)
        # Boundary and grading make the count differ from what the size promises: again with what was learnt.
        for _ in range(3):
            points, faces = triangulate(shape, size)
            size *= math.sqrt(len(faces) / triangles)
        partial = path.with_suffix(".partial.npz")
        np.savez(partial, points=points, triangles=faces)
        partial.rename(path)
    data = np.load(path)
    return tm.MeshBatch.from_arrays(data["points"], data["triangles"])


_RADIUS, _START = 0.5, 2.0


def _channel(seed: int, grading: float) -> Shape:
    sides = 36
    angle = 2 * np.pi * (np.arange(sides) + np.random.default_rng(seed).uniform()) / sides
    hole = np.stack([_START + _RADIUS * np.cos(angle), 3 + _RADIUS * np.sin(angle), np.full(sides, grading)], 1)
    far = np.array([(x, y, 1.0) for x, y in ((0, 0), (16, 0), (16, 6), (0, 6))])
    return Shape([far, hole], 96 - math.pi * _RADIUS**2, lambda points: points)


def _far_field(seed: int, grading: float) -> Shape:
    angle = 2 * np.pi * np.arange(48) / 48
    far = np.stack([3 * np.cos(angle), 3 * np.sin(angle), np.ones(48)], 1)
    s = np.linspace(0, np.pi, 32)
    x = (1 - np.cos(s)) / 2
    # NACA 00xx with a closed trailing edge (Abbott & von Doenhoff 1959, equation 6.2).
    thick = 5 * (0.10 + 0.02 * (seed % 3))
    y = thick * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    foil = np.concatenate([[[0, 0]], np.stack([x, y], 1)[1:-1], [[1, 0]], np.stack([x, -y], 1)[::-1][1:-1]])
    return Shape([far, np.insert(foil - [0.5, 0], 2, grading / 2, 1)], 28.0, lambda points: points)


def _square(seed: int, grading: float) -> Shape:
    corners = np.array([(x, y, s) for x, y, s in ((0, 0, grading), (1, 0, 1), (1, 1, 1), (0, 1, 1))], float)
    return Shape([corners], 1.0, lambda points: points)


def _moved(mesh: tm.MeshBatch, diameters: float, angle: float, seed: int) -> torch.Tensor:
    up = np.random.default_rng([seed, 1]).uniform(-1.0, 1.0)
    start = torch.tensor([_START, 3.0], dtype=torch.float64)
    hole = mesh.fixed & ((mesh.points - start).norm(dim=1) < 1.1 * _RADIUS)
    there = start + torch.tensor([diameters * 2 * _RADIUS, up], dtype=torch.float64)
    goal = (mesh.points - start) @ _turn(angle, seed) + there
    return tm.femwarp(mesh, torch.where(hole[:, None], goal, mesh.points)).points


def _turned(mesh: tm.MeshBatch, degrees: float, angle: float, seed: int) -> torch.Tensor:
    foil = mesh.fixed & (mesh.points.norm(dim=1) < 1)
    return tm.femwarp(mesh, torch.where(foil[:, None], mesh.points @ _turn(degrees, seed), mesh.points)).points


def _turn(degrees: float, seed: int) -> torch.Tensor:
    """(2, 2) the matrix, for rows of points: one way round for even seeds, the other for odd ones."""
    a = math.radians(degrees) * (1 if seed % 2 == 0 else -1)
    return torch.tensor([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]], dtype=torch.float64)


def local_length(mesh: tm.MeshBatch) -> Array:
    """(V,) root of the mean area round each vertex: about two thirds of an edge."""
    corner = mesh.triangles.numpy().ravel()
    area = 0.5 * np.abs(double_areas(mesh.points.numpy(), mesh.triangles.numpy()))
    return np.sqrt(np.bincount(corner, np.repeat(area, 3)) / np.bincount(corner))


def _jittered(mesh: tm.MeshBatch, cells: float, angle: float, seed: int) -> torch.Tensor:
    # An equilateral triangle's edge is 1.52 roots of its area.
    throw = (
        np.random.default_rng([seed, 2]).normal(size=mesh.points.shape) * (cells * 1.52 * local_length(mesh))[:, None]
    )
    return torch.where(mesh.fixed[:, None], mesh.points, mesh.points + torch.from_numpy(throw))


def _scrambled(mesh: tm.MeshBatch, how: float, angle: float, seed: int) -> torch.Tensor:
    free = (~mesh.fixed).nonzero().squeeze(1)
    points = mesh.points.clone()
    low, high = points.amin(0), points.amax(0)
    if how == 0:
        points[free] = low + 0.37 * (high - low)
    elif how == 1:
        points[free] = points[free[torch.from_numpy(np.random.default_rng([seed, 3]).permutation(len(free)))]]
    elif how == 2:
        points[free, 0] = low[0] + high[0] - points[free, 0]
    else:
        points[free] = points[free] + 2 * (high - low)
    return points


def letter(arms: int) -> Array:
    """(N, 2) the outline, counter-clockwise, of a band that winds: 1 an L, 2 a U, 4 a G, 6 and more a spiral."""
    steps, place, heading = [np.array([0.0, 0.0])], np.array([0.0, 0.0]), np.array([1.0, 0.0])
    for arm in range(arms + 1):
        place = place + heading * (1.0 + (arms - arm) // 2)
        steps.append(place)
        heading = np.array([-heading[1], heading[0]])
    line = np.array(steps)
    half = 0.2
    sides = []
    for sign in (-1, 1):
        side = []
        for i, p in enumerate(line):
            before, after = (line[i] - line[i - 1] if i else None), (line[i + 1] - p if i + 1 < len(line) else None)
            normals = [np.array([-d[1], d[0]]) / np.linalg.norm(d) for d in (before, after) if d is not None]
            side.append(p + sign * half * (normals[0] if len(normals) == 1 else normals[0] + normals[1]))
        sides.append(np.array(side))
    return np.concatenate([sides[0], sides[1][::-1]])


def spiral(turns: float) -> Array:
    """(N, 2) the outline, counter-clockwise, of a strip of constant width wound so many times."""
    steps = max(24, round(48 * turns))
    angle = np.linspace(0, 2 * np.pi * turns, steps)
    radius = 0.6 + angle / (2 * np.pi)
    ray = np.stack([np.cos(angle), np.sin(angle)], 1)
    return np.concatenate([(radius + 0.2)[:, None] * ray, ((radius - 0.2)[:, None] * ray)[::-1]])


def _mapped(mesh: tm.MeshBatch, arms: float, angle: float, seed: int) -> torch.Tensor:
    return _laid(mesh, letter(int(arms)), seed)


def _wound(mesh: tm.MeshBatch, turns: float, angle: float, seed: int) -> torch.Tensor:
    return _laid(mesh, spiral(turns), seed)


# Where an outline turns by less, no vertex has to stand.
_CORNER = math.radians(30)


def _laid(mesh: tm.MeshBatch, outline: Array, seed: int) -> torch.Tensor:
    """The boundary loop onto an outline by arc length, corner on corner where the spacing allows."""
    loop = connectivity.boundary_loops(connectivity.boundary_edges(mesh.triangles, connectivity.twins(mesh.triangles)))[
        0
    ]
    closed = np.concatenate([outline, outline[:1]])
    side = np.diff(closed, axis=0)
    place = np.concatenate([[0.0], np.cumsum(np.linalg.norm(side, axis=1))])
    at = (np.arange(len(loop)) + 0.5 * (seed % 2)) / len(loop) * place[-1]
    before = np.roll(side, 1, axis=0)
    turn = np.arctan2(before[:, 0] * side[:, 1] - before[:, 1] * side[:, 0], (before * side).sum(1))
    # Every corner of the outline gets the vertex nearest to it along the outline.
    for c in place[:-1][np.abs(turn) > _CORNER]:
        at[np.abs((at - c + place[-1] / 2) % place[-1] - place[-1] / 2).argmin()] = c
    at = np.sort(at % place[-1])
    points = mesh.points.clone()
    places = np.stack([np.interp(at, place, closed[:, k]) for k in (0, 1)], 1)
    points[loop] = torch.from_numpy(places)
    return tm.relax(mesh.with_points(points)).points


FAMILIES = {
    family.name: family
    for family in (
        Family("moved", _channel, _moved, (1, 2, 4, 8, 12), "diameters moved", turns=True),
        Family("turned", _far_field, _turned, (15, 30, 60, 90, 120, 150, 180), "degrees turned"),
        Family("jittered", _channel, _jittered, (0.15, 0.3, 0.5, 1, 2, 4), "edge lengths thrown"),
        Family("scrambled", _channel, _scrambled, (0, 1, 2, 3), "one point, shuffled, mirrored, outside"),
        Family("mapped", _square, _mapped, (1, 2, 3, 4, 6, 8), "bends of the letter"),
        Family("wound", _square, _wound, (0.5, 1, 1.5, 2, 3), "turns of the spiral"),
    )
}
