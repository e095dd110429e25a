"""The compiled library: where it is, whether it is used, and how arrays are handed to it.

The algorithms are written in torch, and run on any device.  On the processor, some of their inner loops have a twin in
C++ (torchmesh/kernels/source), which does the same in a fraction of the time.  It is a plain C interface called through
ctypes: it depends on the version of neither Python nor torch, and is built by any compiler of C++17.  ctypes lets other
Python threads run during a call.

The environment variable TORCHMESH_KERNELS chooses: "torch" for torch alone, "compiled" for an error where the library
is missing; without it, the library is used where it is there.
"""

import ctypes
import functools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from torch import Tensor

INT32, INT64, DOUBLE, ADDRESS = ctypes.c_int32, ctypes.c_int64, ctypes.c_double, ctypes.c_void_p
BOOL = ctypes.c_bool

_CHOICES = ("", "torch", "compiled")
_chosen: str | None = None


def library() -> ctypes.CDLL | None:
    """The compiled loops, or None where torch is to do their work.

    Raises RuntimeError if TORCHMESH_KERNELS asks for them and they are not there, or has another value than those that
    the head of this module names.
    """
    choice = asked_for() if _chosen is None else _chosen
    if choice == "torch":
        return None
    found = _load()
    if found is None and choice == "compiled":
        raise RuntimeError(
            "TORCHMESH_KERNELS asks for compiled kernels, but they were not built when torchmesh was installed; "
            "install a C++ compiler and then torchmesh anew, or unset TORCHMESH_KERNELS"
        )
    return found


@functools.cache
def asked_for() -> str:
    """What TORCHMESH_KERNELS says, which is read once."""
    choice = os.environ.get("TORCHMESH_KERNELS", "")
    if choice not in _CHOICES:
        raise RuntimeError(f"TORCHMESH_KERNELS must be 'torch' or 'compiled', or not be set; it is {choice!r}")
    return choice


def library_for(values: "Tensor") -> ctypes.CDLL | None:
    """The compiled loops, or None where torch is to do their work, as on another device than the processor."""
    return library() if values.is_cpu else None


def kernels_in_use() -> str:
    """ "compiled" or "torch": which inner loops this process uses on the processor."""
    return "torch" if library() is None else "compiled"


@contextmanager
def using(choice: str) -> Iterator[None]:
    """Inside this context, "torch" or "compiled" is chosen whatever the environment says; for tests and timings."""
    global _chosen
    before, _chosen = _chosen, choice
    try:
        yield
    finally:
        _chosen = before


def built() -> bool:
    """Whether the compiled loops are there, be they in use or not."""
    return _load() is not None


@functools.cache
def _load() -> ctypes.CDLL | None:
    """The library beside this module, if it was built."""
    for suffix in ("so", "pyd", "dylib"):
        for path in sorted(Path(__file__).parent.glob(f"_loops*.{suffix}")):
            return ctypes.CDLL(str(path))
    return None


def call(name: str, result: type | None, *arguments: object) -> int:
    """Call a function of the library, which must be in use; `result` is the type of what it returns."""
    loops = library()
    assert loops is not None
    function = getattr(loops, name)
    function.restype = result
    value: int = function(*arguments)
    return value


@functools.cache
def function(name: str, result: type | None, *arguments: type) -> Callable[..., int]:
    """A function of the library that takes plain numbers as its `arguments`, for calls that must cost little.

    It may be called where the library is in use.
    """
    loops = _load()
    assert loops is not None
    found = loops[name]
    found.restype, found.argtypes = result, arguments
    return cast("Callable[..., int]", found)


def release(name: str, handle: int) -> None:
    """Call the function of the library that frees what `handle` stands for, whichever loops are in use."""
    loops = _load()
    if loops is not None:
        getattr(loops, name)(ADDRESS(handle))


def pointer(values: "Tensor | None") -> int | None:
    """Where the numbers of a contiguous tensor begin; None stays None."""
    if values is None:
        return None
    assert values.is_contiguous()
    return values.data_ptr()


def threads() -> int:
    """On how many threads the loops may run: as many as torch may use."""
    import torch

    return torch.get_num_threads()
