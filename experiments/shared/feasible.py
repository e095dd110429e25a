"""Tangled meshes for which a valid mesh with the same triangles and boundary is known, since they are made from one.

A case is a valid mesh whose free vertices were then put elsewhere.  Its name, such as "spiral-600-3-laplace", makes it
again: the kind of domain, about how many triangles, the seed, and where the free vertices were put.

    letter    a block letter, some with holes          turned    an annulus whose inner circle turns by an angle;
    spiral    a strip wound 0.6 to 3 times                       the known mesh is twisted in between
    comb      a comb of 3 to 8 teeth                   bent      one of the others, bent by a smooth map
    annulus   a ring                                   holes     a rectangle with one to five holes

    laplace   at the means of their neighbours         point     all in one position
    random    anywhere in the box round the mesh
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch

import torchmesh as tm
from torchmesh.bench.exact_check import double_areas
from torchmesh.learning import families
from torchmesh.learning.outlines import LETTERS, letter_loops, regular_polygon, spiral_loop
from torchmesh.triangulating.mesher import Outline, mesh_outline

Array = np.ndarray
INTERIORS = ("laplace", "point", "random")


@dataclass(frozen=True)
class Case:
    """A valid mesh, and the same with its free vertices put elsewhere."""

    name: str
    valid: tm.MeshBatch
    tangled: tm.MeshBatch


def _letter(rng: np.random.Generator) -> Outline:
    loops = letter_loops(str(rng.choice(list(LETTERS))))
    return Outline(loops, (1.0,) * len(loops), 0.2)


def _spiral(rng: np.random.Generator) -> Outline:
    return Outline((spiral_loop(rng.uniform(0.6, 3.0), rng.uniform(0.3, 0.8)),), (1.0,), 0.2)


def _comb(rng: np.random.Generator) -> Outline:
    teeth, tall, thick = int(rng.integers(3, 9)), rng.uniform(0.5, 3.0), rng.uniform(0.2, 0.7)
    corners = [(0.0, 0.0), (teeth - 1 + thick, 0.0)]
    for k in reversed(range(teeth)):
        corners += [(k + thick, 0.4 + tall), (k, 0.4 + tall)] + ([(k, 0.4), (k - 1 + thick, 0.4)] if k else [])
    return Outline((np.array(corners),), (1.0,), 0.2)


def _annulus(rng: np.random.Generator) -> Outline:
    return ring(rng.uniform(0.1, 0.7))


def ring(inner: float) -> Outline:
    outer = regular_polygon(120)
    return Outline((outer, inner * outer[::-1]), (1.0, 1.0), 0.2)


def _holes(rng: np.random.Generator) -> Outline:
    return families.holes(rng).outline


DOMAINS: dict[str, Callable[[np.random.Generator], Outline]] = {
    "letter": _letter,
    "spiral": _spiral,
    "comb": _comb,
    "annulus": _annulus,
    "holes": _holes,
}
KINDS = (*DOMAINS, "turned", "bent")


def case(name: str) -> Case:
    """The case of that name."""
    kind, triangles, seed, interior = name.split("-")
    rng = np.random.default_rng([int(seed), int(triangles), KINDS.index(kind)])
    made = {"turned": _turned, "bent": _bent}.get(kind)
    valid = made(rng, int(triangles)) if made else meshed(DOMAINS[kind](rng), rng, int(triangles))
    return Case(name, valid, _put(valid, interior, rng))


def names(count: int, triangles: int, first_seed: int = 0) -> Iterator[str]:
    """The names of `count` cases: kinds and interiors in turn, then the next seed."""
    for number in range(count):
        seed, which = divmod(number, len(KINDS) * len(INTERIORS))
        yield f"{KINDS[which % len(KINDS)]}-{triangles}-{first_seed + seed}-{INTERIORS[which // len(KINDS)]}"


def meshed(outline: Outline, rng: np.random.Generator, triangles: int) -> tm.MeshBatch:
    return tm.MeshBatch.from_arrays(*mesh_outline(outline, triangles, rng)[:2])


def twisted(points: Array, inner: float, angle: float) -> Array:
    """(V, 2) a ring between the radii `inner` and 1 whose inner circle turns by `angle` radians, the outer one not."""
    radius = np.hypot(*points.T)
    part = np.clip(np.log(np.maximum(radius, inner)) / math.log(inner), 0, 1)
    return families._turned(points, angle * part)


def _turned(rng: np.random.Generator, triangles: int) -> tm.MeshBatch:
    """The largest of some turns, up to a half one, for which the twisted mesh is valid."""
    inner = rng.uniform(0.1, 0.5)
    mesh = meshed(ring(inner), rng, triangles)
    for angle in (rng.uniform(0.5, 1.0) * np.linspace(1, 0, 20)) * math.pi * rng.choice([-1, 1]):
        moved = twisted(mesh.points.numpy(), inner, angle)
        if (double_areas(moved, mesh.triangles.numpy()) > 0).all():
            break
    return mesh.with_points(torch.from_numpy(moved))


def _bent(rng: np.random.Generator, triangles: int) -> tm.MeshBatch:
    """A mesh under the strongest of some smooth maps for which it stays valid."""
    mesh = meshed(DOMAINS[str(rng.choice(list(DOMAINS)))](rng), rng, triangles)
    points = mesh.points.numpy()
    low, high = points.min(0), points.max(0)
    at = (points - (low + high) / 2) / (high - low).max()
    twist, waves = rng.uniform(-4, 4), rng.normal(0, 0.1, (3, 2))
    frequency, phase = rng.uniform(3, 12, (3, 2)), rng.uniform(0, 2 * np.pi, 3)
    for part in 0.8 ** np.arange(40):
        bent = at + part * np.sin(at @ frequency.T + phase) @ waves
        bent = families._turned(bent, part * twist * (bent**2).sum(1))
        if (double_areas(bent, mesh.triangles.numpy()) > 0).all():
            break
    return mesh.with_points(torch.from_numpy(bent))


def _put(valid: tm.MeshBatch, interior: str, rng: np.random.Generator) -> tm.MeshBatch:
    if interior == "laplace":
        return tm.relax(valid)
    low, high = valid.points.amin(0).numpy(), valid.points.amax(0).numpy()
    count = 1 if interior == "point" else len(valid.points)
    there = torch.from_numpy(rng.uniform(low, high, (count, 2)))
    return valid.with_points(torch.where(valid.fixed[:, None], valid.points, there))
