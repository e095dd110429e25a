"""Public functions compute with plain numbers, whatever autograd and autocast are set to outside.

Minimisers work in place, and libraries read the memory of tensors: neither goes together with tensors that require
gradients.  Under autocast, matrix products would round to half precision.  What has a derivative says so: the layers of
`nn`, the losses, `metrics`, `femwarp` and `transfer`.
"""

import contextlib
import dataclasses
import functools
import threading
from collections.abc import Callable, Iterator
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor

from ..kernels.library import library_for
from .typed import check_of

_P = ParamSpec("_P")
_R = TypeVar("_R")


# What has no tensors in it.  Options are full of these, and looking into each would take longer than measuring a mesh.
_PLAIN = frozenset({int, float, bool, str, type(None), torch.dtype, torch.device})

# The names of the fields of each type that was met.
_KNOWN: dict[type, tuple[str, ...]] = {}


class _Thread(threading.local):
    """inside: whether a function of ours is already at work in this thread."""

    inside = False


_thread = _Thread()


def without_autograd(verb: Callable[_P, _R]) -> Callable[_P, _R]:
    """`verb`, whose arguments come detached from the graph of autograd, and in which autograd and autocast are off.

    Raises TypeError, at a call from outside, for what is not the mesh or the record that the annotations say.
    """
    check = check_of(verb)

    @functools.wraps(verb)
    def plain(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        if _thread.inside and not any(map(_requires_grad, (*args, *kwargs.values()))):
            return verb(*args, **kwargs)
        check(args, kwargs)
        before, _thread.inside = _thread.inside, True
        try:
            with torch.no_grad(), without_autocast():
                return verb(*map(detached, args), **{name: detached(value) for name, value in kwargs.items()})
        finally:
            _thread.inside = before

    return plain


def loops_may_read(values: Tensor) -> bool:
    """Whether the compiled loops are in use and may read the memory of `values`.

    Only inside a function that computes with plain numbers is this sure: elsewhere autograd, torch.compile or a
    transform of torch.func may want to see every operation.
    """
    return _thread.inside and not values.requires_grad and library_for(values) is not None


@contextlib.contextmanager
def without_autocast() -> Iterator[None]:
    """Inside, operations have the precision of their arguments."""
    with contextlib.ExitStack() as stack:
        for device in ("cpu", "cuda"):
            if torch.is_autocast_enabled(device):
                stack.enter_context(torch.autocast(device, enabled=False))
        yield


def detached(value: Any) -> Any:
    """`value` with every tensor in it detached; the same object if none requires a gradient.

    value  anything: tensors are looked for in meshes, options and other dataclasses, and in lists, tuples and dicts
    """
    if type(value) in _PLAIN:
        return value
    if isinstance(value, Tensor):
        return value.detach() if value.requires_grad else value
    names = _fields(type(value))
    if names:
        changed = {}
        for name in names:
            old = getattr(value, name)
            if type(old) in _PLAIN:
                continue
            new = detached(old)
            if new is not old:
                changed[name] = new
        return dataclasses.replace(value, **changed) if changed else value
    if type(value) in (list, tuple):
        parts = [detached(part) for part in value]
        return value if all(a is b for a, b in zip(parts, value, strict=True)) else type(value)(parts)
    if type(value) is dict:
        values = {key: detached(part) for key, part in value.items()}
        return value if all(values[key] is part for key, part in value.items()) else values
    return value


def _fields(kind: type) -> tuple[str, ...]:
    """The names of the fields of a dataclass; none for any other type."""
    if kind not in _KNOWN:
        _KNOWN[kind] = tuple(f.name for f in dataclasses.fields(kind)) if dataclasses.is_dataclass(kind) else ()
    return _KNOWN[kind]


def _requires_grad(value: Any) -> bool:
    """Whether a tensor, or the points of a mesh, require a gradient."""
    points = getattr(value, "points", value)
    return isinstance(points, Tensor) and points.requires_grad
