"""Which meshes of a batch are meant by an index: a number, a slice, numbers in any order, or a mask."""

import operator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .ragged import true_rows


def numbers_of(index: Any, count: int, device: torch.device | str = "cpu") -> Tensor:
    """(M,) int64 the numbers, from 0, of the meshes that `index` names among `count`.

    index  a whole number (negative: from the end), a slice, a sequence or one-dimensional array of whole numbers in
           any order, or `count` booleans; lists, ranges, numpy arrays and tensors

    Raises IndexError for a mesh that is not there or a mask of another length, and TypeError for any other index.
    """
    if isinstance(index, slice):
        run = range(count)[index]
        return torch.arange(run.start, run.stop if run else run.start, run.step, device=device)
    if not isinstance(index, bool | np.bool_) and _is_number(index):
        return _checked(torch.tensor([operator.index(index)], device=device), count)
    if not isinstance(index, list | range | np.ndarray | Tensor):
        raise TypeError(
            f"meshes are taken by a number, a slice, a list, or an array of numbers or booleans, not by {index!r}"
        )
    wanted = index if isinstance(index, Tensor) else torch.from_numpy(np.asarray(index))
    wanted = wanted.to(device)
    if wanted.ndim != 1:
        raise TypeError(f"meshes are taken by one number each, not by an array of shape {tuple(wanted.shape)}")
    if wanted.dtype == torch.bool:
        if len(wanted) != count:
            raise IndexError(f"there are {count} meshes, and the mask has {len(wanted)} entries")
        return true_rows(wanted)
    # An empty list comes as an array of floating-point numbers.
    if len(wanted) and (wanted.is_floating_point() or wanted.is_complex()):
        raise TypeError(f"meshes are taken by whole numbers or booleans, not by {wanted.dtype}")
    return _checked(wanted.to(torch.int64), count)


def _is_number(index: Any) -> bool:
    """Whether it is one whole number, of Python, numpy or torch."""
    if isinstance(index, Tensor | np.ndarray) and (index.ndim or index.dtype in (torch.bool, np.dtype(bool))):
        return False
    return hasattr(index, "__index__")


def _checked(numbers: Tensor, count: int) -> Tensor:
    """The numbers counted from 0.  Raises IndexError for one that is none of `count` meshes."""
    bad = (numbers < -count) | (numbers >= count)
    if bool(bad.any()):
        raise IndexError(f"there are {count} meshes; there is no mesh {int(numbers[bad][0])}")
    return torch.where(numbers < 0, numbers + count, numbers)
