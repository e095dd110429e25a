"""The curves that vertices may slide along: chains of boundary and constrained edges between corners.

    corner o---o---o---o---o corner         knots: where the vertices stood when the curves were fitted
            0   1   2   3   4               stations: the vertices in order, at parameters along the curve

Between two knots the curve is a straight line where the chain is straight, else the cubic whose
ends run tangent to the circle through three neighbouring knots and whose handles are those of an
arc: of knots on a circle it departs from that circle by less than 1e-6 of the radius at 30 degrees
a segment.  A closed curve without corners starts anywhere; its last station is its first again.
"""

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from .ragged import counts_from_offsets, offsets_from_counts, spread, true_rows


@dataclass(frozen=True, eq=False)
class BoundaryCurves:
    """K stations on C chains; the stations of a mesh, and those of a chain, are contiguous.

    vertex         (K,) int64 row within its mesh
    slides         (K,) bool: false for the corners at the ends of a chain, and for the last station of a
                   closed chain, which is its first one again
    after, before  (K,) int64 neighbouring stations on the chain; themselves at the ends of an open one
    first, last    (K,) int64 the ends of the station's chain
    period         (K,) length of the chain if it is closed, else 0
    straight       (K,) bool, the segment from knot k to the next is a straight line
    knots          (K, 2) float64
    leave, arrive  (K, 2) tangents at the beginning and the end of the segment from knot k
    at_knot        (K,) parameter of knot k: chord lengths from the chain's beginning
    bend           (K,) by how much the curve turns from the chain's beginning to knot k, in radians
    height         (K,) how high an arc may stand over its edge on this chain; 0: the chain is straight
    parameter      (K,) where the stations are now
    offsets        (B+1,) int64 the stations of each mesh
    """

    vertex: Tensor
    slides: Tensor
    after: Tensor
    before: Tensor
    first: Tensor
    last: Tensor
    period: Tensor
    straight: Tensor
    knots: Tensor
    leave: Tensor
    arrive: Tensor
    at_knot: Tensor
    bend: Tensor
    height: Tensor
    parameter: Tensor
    offsets: Tensor

    def rows(self, point_offsets: Tensor) -> Tensor:
        """(K,) the rows of the stations' vertices in the batch."""
        return self.vertex + spread(point_offsets[:-1], self.offsets)

    def may_slide(self, point_offsets: Tensor) -> Tensor:
        """(V,) bool: the vertices that slide."""
        mask = torch.zeros(int(point_offsets[-1]), dtype=torch.bool, device=self.vertex.device)
        mask[self.rows(point_offsets)[self.slides]] = True
        return mask

    def holding(self, vertices: Tensor, point_offsets: Tensor) -> "BoundaryCurves":
        """The same curves, on which the `vertices` (V,) bool do not slide."""
        return replace(self, slides=self.slides & ~vertices[self.rows(point_offsets)])

    def moved_to(self, sliding: Tensor) -> Tensor:
        """(K,) parameters of all stations when the sliding ones are at `sliding` (S,)."""
        s = self.parameter.clone()
        s[self.slides] = sliding.to(s)
        return torch.where(self.comes_again(), s[self.first] + self.period, s)

    def at(self, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(K, 2) positions and (K, 2) derivatives of the stations at parameters s (K,); (K,) their segments."""
        s, _ = self._wrapped(s)
        k = self._segment(s)
        onward = self.onward(k)
        along, length = self.knots[onward] - self.knots[k], self._length(k)
        u = ((s - self.at_knot[k]) / length)[:, None]
        length = length[:, None]
        leave, arrive = self.leave[k], self.arrive[k]
        v = 1 - u
        # Added to the knot last, so that what is the same all along a straight line keeps its bits.
        position = self.knots[k] + (u * u * (3 - 2 * u) * along + length * (u * v * v * leave - u * u * v * arrive))
        return position, 6 * u * v * along / length + v * (1 - 3 * u) * leave - u * (2 - 3 * u) * arrive, k

    def bending(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """(K,) how far the curve has turned at parameters s (K,), in radians, and its rate."""
        s, turns = self._wrapped(s)
        k = self._segment(s)
        rate = (self.bend[self.onward(k)] - self.bend[k]) / self._length(k)
        return self.bend[k] + rate * (s - self.at_knot[k]) + turns * self.bend[self.last], rate

    @property
    def chain_offsets(self) -> Tensor:
        """(C+1,) int64 the stations of each chain."""
        starts = true_rows(self.first == torch.arange(len(self.first), device=self.first.device))
        return torch.cat([starts, self.offsets[-1:]])

    def packed(self, centre: Tensor, unit: Tensor) -> "BoundaryCurves":
        """The same curves in coordinates counted from `centre` (B, 2) in lengths of `unit` (B,)."""
        c, w = spread(centre, self.offsets), spread(unit, self.offsets)
        lengths = {name: getattr(self, name) / w for name in ("period", "at_knot", "height", "parameter")}
        return replace(self, knots=(self.knots - c) / w[:, None], **lengths)

    def renumbered(self, new_row: Tensor, before: Tensor, after: Tensor) -> "BoundaryCurves":
        """The same curves and stations where the batch's vertices have other rows.

        new_row        (V_old,) int64 the row that each vertex has now
        before, after  (B+1,) the point offsets of then and now
        """
        return replace(self, vertex=new_row[self.rows(before)] - spread(after[:-1], self.offsets))

    def select(self, keep: Tensor) -> "BoundaryCurves":
        """The curves of the meshes whose keep (B,) is true."""
        kept = spread(keep, self.offsets)
        shift = kept.to(torch.int64).cumsum(0) - 1
        changes = {f.name: getattr(self, f.name)[kept] for f in fields(self) if f.name != "offsets"}
        for name in ("after", "before", "first", "last"):
            changes[name] = shift[changes[name]]
        return BoundaryCurves(**changes, offsets=offsets_from_counts(counts_from_offsets(self.offsets)[keep]))

    def put(self, at: Tensor, part: "BoundaryCurves") -> "BoundaryCurves":
        """These curves with the stations of the meshes `at` (B,) bool where they are on `part`."""
        parameter = self.parameter.clone()
        parameter[spread(at, self.offsets)] = part.parameter
        return replace(self, parameter=parameter)

    def comes_again(self) -> Tensor:
        """(K,) bool: the station is the last one of a closed chain, which is its first one again."""
        return (self.period > 0) & (self.last == torch.arange(len(self.last), device=self.last.device))

    def onward(self, k: Tensor) -> Tensor:
        """The next knot; the last one itself."""
        return torch.where(self.last[k] == k, k, k + 1)

    def _length(self, k: Tensor) -> Tensor:
        length = self.at_knot[self.onward(k)] - self.at_knot[k]
        return torch.where(length > 0, length, 1.0)

    def _wrapped(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """(K,) parameters within the period of closed chains, and how often that was taken off."""
        closed = self.period > 0
        turns = torch.where(closed, (s / torch.where(closed, self.period, 1.0)).floor(), 0.0)
        return s - turns * self.period, turns

    def _segment(self, s: Tensor) -> Tensor:
        """(K,) the last knot on the chain that is not after s, the last but one at most."""
        low, high = self.first.clone(), self.last.clone()
        for _ in range(int((high - low).max() if len(s) else 0).bit_length()):
            middle = (low + high) // 2
            inside = middle > low
            left = self.at_knot[middle] <= s
            low, high = torch.where(inside & left, middle, low), torch.where(inside & ~left, middle, high)
        return low
