"""A device that there is not: tensors that say they are elsewhere, and refuse to meet tensors of the processor.

A tensor made by `elsewhere(tensor)`, or inside `Pretended` by an operation with one, reports a device of its own; its
numbers are kept in a tensor of the processor inside.  What a real device would do silently and slowly is counted:
copies to the processor and from it, and what Python waits for (`bool`, `int`, `.tolist()`, sizes that depend on
values).
"""

import sys
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map
from torch.utils.backend_registration import _setup_privateuseone_for_python_backend

PACKAGE = Path(__file__).parents[1] / "torchmesh"

_setup_privateuseone_for_python_backend("pretended")
DEVICE = torch.device("pretended:0")

# What Python waits for: a number out of a tensor.
_WAITS = ("aten._local_scalar_dense.default",)

# Sizes that depend on values, for which a device is waited for, too.
_SIZES = (
    "aten.nonzero.default", "aten.masked_select.default", "aten.repeat_interleave.Tensor",
    "aten._unique2.default", "aten.unique_consecutive.default", "aten.unique_dim.default",
)  # fmt: skip


class Elsewhere(Tensor):
    """A tensor that reports DEVICE; `inner` has its numbers."""

    @staticmethod
    def __new__(cls, inner: Tensor) -> "Elsewhere":
        made = torch.Tensor._make_wrapper_subclass(
            cls, inner.shape, strides=inner.stride(), storage_offset=inner.storage_offset(), dtype=inner.dtype,
            device=DEVICE, requires_grad=inner.requires_grad,
        )  # fmt: skip
        made.inner = inner
        return made

    __torch_function__ = torch._C._disabled_torch_function_impl

    def tolist(self) -> Any:
        if Pretended.active is not None:
            Pretended.active.waits[place()] += 1
        return self.inner.tolist()

    def numpy(self, *_: Any, **__: Any) -> Any:
        raise TypeError(f"numpy() of a tensor on the device, at {place()}")

    def __repr__(self) -> str:
        return f"Elsewhere({self.inner})"

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return run(None, func, args, kwargs or {})


def elsewhere(value: Tensor) -> Elsewhere:
    """The tensor as if it lay on the device."""
    return Elsewhere(value)


def here(value: Any) -> Any:
    """The numbers of what the device holds, for the test to look at."""
    return value.inner if isinstance(value, Elsewhere) else value


class _Uploads(TorchFunctionMode):
    """Numbers of Python that are made a tensor of the device, which torch copies there below what can be seen."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if func is Tensor.new_tensor and isinstance(args[0], Elsewhere) and "device" not in kwargs:
            return Elsewhere(args[0].inner.new_tensor(*args[1:], **kwargs))
        device = kwargs.get("device")
        if func in (torch.tensor, torch.as_tensor) and device is not None and torch.device(device).type == DEVICE.type:
            if isinstance(args[0], Elsewhere):
                return args[0] if kwargs.get("dtype") is None else args[0].to(kwargs["dtype"])
            return Elsewhere(func(*args, **{k: v for k, v in kwargs.items() if k != "device"}))
        return func(*args, **kwargs)


class Pretended(TorchDispatchMode):
    """Inside, tensors may be made on DEVICE.

    waits   by stage and place in the package, how often Python waited for the device
    copies  places at which tensors went to the processor or came from it
    """

    active: "Pretended | None" = None

    def __enter__(self) -> "Pretended":
        Pretended.active = self
        self.uploads = _Uploads()
        self.uploads.__enter__()
        return super().__enter__()

    def __exit__(self, *error: Any) -> None:
        Pretended.active = None
        super().__exit__(*error)
        self.uploads.__exit__(*error)

    def __init__(self) -> None:
        super().__init__()
        self.waits: Counter[str] = Counter()
        self.copies: Counter[str] = Counter()

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return run(self, func, args, kwargs or {})


def run(mode: "Pretended | None", func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    """One operation: on the numbers inside, and on the device if any of its tensors is there."""
    flat, _ = tree_flatten((args, kwargs))
    there = [v for v in flat if isinstance(v, Elsewhere)]
    mine = [v for v in flat if isinstance(v, Tensor) and not isinstance(v, Elsewhere)]
    device = kwargs.get("device")
    made_there = device is not None and torch.device(device).type == DEVICE.type
    name = str(func)
    copying = name.startswith(("aten._to_copy", "aten.copy_"))
    if there and not copying:
        strange = [v for v in mine if v.dim() > 0]
        if strange:
            raise RuntimeError(f"{name}: a tensor of the processor {tuple(strange[0].shape)} meets the device")
    if mode is not None:
        if name in _WAITS or name in _SIZES:
            mode.waits[place()] += bool(there)
        if copying and (bool(there) != made_there or (there and mine)) and (device is not None or (there and mine)):
            mode.copies[place()] += 1
    inner = tree_map(here, (args, {k: torch.device("cpu") if k == "device" and v is not None else v
                                   for k, v in kwargs.items()}))  # fmt: skip
    result = func(*inner[0], **inner[1])
    stays = made_there if device is not None else bool(there)
    if name in _WAITS:
        return result
    # What works in place gives back the tensor that it was given.
    given = {id(here(v)): v for v in there}

    def out(value: Any) -> Any:
        if id(value) in given:
            return given[id(value)]
        return Elsewhere(value) if isinstance(value, Tensor) and stays else value

    return tree_map(out, result)


def place() -> str:
    """The innermost line of the package that is at work."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        name = frame.f_code.co_filename
        if name.startswith(str(PACKAGE)):
            return f"{Path(name).relative_to(PACKAGE)}:{frame.f_lineno} {frame.f_code.co_name}"
        frame = frame.f_back
    return "outside"
