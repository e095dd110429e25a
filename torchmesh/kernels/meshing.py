"""A mesh of a boundary from nothing, compiled: the twin of `triangulating.front.OutlineMesher`."""

import ctypes

import torch
from torch import Tensor

from .library import ADDRESS, DOUBLE, INT32, INT64, call, pointer, release

# A call of the library comes back after so many vertices, a fraction of a second, so that Python sees interrupts.
_STEPS = 50_000


class _Outline(ctypes.Structure):
    """`Outline` of source/front.cpp."""

    _fields_ = [
        ("points", ADDRESS), ("vertices", INT64), ("held", ADDRESS),
        ("boundary", ADDRESS), ("boundaries", INT64), ("segments", ADDRESS), ("inner", INT64),
    ]  # fmt: skip


class _Front(ctypes.Structure):
    """`FrontOptions` of source/front.cpp."""

    _fields_ = [("done", DOUBLE), ("room", DOUBLE), ("low", DOUBLE)]


class OutlineMesher:
    """Meshes an outline; `triangulating.front` says how, and names the arguments."""

    def __init__(self, points: Tensor, held: Tensor, boundary: Tensor, segments: Tensor) -> None:
        arrays = [v.contiguous() for v in (points, held, boundary, segments)]
        at = [pointer(v) for v in arrays]
        outline = _Outline(at[0], len(points), at[1], at[2], len(boundary), at[3], len(segments))
        fault = INT32(0)
        self.vertices = len(points)
        self._mesher = call("tm_mesher_start", ADDRESS, ctypes.byref(outline), ctypes.byref(fault))
        self.fault = fault.value

    def __del__(self) -> None:
        release("tm_mesher_end", self._mesher)

    def background(self) -> Tensor:
        """(T, 3) int64 the triangles of all the vertices that are inside; those of the others are in none."""
        triangles = torch.empty(
            (call("tm_mesher_background", INT64, ADDRESS(self._mesher), None), 3), dtype=torch.int64
        )
        call("tm_mesher_background", INT64, ADDRESS(self._mesher), ADDRESS(pointer(triangles)))
        return triangles

    def mesh(
        self, size: Tensor, done: float, room: float, low: float, filled: tuple[int, int] | None = None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The triangles (T, 3); of the new vertices positions, sizes, corners and weights."""
        mesher, size, options = ADDRESS(self._mesher), size.contiguous(), _Front(done, room, low)
        call("tm_mesher_begin", None, mesher, ADDRESS(pointer(size)), ctypes.byref(options))
        while not call("tm_mesher_advance", INT32, mesher, INT64(_STEPS)):
            pass
        added = INT64(0)
        count = call("tm_mesher_mesh", INT64, mesher, *(None,) * 5, ctypes.byref(added))
        if filled is not None and filled[0] <= added.value < filled[1]:
            call("tm_mesher_fill", None, mesher, INT64(filled[1] - added.value))
            count = call("tm_mesher_mesh", INT64, mesher, *(None,) * 5, ctypes.byref(added))
        new = added.value
        triangles, corners = (torch.empty((rows, 3), dtype=torch.int64) for rows in (count, new))
        points, weights = (torch.empty((new, columns), dtype=torch.float64) for columns in (2, 3))
        found = triangles, points, torch.empty(new, dtype=torch.float64), corners, weights
        call("tm_mesher_mesh", INT64, mesher, *(ADDRESS(pointer(v)) for v in found), ctypes.byref(added))
        return found
