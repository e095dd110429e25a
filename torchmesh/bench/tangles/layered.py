"""Layers of thin triangles, or of quads, round a body that turns in its far field.

The mesh is an O-grid of an ellipse: rows of cells whose heights grow with the distance from the wall.
"""

import numpy as np

from ...mesh.batch import MeshBatch
from ...warping.femwarp import femwarp
from ..case import Drawn, Family
from .drawing import turn


def o_grid(aspect: float, sides: int, first: float, growth: float, far: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and quads (Q, 4) of the grid; vertex j sides + i is in column i and row j, row 0 is the wall.

    first   the height of the first row
    growth  the ratio of heights of neighbouring rows
    far     how far away the last row is, at least
    """
    angle = 2 * np.pi * np.arange(sides) / sides
    wall = np.stack([0.5 * np.cos(angle), 0.5 / aspect * np.sin(angle)], 1)
    # The normal of an ellipse; lines along it do not meet outside.
    normal = np.stack([np.cos(angle) / aspect, np.sin(angle)], 1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    rows = int(np.ceil(np.log1p(far * (growth - 1) / first) / np.log(growth)))
    height = first * (growth ** np.arange(rows + 1) - 1) / (growth - 1)
    points = (wall + height[:, None, None] * normal).reshape(-1, 2)
    j, i = np.mgrid[:rows, :sides].reshape(2, -1)
    u, w = j * sides + i, j * sides + (i + 1) % sides
    return points, np.stack([w, u, u + sides, w + sides], 1)


def layers(rng: np.random.Generator, degrees: float) -> Drawn | None:
    """An ellipse with layers, turned; the first height is between 1e-4 and 1e-2 of the body's length."""
    aspect, sides = rng.uniform(1, 4), int(rng.integers(16, 40))
    first, growth = 10 ** rng.uniform(-4, -2), rng.uniform(1.2, 1.5)
    points, quads = o_grid(aspect, sides, first, growth, 2.0)
    if len(quads) > 1200:
        return None
    a, b, c, d = quads.T
    diagonal = rng.random(len(quads)) < 0.5
    one = np.where(diagonal, [a, b, c], [a, b, d]).T
    two = np.where(diagonal, [a, c, d], [b, c, d]).T
    mesh = MeshBatch.from_arrays(points, np.concatenate([one, two]))
    goal = mesh.points.clone()
    goal[:sides] = goal[:sides] @ turn(degrees * float(rng.choice([-1, 1])))
    details = {"first": float(f"{first:.3g}"), "growth": round(growth, 3), "aspect": round(aspect, 3)}
    return Drawn(mesh, femwarp(mesh, goal).points, details=details)


def quads(rng: np.random.Generator, degrees: float) -> Drawn | None:
    """An ellipse in a layer of quads, with triangles outside, turned."""
    aspect, sides = rng.uniform(1, 3), int(rng.integers(16, 40))
    first, growth = rng.uniform(0.02, 0.08), rng.uniform(1.1, 1.4)
    points, cells = o_grid(aspect, sides, first, growth, 2.0)
    if len(cells) > 800:
        return None
    layers = int(rng.integers(2, 6)) * sides
    inner, (a, b, c, d) = cells[:layers], cells[layers:].T
    outer = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    mesh = MeshBatch.from_arrays(points, outer, quads=inner)
    goal = mesh.points.clone()
    goal[:sides] = goal[:sides] @ turn(degrees * float(rng.choice([-1, 1])))
    details = {"aspect": round(aspect, 3), "first": round(first, 4), "quads": len(inner)}
    return Drawn(mesh, femwarp(mesh, goal).points, details=details)


FAMILIES = (
    Family("layers", layers, (30, 60, 90, 120, 150, 180), "degrees turned", "a body with layers, turned"),
    Family(
        "quads", quads, (30, 60, 90, 120, 150, 180), "degrees turned", "a body in quads, with triangles outside, turned"
    ),
)
