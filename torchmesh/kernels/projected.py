"""Second-order steps of one mesh, compiled: the twin of `optimising.projected_newton` and `optimising.levenberg`.

The loops are in source/projected.cpp.  Their sums have another order than those of numpy and torch, so that both come
to the same positions up to rounding, and up to what rounding decides on the way.
"""

import ctypes
import weakref
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from .library import ADDRESS, DOUBLE, INT32, INT64, call, pointer, release

# A call of the library takes so many steps of a mesh times its triangles, so that Python sees interrupts.
_WORK = 100_000

# What a minimisation gives: points (V, 2), det (T,), the energy before and after, and the steps.
Found = tuple[Tensor, Tensor, float, float, int]

_TOLERANCES = ("slope_tolerance", "energy_tolerance", "decrease", "shortest", "floor", "common_floor")
_FACTORS = ("damping", "less", "more", "good", "poor", "most", "least", "energy_tolerance")


class _Settings(ctypes.Structure):
    """`Settings` of source/projected.cpp."""

    _fields_ = [
        ("kind", INT32), ("enough", INT32), ("parameter", DOUBLE), ("theta", DOUBLE),
        *((name, DOUBLE) for name in _TOLERANCES),
    ]  # fmt: skip


class _Damping(ctypes.Structure):
    """`Damping` of source/projected.cpp."""

    _fields_ = [*((name, DOUBLE) for name in _FACTORS), ("fresh", INT32)]


class CompiledSystem:
    """The free vertices of one mesh, and the pattern of the factors of their Hessian.

    triangles  (T, 3) int64
    row        (V,) int32, the number of each free vertex in an order of few fill-ins, -1 for the others
    rows       how many are free
    columns    (T, 3, 2) float64, the weights of the corners in the columns of J
    """

    def __init__(self, triangles: Tensor, row: Tensor, rows: int, columns: Tensor) -> None:
        corners = triangles.to(torch.int32).contiguous()
        self.count, self.vertices = len(triangles), len(row)
        self._handle = call(
            "tm_projected", ADDRESS, INT32(len(row)), INT32(self.count), ADDRESS(pointer(corners)),
            ADDRESS(pointer(row.contiguous())), INT32(rows), ADDRESS(pointer(columns.contiguous())),
        )  # fmt: skip
        weakref.finalize(self, release, "tm_end_projected", self._handle)

    def minimised(
        self,
        points: Tensor,
        weight: Tensor,
        kind: int,
        parameter: float,
        theta: float,
        options: Mapping[str, Any],
        enough: bool,
    ) -> Found:
        """What `minimise_by_projection` gives, of energy 0 (regularised, with epsilon) or 1 (lifted, with alpha).

        options  the fields of `ProjectedOptions`
        """
        settings = _Settings(kind, enough, parameter, theta, *(options[name] for name in _TOLERANCES))
        return self._taken(
            "tm_projected_minimise", (ctypes.byref(settings),), points, weight, options["max_iterations"]
        )

    def pushed(self, points: Tensor, weight: Tensor, least: float, options: Mapping[str, Any]) -> Found:
        """What `push_areas` gives; `options` are the fields of `LevenbergOptions`."""
        damping = _Damping(*(options[name] for name in _FACTORS), 1)
        state = (ctypes.byref(damping), DOUBLE(least))
        return self._taken("tm_projected_push", state, points, weight, options["max_iterations"])

    def _taken(self, name: str, state: tuple[Any, ...], points: Tensor, weight: Tensor, most: int) -> Found:
        """Call the function until it is done, or has taken so many steps."""
        points, weight = points.contiguous().clone(), weight.contiguous()
        energy, det = torch.empty(2, dtype=torch.float64), torch.empty(self.count, dtype=torch.float64)
        done, start, taken = INT32(0), None, 0
        while start is None or (taken < most and not done.value):
            steps = min(most - taken, max(1, _WORK // max(1, self.count)))
            taken += call(
                name, INT64, ADDRESS(self._handle), *state, ADDRESS(pointer(weight)), INT64(steps),
                *(ADDRESS(pointer(v)) for v in (points, energy, det)), ctypes.byref(done),
            )  # fmt: skip
            start = float(energy[0]) if start is None else start
        return points, det, start, float(energy[1]), taken
