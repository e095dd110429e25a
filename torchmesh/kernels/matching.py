"""Points paired with points near them, compiled: the twin of the loop in `mesh.matching`."""

import torch
from torch import Tensor

from .library import ADDRESS, INT64, call, pointer


def pairs_of_squares(squares: Tensor, goals: Tensor, bits: int, level: int) -> Tensor:
    """(N,) int64 as from `mesh.matching.pairs_of_squares`; the squares (N, 2) int64 of both are contiguous."""
    found = torch.empty(len(goals), dtype=torch.int64)
    call("tm_pairs_nearby", None, ADDRESS(pointer(squares)), ADDRESS(pointer(goals)), INT64(len(goals)), INT64(bits),
         INT64(level), ADDRESS(pointer(found)))  # fmt: skip
    return found
