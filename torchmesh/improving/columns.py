"""Records of columns with a row a mesh or a triangle: some rows taken out of them, and put back."""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from ..mesh.measure import Quality
from ..mesh.ragged import put_rows, take, true_rows
from ..remeshing.sizing import SizeConformity

# The columns of `Quality` that have a row a triangle; the others have one a mesh.
_OF_TRIANGLES = ("area", "inverse_mean_ratio", "upright")


# Those that a batch with quads as halves is not asked for on its way: measured anew at the end.
_OF_QUADS = ("quad_area", "quad_inverse_mean_ratio", "quad_upright")


def put_where(values: Tensor, at: Tensor, part: Tensor) -> Tensor:
    """`values` (N, ...) with the rows `at` (N,) bool replaced by `part`."""
    return put_rows(values, true_rows(at), part)


def select_quality(q: Quality, at: Tensor, triangles: Tensor) -> Quality:
    """The quality of the meshes `at` (B,) bool, to which `triangles` (T,) bool belong."""
    rows = true_rows(triangles)
    columns = {f.name: getattr(q, f.name) for f in fields(q)}
    some = {n: take(v, rows) if n in _OF_TRIANGLES else v[at] for n, v in columns.items() if n not in _OF_QUADS}
    return Quality(**some, **{name: columns[name] for name in _OF_QUADS})


def put_quality(q: Quality, at: Tensor, triangles: Tensor, part: Quality) -> Quality:
    """`q` with the rows of the meshes `at` (B,) bool and of their `triangles` (T,) bool replaced by those of `part`."""
    meshes, faces = true_rows(at), true_rows(triangles)
    rows = {f.name: faces if f.name in _OF_TRIANGLES else meshes for f in fields(q) if f.name not in _OF_QUADS}
    whole = {name: put_rows(getattr(q, name), some, getattr(part, name)) for name, some in rows.items()}
    return Quality(**whole, **{name: getattr(q, name) for name in _OF_QUADS})


def select_conformity(found: SizeConformity | None, at: Tensor) -> SizeConformity | None:
    """That of the meshes `at` (B,) bool; None where there is none."""
    return None if found is None else SizeConformity(*(getattr(found, f.name)[at] for f in fields(found)))


def put_conformity(found: SizeConformity | None, at: Tensor, part: SizeConformity | None) -> SizeConformity | None:
    """`found` with the rows of the meshes `at` (B,) bool replaced by those of `part`, NaN where nothing was found."""
    if part is None:
        return found
    if found is None:
        nothing = part.mean.new_full(at.shape, torch.nan)
        found = SizeConformity(nothing, nothing, nothing)
    names = [f.name for f in fields(found)]
    return SizeConformity(*(put_where(getattr(found, name), at, getattr(part, name)) for name in names))


@dataclass(frozen=True, eq=False)
class Edits:
    """Numbers of vertices and edges that came, went and flipped under topology "full", (B,) int64 each."""

    splits: Tensor
    collapses: Tensor
    flips: Tensor
    rounds: Tensor

    @classmethod
    def none(cls, like: Tensor) -> "Edits":
        return cls(*(torch.zeros_like(like) for _ in range(4)))

    def select(self, at: Tensor) -> "Edits":
        """Those of the meshes `at` (B,) bool."""
        return Edits(*(getattr(self, f.name)[at] for f in fields(self)))

    def plus(self, more: "Edits") -> "Edits":
        """These and `more` of the same meshes."""
        return Edits(*(getattr(self, f.name) + getattr(more, f.name) for f in fields(self)))

    def put(self, at: Tensor, part: "Edits") -> "Edits":
        """These, with those of the meshes `at` (B,) bool replaced by `part`."""
        return Edits(*(put_where(getattr(self, f.name), at, getattr(part, f.name)) for f in fields(self)))
