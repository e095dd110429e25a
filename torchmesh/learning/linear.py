"""The linear maps of losses: from points to the edges of triangles, and from triangles to sums over meshes.

torch.compile would write the gathers and scatters of these maps into its loops once for every corner, which takes a
C++ compiler many seconds.  Inside what is compiled each map, and its transpose, is therefore one operator of torch
(`torch.library.custom_op`), which is the derivative of the other; elsewhere they are ordinary tensor operations.
"""

from typing import Any

import torch
from torch import Tensor

from ..mesh.ragged import counts_from_offsets, owner_of
from ..mesh.triangle import corners
from ..optimising.jacobian import edge_coordinates

# x and y of e1 = b - a, then of e2 = c - a, (T,) each.
Edges = tuple[Tensor, Tensor, Tensor, Tensor]


def edges_of(points: Tensor, triangles: Tensor) -> Edges:
    """The edges of `triangles` (T, 3) over `points` (V, 2), differentiable any number of times."""
    if torch.compiler.is_compiling():
        e1x, e1y, e2x, e2y = _edges(points, triangles).unbind(0)
        return e1x, e1y, e2x, e2y
    return edge_coordinates(corners(points, triangles))


def mean_of_each(values: Tensor, offsets: Tensor) -> Tensor:
    """(B,) the means of `values` (T,) over the triangles of each mesh, differentiable any number of times."""
    counts = counts_from_offsets(offsets)
    if torch.compiler.is_compiling():
        return _sums(values, offsets) / counts
    return values.new_zeros(len(counts)).index_add(0, owner(offsets, len(values), values), values) / counts


def owner(offsets: Tensor, count: int, like: Tensor) -> Tensor:
    """(count,) the mesh of each triangle, by an operation whose result has a size that is known beforehand."""
    return owner_of(torch.arange(count, device=like.device), offsets)


@torch.library.custom_op("torchmesh::edges", mutates_args=())
def _edges(points: Tensor, triangles: Tensor) -> Tensor:
    return torch.stack(edge_coordinates(corners(points, triangles)))


@torch.library.custom_op("torchmesh::edge_forces", mutates_args=())
def _edge_forces(forces: Tensor, triangles: Tensor, vertices: int) -> Tensor:
    """(V, 2) the transpose of `_edges`: forces (4, T) on edges as forces on vertices."""
    out = forces.new_zeros((2, vertices))
    a, b, c = (v.contiguous() for v in triangles.unbind(1))
    for axis, total in enumerate(out):
        one, two = forces[axis].contiguous(), forces[axis + 2].contiguous()
        total.index_add_(0, b, one).index_add_(0, c, two).index_add_(0, a, one + two, alpha=-1)
    return out.T.contiguous()


@torch.library.custom_op("torchmesh::sums", mutates_args=())
def _sums(values: Tensor, offsets: Tensor) -> Tensor:
    return values.new_zeros(len(offsets) - 1).index_add_(0, owner(offsets, len(values), values), values)


@torch.library.custom_op("torchmesh::spread", mutates_args=())
def _spread(values: Tensor, offsets: Tensor, count: int) -> Tensor:
    """(count,) the transpose of `_sums`: the number of each mesh for each of its triangles."""
    return values.index_select(0, owner(offsets, count, values))


_edges.register_fake(lambda points, triangles: points.new_empty((4, triangles.shape[0])))
_edge_forces.register_fake(lambda forces, triangles, vertices: forces.new_empty((vertices, 2)))
_sums.register_fake(lambda values, offsets: values.new_empty(offsets.shape[0] - 1))
_spread.register_fake(lambda values, offsets, count: values.new_empty(count))


def _remember(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    """Keep what the transpose needs: the rows, and the length of what went in."""
    ctx.save_for_backward(inputs[1])
    ctx.length = inputs[0].shape[-1 if inputs[1].dim() == 1 else 0]


_edges.register_autograd(
    lambda ctx, g: (_edge_forces(g.contiguous(), *ctx.saved_tensors, ctx.length), None), setup_context=_remember
)
_edge_forces.register_autograd(lambda ctx, g: (_edges(g, *ctx.saved_tensors), None, None), setup_context=_remember)
_sums.register_autograd(
    lambda ctx, g: (_spread(g.contiguous(), *ctx.saved_tensors, ctx.length), None), setup_context=_remember
)
_spread.register_autograd(lambda ctx, g: (_sums(g, *ctx.saved_tensors), None, None), setup_context=_remember)
