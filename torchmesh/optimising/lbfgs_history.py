"""The history of L-BFGS for many problems at once, in its compact representation.

With the last m steps s_i as the columns of S, the changes of the gradient y_i as those of Y, and R the upper
triangle of S'Y with its diagonal D (Byrd, Nocedal & Schnabel, Mathematical Programming 63, 1994, equation 3.1):

    H g = gamma g + [S  gamma Y] [ R^-T (D + gamma Y'Y) R^-1   -R^-T ] [ S'g       ]
                                 [ -R^-1                         0   ] [ gamma Y'g ]

The history is read twice an iteration, for the products with the gradient and for the direction.  All else that
happens is small, in tensors (B, m, m), as in the vector-free form of Chen, Wang & Zhou (NIPS 2014).
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.ragged import take
from .blocks import Blocks

# Numerical floor of a gradient's size in a quotient.
_LEAST = 1e-300


@dataclass(eq=False)
class History:
    """The last m pairs of every problem, and its gradient g.  Written in place: a copy would cost as much as a step.

    blocks    of the problems
    free      (B,) unknowns that may move
    first     root mean square length of a step that knows no pair
    vectors   (K, 2m+1, W) the steps s, the changes y, and g, in the precision of the unknowns
    products  (B, 2m+1) of `vectors` with g, S'g and Y'g by slots, then g'g
    sy        (B, m) the diagonal of D, s_i'y_i
    inverse   (B, m, m) R^-1 by slots: without the row and column of the oldest pair it is that of the others
    yy        (B, m, m) Y'Y
    gamma     (B,) s'y / y'y of the newest pair that counts: the scale of the first Hessian

    The pair of an iteration stands in the slot (iteration mod m), where it replaces the oldest.  A pair that does
    not count, because the step was refused or because it has no positive curvature, is zero, with a one in `sy`.
    """

    blocks: Blocks
    free: Tensor
    first: float
    vectors: Tensor
    products: Tensor
    sy: Tensor
    inverse: Tensor
    yy: Tensor
    gamma: Tensor

    @classmethod
    def start(cls, blocks: Blocks, free: Tensor, gradient: Tensor, pairs: int, first: float) -> "History":
        """No pairs yet, and the gradient (K, W)."""
        vectors = gradient.new_zeros((len(gradient), 2 * pairs + 1, gradient.shape[1]))
        vectors[:, -1] = gradient
        sy = torch.ones((len(free), pairs), dtype=torch.float64, device=free.device)
        inverse = torch.diag_embed(sy)
        history = cls(blocks, free, first, vectors, sy, sy, inverse, torch.zeros_like(inverse), free)
        history.products = history._products()
        history.gamma = history._first_gamma()
        return history

    @property
    def gradient(self) -> Tensor:
        """(K, W) g."""
        return self.vectors[:, -1]

    @property
    def square(self) -> Tensor:
        """(B,) g'g."""
        return self.products[:, -1]

    @property
    def slope(self) -> Tensor:
        """(B,) the root mean square of g over the unknowns that may move."""
        return (self.square / self.free).sqrt()

    def step(self, slot: int) -> Tensor:
        """(K, W) a view of the steps s in `slot`, for the next to be written to."""
        return self.vectors[:, slot]

    def take(self, slot: int, gradient: Tensor, slope: Tensor, good: Tensor, least_curvature: float) -> None:
        """Take the gradient (K, W) at the new point, which with the step written to `slot` makes a new pair.

        slope            (B,) s'g of the step and the old gradient
        good             (B,) bool, the problems that moved
        least_curvature  a pair counts where s'y is above this part of -s'g

        The products with g are read off the history once; those with the new y are their change, since
        y = g_new - g_old.
        """
        m = self.sy.shape[1]
        torch.sub(gradient, self.vectors[:, 2 * m], out=self.vectors[:, m + slot])
        self.vectors[:, 2 * m] = gradient
        before, self.products = self.products, self._products()
        change = self.products - before
        # As |g|^2 - |g - y|^2 is 2 y'g - y'y.
        sy, yy = self.products[:, slot] - slope, 2 * self.products[:, m + slot] - change[:, -1]
        curved = good & (sy > -least_curvature * slope) & (yy > 0)
        # On another device it takes longer to hear of this than to do without.
        if curved.device.type == "cpu" and bool(curved.all()):
            self.gamma = sy / yy
        else:
            sy, yy = torch.where(curved, sy, 1.0), torch.where(curved, yy, 0.0)
            change = torch.where(curved[:, None], change, 0.0)
            self._void(slot, curved, sy, yy)
        self._put(slot, change[:, : 2 * m].view(-1, 2, m), sy, yy)

    def direction(self) -> tuple[Tensor, Tensor]:
        """(K, W) minus H g, and (B,) the slope along it."""
        m = self.sy.shape[1]
        sg, yg = self.products[:, None, :m], self.products[:, None, m : 2 * m]
        gamma = self.gamma[:, None, None]
        w = _batched(sg, self.inverse.mT)
        a = _batched(self.sy[:, None] * w + gamma * (_batched(w, self.yy) - yg), self.inverse)
        weights = torch.cat([a, -gamma * w], 2).squeeze(1)
        weights = -torch.cat([weights, self.gamma[:, None]], 1)
        row = take(weights.to(self.vectors), self.blocks.owner)
        return _batched(row[:, None], self.vectors).squeeze(1), (weights * self.products).sum(1)

    def forget(self, lost: Tensor) -> None:
        """Drop all pairs of the problems `lost` (B,) bool."""
        self._drop(~lost, list(range(2 * self.sy.shape[1])))
        self.gamma = torch.where(lost, self._first_gamma(), self.gamma)
        self.sy = torch.where(lost[:, None], 1.0, self.sy)
        self.inverse = torch.where(lost[:, None, None], torch.diag_embed(torch.ones_like(self.sy)), self.inverse)
        self.yy = torch.where(lost[:, None, None], 0.0, self.yy)

    def select(self, keep: Tensor, rows: Tensor, blocks: Blocks) -> "History":
        """The problems `keep` (B,) bool, whose blocks are `rows` (K',) bool and then `blocks`."""
        of_problems = (v[keep] for v in (self.products, self.sy, self.inverse, self.yy, self.gamma))
        return History(blocks, self.free[keep], self.first, self.vectors[rows], *of_problems)

    def _put(self, slot: int, new: Tensor, sy: Tensor, yy: Tensor) -> None:
        """The newest pair takes the place of the oldest in `slot`.

        new  (B, 2, m) the products of its y with all s and y;  sy, yy (B,) those with its own
        """
        new[:, 0, slot], new[:, 1, slot] = 0.0, yy
        self.inverse[:, slot] = 0.0
        self.inverse[:, :, slot] = _batched(new[:, :1], self.inverse.mT).squeeze(1) / -sy[:, None]
        self.inverse[:, slot, slot] = sy.reciprocal()
        self.yy[:, slot] = self.yy[:, :, slot] = new[:, 1]
        self.sy[:, slot] = sy

    def _void(self, slot: int, curved: Tensor, sy: Tensor, yy: Tensor) -> None:
        """Make the pair of `slot` zero where `curved` (B,) is false; gamma is then that of an older pair."""
        self._drop(curved, [slot, self.sy.shape[1] + slot])
        self.yy[:, slot, slot] = 0.0
        old = (self.yy.diagonal(dim1=1, dim2=2) > 0).any(1)
        self.gamma = torch.where(curved, sy / yy, torch.where(old, self.gamma, self._first_gamma()))

    def _drop(self, keep: Tensor, slots: list[int]) -> None:
        """Make the vectors in `slots` zero where `keep` (B,) is false."""
        gone = self.blocks.spread(~keep)
        for i in slots:
            self.vectors[:, i].masked_fill_(gone, 0.0)
            self.products[:, i].masked_fill_(~keep, 0.0)

    def _products(self) -> Tensor:
        """(B, 2m+1) of all vectors with g."""
        per_block = _batched(self.vectors[:, -1:], self.vectors.mT).squeeze(1)
        return self.blocks.sum(per_block.to(self.free))

    def _first_gamma(self) -> Tensor:
        """(B,) the gamma of a step that knows no pair."""
        return self.first / self.slope.clamp_min(_LEAST)


def _batched(left: Tensor, right: Tensor) -> Tensor:
    """`torch.bmm` with the same bits for a matrix alone as among others: a batch of one goes another way in torch.

    A row times matrices, never matrices times a column: that way is four times slower.
    """
    if len(left) != 1:
        return torch.bmm(left, right)
    return torch.bmm(left.expand(2, -1, -1), right.expand(2, -1, -1))[:1]
