"""Orders of elimination and factors of the Hessians of meshes, which are preconditioners of Newton's method, compiled.

Systems with a Hessian are solved by conjugate gradients.  With the factors of the Hessian at a point nearby, these take
a few steps in place of dozens.  The twin in torch takes the diagonal as preconditioner and more steps.
"""

import weakref

import torch
from torch import Tensor

from .library import ADDRESS, INT32, INT64, call, pointer, release, threads

# A call of the library orders or factorises meshes of about so many triangles, so that Python sees interrupts.
TRIANGLES = 100_000

# Meshes with more unknowns than this are left to the diagonal as preconditioner: their factors take too much memory.
_MOST = 200_000


class Orders:
    """In which order the free vertices of meshes are eliminated; this depends on their triangles alone.

    rows              (6, T) int32 of a `Packing`
    offsets           (B+1,) int64 the unknowns of each mesh
    triangle_offsets  (B+1,) int64
    """

    def __init__(self, rows: Tensor, offsets: Tensor, triangle_offsets: Tensor) -> None:
        self.made_of = tuple(v.contiguous() for v in (rows, offsets, triangle_offsets))
        rows, offsets, triangle_offsets = self.made_of
        self.handle = call("tm_new_eliminations", ADDRESS, INT64(len(offsets) - 1))
        weakref.finalize(self, release, "tm_end_eliminations", self.handle)
        for first, end in portions(triangle_offsets):
            call(
                "tm_eliminate", None, ADDRESS(self.handle), ADDRESS(pointer(rows)), INT64(rows.shape[1]),
                ADDRESS(pointer(offsets)), ADDRESS(pointer(triangle_offsets)), INT64(first), INT64(end), INT64(_MOST),
                INT32(threads()),
            )  # fmt: skip

    def are_of(self, rows: Tensor, offsets: Tensor, triangle_offsets: Tensor) -> bool:
        """Whether these are the orders of the meshes with such rows."""
        return all(map(torch.equal, self.made_of, (rows, offsets, triangle_offsets)))


class BlockFactors:
    """The factors of a Hessian of each mesh, made by `newton.factorised_hessians`; meshes may have none."""

    def __init__(self, orders: Orders) -> None:
        self.orders = orders
        self.handle = call("tm_new_factors", ADDRESS, INT64(len(orders.made_of[1]) - 1))
        weakref.finalize(self, release, "tm_end_factors", self.handle)


def handles(factors: BlockFactors | None) -> tuple[int | None, int | None]:
    """The orders and the factors, as the loops take them."""
    return (None, None) if factors is None else (factors.orders.handle, factors.handle)


def portions(triangle_offsets: Tensor) -> list[tuple[int, int]]:
    """The first mesh, and the one after the last, of portions that one call of the library works on."""
    ends = triangle_offsets.tolist()
    start, meshes, out = 0, len(ends) - 1, []
    for mesh in range(1, meshes + 1):
        if mesh == meshes or ends[mesh] - ends[start] >= TRIANGLES:
            out.append((start, mesh))
            start = mesh
    return out
