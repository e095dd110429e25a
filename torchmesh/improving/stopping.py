"""When the loops of the strategy stop.

Stall      the loop of the paper: flips and untangle-beta in turn
Gain       the same loop of the default method, which has other ways to go on
settled    flips and smoothing in turn
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..optimising.lbfgs_options import LbfgsOptions
from .options import ImproveOptions
from .state import State
from .step_options import Rounds


@dataclass(frozen=True, eq=False)
class Stall:
    """When the loop of the paper has come to a standstill; the paper names no limit.

    best   (B,) the fewest inverted triangles so far
    since  (B,) rounds since there were fewer
    quiet  (B,) rounds in a row that had no flip and at most `LbfgsOptions.patience` steps of L-BFGS, its fewest
    """

    best: Tensor
    since: Tensor
    quiet: Tensor

    @classmethod
    def of(cls, inverted: Tensor) -> "Stall":
        """Before the first round, with the numbers of inverted triangles (B,)."""
        none = torch.zeros_like(inverted)
        return cls(inverted, none, none)

    def after(self, inverted: Tensor, flips: Tensor, iterations: Tensor, short: bool) -> "Stall":
        """After a round that leaves so many `inverted` triangles and took so many flips and iterations, (B,) each.

        short  whether the round had a lowered limit of iterations; it then does not count as one without gain
        """
        # Without a flip, and at a minimum already, the next round would be the same again.
        still = (flips == 0) & (iterations <= LbfgsOptions().patience)
        return Stall(
            torch.minimum(self.best, inverted),
            torch.where((inverted < self.best) | short, 0, self.since + 1),
            torch.where(still, self.quiet + 1, 0),
        )

    def reached(self, options: Rounds, may_flip: bool) -> Tensor:
        """(B,) bool: the loop ends here.

        Flips may let a later round gain after some without gain.  Without flips, one round without gain is enough.
        """
        patience = options.paper_patience if may_flip else 1
        return (self.since >= patience) | (self.quiet >= options.paper_quiet)


@dataclass(frozen=True, eq=False)
class Gain:
    """Whether the number of inverted triangles still falls fast enough.

    best   (B,) the fewest inverted triangles so far
    since  (B,) rounds since the number fell to `Rounds.progress` of the fewest
    """

    best: Tensor
    since: Tensor

    @classmethod
    def of(cls, inverted: Tensor) -> "Gain":
        """Before the first round, with the numbers of inverted triangles (B,)."""
        return cls(inverted, torch.zeros_like(inverted))

    def after(self, inverted: Tensor, options: Rounds) -> "Gain":
        """After a round that leaves so many inverted triangles (B,)."""
        since = torch.where(inverted <= options.progress * self.best, 0, self.since + 1)
        return Gain(torch.minimum(self.best, inverted), since)

    def lasts(self, options: Rounds) -> Tensor:
        """(B,) bool: another round is worth it."""
        return self.since < options.patience


def settled(before: State, after: State, o: ImproveOptions) -> Tensor:
    """(B,) bool: a round of flips and smoothing brought so little that another one is not worth it."""
    old, q, r = before.judged, after.judged, o.refine
    gain = old.mean - q.mean
    nothing = (gain < r.least_gain) & (old.max - q.max < r.least_gain_of_maximum * old.max)
    # Where no triangle is poor, the last smoothing does the rest.
    return nothing | ((gain < r.little_gain) & (q.max < (o.smooth.ceiling or 1.0)))
