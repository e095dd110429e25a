"""Families of tangled meshes, each with one number that makes it harder.

    moved       a hole moved by so many of its diameters through a long channel, and turned by an angle on its way;
                FEMWARP moves the interior
    turned      an airfoil turned by so many degrees in its far field; FEMWARP moves the interior
    jittered    interior vertices thrown by so many local edge lengths
    scrambled   interior vertices 0: all in one point, 1: shuffled, 2: mirrored, 3: outside the domain
    mapped      a square's boundary mapped onto a letter or spiral of so many bends, the interior relaxed
    wound       a square's boundary mapped onto a round spiral of so many turns, the interior relaxed

gmsh triangulates the undeformed domains.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import torchmesh as tm
from experiments.shared import outlines
from experiments.shared.cache import cached
from torchmesh.bench import boundary
from torchmesh.bench.exact_check import double_areas
from torchmesh.bench.methods import gmsh_mesher
from torchmesh.learning.outlines import bent_band

Array = np.ndarray
# The loops of a domain, sizes as parts of the size far away, and its area.
Domain = tuple[list[Array], float]


@dataclass(frozen=True)
class Family:
    """A way to tangle: `make(mesh, value, angle, seed)` gives the new points (V, 2) of an undeformed mesh.

    values  the numbers that make it harder, in order
    unit    what they are, for a plot's axis
    turns   whether an angle in degrees makes it harder too
    """

    name: str
    domain: Callable[[int, float], Domain]
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
    """The case of that family and number.

    triangles  about so many
    grading    the mesh size at the body as a part of the size far away
    angle      degrees by which the body turns, where the family has it
    """
    kind = FAMILIES[family]

    def make() -> dict[str, Array]:
        points, faces = gmsh_mesher.triangulate_about(*kind.domain(seed, grading), triangles)
        return {"points": points, "triangles": faces}

    data = cached(cache / f"{kind.domain.__name__[1:]}-{triangles}-{grading:g}-{seed}.npz", make)
    mesh = tm.MeshBatch.from_arrays(data["points"], data["triangles"])
    turned = f" and {angle:g} degrees" if angle else ""
    name = f"{family} {value:g}{turned}, {triangles} triangles, grading {grading:g}, seed {seed}"
    return Tangle(name, mesh, mesh.with_points(kind.make(mesh, value, angle, seed)))


_RADIUS, _START = 0.5, 2.0


def _channel(seed: int, grading: float) -> Domain:
    sides = 36
    angle = 2 * np.pi * (np.arange(sides) + np.random.default_rng(seed).uniform()) / sides
    hole = np.stack([_START + _RADIUS * np.cos(angle), 3 + _RADIUS * np.sin(angle)], 1)
    return [outlines.rectangle(0, 0, 16, 6, 1.0), outlines.sized(hole, grading)], 96 - math.pi * _RADIUS**2


def _far_field(seed: int, grading: float) -> Domain:
    angle = 2 * np.pi * np.arange(48) / 48
    far = np.stack([3 * np.cos(angle), 3 * np.sin(angle)], 1)
    x = (1 - np.cos(np.linspace(0, np.pi, 32))) / 2
    y = outlines.half_thickness(x, 0.10 + 0.02 * (seed % 3))
    foil = np.concatenate([[[0, 0]], np.stack([x, y], 1)[1:-1], [[1, 0]], np.stack([x, -y], 1)[::-1][1:-1]])
    return [outlines.sized(far, 1.0), outlines.sized(foil - [0.5, 0], grading / 2)], 28.0


def _square(seed: int, grading: float) -> Domain:
    return [np.array([(x, y, s) for x, y, s in ((0, 0, grading), (1, 0, 1), (1, 1, 1), (0, 1, 1))], float)], 1.0


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
    """(2, 2) the matrix for rows of points; even seeds turn one way round, odd seeds the other."""
    a = math.radians(degrees) * (1 if seed % 2 == 0 else -1)
    return torch.tensor([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]], dtype=torch.float64)


def _jittered(mesh: tm.MeshBatch, lengths: float, angle: float, seed: int) -> torch.Tensor:
    corner = mesh.triangles.numpy().ravel()
    area = 0.5 * np.abs(double_areas(mesh.points.numpy(), mesh.triangles.numpy()))
    root = np.sqrt(np.bincount(corner, np.repeat(area, 3)) / np.bincount(corner))
    # An equilateral triangle's edge is 1.52 roots of its area.
    throw = np.random.default_rng([seed, 2]).normal(size=mesh.points.shape) * (lengths * 1.52 * root)[:, None]
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


def _mapped(mesh: tm.MeshBatch, arms: float, angle: float, seed: int) -> torch.Tensor:
    return _laid(mesh, bent_band(int(arms)), seed)


def _wound(mesh: tm.MeshBatch, turns: float, angle: float, seed: int) -> torch.Tensor:
    return _laid(mesh, outlines.spiral(turns), seed)


# Where an outline turns by less, no vertex has to stand.
_CORNER = math.radians(30)


def _laid(mesh: tm.MeshBatch, outline: Array, seed: int) -> torch.Tensor:
    """The boundary curve onto an outline by arc length, corner on corner where the spacing allows."""
    loop = boundary.loops(mesh.triangles)[0]
    closed = np.concatenate([outline, outline[:1]])
    side = np.diff(closed, axis=0)
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(side, axis=1))])
    whole = length[-1]
    at = (np.arange(len(loop)) + 0.5 * (seed % 2)) / len(loop) * whole
    before = np.roll(side, 1, axis=0)
    turn = np.arctan2(before[:, 0] * side[:, 1] - before[:, 1] * side[:, 0], (before * side).sum(1))
    # Every corner of the outline gets the vertex nearest to it along the outline.
    for c in length[:-1][np.abs(turn) > _CORNER]:
        at[np.abs((at - c + whole / 2) % whole - whole / 2).argmin()] = c
    at = np.sort(at % whole)
    points = mesh.points.clone()
    points[loop] = torch.from_numpy(np.stack([np.interp(at, length, closed[:, k]) for k in (0, 1)], 1))
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
