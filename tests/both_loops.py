"""The same work by the compiled loops and by torch."""

import shutil
from collections.abc import Callable
from typing import TypeVar

import pytest

from torchmesh.kernels import library

_R = TypeVar("_R")


def need_compiled_loops() -> None:
    """Skip the test where there is no compiler to build the loops with; where there is one, they must be there."""
    if library.built():
        return
    if any(shutil.which(name) for name in ("c++", "g++", "clang++", "cl")):
        pytest.fail("there is a compiler, but no compiled loops: run python setup.py build_ext --inplace")
    pytest.skip("there is no C++ compiler, and torchmesh works by torch alone")


def both(run: Callable[[], _R]) -> list[_R]:
    """What `run` returns by torch, and by the compiled loops."""
    results = []
    for choice in ("torch", "compiled"):
        with library.using(choice):
            results.append(run())
    return results
