"""L-BFGS on the energies of meshes, compiled: the twin of `optimising.lbfgs.minimise` for `MeshObjective`s.

The loop of every mesh runs in C++ from its start to its end (source/minimise.cpp).  What a mesh comes to depends
neither on the other meshes nor on threads.
"""

import ctypes
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from ..status import Status
from .energies import PackedTriangles, TrianglesArgument, triangles_argument
from .library import ADDRESS, DOUBLE, INT32, INT64, call, pointer, threads

# A call of the library comes back after so many visits of triangles, a fraction of a second, so that Python sees
# interrupts.
WORK = 20_000_000


class OptionsArgument(ctypes.Structure):
    """`OptionsArgument` of source/minimise.hpp."""

    _fields_ = [
        ("max_iterations", INT64), ("patience", INT64), ("history", INT64),
        ("gradient_tolerance", DOUBLE), ("energy_tolerance", DOUBLE), ("first_step", DOUBLE),
        ("largest_step", DOUBLE), ("sufficient_decrease", DOUBLE), ("least_curvature", DOUBLE),
        ("shortening_least", DOUBLE), ("shortening_most", DOUBLE), ("blind_shortening", DOUBLE),
        ("shortest_step", DOUBLE), ("enough", DOUBLE), ("has_enough", INT64), ("status", INT64 * 7),
    ]  # fmt: skip


class ProblemsArgument(ctypes.Structure):
    """`ProblemsArgument` of source/minimise.hpp."""

    _fields_ = [
        ("triangles", TrianglesArgument), ("start", ADDRESS), ("anchored", ADDRESS), ("scale", ADDRESS),
        ("block_offsets", ADDRESS), ("triangle_offsets", ADDRESS),
        ("count", INT64), ("width", INT64), ("unknowns", INT64), ("out", ADDRESS),
        ("energy", ADDRESS), ("gradient", ADDRESS),
        ("iterations", ADDRESS), ("evaluations", ADDRESS), ("status", ADDRESS),
    ]  # fmt: skip


# In the order of the structure above, after the counts.
_NUMBERS = (
    "gradient_tolerance", "energy_tolerance", "first_step", "largest_step", "sufficient_decrease", "least_curvature",
)  # fmt: skip
_STATUSES = (
    Status.RUNNING, Status.CONVERGED, Status.SETTLED, Status.ITERATION_LIMIT, Status.STALLED, Status.VALID,
    Status.NOT_FINITE,
)  # fmt: skip


def options_argument(settings: Mapping[str, Any], enough: float | None = None) -> OptionsArgument:
    """The structure of the fields of `optimising.lbfgs_options.LbfgsOptions`, by name."""
    return OptionsArgument(
        settings["max_iterations"], settings["patience"], settings["history"],
        *(settings[name] for name in _NUMBERS), *settings["shortening"],
        settings["blind_shortening"], settings["shortest_step"], enough or 0.0, enough is not None,
        (INT64 * 7)(*(int(s) for s in _STATUSES)),
    )  # fmt: skip


def outcome_columns(meshes: int) -> tuple[Tensor, ...]:
    """The fields of `optimising.lbfgs_options.LbfgsResult` after the unknowns, all zero."""
    numbers, counts = torch.zeros((2, meshes), dtype=torch.float64), torch.zeros((3, meshes), dtype=torch.int64)
    return *numbers, *counts


def minimise_meshes(
    triangles: PackedTriangles,
    anchored: Tensor,
    scale: Tensor,
    block_offsets: Tensor,
    triangle_offsets: Tensor,
    width: int,
    start: Tensor,
    settings: Mapping[str, Any],
    enough: float | None,
    monitor: Callable[[int, Tensor], None] | None,
) -> tuple[Tensor, ...]:
    """Minimise every mesh's energy from `start` (N,), float32 or float64, on the processor.

    anchored, scale  (F,) and (N,) in the type of `start`
    width            numbers in a block
    settings         the fields of `optimising.lbfgs_options.LbfgsOptions`, by name
    enough           a mesh is done when the determinants of all its triangles exceed this; None: never

    monitor is called after each step with its number and the energies (B',) of the meshes still running.

    Returns the fields of `optimising.lbfgs_options.LbfgsResult`, in their order.
    """
    # What the addresses point to must live as long as the run.
    alive: list[object] = [start, anchored, scale, block_offsets, triangle_offsets]
    meshes = len(block_offsets) - 1
    outcome = torch.empty_like(start), *outcome_columns(meshes)
    problems = ProblemsArgument(
        triangles_argument(triangles, start.dtype, alive),
        *(pointer(v) for v in (start, anchored, scale, block_offsets, triangle_offsets)),
        meshes, width, len(start),
        *(pointer(v) for v in outcome),
    )  # fmt: skip
    options = options_argument(settings, enough)
    run = call("tm_minimise_start", ADDRESS, ctypes.byref(problems), ctypes.byref(options),
                INT32(start.dtype == torch.float32))  # fmt: skip
    try:
        _advance(run, settings["max_iterations"], meshes, monitor)
    finally:
        call("tm_minimise_end", None, ADDRESS(run))
    return outcome


def _advance(run: int, most: int, meshes: int, monitor: Callable[[int, Tensor], None] | None) -> None:
    """Go on until no mesh is running; with a monitor, step by step."""
    energies = None if monitor is None else torch.empty(meshes, dtype=torch.float64)
    running, step = meshes, 0
    while running:
        up_to = most + 1 if monitor is None else step
        work = WORK if monitor is None else 2**62
        running = call("tm_minimise_advance", INT64, ADDRESS(run), INT64(up_to), INT64(work),
                        INT32(threads()), ADDRESS(pointer(energies)))  # fmt: skip
        if monitor is not None and energies is not None:
            if step:
                monitor(step, energies[~energies.isnan()])
            step += 1
