"""The energies of meshes and their gradient, compiled: the twin of `optimising.assembly.energy_and_forces`."""

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from .library import ADDRESS, DOUBLE, INT32, INT64, call, pointer


class Formula(NamedTuple):
    """An energy as the library knows it.

    kind       0 inverse mean ratio, 1 untangle-beta, 2 regularised
    power      of the inverse mean ratio, and its ceiling, 0 for none
    theta      of the regularised functional
    parameter  beta or epsilon, one number or (T,)
    """

    kind: int
    power: int = 2
    ceiling: float = 0.0
    theta: float = 0.0
    parameter: Tensor | float = 0.0


class PackedTriangles(NamedTuple):
    """The triangles of an objective; see `optimising.objective.MeshObjective`, whose names these are.

    target   g11, g12, g22 and m, one number or (T,) each
    edges    (4, T), or None
    map      h11, h12 and h22, (T,) each, or None
    """

    formula: Formula
    target: Sequence[Tensor | float]
    rows: Tensor
    edges: Tensor | None
    map: Sequence[Tensor] | None


class TrianglesArgument(ctypes.Structure):
    """`TrianglesArgument` of source/energy.hpp."""

    _fields_ = [
        ("kind", INT32), ("power", INT32), ("ceiling", DOUBLE), ("theta", DOUBLE),
        ("parameter", ADDRESS), ("target", ADDRESS * 4),
        ("parameter_stride", INT64), ("target_stride", INT64 * 4),
        ("rows", ADDRESS), ("count", INT64), ("edges", ADDRESS), ("map", ADDRESS * 3),
    ]  # fmt: skip


def energies(
    triangles: PackedTriangles, coordinates: Tensor, triangle_offsets: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """The energy of each mesh (B,), the gradient of their sum (N,), and the least det J of each mesh (B,).

    coordinates  (N,) float32 or float64, on the processor
    """
    alive: list[object] = []
    argument = triangles_argument(triangles, coordinates.dtype, alive)
    meshes = len(triangle_offsets) - 1
    gradient = torch.zeros_like(coordinates)
    energy, least = torch.empty((2, meshes), dtype=torch.float64)
    call(
        "tm_energies", None, ctypes.byref(argument), *(ADDRESS(pointer(v)) for v in (coordinates, triangle_offsets)),
        INT64(meshes), *(ADDRESS(pointer(v)) for v in (gradient, energy, least)),
        INT32(coordinates.dtype == torch.float32),
    )  # fmt: skip
    return energy, gradient, least


def triangles_argument(given: PackedTriangles, dtype: torch.dtype, alive: list[object]) -> TrianglesArgument:
    """The structure that describes the triangles; what it points to is added to `alive`."""

    def column(values: Tensor | float) -> tuple[int | None, int]:
        """Where the numbers are, and whether there is one for each triangle."""
        many = isinstance(values, Tensor) and values.dim() > 0
        held = torch.as_tensor(values, dtype=dtype).contiguous()
        alive.append(held)
        return pointer(held), int(many)

    formula = given.formula
    parameter, parameter_stride = column(formula.parameter)
    target, target_strides = zip(*(column(v) for v in given.target), strict=True)
    maps = [None] * 3 if given.map is None else [column(v)[0] for v in given.map]
    edges = None if given.edges is None else column(given.edges)[0]
    rows = given.rows.contiguous()
    alive.append(rows)
    return TrianglesArgument(
        formula.kind, formula.power, formula.ceiling, formula.theta, parameter, (ADDRESS * 4)(*target),
        parameter_stride, (INT64 * 4)(*target_strides), pointer(rows), rows.shape[1], edges, (ADDRESS * 3)(*maps),
    )  # fmt: skip
