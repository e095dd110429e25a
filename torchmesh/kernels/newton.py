"""Newton's method on the energies of meshes, compiled: the twin of `optimising.newton.newton`.

Meshes take their steps in C++ (source/newton.cpp).  What a mesh comes to depends neither on the other meshes nor on
threads.
"""

import ctypes
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor

from .block_factors import BlockFactors, Orders, handles, portions
from .energies import PackedTriangles, TrianglesArgument, triangles_argument
from .library import ADDRESS, DOUBLE, INT32, INT64, call, pointer, threads

# A call of the library takes all steps of meshes of about so many triangles together, and fewer of one that has more,
# so that Python sees interrupts.
_TRIANGLES = 20_000

_NUMBERS = ("tolerance", "cg_tolerance", "first_cg_tolerance", "near", "decrease", "left", "first_chord", "contraction")


class _Problems(ctypes.Structure):
    """`NewtonArgument` of source/newton.cpp."""

    _fields_ = [
        ("triangles", TrianglesArgument), ("anchored", ADDRESS), ("size", ADDRESS),
        ("offsets", ADDRESS), ("triangle_offsets", ADDRESS), ("unknowns", INT64),
        ("cg_iterations", INT64), ("halvings", INT64), *((name, DOUBLE) for name in _NUMBERS),
        ("x", ADDRESS), ("energy", ADDRESS), ("step", ADDRESS), ("running", ADDRESS),
        ("orders", ADDRESS), ("factors", ADDRESS),
    ]  # fmt: skip


class MeshProblems(NamedTuple):
    """The energies of packed meshes.

    anchored, size             (F,) and (N,) float64
    offsets, triangle_offsets  (B+1,) the unknowns and the triangles of each mesh
    """

    triangles: PackedTriangles
    anchored: Tensor
    size: Tensor
    offsets: Tensor
    triangle_offsets: Tensor


def newton_for_meshes(
    meshes: MeshProblems, start: Tensor, valid: Tensor, settings: Mapping[str, Any], factors: BlockFactors | None = None
) -> tuple[Tensor, Tensor]:
    """What `newton` gives: the unknowns (N,) float64, and (B,) how far each mesh is from there at most.

    start     (N,) float64
    valid     (B,) bool, the meshes that are to move
    settings  the fields of `optimising.newton.NewtonOptions`, and what else the argument of the loop needs, by name
    factors   of the Hessians at points near the way
    """
    alive: list[object] = []
    x, running = start.clone(), valid.clone()
    energy = torch.full((len(valid),), torch.nan, dtype=torch.float64)
    step = torch.full_like(energy, torch.inf)
    triangle_offsets = meshes.triangle_offsets
    problems = _argument(meshes, settings, (x, energy, step, running), factors, alive)
    for first, end, count in _portions(triangle_offsets.tolist()):
        left = settings["newton_steps"]
        steps = max(1, _TRIANGLES * left // max(1, count))
        while left > 0 and bool(running[first:end].any()):
            call("tm_newton", None, ctypes.byref(problems), INT64(first), INT64(end), INT64(min(steps, left)),
                 INT32(threads()))  # fmt: skip
            left -= steps
    return x, step


def _portions(ends: list[int]) -> Iterator[tuple[int, int, int]]:
    """The first mesh, the one after the last, and the number of triangles of portions that are worked on together."""
    start, meshes = 0, len(ends) - 1
    for mesh in range(1, meshes + 1):
        if mesh == meshes or ends[mesh] - ends[start] >= _TRIANGLES:
            yield start, mesh, ends[mesh] - ends[start]
            start = mesh


def factorised_hessians(meshes: MeshProblems, x: Tensor, valid: Tensor, orders: Orders) -> BlockFactors:
    """The factors of the Hessians at the unknowns x (N,) of the meshes `valid` (B,), where these are positive."""
    alive: list[object] = []
    factors = BlockFactors(orders)
    energy, step = torch.empty((2, len(valid)), dtype=torch.float64)
    settings = {"cg_iterations": 0, "halvings": 0, **dict.fromkeys(_NUMBERS, 0.0)}
    values = x.contiguous(), energy, step, valid.contiguous()
    problems = _argument(meshes, settings, values, factors, alive)
    for first, end in portions(meshes.triangle_offsets):
        call("tm_factorise_hessians", None, ctypes.byref(problems), ADDRESS(factors.handle), INT64(first), INT64(end),
             INT32(threads()))  # fmt: skip
    return factors


def _argument(
    meshes: MeshProblems,
    settings: Mapping[str, Any],
    values: tuple[Tensor, ...],
    factors: BlockFactors | None,
    alive: list[object],
) -> _Problems:
    """The structure that describes the problems; what it points to is added to `alive`.

    values  x, energy, step and running
    """
    columns = [v.contiguous() for v in meshes[1:]]
    alive += columns
    packed = triangles_argument(meshes.triangles, torch.float64, alive)
    return _Problems(
        packed, *(pointer(v) for v in columns), len(values[0]),
        settings["cg_iterations"], settings["halvings"], *(settings[name] for name in _NUMBERS),
        *(pointer(v) for v in values), *handles(factors),
    )  # fmt: skip
