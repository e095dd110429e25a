"""One value of epsilon of the regularised functional, compiled: the twin of `untangling.continuation.Turns`.

The meshes that are to go on are minimised in C++ (source/continuation.cpp), and no part of the batch is copied for
that.  What a mesh comes to depends neither on the other meshes nor on threads.
"""

import ctypes
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from .energies import PackedTriangles, triangles_argument
from .library import ADDRESS, INT32, INT64, call, pointer, threads
from .minimiser import OptionsArgument, ProblemsArgument, options_argument, outcome_columns

# A call of the library comes back after meshes of about so many triangles, so that Python sees interrupts.
_TRIANGLES = 20_000

# Larger meshes are left to the minimiser that can be interrupted; what this loop saves is nothing to them.
LARGEST = 20_000


class _Turn(ctypes.Structure):
    """`TurnArgument` of source/continuation.cpp."""

    _fields_ = [
        ("problems", ProblemsArgument), ("options", OptionsArgument), ("eps_of_triangles", ADDRESS),
        ("rows", ADDRESS), ("eps", ADDRESS), ("before", ADDRESS), ("lowest", ADDRESS), ("inverted", ADDRESS),
    ]  # fmt: skip


class CompiledTurns:
    """Meshes that are minimised with an epsilon of each, again and again.

    x  (N,) float64 the unknowns, which change
    """

    def __init__(
        self,
        triangles: PackedTriangles,
        anchored: Tensor,
        scale: Tensor,
        block_offsets: Tensor,
        triangle_offsets: Tensor,
        width: int,
        x: Tensor,
        settings: Mapping[str, Any],
    ) -> None:
        """The arguments are those of `minimiser.minimise_meshes`; the epsilon of `triangles` is not looked at."""
        meshes = len(block_offsets) - 1
        self.x, self._offsets = x, triangle_offsets.tolist()
        self._of_triangles = torch.ones(triangles.rows.shape[1], dtype=torch.float64)
        self._outcome = outcome_columns(meshes)
        self._alive: list[object] = [anchored, scale, block_offsets, triangle_offsets]
        known = triangles._replace(formula=triangles.formula._replace(parameter=self._of_triangles))
        self._problems = ProblemsArgument(
            triangles_argument(known, torch.float64, self._alive),
            *(pointer(v) for v in (x, anchored, scale, block_offsets, triangle_offsets)),
            meshes, width, len(x), pointer(x), *(pointer(v) for v in self._outcome),
        )  # fmt: skip
        self._options = options_argument(settings)

    def take(self, rows: Tensor, eps: Tensor) -> tuple[Tensor, Tensor, Tensor, tuple[Tensor, ...]]:
        """Minimise the meshes `rows` (K,) with `eps` (K,).

        Returns (K,) each: their energies before, their lowest determinants and numbers of inverted triangles after, and
        the fields of `optimising.lbfgs_options.LbfgsResult` after the unknowns.
        """
        rows, eps = rows.contiguous(), eps.contiguous()
        before, lowest, inverted = torch.empty_like(eps), torch.empty_like(eps), torch.empty_like(rows)
        argument = _Turn(
            self._problems, self._options, pointer(self._of_triangles),
            *(pointer(v) for v in (rows, eps, before, lowest, inverted)),
        )  # fmt: skip
        start = triangles = 0
        meshes = rows.tolist()
        for k, mesh in enumerate(meshes):
            triangles += self._offsets[mesh + 1] - self._offsets[mesh]
            if triangles >= _TRIANGLES or k == len(meshes) - 1:
                call("tm_continuation_turn", None, ctypes.byref(argument), INT64(start), INT64(k + 1), INT32(threads()))
                start, triangles = k + 1, 0
        return before, lowest, inverted, tuple(column[rows] for column in self._outcome)
