"""The one mesh type: a batch of planar meshes of triangles and quads as a disjoint union of rows.

A mesh is its points, its triangles, and its quads if it has any.  A batch holds many meshes, one after the other, with
offsets that say which rows belong to which mesh.  A single mesh is a batch of one.
"""

import dataclasses
import itertools
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from ..errors import InvalidMeshError, MeshWarning
from . import connectivity
from .numbers import numbers_of
from .ragged import (
    counts_from_offsets,
    offsets_from_counts,
    owner_of,
    put_rows,
    rows_of,
    rows_of_each,
    segment_ids,
    shifted,
    spread,
    take,
    true_rows,
)
from .rows import check_rows
from .typed import check_meshes
from .validation import (
    checked_constraints,
    checked_fixed,
    checked_points,
    checked_positions,
    checked_triangles,
    seen_from_above,
    to_plane,
)
from .winding import oriented


@dataclass(frozen=True, eq=False)
class MeshBatch:
    """B planar meshes of triangles and quads, each of which owns a contiguous run of rows.

    points             (V, 2) float64 or float32, in any one length unit
    triangles          (T, 3) int64, rows of points; counter-clockwise unless the triangle is inverted
    fixed              (V,) bool, the vertices that nothing may move: the boundary, and what the user has fixed
    constrained_edges  (K, 2) int64, interior edges that no flip may remove: interfaces (`mesh.interfaces`)
    point_offsets      (B+1,) int64; mesh b owns points[point_offsets[b]:point_offsets[b + 1]]
    triangle_offsets   (B+1,) int64, the same for triangles
    frames             (B, 3, 3) float64, the plane of each mesh in space: origin, x axis, y axis
    quads              (Q, 4) int64, rows of points; counter-clockwise unless the quad is inverted
    quad_offsets       (B+1,) int64, as the other offsets

    Use `from_arrays` to make one: it checks its arguments, and the constructor does not.  The half-edge twins are
    computed when `twin` is first read, and are kept with the mesh from then on.
    """

    points: Tensor
    triangles: Tensor
    fixed: Tensor
    constrained_edges: Tensor
    point_offsets: Tensor
    triangle_offsets: Tensor
    frames: Tensor
    # The triangles whose twins are known, and these twins.  A mesh with other triangles does not know its twins.
    _twin: tuple[Tensor, Tensor] | None = field(default=None, repr=False)
    quads: Tensor = None  # type: ignore[assignment]
    quad_offsets: Tensor = None  # type: ignore[assignment]
    # How many rows of `triangles` stand for each quad, behind the triangles of its mesh.
    _rows_per_quad: int = field(default=0, repr=False)

    def __post_init__(self) -> None:
        if self.quads is None:
            object.__setattr__(self, "quads", self.triangles.new_zeros((0, 4)))
            object.__setattr__(self, "quad_offsets", torch.zeros_like(self.point_offsets))

    @classmethod
    def from_arrays(
        cls, points: Any, triangles: Any, fixed: Any = None, constrained_edges: Any = None, *, quads: Any = None
    ) -> "MeshBatch":
        """One mesh (B = 1) from numpy arrays, torch tensors or nested lists.

        points             (V, 2), or (V, 3) in any one plane of space
        triangles          (T, 3) integers, rows of points.  Triangles that all run clockwise, or in different
                           directions, are turned round by walking from neighbour to neighbour, with a
                           `MeshWarning`
        fixed              (V,) bool; None means the boundary.  Boundary vertices and unused vertices are fixed in any
                           case
        constrained_edges  (K, 2) integers, edges of the mesh that no flip may remove.  `femwarp` and `deform` carry
                           their ends along; everything else holds them, unless its options say otherwise
        quads              (Q, 4) integers, rows of points, each in the order in which its boundary passes them; they
                           are turned round as triangles are.  A mesh may have quads alone: `triangles` is then empty

        Raises InvalidMeshError, which names the row, for anything that is not a planar mesh.
        """
        if quads is not None and len(quads):
            from .mixed_arrays import mixed_columns

            columns: dict[str, Any] = mixed_columns(points, triangles, fixed, constrained_edges, quads)
            return cls(**columns)
        xyz = checked_points(points)
        faces = checked_triangles(triangles, len(xyz)).to(xyz.device)
        xyz = checked_positions(xyz, faces)
        flat, frame = to_plane(xyz, faces)
        faces, twin = oriented(flat, seen_from_above(flat, faces, frame))
        count = len(flat)
        used = torch.zeros(count, dtype=torch.bool, device=flat.device)
        used[faces.reshape(-1)] = True
        unused = int((~used).sum())
        if unused:
            warnings.warn(MeshWarning(f"{unused} vertices belong to no triangle; they are kept"), stacklevel=2)
        kept = checked_constraints(constrained_edges, faces, twin, count)
        mask = checked_fixed(fixed, count, flat.device)
        mask = mask | ~used | connectivity.boundary_vertices(faces, twin, count)
        return cls(
            points=flat,
            triangles=faces,
            fixed=mask,
            constrained_edges=kept,
            point_offsets=torch.tensor([0, count], device=flat.device),
            triangle_offsets=torch.tensor([0, len(faces)], device=flat.device),
            frames=frame[None],
            _twin=(faces, twin),
        )

    @property
    def twin(self) -> Tensor:
        """(3T,) int64 the twin of each half-edge, -1 on the boundary; numbered as in `connectivity.twins`."""
        known = self.known_twin
        if known is None:
            known = connectivity.twins(self.triangles)
            object.__setattr__(self, "_twin", (self.triangles, known))
        return known

    @property
    def known_twin(self) -> Tensor | None:
        """The twins if they have been computed already; None otherwise."""
        return None if self._twin is None or self._twin[0] is not self.triangles else self._twin[1]

    def __getstate__(self) -> dict[str, Any]:
        # Another process computes the twins faster than it would receive them.
        return self.__dict__ | {"_twin": None}

    def __len__(self) -> int:
        return len(self.point_offsets) - 1

    def __repr__(self) -> str:
        quads = f"{len(self.quads)} quads, " if len(self.quads) else ""
        return (
            f"MeshBatch({len(self)} meshes, {len(self.points)} points, {len(self.triangles)} triangles, {quads}"
            f"{self.points.dtype}, {self.points.device})"
        )

    @property
    def rows_per_quad(self) -> int:
        """How many rows of `triangles` stand for each quad: none but inside of the package (`mesh.quads`)."""
        return self._rows_per_quad

    @property
    def of_quads(self) -> Tensor:
        """(T,) bool, the rows of `triangles` that stand for quads; there are none but inside of the package."""
        ends, behind = self.triangle_offsets, self.rows_per_quad * counts_from_offsets(self.quad_offsets)
        row = torch.arange(len(self.triangles), device=ends.device)
        return row >= spread(ends[1:] - behind, ends)

    def with_points(self, points: Tensor) -> "MeshBatch":
        """The same meshes at other positions (V, 2), which may be anything: not even finite.

        Raises InvalidMeshError for another shape, and for what is no tensor of real numbers.
        """
        if not isinstance(points, Tensor):
            raise InvalidMeshError(f"points must be a tensor, not {type(points).__name__}")
        if points.dtype == torch.bool or points.is_complex():
            raise InvalidMeshError(f"points must be real numbers, not {points.dtype}")
        if points.shape != self.points.shape:
            raise InvalidMeshError(
                f"points must be {tuple(self.points.shape)} as in the batch, not {tuple(points.shape)}"
            )
        return dataclasses.replace(self, points=points.to(self.points))

    def with_triangles(self, triangles: Tensor, twin: Tensor | None = None) -> "MeshBatch":
        """The same vertices with other `triangles` (T, 3) int64, of which each mesh has as many as before.

        twin  (3T,) the twins of these triangles, if the caller knows them; then nothing is checked but shape and type

        Raises InvalidMeshError for another shape or type, and for rows that are not of the mesh's own vertices.
        """
        if not isinstance(triangles, Tensor) or triangles.dtype != torch.int64:
            raise InvalidMeshError(f"triangles must be int64, not {getattr(triangles, 'dtype', type(triangles))}")
        if triangles.shape != self.triangles.shape:
            raise InvalidMeshError(
                f"triangles must be {tuple(self.triangles.shape)} as in the batch, not {tuple(triangles.shape)}"
            )
        batch = dataclasses.replace(self, triangles=triangles, _twin=None if twin is None else (triangles, twin))
        if twin is None:
            check_rows(batch)
        return batch

    def to(self, *args: Any, **kwargs: Any) -> "MeshBatch":
        """The batch in another dtype or on another device, with arguments as in `torch.Tensor.to`.

        A dtype converts the points only; a device moves every tensor.
        """
        points = self.points.to(*args, **kwargs)
        plain = ("points", "_twin", "_rows_per_quad")
        columns = {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name not in plain}
        moved = {name: column.to(points.device) for name, column in columns.items()}
        return MeshBatch(points, **moved, _rows_per_quad=self.rows_per_quad)

    def pin_memory(self) -> "MeshBatch":
        """The batch in page-locked memory, from which a GPU copies faster; `DataLoader(pin_memory=True)` calls this.

        Where there is no GPU, torch raises RuntimeError, and a DataLoader warns and goes on without.
        """
        names = [f.name for f in dataclasses.fields(self) if isinstance(getattr(self, f.name), Tensor)]
        return dataclasses.replace(self, **{name: getattr(self, name).pin_memory() for name in names}, _twin=None)

    def split(self) -> list["MeshBatch"]:
        """The B meshes, each as a batch of one."""
        if len(self) == 1:
            return [self]
        vertex, face, quad = (v.tolist() for v in (self.point_offsets, self.triangle_offsets, self.quad_offsets))
        owner, twin = constraint_owner(self), self.known_twin
        meshes = []
        for b in range(len(self)):
            v, t = slice(vertex[b], vertex[b + 1]), slice(face[b], face[b + 1])
            triangles = self.triangles[t] - vertex[b]
            meshes.append(
                MeshBatch(
                    self.points[v],
                    triangles,
                    self.fixed[v],
                    self.constrained_edges[owner == b] - vertex[b],
                    self.point_offsets[b : b + 2] - vertex[b],
                    self.triangle_offsets[b : b + 2] - face[b],
                    self.frames[b : b + 1],
                    None if twin is None else (triangles, _shifted(twin[3 * t.start : 3 * t.stop], -3 * t.start)),
                    self.quads[quad[b] : quad[b + 1]] - vertex[b],
                    self.quad_offsets[b : b + 2] - quad[b],
                    self.rows_per_quad,
                )
            )
        return meshes

    def __getitem__(self, index: Any) -> "MeshBatch":
        """Some of the meshes as a batch: `batch[0]`, `batch[-1]`, `batch[2:5]`, `batch[[4, 0, 0]]`, `batch[mask]`.

        index  a number, a slice, numbers in any order and any number of times, or (B,) bool; sequence, numpy or torch

        Raises IndexError for a mesh that is not there, and TypeError for anything else.
        """
        return self._taken(numbers_of(index, len(self), self.points.device))

    def __iter__(self) -> Iterator["MeshBatch"]:
        return iter(self.split())

    def select(self, keep: Tensor) -> "MeshBatch":
        """The meshes whose `keep` (B,) bool is true, in their order."""
        keep = torch.as_tensor(keep, device=self.points.device)
        if keep.dtype != torch.bool or keep.shape != (len(self),):
            raise InvalidMeshError(f"keep must be ({len(self)},) bool, not {tuple(keep.shape)} {keep.dtype}")
        return self if bool(keep.all()) else self._taken(true_rows(keep))

    def _taken(self, numbers: Tensor) -> "MeshBatch":
        """The meshes of these `numbers` (M,) int64, in this order."""
        rows, faces = rows_of_each(numbers, self.point_offsets), rows_of_each(numbers, self.triangle_offsets)
        offsets = offsets_from_counts(counts_from_offsets(self.point_offsets)[numbers])
        triangle_offsets = offsets_from_counts(counts_from_offsets(self.triangle_offsets)[numbers])
        shift = offsets[:-1] - self.point_offsets[:-1][numbers]
        triangles = shifted(take(self.triangles, faces), shift, triangle_offsets)
        quad_offsets = offsets_from_counts(counts_from_offsets(self.quad_offsets)[numbers])
        quads = shifted(self.quads[rows_of_each(numbers, self.quad_offsets)], shift, quad_offsets)
        twin = self.known_twin
        return MeshBatch(
            take(self.points, rows),
            triangles,
            take(self.fixed, rows),
            _taken_constraints(self, numbers, shift),
            offsets,
            triangle_offsets,
            self.frames[numbers],
            None if twin is None else (triangles, _taken_twins(self, twin, numbers, triangle_offsets)),
            quads,
            quad_offsets,
            self.rows_per_quad,
        )


def join(meshes: Sequence[MeshBatch]) -> MeshBatch:
    """One batch of all the meshes of the given batches, in order.

    Raises InvalidMeshError when no batch is given, or when dtypes or devices differ.
    """
    if not meshes:
        raise InvalidMeshError("join needs at least one mesh")
    check_meshes("join", MeshBatch, meshes)
    kinds = {(m.points.dtype, m.points.device) for m in meshes}
    if len(kinds) > 1:
        raise InvalidMeshError(f"the meshes to join differ in dtype or device: {sorted(map(str, kinds))}; use .to(...)")
    if len(meshes) == 1:
        return meshes[0]
    if len({m.rows_per_quad for m in meshes if len(m.quads)}) > 1:
        raise InvalidMeshError("the meshes to join have quads in different forms")
    device = meshes[0].points.device
    shifts = offsets_from_counts(torch.tensor([len(m.points) for m in meshes], device=device)).tolist()
    triangles = torch.cat([m.triangles + s for m, s in zip(meshes, shifts, strict=False)])
    return MeshBatch(
        torch.cat([m.points for m in meshes]),
        triangles,
        torch.cat([m.fixed for m in meshes]),
        torch.cat([m.constrained_edges + s for m, s in zip(meshes, shifts, strict=False)]),
        offsets_from_counts(torch.cat([counts_from_offsets(m.point_offsets) for m in meshes])),
        offsets_from_counts(torch.cat([counts_from_offsets(m.triangle_offsets) for m in meshes])),
        torch.cat([m.frames for m in meshes]),
        None if any(m.known_twin is None for m in meshes) else (triangles, _joined_twins(meshes)),
        torch.cat([m.quads + s for m, s in zip(meshes, shifts, strict=False)]),
        offsets_from_counts(torch.cat([counts_from_offsets(m.quad_offsets) for m in meshes])),
        max(m.rows_per_quad for m in meshes),
    )


def _joined_twins(meshes: Sequence[MeshBatch]) -> Tensor:
    """(3T,) the twins of the joined batch, made of those of its parts."""
    starts = itertools.accumulate((3 * len(m.triangles) for m in meshes), initial=0)
    return torch.cat([_shifted(m.twin, start) for m, start in zip(meshes, starts, strict=False)])


def _shifted(twin: Tensor, by: Tensor | int) -> Tensor:
    """`twin` with `by` added to every half-edge; the -1 of the boundary stays."""
    return torch.where(twin < 0, -1, twin + by)


def put(batch: MeshBatch, at: Tensor, part: MeshBatch) -> MeshBatch:
    """`batch` with the points and triangles of the meshes `at` (B,) bool replaced by those of `part`.

    This is the inverse of `part = batch.select(at)` after the part's vertices moved or its edges flipped.
    """
    if len(part) == len(batch):
        return part
    shift = batch.point_offsets[:-1][at] - part.point_offsets[:-1]
    triangles = shifted(part.triangles, shift, part.triangle_offsets)
    triangles = put_rows(batch.triangles, rows_of(at, batch.triangle_offsets), triangles)
    twin = batch.known_twin
    return dataclasses.replace(
        batch,
        points=put_rows(batch.points, rows_of(at, batch.point_offsets), part.points),
        triangles=triangles,
        _twin=None if twin is None else (triangles, _put_twins(batch, twin, at, part.twin)),
    )


def _taken_constraints(batch: MeshBatch, numbers: Tensor, shift: Tensor) -> Tensor:
    """(K', 2) the constrained edges of the meshes `numbers`, whose vertices are renumbered by `shift` (M,)."""
    if not len(batch.constrained_edges):
        return batch.constrained_edges
    owner = constraint_owner(batch)
    order = owner.argsort(stable=True)
    ends = offsets_from_counts(torch.bincount(owner, minlength=len(batch)))
    rows = order[rows_of_each(numbers, ends)]
    moved = shift.repeat_interleave(counts_from_offsets(ends)[numbers])
    return batch.constrained_edges[rows] + moved[:, None]


def _taken_twins(batch: MeshBatch, twin: Tensor, numbers: Tensor, triangle_offsets: Tensor) -> Tensor:
    """The twins (3T',) of the meshes `numbers` of `batch`, whose triangles get `triangle_offsets` (M+1,)."""
    part = take(twin, rows_of_each(numbers, 3 * batch.triangle_offsets))
    shift = 3 * (triangle_offsets[:-1] - batch.triangle_offsets[:-1][numbers])
    return shifted(part, shift, 3 * triangle_offsets)


def _put_twins(batch: MeshBatch, twin: Tensor, at: Tensor, part: Tensor) -> Tensor:
    """`twin` (3T,) of `batch` with those of the meshes `at` (B,) bool replaced by `part`, numbered within it."""
    offsets = 3 * batch.triangle_offsets
    ends = offsets_from_counts(counts_from_offsets(offsets)[at])
    return put_rows(twin, rows_of(at, offsets), shifted(part, offsets[:-1][at] - ends[:-1], ends))


def lift(mesh: MeshBatch) -> Tensor:
    """(V, 3) the points in space, each in the plane in which its mesh was given."""
    frame = spread(mesh.frames, mesh.point_offsets).to(mesh.points.dtype)
    x, y = mesh.points[:, :1], mesh.points[:, 1:]
    return frame[:, 0] + x * frame[:, 1] + y * frame[:, 2]


def vertex_mesh(mesh: MeshBatch) -> Tensor:
    """(V,) int64 the mesh each vertex belongs to."""
    return segment_ids(mesh.point_offsets)


def triangle_mesh(mesh: MeshBatch) -> Tensor:
    """(T,) int64 the mesh each triangle belongs to."""
    return segment_ids(mesh.triangle_offsets)


def constraint_owner(mesh: MeshBatch) -> Tensor:
    """(K,) int64 the mesh each constrained edge belongs to."""
    return owner_of(mesh.constrained_edges[:, 0], mesh.point_offsets)
