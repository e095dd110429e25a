"""A mesh with quads from arrays as people have them: checked, wound alike, or refused with the reason."""

import warnings
from typing import Any

import torch
from torch import Tensor

from ..errors import InvalidMeshError, MeshWarning
from . import connectivity
from .validation import (
    checked_constraints,
    checked_faces,
    checked_fixed,
    checked_points,
    checked_positions,
    checked_triangles,
    seen_from_above,
    to_plane,
)
from .winding import oriented


def halves_of(quads: Tensor) -> Tensor:
    """(2Q, 3) the halves abc and cda of each quad, one after the other."""
    a, b, c, d = quads.unbind(1)
    return torch.stack([torch.stack([a, b, c], 1), torch.stack([c, d, a], 1)], 1).reshape(-1, 3)


def mixed_columns(points: Any, triangles: Any, fixed: Any, constrained_edges: Any, quads: Any) -> dict[str, Tensor]:
    """The columns of the one mesh that `MeshBatch.from_arrays` makes of these; errors and warnings are as there."""
    xyz = checked_points(points)
    count = len(xyz)
    faces = torch.zeros((0, 3), dtype=torch.int64)
    if triangles is not None and len(triangles):
        faces = checked_triangles(triangles, count)
    rows = checked_quads(quads, count)
    faces, rows = faces.to(xyz.device), rows.to(xyz.device)
    _refuse_shared_edges(faces, rows, count)
    rows = _with_free_diagonals(faces, rows, count)
    halves = torch.cat([faces, halves_of(rows)])
    xyz = checked_positions(xyz, halves)
    flat, frame = to_plane(xyz, halves)
    seen = seen_from_above(flat, halves, frame)
    wound, turned = _wound(flat, halves, seen)
    against = turned if seen is halves else ~turned
    faces, rows = wound[: len(faces)], torch.where(turned[len(faces) :: 2][:, None], rows[:, [0, 3, 2, 1]], rows)
    halves = torch.cat([faces, halves_of(rows)])
    number = int(against[: len(faces)].sum()) + int(against[len(faces) :: 2].sum())
    if number:
        text = f"{number} of {len(faces) + len(rows)} triangles and quads were wound against the others"
        text = "all triangles and quads were wound clockwise" if bool(against.all()) else text
        warnings.warn(MeshWarning(f"{text}; they were turned"), stacklevel=3)
    twin = connectivity.twins(halves)
    used = torch.zeros(count, dtype=torch.bool, device=flat.device)
    used[halves.reshape(-1)] = True
    if not bool(used.all()):
        text = f"{int((~used).sum())} vertices belong to no triangle and no quad; they are kept"
        warnings.warn(MeshWarning(text), stacklevel=3)
    kept = checked_constraints(constrained_edges, halves, twin, count)
    _refuse_diagonals(kept, faces, rows, count)
    mask = checked_fixed(fixed, count, flat.device)
    ends = (torch.tensor([0, n], device=flat.device) for n in (count, len(faces), len(rows)))
    point_offsets, triangle_offsets, quad_offsets = ends
    return {
        "points": flat,
        "triangles": faces,
        "fixed": mask | ~used | connectivity.boundary_vertices(halves, twin, count),
        "constrained_edges": kept,
        "point_offsets": point_offsets,
        "triangle_offsets": triangle_offsets,
        "frames": frame[None],
        "quads": rows,
        "quad_offsets": quad_offsets,
    }


def checked_quads(quads: Any, vertices: int) -> Tensor:
    """(Q, 4) int64 rows of points; raises InvalidMeshError, naming the row, for anything else."""
    rows = checked_faces(quads, vertices, 4, "quads")
    order = rows.sort(1).values
    repeated = (order[:, 1:] == order[:, :-1]).any(1)
    if bool(repeated.any()):
        row = int(repeated.nonzero()[0])
        raise InvalidMeshError(
            f"quads row {row} is {rows[row].tolist()}: a quad needs four different vertices; "
            "torchmesh clean IN OUT (tm.clean) mends this"
        )
    return rows


def _wound(flat: Tensor, halves: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
    """The triangles, which are `seen` like this, with consistent winding, and (N,) bool which of them were turned."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)
        wound, _ = oriented(flat, seen)
    return wound, (wound != halves).any(1)


def _refuse_shared_edges(faces: Tensor, quads: Tensor, vertices: int) -> None:
    """Raise InvalidMeshError, naming the rows, for an edge of more than two triangles and quads."""
    sides = [(f, f.roll(-1, 1)) for f in (faces, quads)]
    keys = torch.cat([connectivity.edge_keys(u.reshape(-1), v.reshape(-1), vertices) for u, v in sides])
    owner = torch.cat([torch.arange(f.numel(), device=f.device) // f.shape[1] for f in (faces, quads)])
    order = keys.argsort(stable=True)
    same = keys[order][2:] == keys[order][:-2]
    if bool(same.any()):
        first = int(same.nonzero()[0])
        three = sorted(order[first : first + 3].tolist())
        names = [f"{'triangles' if h < faces.numel() else 'quads'} row {int(owner[h])}" for h in three]
        edge = [int(keys[three[0]]) // vertices, int(keys[three[0]]) % vertices]
        raise InvalidMeshError(
            f"{names[0]}, {names[1]} and {names[2]} share the edge {edge}: an edge may have two triangles or quads at "
            "most; torchmesh clean IN OUT (tm.clean) mends this where one is there twice"
        )


def _with_free_diagonals(faces: Tensor, quads: Tensor, vertices: int) -> Tensor:
    """The quads, begun at another corner where the diagonal from the first one is an edge of some element.

    So it is beside a quad that turns inwards.  Raises InvalidMeshError, naming the row, where both diagonals are edges.
    """
    sides = [connectivity.edge_keys(f.reshape(-1), f.roll(-1, 1).reshape(-1), vertices) for f in (faces, quads)]
    edges = torch.cat(sides)
    first, second = (torch.isin(connectivity.edge_keys(quads[:, k], quads[:, k + 2], vertices), edges) for k in (0, 1))
    if bool((first & second).any()):
        row = int((first & second).nonzero()[0])
        raise InvalidMeshError(
            f"quads row {row} is {quads[row].tolist()}: both of its diagonals are edges of other triangles or quads, "
            "which lie over it"
        )
    return torch.where(first[:, None], quads.roll(-1, 1), quads)


def _refuse_diagonals(edges: Tensor, faces: Tensor, quads: Tensor, vertices: int) -> None:
    """Raise InvalidMeshError for constrained edges (K, 2) that are no edges of triangles or quads."""
    sides = [connectivity.edge_keys(f.reshape(-1), f.roll(-1, 1).reshape(-1), vertices) for f in (faces, quads)]
    missing = ~torch.isin(connectivity.keys_of(edges, vertices), torch.cat(sides))
    if bool(missing.any()):
        edge = edges[missing][0].tolist()
        raise InvalidMeshError(f"constrained_edges: {edge} is the diagonal of a quad, and no edge of the mesh")
