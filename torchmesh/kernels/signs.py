"""Exact signs, compiled: the twins of the predicates of `mesh.predicates`."""

import ctypes
from collections.abc import Sequence

import torch
from torch import Tensor

from .library import ADDRESS, INT64, call, pointer


def orientation_signs(columns: Sequence[Tensor]) -> Tensor:
    """(N,) int8 from the six columns (N,) float64 of `mesh.predicates.orientation`."""
    return _signs("tm_orientation", columns)


def incircle_signs(columns: Sequence[Tensor]) -> Tensor:
    """(N,) int8 from the eight columns (N,) float64 of `mesh.predicates.incircle`."""
    return _signs("tm_incircle", columns)


def triangle_signs(points: Tensor, triangles: Tensor) -> Tensor:
    """(T,) int8, the orientation of triangles (T, 3) int64 over points (V, 2) float64."""
    sign = torch.empty(len(triangles), dtype=torch.int8)
    columns = points.contiguous(), triangles.contiguous()
    call("tm_triangle_signs", None, *(ADDRESS(pointer(v)) for v in columns), INT64(len(triangles)),
         ADDRESS(pointer(sign)))  # fmt: skip
    return sign


def _signs(name: str, columns: Sequence[Tensor]) -> Tensor:
    columns = [v.contiguous() for v in columns]
    sign = torch.empty(len(columns[0]), dtype=torch.int8)
    addresses = (ADDRESS * len(columns))(*(pointer(v) for v in columns))
    call(name, None, ctypes.byref(addresses), INT64(len(sign)), ADDRESS(pointer(sign)))
    return sign
