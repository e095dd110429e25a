"""One round of splits and collapses: freely, or in pairs that keep every row.

Freely, the numbers of vertices and triangles change.  In pairs, a collapse in a crowded region frees the rows of
a vertex and two triangles, and a split in an empty region takes them up, so that the numbers and the order of
vertices and triangles stay, as with flips.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..mesh.batch import triangle_mesh
from ..mesh.ragged import put_rows, spread, true_rows
from .collapses import Judge, Outcome, collapse_rounds
from .collapses import Wish as CollapseWish
from .metric_sizing import unit_metric
from .mutable import Editable
from .options import RemeshOptions
from .splits import Room, split_rounds, worst_after
from .splits import Wish as SplitWish
from .state import RemeshState, editable, rebuilt, unit_of


@dataclass(frozen=True)
class Limits:
    """Which edges a cut changes, by their length relative to the size wanted.

    short    edges shorter than this are collapsed
    long     edges longer than this are split
    longest  no collapse makes an edge as long as this
    worst    no split or collapse makes a triangle of higher inverse mean ratio, unless one as bad was there
    """

    short: float
    long: float
    longest: float
    worst: float

    @classmethod
    def of(cls, options: RemeshOptions) -> "Limits":
        """Those that the options name."""
        return cls(options.collapse_below, options.split_above, options.split_above, options.worst)


def cut_freely(state: RemeshState, limits: Limits, split_boundary: bool) -> tuple[RemeshState, Tensor]:
    """Split the edges that are too long and collapse those that are too short; the edges changed (B,) int64."""
    e = editable(state)
    splits = split_rounds(e, too_long(e, limits.long, limits.worst), allow_fixed=split_boundary)
    collapses = collapse_rounds(e, too_short(e, limits.short), harmless(limits))
    state = rebuilt(state, e)
    metric = None if state.metric is None else unit_metric(state.metric)
    done = replace(state, metric=metric, splits=state.splits + splits, collapses=state.collapses + collapses)
    return done, splits + collapses


@dataclass(frozen=True)
class PairOptions:
    """How `cut_in_pairs` works.

    worth        collapsing stops in a mesh when a round does less than this part of all its collapses in this cut;
                 those that are left wait for the next cut.  0: it goes on to the end
    split_above  only edges longer than this many times the size wanted receive a freed vertex
    tries        how often a mesh that found no room for all its freed vertices tries again with half of them
    """

    worth: float
    split_above: float = 1.2
    tries: int = 4


def cut_in_pairs(state: RemeshState, limits: Limits, options: PairOptions) -> tuple[RemeshState, Tensor]:
    """As many splits as collapses in each mesh, in the same rows; the edges changed (B,) int64."""
    changed, going = torch.zeros_like(state.splits), state.every()
    most: Tensor | None = None
    for _ in range(options.tries):
        if not bool(going.any()):
            break
        part, splits, collapses = _exchange(state.select(going), limits, options, most)
        state = state.put(going, part)
        whole = splits == collapses
        changed[going] = torch.where(whole, 2 * splits, 0)
        again = ~whole & (splits > 0)
        going, most = torch.zeros_like(going).masked_scatter(going, again), (splits // 2)[again]
    pairs = changed // 2
    return replace(state, splits=state.splits + pairs, collapses=state.collapses + pairs), changed


def _exchange(
    state: RemeshState, limits: Limits, options: PairOptions, most: Tensor | None
) -> tuple[RemeshState, Tensor, Tensor]:
    """Collapse and split, `most` (B,) times at most, and keep it in the meshes where both numbers agree.

    Returns the splits and collapses (B,) that each mesh found.
    """
    batch = state.batch
    # Lengths are those of the plane here.
    e = editable(replace(state, metric=None))
    edge = e.edges()
    wanted = e.per_mesh(edge[e.relative_length(edge) > limits.long])
    wanted = wanted if most is None else torch.minimum(wanted, most)
    judge = harmless(limits)
    collapses = collapse_rounds(e, too_short(e, limits.short), judge, budget=wanted, worth=options.worth)
    wish = too_long(e, options.split_above, limits.worst)
    splits = split_rounds(e, wish, budget=collapses, room=freed_rows(triangle_mesh(batch)))
    whole = splits == collapses
    unit = spread(unit_of(batch), batch.point_offsets)
    points = (torch.stack([e.x, e.y], 1) * unit[:, None]).to(batch.points)
    done = replace(state, batch=batch.with_points(points).with_triangles(e.triangles, e.twin), size=e.size * unit)
    return state.put(whole, done.select(whole)), splits, collapses


def too_long(e: Editable, limit: float, worst: float) -> SplitWish:
    """Split edges longer than `limit`, longest first, unless a triangle becomes worse than `worst` and those before."""

    def wish(h: Tensor) -> tuple[Tensor, Tensor]:
        ratio = e.relative_length(h)
        long = true_rows(ratio > limit)
        before, after = worst_after(e, h[long])
        wanted = torch.zeros(len(h), dtype=torch.bool, device=h.device)
        wanted[long] = after <= before.clamp_min(worst)
        return wanted, put_rows(torch.zeros_like(h), long, e.shuffled(h[long], -ratio[long]))

    return wish


def too_short(e: Editable, limit: float) -> CollapseWish:
    """Collapse edges shorter than `limit`, shortest first."""

    def wish(h: Tensor) -> Tensor:
        ratio = e.relative_length(h)
        return torch.where(ratio < limit, ratio, torch.inf)

    return wish


def harmless(limits: Limits) -> Judge:
    """Accept collapses that make no triangle and no edge that the limits forbid."""

    def judge(outcome: Outcome) -> Tensor:
        return (outcome.after <= outcome.before.clamp_min(limits.worst)) & (outcome.longest < limits.longest)

    return judge


def freed_rows(face_mesh: Tensor) -> Room:
    """Room for splits in the dead rows of the same mesh; face_mesh (T,) int64 is the mesh of each row of triangles."""

    def room(e: Editable, h: Tensor) -> tuple[Tensor, Tensor]:
        owner = e.mesh[e.vertex[h]]
        order = owner.argsort(stable=True)
        counts = torch.bincount(owner, minlength=e.meshes)
        turn = torch.empty_like(order)
        turn[order] = torch.arange(len(h), device=h.device) - (counts.cumsum(0) - counts)[owner[order]]
        vertices = true_rows(~e.alive)
        faces = true_rows(e.triangles[:, 0] < 0)
        first_vertex = torch.searchsorted(e.mesh[vertices].contiguous(), owner)
        first_face = torch.searchsorted(face_mesh[faces].contiguous(), owner)
        pair = first_face + 2 * turn
        return vertices[first_vertex + turn], torch.stack([faces[pair], faces[pair + 1]])

    return room
