"""Linear maps that torch differentiates by their transpose, as often as it is asked to."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class LinearMap:
    """A linear map of tensors by what it does, forwards and transposed; neither need be differentiable in torch."""

    forward: Callable[[Tensor], Tensor]
    transposed: Callable[[Tensor], Tensor]

    def __call__(self, values: Tensor) -> Tensor:
        """The map's value, which has a gradient in `values`, and that again."""
        out: Tensor = _Applied.apply(values, self)
        return out


class _Applied(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, values: Tensor, by: LinearMap) -> Tensor:
        context.by = by
        return by.forward(values)

    @staticmethod
    def backward(context: Any, gradient: Tensor) -> tuple[Tensor, None]:
        by = context.by
        return LinearMap(by.transposed, by.forward)(gradient), None
