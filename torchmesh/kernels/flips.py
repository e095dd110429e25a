"""Rounds of edge flips, compiled: the twin of the loop in `flipping.rounds.flip_rounds`."""

import ctypes

import torch
from torch import Tensor

from .library import ADDRESS, INT32, INT64, call, function, pointer

# A call of the library comes back after so many questions, a fraction of a second, so that Python sees interrupts.
_WORK = 5_000_000

# The numbers of the rules in source/flips.cpp.
SAFE, KIM, SHAPE, METRIC = range(4)


class _Rounds(ctypes.Structure):
    """`RoundsArgument` of source/flips.cpp."""

    _fields_ = [
        ("x", ADDRESS), ("y", ADDRESS), ("metric", ADDRESS),
        ("vertex", ADDRESS), ("twin", ADDRESS), ("locked", ADDRESS), ("half_edges", INT64),
        ("queue", ADDRESS), ("queued", INT64), ("max_rounds", INT64), ("vertices", INT64),
        ("rule", INT32), ("once", INT32),
    ]  # fmt: skip


def edges_of(triangles: Tensor, twin: Tensor) -> Tensor:
    """(Q,) int64, ascending: the lower half-edges of the interior edges of the `triangles` (T,) bool; twin (3T,)."""
    triangles, twin = triangles.contiguous(), twin.contiguous()
    given = triangles.data_ptr(), twin.data_ptr(), twin.numel()
    kinds = ADDRESS, ADDRESS, INT64, ADDRESS
    edges = torch.empty(function("tm_edges_of", INT64, *kinds)(*given, None), dtype=torch.int64)
    function("tm_edges_of", INT64, *kinds)(*given, edges.data_ptr())
    return edges


def flip_in_rounds(
    xy: tuple[Tensor, Tensor],
    half_edges: tuple[Tensor, Tensor, Tensor],
    queue: Tensor | None,
    rule: int,
    metric: Tensor | None,
    once: bool,
    max_rounds: int,
) -> Tensor:
    """Flip until no edge is eligible; vertices, twins and locks of the `half_edges` are written in place.

    xy          x and y (V,) float64
    half_edges  vertex and twin (3T,) int64, locked (3T,) bool
    queue       (Q,) int64, the lower half-edges of the edges to ask about first, ascending; None: all
    rule        one of the numbers above; with METRIC, metric is (V, 3) float64

    Returns (F,) int64, the lower-numbered triangle of each flip.
    """
    vertex, twin, locked = half_edges
    metric = None if metric is None else metric.contiguous()
    argument = _Rounds(
        *(pointer(v) for v in (*xy, metric, vertex, twin, locked)), len(vertex),
        pointer(queue), -1 if queue is None else len(queue), max_rounds, len(xy[0]), rule, once,
    )  # fmt: skip
    rounds = ADDRESS(call("tm_flips_start", ADDRESS, ctypes.byref(argument)))
    try:
        while not call("tm_flips_advance", INT32, rounds, INT64(_WORK)):
            pass
        log = torch.empty(call("tm_flips_log", INT64, rounds, None), dtype=torch.int64)
        call("tm_flips_log", INT64, rounds, ADDRESS(pointer(log)))
    finally:
        call("tm_flips_end", None, rounds)
    return log
