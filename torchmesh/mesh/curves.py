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

from .ragged import counts_from_offsets, offsets_from_counts, owner_of, segment_sum, spread
from .triangle import arctangent

# Turns below this many radians are rounding: the curve is straight there.
_STRAIGHT = 1e-6


# The height of an edge's arc may grow to about this many times the largest on its chain.
_HEIGHT_FACTOR = 2.0


@dataclass(frozen=True, eq=False)
class BoundaryCurves:
    """K stations on C chains, each mesh's and each chain's contiguous.

    vertex         (K,) int64 row within its mesh
    slides         (K,) bool: false for the corners at the ends of a chain, and for the second time a
                   closed chain comes to its first station
    after, before  (K,) int64 neighbouring stations on the chain; themselves at the ends of an open one
    first, last    (K,) int64 the ends of the station's chain
    period         (K,) length of the chain if it is closed, else 0
    straight       (K,) bool, the segment from knot k to the next is a straight line
    knots          (K, 2) float64
    leave, arrive  (K, 2) tangents at the beginning and the end of the segment from knot k
    place          (K,) parameter of knot k: chord lengths from the chain's beginning
    bend           (K,) turning of the curve from the chain's beginning to knot k, in radians
    height         (K,) how high an arc may stand over its edge on this chain; 0: it is straight
    parameter      (K,) where the stations are now
    offsets        (B+1,) int64
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
    place: Tensor
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

    def moved_to(self, sliding: Tensor) -> Tensor:
        """(K,) parameters of all stations when the sliding ones are at `sliding` (S,)."""
        s = self.parameter.clone()
        s[self.slides] = sliding.to(s)
        return torch.where(self._again(), s[self.first] + self.period, s)

    def at(self, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(K, 2) places and (K, 2) derivatives of the stations at parameters s (K,); (K,) the segments they are on."""
        s, _ = self._wrapped(s)
        k = self._segment(s)
        onward = self._onward(k)
        along, length = self.knots[onward] - self.knots[k], self._length(k)
        u = ((s - self.place[k]) / length)[:, None]
        length = length[:, None]
        leave, arrive = self.leave[k], self.arrive[k]
        v = 1 - u
        # Added to the knot last, so that what is the same all along a straight line keeps its bits.
        place = self.knots[k] + (u * u * (3 - 2 * u) * along + length * (u * v * v * leave - u * u * v * arrive))
        return place, 6 * u * v * along / length + v * (1 - 3 * u) * leave - u * (2 - 3 * u) * arrive, k

    def bending(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """(K,) how far the curve has turned at parameters s (K,), in radians, and its rate."""
        s, turns = self._wrapped(s)
        k = self._segment(s)
        rate = (self.bend[self._onward(k)] - self.bend[k]) / self._length(k)
        return self.bend[k] + rate * (s - self.place[k]) + turns * self.bend[self.last], rate

    def penalty(self, s: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """What keeps the stations in order and the edges close to the curve.

        The arc over an edge is about length * turning / 8 high; the eighth power of that over
        `height` is felt only near 1 and above.  Returns its sum (B,), its slope (K,) by s, and (B,)
        bool: the stations of the mesh are in order.
        """
        bend, rate = self.bending(s)
        edge = torch.arange(len(s), device=s.device) != self.last
        gap = torch.where(edge, s[self.after] - s, 1.0)
        turn = torch.where(edge, bend[self.after] - bend, 0.0)
        # The first station of a closed chain is after its last edge by a whole turn.
        curved = edge & (self.height > 0)
        scale = torch.where(curved, 0.125 / torch.where(curved, self.height, 1.0), 0.0)
        ratio = scale * gap * turn
        square = ratio * ratio
        seventh = 8 * square * square * square * ratio * scale
        by_end = seventh * (turn + gap * rate[self.after])
        by_start = -seventh * (turn + gap * rate)
        inner = self.before != torch.arange(len(s), device=s.device)
        slope = by_start + torch.where(inner, by_end[self.before], 0.0)
        total = segment_sum((square * square).square(), self.offsets)
        disorder = segment_sum((edge & (gap <= 0)).to(s.dtype), self.offsets)
        return total, slope, disorder == 0

    def area(self, places: Tensor) -> Tensor:
        """(C,) twice the signed areas between the chains through `places` (K, 2) and their chords."""
        origin = places[self.first]
        p, q = places - origin, places[self._onward(torch.arange(len(places), device=places.device))] - origin
        return segment_sum(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0], self.chain_offsets)

    @property
    def chain_offsets(self) -> Tensor:
        """(C+1,) int64 the stations of each chain."""
        starts = (self.first == torch.arange(len(self.first), device=self.first.device)).nonzero().squeeze(1)
        return torch.cat([starts, self.offsets[-1:]])

    def restore_area(self, places: Tensor, segment: Tensor) -> tuple[Tensor, Tensor]:
        """`places` (K, 2) shifted along normals, each chain by one width, so that its area is that of its knots.

        segment  (K,) the segments the stations are on: those on straight ones stay

        Also (C,) how much of the area could not be had back, as it is only where no station is on
        a curved segment any more; in units of length squared, twice.
        """
        step = places[self.after] - places[self.before]
        reach = (step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1]).sqrt()
        free = self.slides & ~self.straight[segment] & (reach > 0)
        normal = torch.stack([step[:, 1], -step[:, 0]], 1) / torch.where(reach > 0, reach, 1.0)[:, None]
        normal = torch.where(free[:, None], normal, 0.0)
        again = self._again()
        normal = torch.where(again[:, None], normal[self.first], normal)
        chains = self.chain_offsets
        lack = self.area(self.knots) - self.area(places)
        # Twice the area as a function of the width w: area + linear w + square w^2.
        linear = segment_sum(torch.where(free, reach, 0.0), chains)
        onward = normal[self._onward(torch.arange(len(places), device=places.device))]
        square = segment_sum(normal[:, 0] * onward[:, 1] - normal[:, 1] * onward[:, 0], chains)
        root = (linear * linear + 4 * square * lack).clamp_min(0).sqrt()
        width = torch.where(linear > 0, 2 * lack / torch.where(linear > 0, linear + root, 1.0), 0.0)
        shifted = places + spread(width, chains)[:, None] * normal
        return shifted, self.area(self.knots) - self.area(shifted)

    def packed(self, centre: Tensor, unit: Tensor) -> "BoundaryCurves":
        """The same curves in coordinates counted from `centre` (B, 2) in lengths of `unit` (B,)."""
        c, w = spread(centre, self.offsets), spread(unit, self.offsets)
        lengths = {name: getattr(self, name) / w for name in ("period", "place", "height", "parameter")}
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

    def _again(self) -> Tensor:
        """(K,) bool: the station is the second time that a closed chain comes to its first one."""
        return (self.period > 0) & (self.last == torch.arange(len(self.last), device=self.last.device))

    def _onward(self, k: Tensor) -> Tensor:
        """The next knot; the last one itself."""
        return torch.where(self.last[k] == k, k, k + 1)

    def _length(self, k: Tensor) -> Tensor:
        length = self.place[self._onward(k)] - self.place[k]
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
            left = self.place[middle] <= s
            low, high = torch.where(inside & left, middle, low), torch.where(inside & ~left, middle, high)
        return low


def fit_curves(
    points: Tensor, edges: Tensor, may_slide: Tensor, corner_angle: float, point_offsets: Tensor
) -> BoundaryCurves:
    """Curves along the `edges` (E, 2) on which vertices slide, with the vertices on them as they are now.

    points         (V, 2) float64
    edges          (E, 2) int64 boundary and constrained edges, each once
    may_slide      (V,) bool: the others are corners
    corner_angle   degrees; a vertex where the chain turns by more is a corner
    point_offsets  (B+1,)

    Corners are also the ends and meetings of edges, and any bend, however slight, between two
    straight lines.
    """
    count = len(points)
    edges = edges[may_slide[edges].any(1)]
    tail, head = torch.cat([edges[:, 0], edges[:, 1]]), torch.cat([edges[:, 1], edges[:, 0]])
    darts = torch.arange(len(tail), device=tail.device)
    twin = torch.cat([darts[len(edges) :], darts[: len(edges)]])
    # Of the two darts that leave a vertex, their sum less the one is the other.
    both = torch.zeros(count, dtype=torch.int64, device=tail.device).index_add_(0, tail, darts)
    degree = torch.bincount(tail, minlength=count)
    one = torch.full_like(both, len(tail)).scatter_reduce_(0, tail, darts, "amin")
    inner = may_slide & (degree == 2)
    vertex = inner.nonzero().squeeze(1)
    a, b = head[one[vertex]], head[both[vertex] - one[vertex]]
    turn = points.new_zeros(count)
    straight, corner = (torch.zeros(count, dtype=torch.bool, device=tail.device) for _ in range(2))
    turn[vertex] = _turn(points[a], points[vertex], points[b])
    straight[vertex] = turn[vertex] <= _STRAIGHT
    corner[vertex] = (turn[vertex] > corner_angle * (torch.pi / 180)) | (~straight[vertex] & straight[a] & straight[b])
    slider = inner & ~corner
    following = torch.where(slider[head], both[head] - twin, -1)
    start, rank = _walks(following, twin)
    # Each chain is walked in both directions: the one that starts from the lower dart counts.
    kept = ((start < start[twin]) & (slider[tail] | slider[head])).nonzero().squeeze(1)
    mesh = owner_of(tail[kept], point_offsets)
    order = rank[kept].argsort(stable=True)
    order = order[start[kept[order]].argsort(stable=True)]
    order = order[mesh[order].argsort(stable=True)]
    darts, mesh = kept[order], mesh[order]
    # A chain of m darts has m + 1 stations: their tails and the last one's head.
    begins = torch.ones(len(darts), dtype=torch.bool, device=tail.device)
    begins[1:] = start[darts[1:]] != start[darts[:-1]]
    chain = begins.to(torch.int64).cumsum(0) - 1
    sizes = torch.bincount(chain) + 1
    ends = offsets_from_counts(sizes)
    station = torch.arange(len(darts), device=tail.device) + chain
    place_of = torch.zeros(int(ends[-1]), dtype=torch.int64, device=tail.device)
    place_of[station], place_of[ends[1:] - 1] = tail[darts], head[darts[station + 2 == ends[1:][chain]]]
    owner = owner_of(place_of, point_offsets)
    first, last = spread(ends[:-1], ends), spread(ends[1:] - 1, ends)
    return _through(points, place_of, first, last, slider, straight, turn, owner, point_offsets)


def _through(
    points: Tensor,
    rows: Tensor,
    first: Tensor,
    last: Tensor,
    slider: Tensor,
    straight: Tensor,
    turn: Tensor,
    owner: Tensor,
    point_offsets: Tensor,
) -> BoundaryCurves:
    """The curves through the vertices `rows` (K,), chain after chain."""
    here = torch.arange(len(rows), device=rows.device)
    closed = (rows[first] == rows[last]) & slider[rows[first]]
    after = torch.where(here == last, torch.where(closed, first + 1, last), here + 1)
    before = torch.where(here == first, torch.where(closed, last - 1, first), here - 1)
    knots = points[rows]
    onward = torch.where(here == last, here, here + 1)
    along = knots[onward] - knots
    length = (along[:, 0] * along[:, 0] + along[:, 1] * along[:, 1]).sqrt()
    unit = along / torch.where(length > 0, length, 1.0)[:, None]
    line = (straight[rows] | straight[rows[onward]]) & (here != last)
    leave, arrive = _tangents(unit, length, line, first, last, before, closed)
    # Chord lengths and turnings are summed chain by chain, so that they do not depend on the chains before.
    place = _running_sum(torch.where(here == first, 0.0, length[here - 1]), here - first)
    turned = turn[rows]
    turned = torch.where(slider[rows], turned, torch.where(here == first, turned[onward], turned[here - 1]))
    half = torch.where(line | (here == last), 0.0, 0.5 * (turned + turned[onward]))
    bend = _running_sum(torch.where(here == first, 0.0, half[here - 1]), here - first)
    chains = torch.cat([first.unique(), torch.full((1,), len(rows), device=rows.device)])
    height = spread(torch.segment_reduce(length * half / 8, "max", offsets=chains, initial=0.0), chains)
    return BoundaryCurves(
        rows - point_offsets[owner],
        slider[rows] & ~(closed & (here == last)),
        after,
        before,
        first,
        last,
        torch.where(closed, place[last], 0.0),
        line,
        knots,
        leave,
        arrive,
        place,
        bend,
        _HEIGHT_FACTOR * height,
        place.clone(),
        offsets_from_counts(torch.bincount(owner, minlength=len(point_offsets) - 1)),
    )


def _tangents(
    unit: Tensor, length: Tensor, line: Tensor, first: Tensor, last: Tensor, before: Tensor, closed: Tensor
) -> tuple[Tensor, Tensor]:
    """(K, 2) tangents at both ends of the segments after the knots, from the directions and lengths of the segments.

    Where two segments meet, the tangent is that of the circle through their three knots: its angles
    to the two chords have sines as their lengths.  A straight line's direction goes before that.
    """
    here = torch.arange(len(unit), device=unit.device)
    segment_in = torch.where(here == last, last - 1, before)  # of an open chain's first knot: none
    segment_out = torch.where(here == last, torch.where(closed, first, last), here)
    joint = closed | ((here != first) & (here != last))
    circle = unit[segment_in] * length[segment_out][:, None] + unit[segment_out] * length[segment_in][:, None]
    tangent = torch.where(line[segment_in][:, None], unit[segment_in], circle)
    tangent = torch.where(line[segment_out][:, None], unit[segment_out], tangent)
    size = (tangent[:, 0] * tangent[:, 0] + tangent[:, 1] * tangent[:, 1]).sqrt()
    tangent = tangent / torch.where(size > 0, size, 1.0)[:, None]
    onward = torch.where(here == last, here, here + 1)
    leave, arrive = tangent, tangent[onward]
    # At the end of an open chain: the other end's tangent mirrored, as an arc has it.
    leave = torch.where(joint[:, None], leave, _mirrored(arrive, unit))
    arrive = torch.where(joint[onward][:, None], arrive, _mirrored(leave, unit))
    leave, arrive = (torch.where(line[:, None], unit, t) for t in (leave, arrive))
    return tuple(_handle(t, unit) for t in (leave, arrive))  # type: ignore[return-value]


def _mirrored(tangent: Tensor, chord: Tensor) -> Tensor:
    """(K, 2) tangents mirrored in their chords' directions."""
    return 2 * _dot(tangent, chord)[:, None] * chord - tangent


def _handle(tangent: Tensor, chord: Tensor) -> Tensor:
    """(K, 2) tangents as long as those of an arc over the chord: a = angle between them, 1 / cos^2(a / 2)."""
    cosine = _dot(tangent, chord).clamp_min(0)
    return torch.where((tangent == chord).all(1)[:, None], tangent, tangent * (2 / (1 + cosine))[:, None])


def _dot(u: Tensor, v: Tensor) -> Tensor:
    return u[:, 0] * v[:, 0] + u[:, 1] * v[:, 1]


def _turn(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """(N,) unsigned angle by which the way from a over b to c turns, in radians."""
    u, v = b - a, c - b
    return arctangent((u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]).abs(), _dot(u, v))


def _walks(following: Tensor, twin: Tensor) -> tuple[Tensor, Tensor]:
    """(D,) where each dart's walk starts and how many darts come before it; a round walk starts from its lowest.

    following  (D,) the next dart, or -1 at the end of the walk
    twin       (D,) the dart the other way: the walk before a dart is that after its twin, backwards

    By pointer doubling: each pass doubles the distance looked over.
    """
    darts = torch.arange(len(following), device=following.device)
    passes = len(darts).bit_length()
    lowest, hop = darts, torch.where(following >= 0, following, darts)
    for _ in range(passes):
        lowest, hop = torch.minimum(lowest, lowest[hop]), hop[hop]
    round_walk = following[hop] >= 0
    behind = following[twin]
    behind = torch.where(behind >= 0, twin[behind.clamp_min(0)], -1)
    behind = torch.where(round_walk & (lowest == darts), -1, behind)
    start, rank = torch.where(behind >= 0, behind, darts), (behind >= 0).to(torch.int64)
    for _ in range(passes):
        rank, start = rank + rank[start], start[start]
    return start, rank


def _running_sum(values: Tensor, rank: Tensor) -> Tensor:
    """(K,) sums of `values` from each run's beginning, where `rank` is 0, up to and with each row.

    By doubling, so that a row's bits depend on its own run only.
    """
    total = values
    here = torch.arange(len(values), device=values.device)
    step = 1
    while step <= int(rank.max() if len(rank) else 0):
        reached = rank >= step
        total = torch.where(reached, total + total[(here - step).clamp_min(0)], total)
        step *= 2
    return total
