"""The fields of a file for a mesh whose vertices moved: interpolated, carried with the vertices, or dropped.

Values belong to places.  Where a vertex or a triangle is somewhere else than before, its value is read there from the
mesh before.  What names a vertex, and what says how a vertex moves, belongs to the vertex and rides with it.
"""

import functools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
import torch

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch
from ..mesh.quads import halved, split_quads
from ..transferring.quads import from_halves
from ..transferring.transfer import Transfer, prepared
from .placed import Placed
from .quadratic_transfer import prepared_through_nodes

FieldChoice = Literal["interpolate", "carry", "drop"]

# Names of vectors that say how a vertex moves or moved, in lower case and without anything that is no letter; the
# last letter may also be x, y or z, for one component.
MOTIONS = (
    "displacement", "displacements", "disp", "displ", "deformation", "motion", "meshdisplacement", "meshmotion",
    "pointdisplacement", "nodedisplacement", "nodaldisplacement", "totaldisplacement",
)  # fmt: skip


def is_motion(name: str) -> bool:
    """Does the name mean a vector of motion (`MOTIONS`)?"""
    letters = "".join(c for c in name.lower() if c.isalpha())
    return letters in MOTIONS or (letters[:-1] in MOTIONS and letters[-1:] in tuple("xyz"))


def is_floating(values: np.ndarray) -> bool:
    """Are the values numbers that can be averaged?"""
    return values.dtype.kind in "fc"


def check_choice(choice: str) -> None:
    """Raises ValueError for what is no `FieldChoice`."""
    if choice not in get_args(FieldChoice):
        raise ValueError(f"fields must be one of {', '.join(get_args(FieldChoice))}, not {choice!r}")


def mesh_of_values(path: Path, given: MeshBatch, before: MeshBatch | None) -> MeshBatch:
    """The meshes that have the values of a file: `given`, which were read from it, or `before` in their place.

    Raises InvalidMeshError, naming the file to be written at `path`, if `before` has other counts.
    """
    if before is None:
        return given
    counts = [(m.point_offsets.tolist(), m.triangle_offsets.tolist()) for m in (given, before)]
    if counts[0] != counts[1]:
        sizes = [f"{len(m)} meshes, {len(m.points)} vertices and {len(m.triangles)} triangles" for m in (given, before)]
        raise InvalidMeshError(f"{path}: the values are those of {sizes[0]}, but `before` has {sizes[1]}")
    return before


@dataclass
class FieldSummary:
    """What became of the fields of a file.

    interpolated, averaged, largest, carried, dropped
                names: point fields interpolated; cell fields averaged over overlaps; cell fields that took the value of
                the largest overlap; vectors of motion, which ride with their vertices; fields left out on request
    outside     vertices outside the mesh before, which took the nearest boundary value
    tangled     vertices where the mesh before overlaps itself, so that a triangulation of its vertices took its place
    overshoots  triangles whose average over signed overlaps passes all values that it is made of
    uncovered   triangles that lie in part outside the mesh before
    missed      the part of the area before that the mesh after does not cover, whose cell values are lost
    """

    interpolated: list[str] = field(default_factory=list)
    averaged: list[str] = field(default_factory=list)
    largest: list[str] = field(default_factory=list)
    carried: list[str] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)
    outside: int = 0
    tangled: int = 0
    overshoots: int = 0
    uncovered: int = 0
    missed: float = 0.0

    def to_dict(self) -> dict[str, Any]:
        """A plain record, for JSON."""
        return dict(vars(self))

    def __add__(self, other: "FieldSummary") -> "FieldSummary":
        """Of two meshes together: names once, counts added, the larger of the lost areas."""
        names = ("interpolated", "averaged", "largest", "carried", "dropped")
        both: dict[str, Any] = {n: list(dict.fromkeys(getattr(self, n) + getattr(other, n))) for n in names}
        sums = {name: getattr(self, name) + getattr(other, name) for name in
                ("outside", "tangled", "overshoots", "uncovered")}  # fmt: skip
        return FieldSummary(**both, **sums, missed=max(self.missed, other.missed))

    def __str__(self) -> str:
        """'3 point fields interpolated (12 vertices lay outside), 1 cell field averaged'; empty without fields."""
        parts = [
            _part(self.interpolated, "point field", "interpolated",
                  [(self.outside, "vertex", "vertices", "outside the mesh before"),
                   (self.tangled, "vertex", "vertices", "in its tangle")]),
            _part(self.averaged, "cell field", "averaged over overlaps",
                  [(self.uncovered, "triangle", "triangles", "partly outside"),
                   (self.overshoots, "value", "values", "beyond the old ones")]),
            _part(self.largest, "cell field", "by largest overlap", []),
            f"carried with its vertices: {', '.join(self.carried)}" if self.carried else "",
            f"dropped: {', '.join(self.dropped)}" if self.dropped else "",
        ]  # fmt: skip
        if self.averaged and self.missed:
            parts.append(f"{self.missed:.2g} of the area before is not covered")
        return ", ".join(part for part in parts if part)


def _part(names: list[str], noun: str, done: str, counts: list[tuple[int, str, str, str]]) -> str:
    if not names:
        return ""
    remarks = [f"{n:,} {one if n == 1 else many} lay {where}" for n, one, many, where in counts if n]
    text = f"{len(names)} {noun}{'' if len(names) == 1 else 's'} {done}"
    return f"{text} ({', '.join(remarks)})" if remarks else text


class FieldTransfer:
    """Fields over the mesh `before`, which a file holds, for the mesh `after`, which takes its place.

    choice   "interpolate", or "drop": what would be interpolated is left out.  To carry fields with their vertices
             needs no transfer at all
    summary  what was done so far

    Weights are computed when they are first needed, and once for all fields.
    """

    def __init__(self, before: MeshBatch, after: MeshBatch, choice: FieldChoice = "interpolate") -> None:
        self.before, self._end = (m.with_points(m.points.detach()).to("cpu") for m in (before, after))
        self.drops = choice == "drop"
        self.summary = FieldSummary()
        self.nodes: tuple[Placed, Placed] | None = None

    @functools.cached_property
    def after(self) -> MeshBatch:
        """The mesh after, in the places from which it takes its values."""
        return self._end

    def through_nodes(self, before: "Placed", after: "Placed") -> "FieldTransfer":
        """The same for meshes with mid-side nodes, whose values at points are interpolated between all of these."""
        made = FieldTransfer(before.mesh, after.mesh, "drop" if self.drops else "interpolate")
        made.summary, made.nodes = self.summary, (before, after)
        return made

    def with_split_quads(self, gone: torch.Tensor) -> "FieldTransfer":
        """The same with the quads `gone` (Q,) bool of the mesh before as two triangles each; it adds to one summary."""
        made = FieldTransfer(split_quads(self.before, gone), self.after, "drop" if self.drops else "interpolate")
        made.summary = self.summary
        return made

    @functools.cached_property
    def unchanged(self) -> bool:
        """Is every vertex and every triangle where it was?"""
        pairs = ((self.before.points, self.after.points), (self.before.triangles, self.after.triangles))
        return all(one.shape == other.shape and bool((one == other).all()) for one, other in pairs)

    @functools.cached_property
    def _points(self) -> Transfer:
        if self.nodes is None:
            made = prepared(halved(self.before), halved(self.after), "points")
        else:
            made = prepared_through_nodes(*self.nodes)
        self.summary.outside = int(made.info.outside.sum())
        self.summary.tangled = int(made.info.tangled.sum())
        return made

    @functools.cached_property
    def _triangles(self) -> Transfer:
        made = prepared(halved(self.before), halved(self.after), "triangles")
        self.summary.uncovered = int(made.info.outside.sum())
        self.summary.missed = float(made.info.missed.max())
        return made

    def at_points(self, name: str, values: np.ndarray, old_vertex: np.ndarray) -> np.ndarray:
        """(V', ...) of point data (V, ...): interpolated, and as it was where a vertex has not moved.

        old_vertex  (V',) the row of each vertex of `after` in the file, or -1
        """
        self.summary.interpolated.append(name)
        made, _ = _applied(self._points, values)
        kept = np.flatnonzero(old_vertex >= 0)
        here, there = self.before.points.numpy()[old_vertex[kept]], self.after.points.numpy()[kept]
        still = kept[(here == there).all(1)]
        made[still] = values[old_vertex[still]]
        return made

    def in_triangles(self, name: str, values: np.ndarray) -> np.ndarray:
        """(T', ...) of cell data (T, ...): floats averaged over overlaps, others by the largest of them."""
        if not is_floating(values):
            self.summary.largest.append(name)
            return values[self._largest]
        self.summary.averaged.append(name)
        made, overshoots = _applied(self._triangles, values)
        self.summary.overshoots += overshoots
        return made

    def in_elements(self, name: str, values: np.ndarray, quads: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(T', ...) and (Q', ...) of cell data of triangles (T, ...) and quads (Q, ...).

        Both halves of a quad have its value.  A quad then takes the mean of its halves by their areas, or where the
        largest overlap counts, the value of the larger half.
        """
        if not len(quads):
            return self.in_triangles(name, values), quads
        made = torch.from_numpy(self.in_triangles(name, np.concatenate([values, np.repeat(quads, 2, 0)])))
        both = from_halves(self.after, made, mean=is_floating(values)).numpy()
        return both[: len(self.after.triangles)], both[len(self.after.triangles) :]

    @functools.cached_property
    def _largest(self) -> np.ndarray:
        """(T',) the triangle before with which each triangle shares most; of equals the first."""
        r = self._triangles.rows
        rows, columns, weights = r.rows.numpy(), r.columns.numpy(), r.weights.numpy()
        order = np.lexsort((columns, -weights, rows))
        first = order[np.concatenate([[True], np.diff(rows[order]) != 0])]
        return columns[first]


def _applied(transfer: Transfer, values: np.ndarray) -> tuple[np.ndarray, int]:
    """The values by a transfer in their own dtype, and how many overshoot."""
    wide = np.complex128 if values.dtype.kind == "c" else np.float64
    native = np.ascontiguousarray(values, values.dtype.newbyteorder("="))
    made, overshoots = transfer(torch.from_numpy(native.astype(wide)))
    return made.numpy().astype(native.dtype), int(overshoots.sum())
