"""The one mesh type: a batch of planar triangle meshes as a disjoint union of rows.

A mesh is two arrays, points and triangles; a batch is many of them laid end to end, with offsets
that say which rows belong to whom.  A single mesh is a batch of one.
"""

import dataclasses
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from . import connectivity
from .errors import InvalidMeshError, MeshWarning
from .segments import counts_from_offsets, offsets_from_counts, segment_ids, segment_sum, spread
from .triangle import corners, signed_area

# A vertex may leave the common plane by this part of the mesh's extent: single-precision files
# of tilted planes are off by a few 1e-7.
_PLANARITY = 1e-5


@dataclass(frozen=True, eq=False)
class MeshBatch:
    """B planar triangle meshes, each owning a contiguous run of rows.

    points             (V, 2) float64 or float32, any one length unit
    triangles          (T, 3) int64 rows of points, counter-clockwise unless inverted
    fixed              (V,) bool, vertices nothing may move
    constrained_edges  (K, 2) int64, interior edges no flip may remove
    point_offsets      (B+1,) int64, mesh b owns points[point_offsets[b]:point_offsets[b + 1]]
    triangle_offsets   (B+1,) int64, likewise for triangles
    frames             (B, 3, 3) float64, each mesh's plane in space: origin, x axis, y axis

    Make one with `from_arrays`, which checks; the constructor itself does not.
    """

    points: Tensor
    triangles: Tensor
    fixed: Tensor
    constrained_edges: Tensor
    point_offsets: Tensor
    triangle_offsets: Tensor
    frames: Tensor

    @classmethod
    def from_arrays(cls, points: Any, triangles: Any, fixed: Any = None, constrained_edges: Any = None) -> "MeshBatch":
        """One mesh (B = 1) from numpy arrays, torch tensors or nested lists.

        points             (V, 2), or (V, 3) in any one plane of space
        triangles          (T, 3) integers, rows of points; wholly clockwise or mixed winding is
                           repaired by walking from neighbour to neighbour, with a `MeshWarning`
        fixed              (V,) bool; None: the boundary.  Boundary vertices, ends of constrained
                           edges and unused vertices are fixed in any case
        constrained_edges  (K, 2) integers, edges of the mesh that must survive every flip

        Raises InvalidMeshError, naming the row, for anything that is not a planar triangle mesh.
        """
        xyz = _checked_points(points)
        faces = _checked_triangles(triangles, len(xyz)).to(xyz.device)
        flat, frame = _to_plane(xyz, faces)
        faces, twin = _oriented(flat, faces)
        count = len(flat)
        used = torch.zeros(count, dtype=torch.bool, device=flat.device)
        used[faces.reshape(-1)] = True
        unused = int((~used).sum())
        if unused:
            warnings.warn(MeshWarning(f"{unused} vertices belong to no triangle; they are kept"), stacklevel=2)
        kept = _checked_constraints(constrained_edges, faces, twin, count)
        mask = _checked_fixed(fixed, count, flat.device)
        mask = mask | ~used | connectivity.boundary_vertices(faces, twin, count)
        mask[kept.reshape(-1)] = True
        return cls(
            points=flat,
            triangles=faces,
            fixed=mask,
            constrained_edges=kept,
            point_offsets=torch.tensor([0, count], device=flat.device),
            triangle_offsets=torch.tensor([0, len(faces)], device=flat.device),
            frames=frame[None],
        )

    def __len__(self) -> int:
        return len(self.point_offsets) - 1

    def __repr__(self) -> str:
        return (
            f"MeshBatch({len(self)} meshes, {len(self.points)} points, {len(self.triangles)} triangles, "
            f"{self.points.dtype}, {self.points.device})"
        )

    def with_points(self, points: Tensor) -> "MeshBatch":
        """The same meshes at other positions (V, 2)."""
        if points.shape != self.points.shape:
            raise InvalidMeshError(
                f"points must be {tuple(self.points.shape)} as in the batch, not {tuple(points.shape)}"
            )
        return dataclasses.replace(self, points=points.to(self.points))

    def with_triangles(self, triangles: Tensor) -> "MeshBatch":
        """The same vertices joined otherwise: (T, 3), each mesh keeping its number of triangles."""
        if triangles.shape != self.triangles.shape:
            raise InvalidMeshError(
                f"triangles must be {tuple(self.triangles.shape)} as in the batch, not {tuple(triangles.shape)}"
            )
        return dataclasses.replace(self, triangles=triangles)

    def to(self, *args: Any, **kwargs: Any) -> "MeshBatch":
        """As `torch.Tensor.to`: a dtype converts the points, a device moves every tensor."""
        points = self.points.to(*args, **kwargs)
        moved = {f.name: getattr(self, f.name).to(points.device) for f in dataclasses.fields(self)}
        return MeshBatch(**(moved | {"points": points}))

    def split(self) -> list["MeshBatch"]:
        """The B meshes, each a batch of one."""
        vertex, face = self.point_offsets.tolist(), self.triangle_offsets.tolist()
        owner = self._constraint_owner()
        meshes = []
        for b in range(len(self)):
            v, t = slice(vertex[b], vertex[b + 1]), slice(face[b], face[b + 1])
            meshes.append(
                MeshBatch(
                    self.points[v],
                    self.triangles[t] - vertex[b],
                    self.fixed[v],
                    self.constrained_edges[owner == b] - vertex[b],
                    self.point_offsets[b : b + 2] - vertex[b],
                    self.triangle_offsets[b : b + 2] - face[b],
                    self.frames[b : b + 1],
                )
            )
        return meshes

    def select(self, keep: Tensor) -> "MeshBatch":
        """The meshes whose `keep` (B,) bool is true, in their order."""
        keep = torch.as_tensor(keep, device=self.points.device)
        if keep.dtype != torch.bool or keep.shape != (len(self),):
            raise InvalidMeshError(f"keep must be ({len(self)},) bool, not {tuple(keep.shape)} {keep.dtype}")
        if bool(keep.all()):
            return self
        vertex_counts = counts_from_offsets(self.point_offsets)
        rows, faces = spread(keep, self.point_offsets), spread(keep, self.triangle_offsets)
        offsets = offsets_from_counts(vertex_counts[keep])
        shift = torch.zeros_like(vertex_counts)
        shift[keep] = offsets[:-1] - self.point_offsets[:-1][keep]
        owner = self._constraint_owner()
        constraints = keep[owner]
        return MeshBatch(
            self.points[rows],
            (self.triangles + spread(shift, self.triangle_offsets)[:, None])[faces],
            self.fixed[rows],
            (self.constrained_edges + shift[owner][:, None])[constraints],
            offsets,
            offsets_from_counts(counts_from_offsets(self.triangle_offsets)[keep]),
            self.frames[keep],
        )

    def _constraint_owner(self) -> Tensor:
        """(K,) the mesh each constrained edge belongs to."""
        return torch.searchsorted(self.point_offsets, self.constrained_edges[:, 0].contiguous(), right=True) - 1


def join(meshes: Sequence[MeshBatch]) -> MeshBatch:
    """One batch of all the meshes of all the batches given, in order.

    Raises InvalidMeshError when there are none, or when their dtypes or devices differ.
    """
    if not meshes:
        raise InvalidMeshError("join needs at least one mesh")
    kinds = {(m.points.dtype, m.points.device) for m in meshes}
    if len(kinds) > 1:
        raise InvalidMeshError(f"the meshes to join differ in dtype or device: {sorted(map(str, kinds))}; use .to(...)")
    if len(meshes) == 1:
        return meshes[0]
    device = meshes[0].points.device
    shifts = offsets_from_counts(torch.tensor([len(m.points) for m in meshes], device=device)).tolist()
    return MeshBatch(
        torch.cat([m.points for m in meshes]),
        torch.cat([m.triangles + s for m, s in zip(meshes, shifts, strict=False)]),
        torch.cat([m.fixed for m in meshes]),
        torch.cat([m.constrained_edges + s for m, s in zip(meshes, shifts, strict=False)]),
        offsets_from_counts(torch.cat([counts_from_offsets(m.point_offsets) for m in meshes])),
        offsets_from_counts(torch.cat([counts_from_offsets(m.triangle_offsets) for m in meshes])),
        torch.cat([m.frames for m in meshes]),
    )


def put(batch: MeshBatch, at: Tensor, part: MeshBatch) -> MeshBatch:
    """`batch` with the points and triangles of the meshes `at` (B,) bool replaced by those of `part`.

    The inverse of `part = batch.select(at)` after the part's vertices moved or its edges flipped.
    """
    if len(part) == len(batch):
        return part
    points, triangles = batch.points.clone(), batch.triangles.clone()
    points[spread(at, batch.point_offsets)] = part.points
    shift = batch.point_offsets[:-1][at] - part.point_offsets[:-1]
    triangles[spread(at, batch.triangle_offsets)] = part.triangles + spread(shift, part.triangle_offsets)[:, None]
    return dataclasses.replace(batch, points=points, triangles=triangles)


def select_twins(batch: MeshBatch, twin: Tensor, keep: Tensor) -> Tensor:
    """The twins (3T',) of `batch.select(keep)` from those of `batch` (3T,)."""
    if bool(keep.all()):
        return twin
    offsets = 3 * batch.triangle_offsets
    counts = counts_from_offsets(offsets)
    shift = offsets[:-1] - offsets_from_counts(counts * keep)[:-1]
    part = twin[spread(keep, offsets)]
    return torch.where(part < 0, -1, part - shift[keep].repeat_interleave(counts[keep]))


def put_twins(batch: MeshBatch, twin: Tensor, at: Tensor, part: Tensor) -> Tensor:
    """`twin` (3T,) of `batch` with those of the meshes `at` (B,) bool replaced by `part`, from `select_twins`."""
    if len(part) == len(twin):
        return part
    offsets = 3 * batch.triangle_offsets
    counts = counts_from_offsets(offsets)
    shift = offsets[:-1] - offsets_from_counts(counts * at)[:-1]
    twin = twin.clone()
    twin[spread(at, offsets)] = torch.where(part < 0, -1, part + shift[at].repeat_interleave(counts[at]))
    return twin


def touching(batch: MeshBatch, vertices: Tensor) -> Tensor:
    """(T,) bool: the triangles with a corner among `vertices` (V,) bool."""
    a, b, c = (vertices.index_select(0, v.contiguous()) for v in batch.triangles.unbind(1))
    return a | b | c


def corners_of(batch: MeshBatch, triangles: Tensor) -> Tensor:
    """(V,) bool: the corners of the `triangles` (T,) bool."""
    mask = torch.zeros(len(batch.points), dtype=torch.bool, device=triangles.device)
    return mask.index_fill_(0, batch.triangles.index_select(0, triangles.nonzero().squeeze(1)).reshape(-1), True)


def surroundings(batch: MeshBatch, triangles: Tensor, rings: int) -> Tensor:
    """(V,) bool: the corners of the `triangles` (T,) bool and the `rings` - 1 rings of vertices round them."""
    near = corners_of(batch, triangles)
    for _ in range(rings - 1):
        near = corners_of(batch, touching(batch, near))
    return near


def triangle_mean(batch: MeshBatch, values: Tensor) -> Tensor:
    """(T,) the mean of `values` (V,) over each triangle's corners."""
    a, b, c = (values.index_select(0, v.contiguous()) for v in batch.triangles.unbind(1))
    return (a + b + c) / 3


def vertex_mean(batch: MeshBatch, values: Tensor) -> Tensor:
    """(V,) the mean of `values` (T,) over the triangles round each vertex; 0 for unused ones."""
    total = values.new_zeros(len(batch.points))
    for v in batch.triangles.unbind(1):
        total.index_add_(0, v.contiguous(), values)
    return total / torch.bincount(batch.triangles.reshape(-1), minlength=len(total)).clamp_min(1)


def lift(mesh: MeshBatch) -> Tensor:
    """(V, 3) the points in space, back in the plane each mesh was given in."""
    frame = spread(mesh.frames, mesh.point_offsets).to(mesh.points.dtype)
    x, y = mesh.points[:, :1], mesh.points[:, 1:]
    return frame[:, 0] + x * frame[:, 1] + y * frame[:, 2]


def vertex_mesh(mesh: MeshBatch) -> Tensor:
    """(V,) int64 the mesh each vertex belongs to."""
    return segment_ids(mesh.point_offsets)


def triangle_mesh(mesh: MeshBatch) -> Tensor:
    """(T,) int64 the mesh each triangle belongs to."""
    return segment_ids(mesh.triangle_offsets)


def _tensor(values: Any, name: str) -> Tensor:
    try:
        tensor = values.detach().clone() if isinstance(values, Tensor) else torch.from_numpy(_native(values))
    except (TypeError, ValueError) as error:
        raise InvalidMeshError(f"{name} is not a rectangular array of numbers: {error}") from None
    return tensor


def _native(values: Any) -> np.ndarray:
    """A copy in the byte order of this machine."""
    array = np.array(values)
    return array.astype(array.dtype.newbyteorder("="))


def _first(rows: Tensor) -> int:
    return int(rows.nonzero()[0, 0])


def _checked_points(points: Any) -> Tensor:
    xyz = _tensor(points, "points")
    if xyz.ndim != 2 or xyz.shape[1] not in (2, 3):
        raise InvalidMeshError(f"points must have shape (V, 2) or (V, 3), not {tuple(xyz.shape)}")
    if xyz.dtype == torch.bool or xyz.is_complex():
        raise InvalidMeshError(f"points must be real numbers, not {xyz.dtype}")
    if xyz.dtype not in (torch.float32, torch.float64):
        xyz = xyz.to(torch.float64)
    if len(xyz) == 0:
        raise InvalidMeshError("the mesh is empty: it has no points")
    bad = ~xyz.isfinite().all(1)
    if bool(bad.any()):
        row = _first(bad)
        raise InvalidMeshError(
            f"points row {row} is {xyz[row].tolist()}: every coordinate must be finite ({int(bad.sum())} rows are not)"
        )
    if float(xyz.abs().max()) > 1e150:
        row = int(xyz.abs().amax(1).argmax())
        raise InvalidMeshError(f"points row {row} is {xyz[row].tolist()}: areas beyond 1e150 squared overflow; rescale")
    extent = float((xyz.amax(0).double() - xyz.amin(0).double()).max())
    if 0 < extent < 1e-150:
        raise InvalidMeshError(f"the mesh is {extent:.3g} wide: areas of less than 1e-300 underflow; rescale")
    return xyz


def _checked_triangles(triangles: Any, vertices: int) -> Tensor:
    faces = _tensor(triangles, "triangles")
    if faces.numel() == 0:
        raise InvalidMeshError("the mesh is empty: it has no triangles")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InvalidMeshError(f"triangles must have shape (T, 3), not {tuple(faces.shape)}")
    if faces.dtype == torch.bool or faces.is_floating_point() or faces.is_complex():
        raise InvalidMeshError(f"triangles must be integers (rows of points), not {faces.dtype}")
    faces = faces.to(torch.int64)
    outside = ((faces < 0) | (faces >= vertices)).any(1)
    if bool(outside.any()):
        row = _first(outside)
        raise InvalidMeshError(
            f"triangles row {row} is {faces[row].tolist()}: rows of points run from 0 to {vertices - 1}"
        )
    a, b, c = faces.unbind(1)
    repeated = (a == b) | (b == c) | (c == a)
    if bool(repeated.any()):
        row = _first(repeated)
        raise InvalidMeshError(
            f"triangles row {row} is {faces[row].tolist()}: a triangle needs three different vertices"
        )
    return faces


def _checked_fixed(fixed: Any, vertices: int, device: torch.device) -> Tensor:
    if fixed is None:
        return torch.zeros(vertices, dtype=torch.bool, device=device)
    mask = _tensor(fixed, "fixed").to(device)
    if mask.shape != (vertices,):
        raise InvalidMeshError(f"fixed must have shape ({vertices},), one value a point, not {tuple(mask.shape)}")
    if mask.dtype != torch.bool:
        raise InvalidMeshError(f"fixed must be bool, not {mask.dtype}")
    return mask


def _checked_constraints(constrained_edges: Any, faces: Tensor, twin: Tensor, vertices: int) -> Tensor:
    """The constrained edges that are interior; boundary edges need no constraint."""
    if constrained_edges is None:
        return torch.zeros((0, 2), dtype=torch.int64, device=faces.device)
    given = _tensor(constrained_edges, "constrained_edges").to(faces.device)
    if given.numel() == 0:
        return torch.zeros((0, 2), dtype=torch.int64, device=faces.device)
    if given.ndim != 2 or given.shape[1] != 2:
        raise InvalidMeshError(f"constrained_edges must have shape (K, 2), not {tuple(given.shape)}")
    if given.dtype == torch.bool or given.is_floating_point() or given.is_complex():
        raise InvalidMeshError(f"constrained_edges must be integers (rows of points), not {given.dtype}")
    given = given.to(torch.int64)
    outside = ((given < 0) | (given >= vertices)).any(1)
    if bool(outside.any()):
        row = _first(outside)
        raise InvalidMeshError(
            f"constrained_edges row {row} is {given[row].tolist()}: rows of points run from 0 to {vertices - 1}"
        )
    keys = connectivity.edge_keys(given[:, 0], given[:, 1], vertices)
    present = connectivity.edges(faces, twin)
    missing = ~torch.isin(keys, connectivity.edge_keys(present[:, 0], present[:, 1], vertices))
    if bool(missing.any()):
        row = _first(missing)
        raise InvalidMeshError(f"constrained_edges row {row} is {given[row].tolist()}: no triangle has that edge")
    rim = connectivity.boundary_edges(faces, twin)
    interior = ~torch.isin(keys, connectivity.edge_keys(rim[:, 0], rim[:, 1], vertices))
    return given[interior]


def _to_plane(xyz: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """(V, 2) coordinates in the plane of the points, and that plane (3, 3): origin, x and y axis.

    A plane of constant z keeps its x and y to the bit and is seen from above; any other is seen
    from the side on which most of the area runs counter-clockwise.
    """
    frame = torch.eye(3, dtype=torch.float64, device=xyz.device).roll(1, 0)
    frame[0] = 0
    if xyz.shape[1] == 2:
        return xyz.contiguous(), frame
    frame[0, 2] = xyz[0, 2]
    if bool((xyz[:, 2] == xyz[0, 2]).all()):
        return xyz[:, :2].contiguous(), frame
    wide = xyz.to(torch.float64)
    low, high = wide.amin(0), wide.amax(0)
    extent = float((high - low).max())
    origin = low + (wide - low).mean(0)
    centred = (wide - origin) / extent
    axes = torch.linalg.svd(centred.T @ centred)[2]
    x_axis, normal = axes[0], axes[2]
    a, b, c = centred[faces].unbind(1)
    if float(torch.linalg.cross(b - a, c - a).sum(0) @ normal) < 0:
        normal = -normal
    y_axis = torch.linalg.cross(normal, x_axis)
    height = (centred @ normal).abs()
    if float(height.max()) > _PLANARITY:
        row = int(height.argmax())
        raise InvalidMeshError(
            f"points row {row} is {xyz[row].tolist()}: it lies {float(height.max()) * extent:.3g} off the plane of "
            "the others; torchmesh improves planar meshes"
        )
    flat = torch.stack([centred @ x_axis, centred @ y_axis], 1) * extent
    return flat.to(xyz.dtype), torch.stack([origin, x_axis, y_axis])


def _oriented(points: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Triangles with consistent counter-clockwise winding, and their twins.

    Winding is topology (do neighbours run along their edge in opposite directions), inversion is
    geometry (is the area negative): a component is turned as a whole, by the sign of the area
    that its boundary encloses, so inverted triangles stay inverted.
    """
    vertices = len(points)
    u, v = connectivity.tails(faces), connectivity.heads(faces)
    keys, order = connectivity.edge_keys(u, v, vertices).sort(stable=True)
    same = keys[1:] == keys[:-1]
    thrice = same[1:] & same[:-1]
    if bool(thrice.any()):
        place = _first(thrice)
        rows = sorted((order[place : place + 3] // 3).tolist())
        h = order[place]
        raise InvalidMeshError(
            f"triangles rows {rows[0]}, {rows[1]} and {rows[2]} share the edge {[int(u[h]), int(v[h])]}: "
            "an edge may have two triangles at most"
        )
    pairs = same.nonzero().squeeze(1)
    left, right = order[pairs], order[pairs + 1]
    clash = u[left] == u[right]
    twin = torch.full_like(u, -1)
    twin[left], twin[right] = right, left
    component = connectivity.triangle_components(faces, twin)
    turn = torch.zeros(len(faces), dtype=torch.bool, device=faces.device)
    if bool(clash.any()):
        turn = _winding_repair(len(faces), left // 3, right // 3, clash)
        still = turn[left // 3] ^ turn[right // 3] ^ clash
        if bool(still.any()):
            raise InvalidMeshError(
                f"triangles row {int(left[_first(still)] // 3)} closes a loop of triangles that cannot be wound "
                "consistently (a Moebius strip): not a planar mesh"
            )
    area = signed_area(corners(points.to(torch.float64) - points[0].to(torch.float64), faces))
    area = torch.where(turn, -area, area)
    order = component.argsort(stable=True)
    sizes = torch.bincount(component)
    enclosed = segment_sum(area[order], offsets_from_counts(sizes))
    turn = turn ^ (enclosed < 0)[component]
    if not bool(turn.any()):
        return faces, twin
    turned = int(turn.sum())
    if turned == len(faces):
        warnings.warn(MeshWarning("all triangles were wound clockwise; they were turned"), stacklevel=3)
    else:
        warnings.warn(
            MeshWarning(f"{turned} of {len(faces)} triangles were wound against their neighbours; they were turned"),
            stacklevel=3,
        )
    faces = torch.where(turn[:, None], faces.flip(1), faces)
    return faces, connectivity.twins(faces)


def _winding_repair(count: int, left: Tensor, right: Tensor, clash: Tensor) -> Tensor:
    """(T,) bool: which triangles to turn so that neighbours agree, walking out from one per component."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    i, j, k = left.cpu().numpy(), right.cpu().numpy(), clash.cpu().numpy()
    data = np.where(k, 2, 1).astype(np.int8)
    graph = coo_matrix((np.r_[data, data], (np.r_[i, j], np.r_[j, i])), shape=(count, count)).tocsr()
    # Two triangles that share two edges sum their entries; either edge tells the same.
    graph.data = np.where(graph.data % 2 == 0, 2, 1).astype(np.int8)
    turn = np.zeros(count, bool)
    starts = np.unique(connected_components(graph, directed=False)[1], return_index=True)[1]
    for start in starts:
        order, before = breadth_first_order(graph, start, directed=False)
        relation = np.asarray(graph[order[1:], before[order[1:]]]).ravel() == 2
        for child, differs in zip(order[1:].tolist(), relation.tolist(), strict=True):
            turn[child] = turn[before[child]] ^ differs
        members = order
        if 2 * turn[members].sum() > len(members):
            turn[members] = ~turn[members]
    return torch.from_numpy(turn).to(left.device)
