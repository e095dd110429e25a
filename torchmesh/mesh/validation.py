"""What a mesh must be: arrays as people have them, checked and turned into tensors, or refused with the reason."""

import math
import warnings
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError, MeshWarning
from . import connectivity

# A vertex may leave the common plane by this part of the mesh's extent: single-precision files
# of tilted planes are off by a few 1e-7.
_PLANARITY = 1e-5

# Coordinates up to here have areas that do not overflow.
_LARGEST = 1e150

# The plane is that of the boundary where other vertices reach this many times as far: the rounding of their coordinates
# would tilt it by as much.
_FAR = 16.0


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


def checked_points(points: Any) -> Tensor:
    xyz = _tensor(points, "points")
    if xyz.ndim != 2 or xyz.shape[1] not in (2, 3):
        raise InvalidMeshError(f"points must have shape (V, 2) or (V, 3), not {tuple(xyz.shape)}")
    if xyz.dtype == torch.bool or xyz.is_complex():
        raise InvalidMeshError(f"points must be real numbers, not {xyz.dtype}")
    if xyz.dtype not in (torch.float32, torch.float64):
        xyz = xyz.to(torch.float64)
    if len(xyz) == 0:
        raise InvalidMeshError("the mesh is empty: it has no points")
    return xyz


def fit_positions(xyz: Tensor) -> Tensor:
    """(V,) bool: every coordinate of the point is finite, and small enough to compute areas with."""
    fit = xyz.abs() <= _LARGEST
    if xyz.dtype != torch.float64:
        # In single precision the limit is infinite.
        fit &= xyz.isfinite()
    # A reduction over two columns takes many times as long.
    return fit[:, 0] & fit[:, 1] if xyz.shape[1] == 2 else fit.all(1)


def fit_on_the_whole(xyz: Tensor) -> bool:
    """Whether all points (V, 2) or (V, 3) fit, as `fit_positions` says, in fewer operations."""
    largest = float(xyz.abs().amax()) if xyz.numel() else 0.0
    return math.isfinite(largest) and largest <= _LARGEST


def checked_positions(xyz: Tensor, faces: Tensor) -> Tensor:
    """The points (V, 2) or (V, 3) if one can compute with them.

    A vertex of no triangle whose coordinates are not finite, or too large, is put on a vertex that has one, with a
    MeshWarning.
    """
    unfit = ~fit_positions(xyz)
    if bool(unfit.any()):
        used = torch.zeros(len(xyz), dtype=torch.bool, device=xyz.device)
        used[faces.reshape(-1)] = True
        bad = unfit & used
        if bool(bad.any()):
            row = _first(bad)
            if bool(xyz[bad].isfinite().all()):
                raise InvalidMeshError(
                    f"points row {row} is {xyz[row].tolist()}: areas beyond 1e150 squared overflow; rescale"
                )
            bad = used & ~xyz.isfinite().all(1)
            row = _first(bad)
            raise InvalidMeshError(
                f"points row {row} is {xyz[row].tolist()}: every coordinate must be finite "
                f"({int(bad.sum())} rows are not)"
            )
        warnings.warn(
            MeshWarning(
                f"points row {_first(unfit)} is {xyz[_first(unfit)].tolist()}, but belongs to no triangle: it is put "
                f"on vertex {int(faces[0, 0])} ({int(unfit.sum())} rows are)"
            ),
            stacklevel=3,
        )
        xyz = torch.where(unfit[:, None], xyz[faces[0, 0]], xyz)
    extent = float((xyz.amax(0).double() - xyz.amin(0).double()).max())
    if 0 < extent < 1e-150:
        raise InvalidMeshError(f"the mesh is {extent:.3g} wide: areas of less than 1e-300 underflow; rescale")
    return xyz


def checked_triangles(triangles: Any, vertices: int) -> Tensor:
    faces = checked_faces(triangles, vertices, 3, "triangles")
    if len(faces) == 0:
        raise InvalidMeshError("the mesh is empty: it has no triangles")
    a, b, c = faces.unbind(1)
    repeated = (a == b) | (b == c) | (c == a)
    if bool(repeated.any()):
        row = _first(repeated)
        raise InvalidMeshError(
            f"triangles row {row} is {faces[row].tolist()}: a triangle needs three different vertices; "
            "torchmesh clean IN OUT (tm.clean) mends this"
        )
    return faces


def checked_faces(given: Any, vertices: int, corners: int, name: str) -> Tensor:
    """(N, corners) int64 rows of `vertices` points; `name` is what errors call them."""
    faces = _tensor(given, name)
    if faces.numel() == 0:
        return torch.zeros((0, corners), dtype=torch.int64)
    if faces.ndim != 2 or faces.shape[1] != corners:
        raise InvalidMeshError(f"{name} must have shape ({name[0].upper()}, {corners}), not {tuple(faces.shape)}")
    if faces.dtype == torch.bool or faces.is_floating_point() or faces.is_complex():
        raise InvalidMeshError(f"{name} must be integers (rows of points), not {faces.dtype}")
    faces = faces.to(torch.int64)
    outside = ((faces < 0) | (faces >= vertices)).any(1)
    if bool(outside.any()):
        row = _first(outside)
        raise InvalidMeshError(
            f"{name} row {row} is {faces[row].tolist()}: rows of points run from 0 to {vertices - 1}"
        )
    return faces


def checked_fixed(fixed: Any, vertices: int, device: torch.device) -> Tensor:
    if fixed is None:
        return torch.zeros(vertices, dtype=torch.bool, device=device)
    mask = _tensor(fixed, "fixed").to(device)
    if mask.shape != (vertices,):
        raise InvalidMeshError(f"fixed must have shape ({vertices},), one value a point, not {tuple(mask.shape)}")
    if mask.dtype != torch.bool:
        raise InvalidMeshError(f"fixed must be bool, not {mask.dtype}")
    return mask


def checked_constraints(constrained_edges: Any, faces: Tensor, twin: Tensor, vertices: int) -> Tensor:
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
    keys = connectivity.keys_of(given, vertices)
    present = connectivity.edges(faces, twin)
    missing = ~torch.isin(keys, connectivity.keys_of(present, vertices))
    if bool(missing.any()):
        row = _first(missing)
        raise InvalidMeshError(f"constrained_edges row {row} is {given[row].tolist()}: no triangle has that edge")
    boundary = connectivity.boundary_edges(faces, twin)
    interior = ~torch.isin(keys, connectivity.keys_of(boundary, vertices))
    return given[interior]


def to_plane(xyz: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """(V, 2) coordinates in the plane of the points, and that plane (3, 3): origin, x and y axis.

    A plane that is parallel to two axes of the file keeps the coordinates along them, in their order, to the bit:
    x and y, x and z, or y and z.  A plane of constant z is seen from above.  A tilted plane is seen from the side on
    which most of the area runs counter-clockwise.  Vertices far outside the boundary do not tilt it.
    """
    if xyz.shape[1] == 2:
        return xyz.contiguous(), frame_across(2, 0.0, xyz.device)
    corners = xyz[faces.reshape(-1)]
    across = axis_across(corners)
    if across is not None:
        return xyz[:, axes_beside(across)].contiguous(), frame_across(across, _level(corners, across), xyz.device)
    wide = xyz.to(torch.float64)
    used = torch.zeros(len(xyz), dtype=torch.bool, device=xyz.device)
    used[faces.reshape(-1)] = True
    plane = _plane(wide, wide, faces)
    if bool((plane.height > _PLANARITY).any()) and not bool(used.all()):
        plane = _plane(wide, wide[used], faces)
    height = plane.height * used
    if float(height.max()) > _PLANARITY:
        row = int(height.argmax())
        raise InvalidMeshError(
            f"points row {row} is {xyz[row].tolist()}: it lies {float(height.max()) * plane.extent:.3g} off the plane "
            "of the others; torchmesh improves planar meshes"
        )
    return plane.flat.to(xyz.dtype), plane.frame


def seen_from_above(flat: Tensor, faces: Tensor, frame: Tensor) -> Tensor:
    """(T, 3) the triangles, turned round where they are clockwise only because of the side they are seen from.

    flat   (V, 2) coordinates in the plane `frame` (3, 3)

    A plane of constant z is seen from above, so its triangles come back as they are.  Of any other plane neither side
    is above, and its coordinates may run along the axes of the file, which fixes the side.
    """
    if bool((frame[1:, 2] == 0).all()):
        return faces
    edges, times = _open_edges(faces, len(flat))
    at = flat.to(torch.float64) - flat[faces[0, 0]].to(torch.float64)
    a, b = at[edges[:, 0]], at[edges[:, 1]]
    area = (times * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])).sum()
    return faces.flip(1) if float(area) < 0 else faces


def axes_beside(across: int) -> list[int]:
    """The two axes of the file that are not `across`, in their order."""
    return [axis for axis in range(3) if axis != across]


def frame_across(across: int, level: float, device: torch.device | None = None) -> Tensor:
    """(3, 3) float64 the plane in which the coordinate `across` is `level`: its origin and its two axes."""
    frame = torch.zeros((3, 3), dtype=torch.float64, device=device)
    frame[0, across] = level
    for row, axis in enumerate(axes_beside(across), 1):
        frame[row, axis] = 1
    return frame


def axis_across(points: Tensor) -> int | None:
    """The axis of space along which the points (N, 3) do not differ, up to `_PLANARITY` of their extent.

    z comes before y, and y before x; None if there is no such axis.  Where no coordinate is constant to the bit, the
    one that varies least is taken.
    """
    spread = points.amax(0).to(torch.float64) - points.amin(0).to(torch.float64)
    order = (2, 1, 0)
    least = min(order, key=lambda axis: float(spread[axis]))
    return least if float(spread[least]) <= _PLANARITY * float(spread.max()) else None


def _level(points: Tensor, across: int) -> float:
    """The coordinate `across` of a plane through the points (N, 3): theirs, if it is the same, or the middle."""
    column = points[:, across].to(torch.float64)
    low, high = float(column.min()), float(column.max())
    return low if low == high else low + 0.5 * (high - low)


class _Plane(NamedTuple):
    """A plane through points: coordinates (V, 2) in it, origin and axes (3, 3), heights (V,) over it, in extents."""

    flat: Tensor
    frame: Tensor
    height: Tensor
    extent: float


def _plane(wide: Tensor, seen: Tensor, faces: Tensor) -> _Plane:
    """The plane of the points `seen` (N, 3) of a mesh `wide` (V, 3); of its boundary, where others lie far outside."""
    edges, times = _open_edges(faces, len(wide))
    boundary = wide[edges.reshape(-1).unique()]
    if len(edges) and _FAR * _extent(boundary) < _extent(seen):
        seen = boundary
    low, extent = seen.amin(0), _extent(seen)
    origin = low + (seen - low).mean(0)
    centred = (wide - origin) / extent
    about = centred if seen is wide else (seen - origin) / extent
    axes = torch.linalg.svd(about.T @ about)[2]
    x_axis, normal = axes[0], axes[2]
    # Twice the area that the boundary encloses, as a vector.
    turn = times[:, None] * torch.linalg.cross(centred[edges[:, 0]], centred[edges[:, 1]])
    if float(turn.sum(0) @ normal) < 0:
        normal = -normal
    y_axis = torch.linalg.cross(normal, x_axis)
    flat = torch.stack([centred @ x_axis, centred @ y_axis], 1) * extent
    height = (centred @ normal).abs() / max(1.0, _extent(about if seen is wide else centred))
    return _Plane(flat, torch.stack([origin, x_axis, y_axis]), height, extent)


def _extent(points: Tensor) -> float:
    """The largest side of the box around the points (N, 3)."""
    return float((points.amax(0) - points.amin(0)).max())


def _open_edges(faces: Tensor, vertices: int) -> tuple[Tensor, Tensor]:
    """(E, 2) the edges along which triangles run more often one way than the other, and (E,) how much more often."""
    tails, heads = connectivity.tails(faces), connectivity.heads(faces)
    keys, edge = connectivity.edge_keys(tails, heads, vertices).unique(return_inverse=True)
    times = torch.zeros_like(keys).index_add_(0, edge, (tails < heads).to(torch.int64) * 2 - 1)
    keys, times = keys[times != 0], times[times != 0]
    return torch.stack([keys // vertices, keys % vertices], 1), times.to(torch.float64)
