"""Quality, angles, twins and segments that meet, compiled.

Each function is the twin, to the bit, of the one that its docstring names; arguments are as there.  Only angles and
the times of `first_flat` may differ in the last bit, since torch does not always round a square root to the nearest
number.
"""

import numpy as np
import torch
from torch import Tensor

from .library import ADDRESS, DOUBLE, INT64, call, function, pointer

# Most searches for pairs of segments find no more than this.
_ROOM = 64


def measured(points: Tensor, triangles: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """(T,) area, inverse mean ratio and uprightness over points (V, 2) float64; `mesh.measure._measure`."""
    area, ratio = torch.empty((2, len(triangles)), dtype=torch.float64)
    upright = torch.empty(len(triangles), dtype=torch.bool)
    _over_triangles("tm_measure", points, triangles, area, ratio, upright)
    return area, ratio, upright


def shapes(points: Tensor, triangles: Tensor) -> tuple[Tensor, Tensor]:
    """(T,) `triangle.minimum_angle` and `triangle.inverse_mean_ratio` over points (V, 2) float64."""
    angle, ratio = torch.empty((2, len(triangles)), dtype=torch.float64)
    _over_triangles("tm_shapes", points, triangles, angle, ratio)
    return angle, ratio


def first_flat(
    points: Tensor, target: Tensor, triangles: Tensor, triangle_offsets: Tensor, centre: Tensor, unit: Tensor
) -> Tensor:
    """(T,) `boundary_path.first_flat` on the way from points to target, both (V, 2); centre (B, 2) and unit (B,)."""
    flat = torch.empty(len(triangles), dtype=torch.float64)
    numbers = [v.to(torch.float64).contiguous() for v in (points, target, centre, unit)]
    whole = triangles.contiguous(), triangle_offsets.contiguous()
    call("tm_first_flat", None, *(ADDRESS(pointer(v)) for v in (*numbers, *whole)), INT64(len(unit)),
         ADDRESS(pointer(flat)))  # fmt: skip
    return flat


def twins(triangles: Tensor) -> Tensor:
    """(3T,) `mesh.connectivity.twins`."""
    triangles = triangles.contiguous()
    twin = torch.empty(triangles.numel(), dtype=torch.int64)
    vertices = int(triangles.max()) + 1 if len(triangles) else 0
    call("tm_twins", None, ADDRESS(pointer(triangles)), INT64(len(triangles)), INT64(vertices), ADDRESS(pointer(twin)))
    return twin


def triangle_components(twin: Tensor, blocked: Tensor | None) -> Tensor:
    """(T,) `mesh.connectivity.triangle_components` of twin (3T,) int64 and blocked (3T,) bool."""
    twin, blocked = twin.contiguous(), None if blocked is None else blocked.contiguous()
    stack, out = torch.empty((2, twin.numel() // 3), dtype=torch.int64)
    function("tm_triangle_components", None, ADDRESS, ADDRESS, INT64, ADDRESS, ADDRESS)(
        twin.data_ptr(), pointer(blocked), out.numel(), stack.data_ptr(), out.data_ptr()
    )
    return out


def boundary_loops(boundary: Tensor) -> list[Tensor] | None:
    """`mesh.connectivity.boundary_loops` of boundary (E, 2) int64; None where a walk does not close."""
    boundary, count = boundary.contiguous(), len(boundary)
    order, sizes = torch.empty((2, count), dtype=torch.int64)
    loops = function("tm_boundary_loops", INT64, ADDRESS, INT64, ADDRESS, ADDRESS)(
        boundary.data_ptr(), count, order.data_ptr(), sizes.data_ptr()
    )
    return None if loops < 0 else list(order.split(sizes[:loops].tolist()))


def half_edges_on(triangles: Tensor, edges: Tensor, vertices: int) -> Tensor:
    """(3T,) bool `mesh.connectivity.half_edges_on`."""
    triangles, edges = triangles.contiguous(), edges.contiguous()
    out = torch.empty(triangles.numel(), dtype=torch.bool)
    function("tm_half_edges_on", None, ADDRESS, INT64, ADDRESS, INT64, INT64, ADDRESS)(
        triangles.data_ptr(), out.numel(), edges.data_ptr(), len(edges), vertices, out.data_ptr()
    )
    return out


def low_half_edges(points: Tensor, triangles: Tensor, among: Tensor, share: float) -> Tensor:
    """(N,) `layering.layers.low_half_edges` of points (V, 2) float64 and the half-edges `among` (3T,) bool."""
    points, triangles, among = points.contiguous(), triangles.contiguous(), among.contiguous()
    out = torch.empty(among.numel(), dtype=torch.int64)
    found = function("tm_low_half_edges", INT64, ADDRESS, ADDRESS, ADDRESS, INT64, DOUBLE, ADDRESS)(
        points.data_ptr(), triangles.data_ptr(), among.data_ptr(), among.numel(), share, out.data_ptr()
    )
    return out[:found].clone()


def row_signs(points: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(N,) `triangulating.arrays.signs`, of points (V, 2) float64 and rows (N,)."""
    points = np.ascontiguousarray(points, np.float64)
    rows = [np.ascontiguousarray(v, np.int64) for v in (a, b, c)]
    out = np.empty(len(rows[0]), np.int8)
    call("tm_row_signs", None, *(ADDRESS(v.ctypes.data) for v in (points, *rows)), INT64(len(out)),
         ADDRESS(out.ctypes.data))  # fmt: skip
    return out


def crossing_pairs(points: np.ndarray, segments: np.ndarray, group: np.ndarray | None, most: int) -> np.ndarray | None:
    """(P, 2) `triangulating.crossings.crossing_pairs`; None where more than `most` pairs overlap in x."""
    points, segments = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(segments, np.int64)
    group = None if group is None else np.ascontiguousarray(group, np.int64)
    out = np.empty((_ROOM, 2), np.int64)
    found = call(
        "tm_crossing_pairs", INT64, ADDRESS(points.ctypes.data), ADDRESS(segments.ctypes.data),
        ADDRESS(None if group is None else group.ctypes.data), INT64(len(segments)), INT64(most), INT64(_ROOM),
        ADDRESS(out.ctypes.data),
    )  # fmt: skip
    if found < 0:
        return None
    if found > _ROOM:
        out = np.empty((found, 2), np.int64)
        call("tm_pairs_found", None, ADDRESS(out.ctypes.data))
    return out[:found]


def _over_triangles(name: str, points: Tensor, triangles: Tensor, *out: Tensor) -> None:
    columns = points.contiguous(), triangles.contiguous()
    call(
        name, None, *(ADDRESS(pointer(v)) for v in columns), INT64(len(triangles)), *(ADDRESS(pointer(v)) for v in out)
    )
