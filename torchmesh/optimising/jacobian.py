"""How a triangle lies to its target: the Jacobian J = E W^-1, its two invariants and their derivatives.

    a ---- e1 ----> b        E = [e1, e2] = [b - a, c - a]; W is the E of the target triangle
     \\                       (Knupp, SIAM Journal on Scientific Computing 23, 2001; Kim 2017 writes A for E)
      `-- e2 --> c

    stretch = ||J||_F^2 = g11 |e1|^2 + 2 g12 e1.e2 + g22 |e2|^2       det = det J = m det E

Every energy is a function of these two numbers.  In a metric field a triangle is first seen through the square
root H of its metric: then e1 and e2 stand for H e1 and H e2 (`EdgeMap`).

The optimiser's loops hold edges as (2, 2, T), first e1 or e2, then x or y; or as four rows of that.  The functions
they call write into tensors that they are given.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias, TypeVar

import torch
from torch import Tensor

from ..mesh.triangle import SQRT3, Corners

_R = TypeVar("_R")


class Target(NamedTuple):
    """The target triangle as the coefficients of J, one float for all triangles or (T,) one each.

    g11, g12, g22 are the entries of W^-1 W^-T, m = det W^-1.
    """

    g11: Tensor | float
    g12: Tensor | float
    g22: Tensor | float
    m: Tensor | float


def equilateral(side: Tensor | float = 1.0) -> Target:
    """The equilateral target W = side [[1, 1/2], [0, sqrt(3)/2]] (Kim 2017, equation 3)."""
    inverse_square = 1.0 / (side * side)
    return Target(4 / 3 * inverse_square, -2 / 3 * inverse_square, 4 / 3 * inverse_square, 2 / SQRT3 * inverse_square)


def target_of(t: Corners) -> Target:
    """Each triangle of `t`, none of which may be inverted or flat, as the target of itself."""
    e1x, e1y, e2x, e2y = edge_coordinates(t)
    det = e1x * e2y - e1y * e2x
    square = det * det
    return Target(
        (e2x * e2x + e2y * e2y) / square,
        -(e1x * e2x + e1y * e2y) / square,
        (e1x * e1x + e1y * e1y) / square,
        1.0 / det,
    )


class EdgeMap(NamedTuple):
    """A symmetric matrix H for each triangle, by its entries (T,): the edges e are seen as H e."""

    h11: Tensor
    h12: Tensor
    h22: Tensor

    @classmethod
    def root_of(cls, metric: Tensor) -> "EdgeMap":
        """The square roots of symmetric matrices M with the entries (T, 3), scaled to determinant 1.

        M + sqrt(det M) I is a multiple of the root, by the theorem of Cayley and Hamilton.
        """
        determinant = (metric[:, 0] * metric[:, 2] - metric[:, 1] * metric[:, 1]).sqrt()
        h11, h12, h22 = metric[:, 0] + determinant, metric[:, 1], metric[:, 2] + determinant
        size = (h11 * h22 - h12 * h12).sqrt()
        return cls(h11 / size, h12 / size, h22 / size)

    def corners(self, t: Corners) -> Corners:
        """The triangles as they are seen, their corners counted from a."""
        e1x, e1y, e2x, e2y = edge_coordinates(t)
        zero = torch.zeros_like(e1x)
        return Corners(zero, zero, *self._seen(e1x, e1y), *self._seen(e2x, e2y))

    def edges(self, e: Tensor) -> Tensor:
        """(2, 2, T) H e1 and H e2.  Since H is symmetric, it also takes forces on H e to those on e."""
        return torch.stack([torch.stack(self._seen(x, y)) for x, y in e])

    def _seen(self, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
        return self.h11 * x + self.h12 * y, self.h12 * x + self.h22 * y


def invariants(t: Corners, target: Target) -> tuple[Tensor, Tensor]:
    """(T,) stretch and det of J for each triangle, in differentiable torch operations."""
    return invariants_of_edges(*edge_coordinates(t), target)


def invariants_of_edges(e1x: Tensor, e1y: Tensor, e2x: Tensor, e2y: Tensor, target: Target) -> tuple[Tensor, Tensor]:
    """The same from the edges e1 = b - a and e2 = c - a, (T,) each."""
    stretch = (
        target.g11 * (e1x * e1x + e1y * e1y)
        + 2 * target.g12 * (e1x * e2x + e1y * e2y)
        + target.g22 * (e2x * e2x + e2y * e2y)
    )
    return stretch, target.m * (e1x * e2y - e1y * e2x)


def edge_coordinates(t: Corners) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """(T,) each: x and y of e1 = b - a, then of e2 = c - a."""
    return t.bx - t.ax, t.by - t.ay, t.cx - t.ax, t.cy - t.ay


# x and y of two vectors for each triangle, (T,) each.
FourRows: TypeAlias = Sequence[Tensor]


def four_rows(e: Tensor) -> FourRows:
    """Views of edges (2, 2, T) as four rows."""
    return e.view(4, -1).unbind(0)


def double_area(e: FourRows) -> Tensor:
    """(T,) det E, twice the signed area."""
    e1x, e1y, e2x, e2y = e
    return (e1x * e2y).addcmul_(e1y, e2x, value=-1)


def inner(u: FourRows, v: FourRows) -> Tensor:
    """(T,) the inner product."""
    return (u[0] * v[0]).addcmul_(u[1], v[1]).addcmul_(u[2], v[2]).addcmul_(u[3], v[3])


def half_stretch_slope(e: Tensor, target: Target, out: Tensor) -> None:
    """Half the derivative of the stretch by the edges (2, 2, T), linear in e; the stretch is its product with e."""
    _combine(target.g11, e[0], target.g12, e[1], out=out[0])
    _combine(target.g22, e[1], target.g12, e[0], out=out[1])


def area_slope(e: FourRows, factor: Tensor, out: FourRows) -> None:
    """`factor` (T,) times the derivative of det E by the edges, linear in e.  `factor` comes back negated."""
    e1x, e1y, e2x, e2y = e
    torch.mul(e2y, factor, out=out[0])
    torch.mul(e1x, factor, out=out[3])
    factor.neg_()
    torch.mul(e2x, factor, out=out[1])
    torch.mul(e1y, factor, out=out[2])


def add_area_slope(e: FourRows, factor: Tensor, to: FourRows) -> None:
    """Add `factor` (T,) times the derivative of det E by the edges to `to`."""
    e1x, e1y, e2x, e2y = e
    to[0].addcmul_(factor, e2y)
    to[1].addcmul_(factor, e2x, value=-1)
    to[2].addcmul_(factor, e1y, value=-1)
    to[3].addcmul_(factor, e1x)


def _combine(p: Tensor | float, u: Tensor, q: Tensor | float, v: Tensor, out: Tensor) -> None:
    """p u + q v."""
    torch.mul(u, p, out=out)
    if isinstance(q, float):
        out.add_(v, alpha=q)
    else:
        out.addcmul_(v, q)


def select_rows(record: _R, keep: Tensor | slice) -> _R:
    """An energy, target or map for some of the triangles: its (T,) parameters at `keep`, floats as they are."""
    if isinstance(record, tuple):
        return type(record)(*(v[keep] if isinstance(v, Tensor) else v for v in record))
    changes = {name: value[keep] for name, value in vars(record).items() if isinstance(value, Tensor)}
    return dataclasses.replace(record, **changes) if changes else record  # type: ignore[type-var]
