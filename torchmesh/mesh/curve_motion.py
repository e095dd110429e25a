"""What stations must not do while they slide along boundary curves: overtake each other, or change enclosed areas."""

import torch
from torch import Tensor

from .curves import BoundaryCurves
from .ragged import segment_sum, spread


def order_penalty(curves: BoundaryCurves, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """A penalty that keeps the stations at parameters s (K,) in order and the edges close to the curve.

    The arc over an edge is about length * turning / 8 high.  The penalty is the eighth power of that over
    `height`: it matters only near 1 and above.  Returns its sum (B,), its slope (K,) by s, and (B,) bool:
    are the stations of the mesh in order?
    """
    bend, rate = curves.bending(s)
    edge = torch.arange(len(s), device=s.device) != curves.last
    gap = torch.where(edge, s[curves.after] - s, 1.0)
    turn = torch.where(edge, bend[curves.after] - bend, 0.0)
    curved = edge & (curves.height > 0)
    scale = torch.where(curved, 0.125 / torch.where(curved, curves.height, 1.0), 0.0)
    ratio = scale * gap * turn
    square = ratio * ratio
    seventh = 8 * square * square * square * ratio * scale
    by_end = seventh * (turn + gap * rate[curves.after])
    by_start = -seventh * (turn + gap * rate)
    inner = curves.before != torch.arange(len(s), device=s.device)
    slope = by_start + torch.where(inner, by_end[curves.before], 0.0)
    total = segment_sum((square * square).square(), curves.offsets)
    disorder = segment_sum((edge & (gap <= 0)).to(s.dtype), curves.offsets)
    return total, slope, disorder == 0


def chain_areas(curves: BoundaryCurves, positions: Tensor) -> Tensor:
    """(C,) twice the signed areas between the chains through `positions` (K, 2) and their chords."""
    origin = positions[curves.first]
    p, q = positions - origin, positions[curves.onward(torch.arange(len(positions), device=positions.device))] - origin
    return segment_sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0], curves.chain_offsets)


def restore_area(curves: BoundaryCurves, positions: Tensor, segment: Tensor) -> tuple[Tensor, Tensor]:
    """`positions` (K, 2) shifted along normals, each chain by one width, so that its area is that of its knots.

    segment  (K,) the segments of the stations: those on straight segments stay

    Also (C,) twice the area that is still missing, in units of length squared: more than rounding only
    where no station of the chain is on a curved segment any more.
    """
    step = positions[curves.after] - positions[curves.before]
    reach = (step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1]).sqrt()
    free = curves.slides & ~curves.straight[segment] & (reach > 0)
    normal = torch.stack([step[:, 1], -step[:, 0]], 1) / torch.where(reach > 0, reach, 1.0)[:, None]
    normal = torch.where(free[:, None], normal, 0.0)
    again = curves.comes_again()
    normal = torch.where(again[:, None], normal[curves.first], normal)
    chains = curves.chain_offsets
    lack = chain_areas(curves, curves.knots) - chain_areas(curves, positions)
    # Twice the area as a function of the width w: area + linear w + square w^2.
    linear = segment_sum(torch.where(free, reach, 0.0), chains)
    onward = normal[curves.onward(torch.arange(len(positions), device=positions.device))]
    square = segment_sum(normal[:, 0] * onward[:, 1] - normal[:, 1] * onward[:, 0], chains)
    root = (linear * linear + 4 * square * lack).clamp_min(0).sqrt()
    width = torch.where(linear > 0, 2 * lack / torch.where(linear > 0, linear + root, 1.0), 0.0)
    shifted = positions + spread(width, chains)[:, None] * normal
    return shifted, chain_areas(curves, curves.knots) - chain_areas(curves, shifted)
