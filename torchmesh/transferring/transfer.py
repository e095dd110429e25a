"""`transfer`: values at the vertices or in the triangles of one mesh, for another mesh of the same domain.

                 points                                       triangles
linear           between the corners of the triangle there    average over the overlaps: the integral is kept
conservative     L2 projection: the integral is kept          the same
nearest          of the nearest vertex                        of the triangle round the centroid
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, overload

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch
from ..mesh.detached import without_autograd
from ..mesh.measure import refuse_inverted
from ..mesh.quads import halved, has_quads
from ..mesh.ragged import counts_from_offsets, owner_of, true_rows
from ..mesh.typed import typed
from ..mesh.validation import fit_positions
from ..optimising.linear_map import LinearMap
from .location import locate, nearest_triangles, nearest_vertices
from .overlaps import Overlaps, overlaps, signed_areas
from .pairs import Side, both_sides
from .projection import MassMatrix, mixed_mass
from .quads import from_halves, matrix_of_elements, to_halves
from .sparse_rows import Entries, SparseRows

Where = Literal["points", "triangles"]
Method = Literal["linear", "conservative", "nearest"]

# A triangle is covered if no larger part of it lies outside the other mesh, and a value is no overshoot if it passes
# the others by no larger part of their range.
_WHOLE = 1e-9

# Rounding of an area, in units of the square of the extent of its triangle.
_ROUNDING = 1e-14


@dataclass(frozen=True, eq=False)
class TransferInfo:
    """What `transfer` saw, per mesh (B,).

    moved       int64 vertices or triangles whose value is not simply copied from the same row
    tangled     int64 vertices at which the mesh before overlaps itself, so that a triangulation of its vertices took
                its place; inverted triangles of the mesh before, where triangles have the values
    outside     int64 vertices outside the mesh before, which have the nearest boundary value; triangles of which a
                part is outside, which have the average over the rest, or the nearest value where nothing is left
    overshoots  int64 vertices or triangles whose value passes all those that it was made of: signed overlaps of a
                tangled mesh and projections can do that, other methods cannot
    uncovered   float64 the part of the area of the mesh after that the mesh before does not cover; 0 for points,
                unless they are projected
    missed      float64 the part of the area of the mesh before that the mesh after does not cover, and whose values
                are lost; likewise
    """

    moved: Tensor
    tangled: Tensor
    outside: Tensor
    overshoots: Tensor
    uncovered: Tensor
    missed: Tensor


@dataclass(frozen=True, eq=False)
class Transfer:
    """The way from a mesh to another one, computed once for any number of fields.

    rows        the linear map; for a projection, of its right-hand side
    info        what was seen, without the overshoots
    row_mesh    (N',) the mesh of each value after
    signed      (N',) bool: rows whose weights are not all positive
    mass        the matrix of a projection; None for the other methods
    """

    rows: SparseRows
    info: TransferInfo
    row_mesh: Tensor
    signed: Tensor
    mass: MassMatrix | None = None

    def __call__(self, values: Tensor) -> tuple[Tensor, Tensor]:
        """The values (N', ...) of the mesh after, and the overshoots (B,) int64."""
        if len(values) != self.rows.shape[1]:
            raise InvalidMeshError(f"values must have {self.rows.shape[1]} rows as the mesh before, not {len(values)}")
        if self.mass is None:
            out = self.rows @ values
        else:
            if not values.is_floating_point():
                raise InvalidMeshError(f"values are {values.dtype}: only floats can be projected")
            right = (self.rows @ values.to(torch.float64)).reshape(self.rows.shape[0], math.prod(values.shape[1:]))
            # The matrix is symmetric: its inverse transposed is its inverse.
            out = LinearMap(self.mass.unknowns, self.mass.unknowns)(right).to(values.dtype)
            out = out.reshape(self.rows.shape[0], *values.shape[1:])
        return out, self._overshoots(values.detach(), out.detach())

    def _overshoots(self, values: Tensor, out: Tensor) -> Tensor:
        meshes = len(self.info.moved)
        if values.is_complex() or not bool(self.signed.any()) or not values[:1].numel():
            return torch.zeros(meshes, dtype=torch.int64)
        given, made = (v.cpu().to(torch.float64).reshape(len(v), -1) for v in (values, out))
        low, high = self.rows.range_of(given)
        slack = _WHOLE * (high - low) + 1e-14 * torch.maximum(low.abs(), high.abs())
        beyond = ((made < low - slack) | (made > high + slack)).any(1) & self.signed
        return torch.bincount(self.row_mesh[beyond], minlength=meshes)


@overload
def transfer(
    before: MeshBatch, after: MeshBatch, values: Any, where: Where = ..., method: Method = ..., *,
    report: Literal[False] = ...,
) -> Tensor: ...  # fmt: skip
@overload
def transfer(
    before: MeshBatch, after: MeshBatch, values: Any, where: Where = ..., method: Method = ..., *,
    report: Literal[True],
) -> tuple[Tensor, TransferInfo]: ...  # fmt: skip
@typed
def transfer(
    before: MeshBatch,
    after: MeshBatch,
    values: Any,
    where: Where = "points",
    method: Method = "linear",
    *,
    report: bool = False,
) -> Tensor | tuple[Tensor, TransferInfo]:
    """Values of the meshes `before` for the meshes `after` of the same domains, mesh b for mesh b.

    values  (V, ...) at the vertices of `before`, or (T + Q, ...) in its triangles and then its quads, on any device;
            floats, or with method "nearest" anything
    where   "points" or "triangles": what has the values
    method  "linear", at points: linear interpolation in the triangle of `before` round each vertex, exact for linear
            functions.  Where triangles of `before` are inverted or overlap, the Delaunay triangulation of its vertices
            inside its boundary takes their place.  A vertex outside takes the nearest value on the boundary.  A vertex
            that has not moved keeps its value, bit for bit.
            "linear", in triangles: the average over the areas that a triangle shares with those of `before`.  The sum
            of value times area is kept to rounding, and there are no new extremes.  Inverted triangles of `before`
            count negative, with which that sum and constants are kept, but new extremes are possible.  Where the
            domains differ, the sum over the common part is kept.
            "conservative": at points the L2 projection (Farrell & Maddison 2011), which keeps the integral and
            smooths least, but may pass the extremes; no triangle of `after` may be inverted.  In triangles as "linear".
            "nearest": the value of the nearest vertex, or of the triangle round the centroid
    report  also return a `TransferInfo`: what was tangled, outside, or passed the extremes

    Quads are two triangles each here: both have the quad's value, and a quad has the mean of both by their areas.

    Returns (V', ...) or (T' + Q', ...) in the dtype and on the device of `values`, differentiable in them.

    Raises InvalidMeshError for batches of different sizes, values of another length, points that are not finite, or
    values at points that are not, with "conservative"; ValueError for an unknown `where` or `method`.
    """
    mixed = where == "triangles" and (has_quads(before) or has_quads(after))
    made = prepared(halved(before), halved(after), where, method)
    given = _checked_values(values, len(before.triangles) + len(before.quads) if mixed else made.rows.shape[1])
    out, overshoots = made(to_halves(before, given) if mixed else given)
    out = from_halves(after, out, mean=method != "nearest") if mixed else out
    if not report:
        return out
    info = made.info
    return out, TransferInfo(info.moved, info.tangled, info.outside, overshoots, info.uncovered, info.missed)


def _checked_values(values: Any, rows: int) -> Tensor:
    """`values` as a tensor with as many `rows`; InvalidMeshError for anything else."""
    try:
        tensor = torch.as_tensor(values)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InvalidMeshError(f"values are no rectangular array of numbers: {error}") from None
    if tensor.ndim == 0 or len(tensor) != rows:
        raise InvalidMeshError(f"values must have {rows} rows as the mesh before, but are {tuple(tensor.shape)}")
    return tensor


@without_autograd
def transfer_matrix(
    before: MeshBatch, after: MeshBatch, where: Where = "points", method: Literal["linear", "nearest"] = "linear"
) -> Tensor:
    """The sparse matrix of `transfer`: (V', V) for points, (T' + Q', T + Q) for triangles, float64, COO, on the CPU.

    Its products with values are what `transfer` returns, up to rounding.  Arguments and errors are those of `transfer`;
    a projection ("conservative" at points) has no sparse matrix and raises ValueError.
    """
    if method == "conservative" and where == "points":
        raise ValueError("a projection has no sparse matrix: use transfer(..., method='conservative')")
    matrix = prepared(halved(before), halved(after), where, method).rows.matrix()
    if where == "triangles" and (has_quads(before) or has_quads(after)):
        return matrix_of_elements(before, after, matrix, method != "nearest")
    return matrix


def prepared(before: MeshBatch, after: MeshBatch, where: Where = "points", method: Method = "linear") -> Transfer:
    """The transfer for any number of fields; arguments and errors are those of `transfer`."""
    if where not in ("points", "triangles"):
        raise ValueError(f"where must be 'points' or 'triangles', not {where!r}")
    if method not in ("linear", "conservative", "nearest"):
        raise ValueError(f"method must be 'linear', 'conservative' or 'nearest', not {method!r}")
    if len(before) != len(after):
        raise InvalidMeshError(f"there are {len(before)} meshes before and {len(after)} after: give as many of both")
    for name, batch in (("before", before), ("after", after)):
        bad = torch.zeros(len(batch.points), dtype=torch.bool, device=batch.points.device)
        bad[batch.triangles.reshape(-1)] = True  # vertices of no triangle may be anything
        bad &= ~fit_positions(batch.points)
        if bool(bad.any()):
            row = bad.nonzero()[0]
            b = int(owner_of(row, batch.point_offsets))
            at = batch.points[row[0]].tolist()
            raise InvalidMeshError(f"{name}: mesh {b}: points row {int(row)} is {at}: not finite, or beyond 1e150")
    sides = both_sides(before, after)
    if where == "triangles":
        return _nearest_in_triangles(*sides) if method == "nearest" else _triangles(*sides, _unmoved(before, after))
    if method == "conservative":
        refuse_inverted(after, ", and a projection needs a valid mesh")
        return _projection(*sides, after)
    return _points(before, *sides, _unmoved(before, after), method)


def _unmoved(before: MeshBatch, after: MeshBatch) -> np.ndarray:
    """(V',) the row in `before` of each vertex that has the same row of its mesh there and the same position; or -1."""
    starts, counts = before.point_offsets[:-1].cpu(), counts_from_offsets(before.point_offsets).cpu()
    now = counts_from_offsets(after.point_offsets).cpu()
    owner = torch.arange(len(after)).repeat_interleave(now)
    row = torch.arange(len(owner)) + (starts - after.point_offsets[:-1].cpu())[owner]
    row[(counts != now)[owner]] = -1
    old, new = before.points.detach().cpu(), after.points.detach().cpu()
    candidates = true_rows(row >= 0)
    here, there = old[row[candidates]], new[candidates]
    same = ((here == there) | (here.isnan() & there.isnan())).all(1)
    row[candidates[~same]] = -1
    return row.numpy()


def _points(before: MeshBatch, old: Side, new: Side, unmoved: np.ndarray, method: Method) -> Transfer:
    moved = np.flatnonzero(unmoved < 0)
    kept = np.flatnonzero(unmoved >= 0)
    x, y, mesh = new.x[moved], new.y[moved], new.vertex[moved]
    none = np.zeros(len(moved), bool)
    if method == "nearest":
        entries = Entries(moved, nearest_vertices(old, x, y, mesh), np.ones(len(moved)))
        tangled = outside = none
    else:
        found = locate(before, old, x, y, mesh)
        entries = found.entries._replace(rows=moved[found.entries.rows])
        tangled, outside = found.tangled, found.outside
    copied = Entries(kept, unmoved[kept], np.ones(len(kept)))
    counts = [_count(new, mesh[some]) for some in (~none, tangled, outside)]
    return _made(new, new.vertex, SparseRows.of([copied, entries], (len(new.x), len(old.x))), counts)


def _nearest_in_triangles(old: Side, new: Side) -> Transfer:
    rows = np.arange(len(new.triangles))
    x, y = (v[new.triangles].mean(1) for v in (new.x, new.y))
    home = nearest_triangles(old, x, y, new.triangle)
    counts = [_count(new, new.triangle), _count(new, rows[:0]), _count(new, rows[:0])]
    return _made(
        new,
        new.triangle,
        SparseRows.of([Entries(rows, home, np.ones(len(rows)))], (len(rows), len(old.triangles))),
        counts,
    )


def _triangles(old: Side, new: Side, unmoved: np.ndarray) -> Transfer:
    areas, sizes = signed_areas(old), np.abs(signed_areas(new))
    inverted = _count(old, old.triangle[areas <= 0])
    tangled = inverted > 0
    same = _same_triangles(old, new, unmoved)
    same[tangled[new.triangle]] = -1
    kept = np.flatnonzero(same >= 0)
    shared = overlaps(old, new, same < 0)
    weight = shared.area * np.where(areas[shared.before] < 0, -1.0, 1.0)
    # Where no pair is left to be looked at, numpy counts in integers.
    total = np.bincount(shared.after, weight, len(sizes)).astype(float)
    total[kept] = sizes[kept]
    slack = _slack(new, sizes)
    partly = total < sizes - slack
    # Signed overlaps make an average only where they add up to the triangle; elsewhere all of them count alike.
    plain = (partly | (total > sizes + slack)) & tangled[new.triangle]
    weight = np.where(plain[shared.after], shared.area, weight)
    divisor = np.bincount(shared.after, weight, len(sizes))
    some = divisor[shared.after] > _WHOLE * sizes[shared.after]
    bare = np.ones(len(sizes), bool)
    bare[kept] = bare[shared.after[some]] = False
    bare = np.flatnonzero(bare)
    x, y = (v[new.triangles[bare]].mean(1) for v in (new.x, new.y))
    nearest = nearest_triangles(old, x, y, new.triangle[bare])
    entries = [
        Entries(kept, same[kept], np.ones(len(kept))),
        Entries(shared.after[some], shared.before[some], weight[some] / divisor[shared.after[some]]),
        Entries(bare, nearest, np.ones(len(bare))),
        *_folded_outside(old, new, shared, areas, sizes, np.unique(new.triangle[plain])),
    ]
    shape = (len(sizes), len(areas))
    rows = SparseRows.of(entries, shape)
    counts = [_count(new, new.triangle[same < 0]), inverted, _count(new, new.triangle[partly & (sizes > 0)])]
    return _made(new, new.triangle, rows, counts, tangled[new.triangle], _shares(old, new, areas, sizes, total))


def _folded_outside(
    old: Side, new: Side, shared: Overlaps, areas: np.ndarray, sizes: np.ndarray, differing: np.ndarray
) -> list[Entries]:
    """Entries for what tangled triangles before have outside the domain, where upright and inverted ones cancel.

    differing  the meshes whose domains differ: theirs is lost, as all that lies outside

    These signed areas add up to zero, so that constants are kept whoever gets them.  They are spread over the
    triangles after that share an area with those triangles, as so much per area: the sum of value times signed area
    is kept.
    """
    inside = np.bincount(shared.before, shared.area * np.sign(areas[shared.before]), len(areas))
    tangled = _count(old, old.triangle[areas <= 0]) > 0
    rest = np.where(tangled[old.triangle], areas - inside, 0.0)
    rest[np.abs(rest) <= _slack(old, np.abs(areas))] = 0.0
    entries = []
    for b in np.setdiff1d(old.triangle[rest != 0], differing):
        out = np.flatnonzero((rest != 0) & (old.triangle == b))
        takers = np.unique(shared.after[rest[shared.before] != 0])
        takers = takers[new.triangle[takers] == b]
        if len(takers):
            share = rest[out] / sizes[takers].sum()
            entries.append(Entries(np.repeat(takers, len(out)), np.tile(out, len(takers)), np.tile(share, len(takers))))
    return entries


def _projection(old: Side, new: Side, after: MeshBatch) -> Transfer:
    areas, sizes = signed_areas(old), signed_areas(new)
    inverted = _count(old, old.triangle[areas <= 0])
    shared = overlaps(old, new, moments=True)
    sign = np.where(areas[shared.before] < 0, -1.0, 1.0)
    total = np.bincount(shared.after, sign * shared.area, len(sizes))
    partly = np.zeros(len(new.x), bool)
    partly[new.triangles[np.abs(total - sizes) > _slack(new, sizes)]] = True
    rows = mixed_mass(old, new, shared, sign)
    unused = np.flatnonzero(np.bincount(new.triangles.reshape(-1), minlength=len(new.x)) == 0)
    if len(unused):
        # The mass matrix has a one for vertices of no triangle, so that these get the nearest value.
        near = nearest_vertices(old, new.x[unused], new.y[unused], new.vertex[unused])
        known = Entries(rows.rows.numpy(), rows.columns.numpy(), rows.weights.numpy())
        rows = SparseRows.of([known, Entries(unused, near, np.ones(len(near)))], rows.shape)
    counts = [_count(new, new.vertex), inverted, _count(new, new.vertex[partly])]
    mass = MassMatrix.of(new, after.point_offsets.cpu())
    everything = np.ones(len(new.x), bool)
    return _made(new, new.vertex, rows, counts, everything, _shares(old, new, areas, sizes, total), mass)


def _same_triangles(old: Side, new: Side, unmoved: np.ndarray) -> np.ndarray:
    """(T',) the triangle of `old` that has the row of each triangle in its mesh and the same corners there; or -1."""
    counts, now = (np.bincount(side.triangle, minlength=len(side.centre)) for side in (old, new))
    starts = np.cumsum(counts) - counts - (np.cumsum(now) - now)
    row = np.arange(len(new.triangles)) + starts[new.triangle]
    row[(counts != now)[new.triangle]] = -1
    corners = unmoved[new.triangles]
    candidates = np.flatnonzero((row >= 0) & (corners >= 0).all(1))
    here, there = np.sort(corners[candidates], 1), np.sort(old.triangles[row[candidates]], 1)
    same = np.full(len(row), -1)
    equal = candidates[(here == there).all(1)]
    same[equal] = row[equal]
    return same


def _slack(side: Side, sizes: np.ndarray) -> np.ndarray:
    """(T,) what may be missing of the areas `sizes` (T,): in thin triangles rounding alone is a large part of them."""
    low, high = side.triangle_boxes()
    return _WHOLE * sizes + _ROUNDING * (high - low).max(1) ** 2


def _shares(
    old: Side, new: Side, areas: np.ndarray, sizes: np.ndarray, total: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(B,) each: the part of the area after, and of that before, which the other mesh does not cover."""
    meshes = len(old.centre)
    common = np.bincount(new.triangle, total, meshes)
    shares = []
    for side, size in ((new, sizes), (old, areas)):
        whole = np.bincount(side.triangle, size, meshes)
        part = 1 - common / np.where(whole > 0, whole, 1.0)
        shares.append(np.where((part > _WHOLE) & (whole > 0), part, 0.0))
    return shares[0], shares[1]


def _count(side: Side, mesh: np.ndarray) -> np.ndarray:
    """(B,) how often each mesh is named."""
    return np.bincount(mesh, minlength=len(side.centre))


def _made(
    side: Side,
    row_mesh: np.ndarray,
    rows: SparseRows,
    counts: list[np.ndarray],
    signed: np.ndarray | None = None,
    shares: tuple[np.ndarray, np.ndarray] | None = None,
    mass: MassMatrix | None = None,
) -> Transfer:
    moved, tangled, outside = (torch.from_numpy(count) for count in counts)
    zero = np.zeros(len(side.centre))
    uncovered, missed = (torch.from_numpy(share) for share in shares or (zero, zero))
    info = TransferInfo(moved, tangled, outside, torch.zeros_like(moved), uncovered, missed)
    no = np.zeros(len(row_mesh), bool)
    return Transfer(rows, info, torch.from_numpy(row_mesh), torch.from_numpy(no if signed is None else signed), mass)
