"""Certificates: why a mesh cannot be valid, as plain data that another program can check without this package.

    {"points": [[x, y], ...], "triangles": [[a, b, c], ...], "fixed": [v, ...], "certificates": [{"kind": ..., ...}]}

Numbers are written so that they are read back to the bit.  Each certificate says what kind it is:

    fixed triangle   "triangle": three fixed vertices, which do not turn to the left
    empty kernel     "vertex", "edges", "weights": the fixed edges of three of its triangles, and weights by which their
                     left sides have nothing in common (Farkas)
    edges meet       "edges": two edges of fixed vertices that meet, which edges of a valid mesh do not
    vertex outside   "vertex": a fixed vertex that the boundary does not go round to the left
    point outside    "point": a point that the boundary goes round to the right, so that no upright triangles cover it
    turns            "triangle": of that triangle's piece the boundary turns round less often than its Euler number
    handles          "triangle": that triangle's piece has handles, which no part of a plane has
    no place         "vertex", "cells", "steps": as in `no_place_steps.NoPlace`, each step as [vertex, place, neighbour]

`experiments/robustness/check_certificates.py` is such a program.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..mesh.batch import MeshBatch
from ..mesh.connectivity import boundary_edges
from ..triangulating.polygon import loop_edges, loops_of, turns_left
from .polygon_kernel import farkas_weights
from .problems import Problem, ProblemKind

# So close to an edge a point is looked for that the boundary goes round the wrong way, in halves of its length.
_HALVINGS = 40


def certificates(mesh: MeshBatch, problems: Sequence[Problem]) -> dict[str, Any]:
    """The mesh and what certifies its problems, as plain data; problems without a certificate are left out.

    mesh      one mesh
    problems  what `diagnose` found in it
    """
    given: list[dict[str, Any]] = []
    for problem in problems:
        found = _certificate(mesh, problem)
        if found is not None and found not in given:
            given.append(found)
    crossing = (ProblemKind.BOUNDARY_CROSSING, ProblemKind.DUPLICATE_VERTICES)
    if any(problem.kind in crossing for problem in problems):
        given += _turns(mesh)
    return {
        "points": mesh.points.detach().to("cpu", torch.float64).tolist(),
        "triangles": mesh.triangles.tolist(),
        "fixed": mesh.fixed.nonzero().squeeze(1).tolist(),
        "certificates": given,
    }


def write_certificates(path: Path | str, mesh: MeshBatch, problems: Sequence[Problem]) -> int:
    """Write the certificates of one mesh as a file of JSON; how many are there?"""
    data = certificates(mesh, problems)
    Path(path).write_text(json.dumps(data) + "\n", encoding="utf-8")
    return len(data["certificates"])


def _certificate(mesh: MeshBatch, problem: Problem) -> dict[str, Any] | None:
    kind, vertices = problem.kind, list(problem.vertices)
    points, triangles, fixed = _arrays(mesh)
    if kind is ProblemKind.FIXED_TRIANGLE:
        return {"kind": "fixed triangle", "triangle": vertices}
    if kind is ProblemKind.NO_KERNEL:
        return _kernel(points, triangles, fixed, vertices[0])
    if kind in (ProblemKind.FIXED_EDGE, ProblemKind.CONSTRAINT_CROSSING) and len(vertices) == 4:
        return {"kind": "edges meet", "edges": [vertices[:2], vertices[2:]]}
    if kind is ProblemKind.NO_PLACE and problem.proof is not None:
        proof = problem.proof
        steps = [[step.vertex, list(step.place), step.neighbour] for step in proof.steps]
        return {"kind": "no place", "vertex": proof.vertex, "cells": proof.cells.tolist(), "steps": steps}
    boundary = boundary_edges(mesh.triangles, mesh.twin).cpu().numpy()
    if kind is ProblemKind.VERTEX_OUTSIDE and len(vertices) == 1 and fixed[vertices[0]]:
        around = _rounds(points, boundary, points[vertices[0]])
        return None if around is None or around > 0 else {"kind": "vertex outside", "vertex": vertices[0]}
    if kind in (ProblemKind.NO_AREA, ProblemKind.HOLE_OUTSIDE):
        at = _outside(points, boundary)
        return None if at is None else {"kind": "point outside", "point": at}
    if kind is ProblemKind.NOT_PLANE and "handle" in problem.message:
        row = int(np.flatnonzero((triangles == vertices[0]).any(1))[0])
        return {"kind": "handles", "triangle": row}
    return None


def _arrays(mesh: MeshBatch) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    points = mesh.points.detach().to("cpu", torch.float64).numpy()
    return points, mesh.triangles.cpu().numpy(), mesh.fixed.cpu().numpy()


def _kernel(points: np.ndarray, triangles: np.ndarray, fixed: np.ndarray, v: int) -> dict[str, Any] | None:
    rows, corner = np.nonzero(triangles == v)
    edges = np.stack([triangles[rows, (corner + 1) % 3], triangles[rows, (corner + 2) % 3]], 1)
    found = farkas_weights(points, edges[fixed[edges].all(1)])
    if found is None:
        return None
    three, weights = found
    return {"kind": "empty kernel", "vertex": v, "edges": three.tolist(), "weights": [str(w) for w in weights]}


def _outside(points: np.ndarray, boundary: np.ndarray) -> list[float] | None:
    """A point that the boundary goes round to the right, close to one of its edges."""
    loops = loops_of(boundary)
    turns = turns_left(points, loops)
    for loop in (loops[i] for i in np.argsort(turns, kind="stable").tolist()):
        for a, b in points[loop_edges(loop)]:
            beside = np.array([b[1] - a[1], a[0] - b[0]])
            for power in range(_HALVINGS):
                at = (a + b) / 2 + 0.5**power * beside
                if (_rounds(points, boundary, at) or 0) < 0:
                    return [float(v) for v in at]
                if power > 3:
                    break
    return None


def _rounds(points: np.ndarray, boundary: np.ndarray, at: np.ndarray) -> int | None:
    """How often the boundary goes round the point to the left, by exact signs; None if the point is on it."""
    from ..triangulating.arrays import signs

    xy = np.concatenate([points, at[None]])
    a, b = boundary.T
    here = np.full(len(a), len(points))
    side = signs(xy, a, b, here)
    above_a, above_b = points[a, 1] > at[1], points[b, 1] > at[1]
    low, high = np.minimum(points[a], points[b]), np.maximum(points[a], points[b])
    if bool(((side == 0) & (low <= at).all(1) & (at <= high).all(1)).any()):
        return None
    up, down = ~above_a & above_b & (side > 0), above_a & ~above_b & (side < 0)
    return int(up.sum()) - int(down.sum())


def _turns(mesh: MeshBatch) -> Iterator[dict[str, Any]]:
    """The pieces of a mesh whose boundaries turn too little."""
    from ..mesh.connectivity import triangle_components
    from .turning import turns_too_little

    label = triangle_components(mesh.triangles, mesh.twin)
    for piece in range(int(label.max()) + 1 if len(label) else 0):
        rows = (label == piece).nonzero().squeeze(1)
        part = MeshBatch.from_arrays(*_of(mesh, mesh.triangles[rows]))
        if bool(turns_too_little(part)):
            yield {"kind": "turns", "triangle": int(rows[0])}


def _of(mesh: MeshBatch, triangles: torch.Tensor) -> tuple[np.ndarray, np.ndarray]:
    used, named = triangles.unique(return_inverse=True)
    return mesh.points[used].detach().cpu().double().numpy(), named.cpu().numpy()
