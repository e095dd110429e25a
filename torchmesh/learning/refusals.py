"""What a layer cannot be asked for is told in a sentence, and not by an error from deep inside."""

import functools
import sys
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor

_P = ParamSpec("_P")
_R = TypeVar("_R")


def refuse_transforms(what: str) -> None:
    """Raise NotImplementedError inside `torch.vmap` and the other transforms of torch.func."""
    if torch._C._functorch.peek_interpreter_stack() is not None:
        raise NotImplementedError(
            f"{what} does not work inside torch.vmap or torch.func: for many meshes join them (tm.join), and for "
            "derivatives use backward(), torch.autograd.grad or torch.autograd.forward_ad"
        )


class FirstOnly(torch.autograd.Function):
    """A gradient that cannot be derived again; it is given with the tensors on which it depends."""

    @staticmethod
    def forward(ctx: Any, what: str, gradient: Tensor, *depends: Tensor) -> Tensor:
        ctx.what = what
        return gradient.view_as(gradient)

    @staticmethod
    def backward(ctx: Any, *_: Tensor) -> Any:
        raise NotImplementedError(
            f"{ctx.what} has first derivatives only: its gradient cannot be differentiated again (create_graph=True)"
        )


def outside_graphs(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """`function`, around which torch.compile breaks its graph, and which runs as it is, uncompiled.

    This is `torch.compiler.disable`, which takes seconds to import, put off until somebody compiles.
    """
    disabled: list[Callable[_P, _R]] = []

    @functools.wraps(function)
    def run(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        if "torch._dynamo" not in sys.modules:
            return function(*args, **kwargs)
        if not disabled:
            disabled.append(torch.compiler.disable(function))
        return disabled[0](*args, **kwargs)

    run._torchdynamo_disable = True  # type: ignore[attr-defined]
    return run
