"""Unknowns of many problems in one vector: each problem owns a whole number of blocks of the same width.

    unknowns  [ block | block ][ block ][ block | block | block ]     (K, W), padded with zeros
    problem     0               1        2                            counts 2, 1, 3

So the products of a problem's vectors with its history are batched matrix products over blocks.
"""

from typing import NamedTuple

import torch
from torch import Tensor

from ..mesh.ragged import offsets_from_counts, take

# The usual width: a few per cent of padding for meshes of a thousand vertices.
BLOCK = 128


def block_width(numbers: int, block_offsets: Tensor) -> int:
    """The width of blocks (B+1,) that hold so many numbers in all."""
    return numbers // max(1, int(block_offsets[-1])) or BLOCK


class Blocks(NamedTuple):
    """Which blocks belong to which problem.

    counts   (B,) the blocks of each problem
    offsets  (B+1,) where they begin
    owner    (K,) the problem of each block
    """

    counts: Tensor
    offsets: Tensor
    owner: Tensor

    @classmethod
    def of(cls, counts: Tensor) -> "Blocks":
        """Blocks of so many (B,) a problem."""
        owner = torch.arange(len(counts), device=counts.device).repeat_interleave(counts)
        return cls(counts, offsets_from_counts(counts), owner)

    def spread(self, per_problem: Tensor) -> Tensor:
        """(B,) one value a problem to (K, 1) one a block."""
        return take(per_problem, self.owner)[:, None]

    def sum(self, per_block: Tensor) -> Tensor:
        """(K, ...) to the sums (B, ...) over each problem's blocks."""
        return torch.segment_reduce(per_block, "sum", offsets=self.offsets, axis=0, initial=0.0)

    def largest(self, per_block: Tensor) -> Tensor:
        """(K,) numbers that are not negative to the largest (B,) of each problem."""
        return torch.segment_reduce(per_block, "max", offsets=self.offsets, initial=0.0)
