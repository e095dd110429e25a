"""Quads among the triangles of a mesh: what they are checked for, and the forms in which the algorithms see them.

d-------c       A quad is upright if all four triangles of a corner and its two neighbours are: dab, abc, bcd, cda.
|     / |       If one of them is not, the quad is folded or has a corner of 180 degrees or more, and the map from
|   /   |       the unit square is not one to one (Knupp, Achieving finite element mesh quality via optimization of
| /     |       the Jacobian matrix norm, International Journal for Numerical Methods in Engineering 48, 2000).
a-------b

A batch that a caller sees has its quads beside its triangles.  Inside of the package it may have one of two other
forms, in which rows of `triangles` stand for the quads, too, behind the triangles of each mesh:

    halves   two rows a quad, abc and cda: a mesh of triangles only, with all that connectivity tells.  The edges of
             quads and their diagonals count as constrained, and both halves are upright only if the quad is
    samples  four rows a quad, one for each corner, which comes first: what an energy is summed over, and what moves
             vertices.  These triangles lie over each other, so connectivity tells nothing of them
"""

import functools
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from . import connectivity
from .batch import MeshBatch
from .mixed_arrays import halves_of
from .predicates import orientation
from .ragged import offsets_from_counts, segment_ids
from .triangle import corners, mean_ratio

_P = ParamSpec("_P")
_R = TypeVar("_R")

HALVES, SAMPLES = 2, 4


def inverted_quads(points: Tensor, quads: Tensor) -> Tensor:
    """(Q,) bool: a corner of the quad is not upright, by exact sign.

    points  (V, 2)
    quads   (Q, 4) int64, counter-clockwise where a quad is upright
    """
    x, y = points.to(torch.float64).unbind(1)
    corners = [quads.roll(-k, 1).unbind(1) for k in range(4)]
    signs = [orientation(x[a], y[a], x[b], y[b], x[c], y[c]) for a, b, c, _ in corners]
    return (torch.stack(signs) <= 0).any(0)


def corners_of_quads(quads: Tensor) -> Tensor:
    """(4Q, 3) the corners abd, bca, cdb, dac of each quad: the corner, the next one and the one before it."""
    return torch.stack([quads, quads.roll(-1, 1), quads.roll(1, 1)], 2).reshape(-1, 3)


# --- forms ---


def has_quads(batch: MeshBatch) -> bool:
    """Whether the batch has quads beside its triangles, in the form that callers see."""
    return len(batch.quads) > 0 and batch.rows_per_quad == 0


def halved(batch: MeshBatch) -> MeshBatch:
    """The batch with the halves of its quads among the triangles; without quads it is the batch itself."""
    return _expanded(batch, halves_of(batch.quads), HALVES) if has_quads(batch) else batch


def sampled(batch: MeshBatch) -> MeshBatch:
    """The batch with the corners of its quads among the triangles; without quads it is the batch itself."""
    if not len(batch.quads) or batch.rows_per_quad == SAMPLES:
        return batch
    return _expanded(whole(batch), corners_of_quads(batch.quads), SAMPLES)


def whole(batch: MeshBatch) -> MeshBatch:
    """The batch in the form that callers see: quads beside the triangles, and no rows that stand for them."""
    if not batch.rows_per_quad:
        return batch
    return replace(
        batch,
        triangles=batch.triangles[~batch.of_quads],
        triangle_offsets=batch.triangle_offsets - batch.rows_per_quad * batch.quad_offsets,
        _rows_per_quad=0,
        _twin=None,
    )


def sample_offsets(batch: MeshBatch) -> Tensor:
    """(B+1,) the offsets of the triangles of `sampled(batch)`."""
    return batch.triangle_offsets + (SAMPLES - batch.rows_per_quad) * batch.quad_offsets


def _expanded(batch: MeshBatch, rows: Tensor, count: int) -> MeshBatch:
    """The batch with `rows` (count Q, 3) behind the triangles of each mesh."""
    triangles = torch.cat([batch.triangles, rows])
    if len(batch) > 1:
        of_quads = segment_ids(batch.quad_offsets).repeat_interleave(count)
        triangles = triangles[torch.cat([segment_ids(batch.triangle_offsets), of_quads]).argsort(stable=True)]
    offsets = batch.triangle_offsets + count * batch.quad_offsets
    return replace(batch, triangles=triangles, triangle_offsets=offsets, _rows_per_quad=count, _twin=None)


def diagonals(batch: MeshBatch) -> Tensor:
    """(3T,) bool, of a batch with quads as halves: the half-edges that are diagonals of quads."""
    last = torch.tensor([False, False, True], device=batch.triangles.device)
    return (batch.of_quads[:, None] & last).reshape(-1)


def edges_of(batch: MeshBatch) -> Tensor:
    """(E, 2) each edge of triangles and quads once."""
    mesh = halved(batch)
    edges = connectivity.edges(mesh.triangles, mesh.twin)
    if not len(mesh.quads):
        return edges
    across = connectivity.keys_of(mesh.quads[:, [0, 2]], len(mesh.points))
    return edges[~torch.isin(connectivity.keys_of(edges, len(mesh.points)), across)]


def triangles_alone(batch: MeshBatch) -> MeshBatch:
    """The triangles of the batch without its quads, whose vertices are fixed; those edges are then on the boundary."""
    if not len(batch.quads):
        return batch
    held = batch.fixed.index_fill(0, batch.quads.reshape(-1), True)
    plain = whole(batch)
    none = torch.zeros_like(batch.quad_offsets)
    # Constrained edges between quads alone are none of the triangles.
    keys = connectivity.keys_of(batch.constrained_edges, len(batch.points))
    tails, heads = connectivity.tails(plain.triangles), connectivity.heads(plain.triangles)
    present = torch.isin(keys, connectivity.edge_keys(tails, heads, len(batch.points)))
    edges = batch.constrained_edges[present]
    return replace(plain, fixed=held, constrained_edges=edges, quads=batch.quads[:0], quad_offsets=none)


def with_triangles_alone(batch: MeshBatch, after: MeshBatch) -> MeshBatch:
    """`batch` after its triangles alone have become `after`, row by row."""
    if not len(batch.quads):
        return after
    mask = batch.of_quads
    triangles = batch.triangles.clone()
    triangles[~mask] = after.triangles
    return replace(batch, points=after.points, triangles=triangles, _twin=None)


def refuse_quads(batch: MeshBatch, what: str) -> None:
    """Raise InvalidMeshError, in the name of `what`, for a batch with quads."""
    if len(batch.quads):
        raise InvalidMeshError(f"{what} takes meshes of triangles alone, and this batch has {len(batch.quads)} quads")


def quads_as_halves(verb: Callable[_P, _R]) -> Callable[_P, _R]:
    """`verb`, which is handed quads as halves, and whose meshes come back in the form that callers see.

    Meshes without quads are passed on as they are.
    """

    @functools.wraps(verb)
    def plain(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        if not any(isinstance(a, MeshBatch) and has_quads(a) for a in (*args, *kwargs.values())):
            return verb(*args, **kwargs)
        halves: list[Any] = [_in_halves(a) for a in args]
        named: dict[str, Any] = {name: _in_halves(a) for name, a in kwargs.items()}
        return _in_whole(verb(*halves, **named))

    return plain


def _in_halves(value: Any) -> Any:
    """The value with every mesh in it halved: a mesh itself, or one in a record of options."""
    if isinstance(value, MeshBatch):
        return halved(value)
    if is_dataclass(value) and not isinstance(value, type):
        old = {f.name: getattr(value, f.name) for f in fields(value)}
        new = {name: halved(mesh) for name, mesh in old.items() if isinstance(mesh, MeshBatch) and has_quads(mesh)}
        return replace(value, **new) if new else value
    return value


def _in_whole(value: Any) -> Any:
    """The value, a mesh or a tuple that begins with one, in the form that callers see."""
    if isinstance(value, MeshBatch):
        return whole(value)
    if isinstance(value, tuple) and value and isinstance(value[0], MeshBatch):
        return (whole(value[0]), *value[1:])
    return value


def spread_to_halves(batch: MeshBatch, of_triangles: Tensor, of_quads: Tensor) -> Tensor:
    """(T,) values over the triangles of a batch in halves, from those of its triangles and of its quads."""
    mask = batch.of_quads
    out = of_quads.new_empty(len(mask))
    out[~mask], out[mask] = of_triangles, of_quads.repeat_interleave(2)
    return out


def worst_of_samples(batch: MeshBatch, values: Tensor) -> tuple[Tensor, Tensor]:
    """The (S,) values over `sampled(batch)` as (T,) values of its triangles and (Q,) greatest values of its quads."""
    mask = sampled(batch).of_quads
    return values[~mask], values[mask].reshape(-1, SAMPLES).amax(1)


# --- quads and triangles ---


def quad_mesh(batch: MeshBatch) -> Tensor:
    """(Q,) int64 the mesh each quad belongs to."""
    return segment_ids(batch.quad_offsets)


def better_diagonals(batch: MeshBatch, chosen: Tensor) -> Tensor:
    """(K,) bool: the diagonal bd of the `chosen` (Q,) bool quads gives the better worse half, by signed mean ratio."""
    points, quads = batch.points.to(torch.float64), batch.quads[chosen]
    by_ac, by_bd = (
        mean_ratio(corners(points, halves_of(q))).reshape(-1, 2).amin(1) for q in (quads, quads.roll(-1, 1))
    )
    return by_bd > by_ac


def split_quads(batch: MeshBatch, chosen: Tensor, other: Tensor | None = None) -> MeshBatch:
    """The batch with the quads `chosen` (Q,) bool as two triangles each, behind the triangles of their mesh.

    other  (K,) bool, those of the chosen ones that the diagonal bd splits, not ac; None: the better of the two
    """
    quads = batch.quads[chosen]
    other = better_diagonals(batch, chosen) if other is None else other
    triangles = torch.cat([batch.triangles, halves_of(torch.where(other[:, None], quads.roll(-1, 1), quads))])
    owner = quad_mesh(batch)
    of = torch.cat([segment_ids(batch.triangle_offsets), owner[chosen].repeat_interleave(2)])
    less = offsets_from_counts(torch.bincount(owner[chosen], minlength=len(batch)))
    return replace(
        batch,
        triangles=triangles[of.argsort(stable=True)],
        triangle_offsets=batch.triangle_offsets + 2 * less,
        quads=batch.quads[~chosen],
        quad_offsets=batch.quad_offsets - less,
        _twin=None,
    )
