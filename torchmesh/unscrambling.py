"""Interiors that are merely scrambled, put back by averaging, and told in a few sweeps from those it cannot help.

Where a boundary has moved far, the interior mostly followed it smoothly, and averaging its places again
changes nothing.  Where the interior alone was disturbed, the folded area vanishes within sweeps.
"""

import torch
from torch import Tensor

from .connectivity import heads, tails
from .mesh import MeshBatch, put
from .packing import centre_and_unit
from .segments import offsets_from_counts, segment_count, segment_ids, segment_sum, spread
from .triangle import Corners, signed_area

# Sweeps between two looks at a mesh.
_SWEEPS = 8

# By what part the folded area, or the number of triangles that are not upright, must fall from look to look in a
# mesh of up to 32 x 32 free vertices.  An error as wide as the mesh takes sweeps in proportion to the vertices
# across: of a wider mesh so much less is asked.
_GAIN, _ACROSS = 0.2, 32

# A valid mesh is done when its residual has come down to this part.
_RESIDUAL = 1e-3


def unscramble(batch: MeshBatch) -> MeshBatch:
    """Free vertices on their way to the mean of their neighbours, as `relax` has them, where that untangles.

    Conjugate gradients (Hestenes & Stiefel, Journal of Research of the National Bureau of Standards 49, 1952)
    with the valences as preconditioner, each mesh by itself, until it is valid and nearly at
    rest, or gains no more.  A mesh that gained nothing comes back as it was.
    """
    result, work = batch, _Averaging(batch)
    going = torch.ones(len(batch), dtype=torch.bool, device=batch.points.device)
    across = segment_count(~batch.fixed, batch.point_offsets).to(torch.float64).sqrt().clamp_min(_ACROSS)
    left = (1 - _GAIN * _ACROSS / across)[:, None]
    given = last = work.tangle()
    rest = _RESIDUAL**2 * work.force()
    while True:
        for _ in range(_SWEEPS):
            work.sweep()
        now = work.tangle()
        valid, was_valid = now[:, 1] == 0, last[:, 1] == 0
        stays = torch.where(valid, work.force() > rest[going], (now < left[going] * last).any(1))
        better = valid | (~stays & ~was_valid & (now < left[going] * given[going]).any(1))
        if bool(better.any()):
            result = put(result, going.masked_scatter(going, better), work.moved().select(better))
        if not bool(stays.any()):
            return result
        last = now
        if not bool(stays.all()):
            going, last, work = going.masked_scatter(going, stays), last[stays], work.select(stays)


class _Averaging:
    """Linear systems, one for the x of each mesh and one for its y: every free vertex at the mean of its neighbours.

    Rows are the x of the free vertices, mesh by mesh, then their y.  Coordinates are counted from each mesh's
    centre in a power of two near its extent.
    """

    def __init__(self, batch: MeshBatch) -> None:
        self.batch = batch
        centre, unit = centre_and_unit(batch.points, batch.point_offsets)
        self.centre, self.unit = spread(centre, batch.point_offsets), spread(unit, batch.point_offsets)[:, None]
        free = ~batch.fixed
        self.vertices = free.nonzero().squeeze(1)
        self.count = count = len(self.vertices)
        offsets = offsets_from_counts(segment_count(free, batch.point_offsets))
        self.offsets = torch.cat([offsets, offsets[1:] + count])
        self.owner = segment_ids(self.offsets)
        # Round a free vertex the triangles close: each neighbour is the head of one half-edge from it.
        tail, head = tails(batch.triangles), heads(batch.triangles)
        out = free[tail].nonzero().squeeze(1)
        row = free.cumsum(0) - 1
        tail, head = row[tail[out]], head[out]
        self.valence = torch.bincount(tail, minlength=count).to(torch.float64).repeat(2)
        x, y = ((batch.points.to(torch.float64) - self.centre) / self.unit).unbind(1)
        self.columns = x.contiguous(), y.contiguous()
        self.places = torch.cat([column[self.vertices] for column in self.columns])
        around = [torch.zeros_like(self.valence[:count]).index_add_(0, tail, c[head]) for c in self.columns]
        self.residual = torch.cat(around) - self.valence * self.places
        inner = free[head]
        tail, head = tail[inner], row[head[inner]]
        self.tail, self.head = torch.cat([tail, tail + count]), torch.cat([head, head + count])
        self.way = self.residual / self.valence
        self.power = segment_sum(self.residual * self.way, self.offsets)

    def sweep(self) -> None:
        """One step of conjugate gradients."""
        image = (self.valence * self.way).index_add_(0, self.tail, self.way[self.head], alpha=-1)
        curved = segment_sum(self.way * image, self.offsets)
        step = torch.where(curved > 0, self.power / curved, 0.0)[self.owner]
        self.places = self.places + step * self.way
        self.residual = self.residual - step * image
        short = self.residual / self.valence
        power = segment_sum(self.residual * short, self.offsets)
        self.way = short + torch.where(self.power > 0, power / self.power, 0.0)[self.owner] * self.way
        self.power = power

    def force(self) -> Tensor:
        """(B,) the square of the residual."""
        one, other = self.power.chunk(2)
        return one + other

    def tangle(self) -> Tensor:
        """(B, 2) the area that lies folded over, and the number of triangles that are not upright."""
        x, y = (
            column.index_copy(0, self.vertices, places)
            for column, places in zip(self.columns, self.places.reshape(2, self.count), strict=True)
        )
        a, b, c = (v.contiguous() for v in self.batch.triangles.unbind(1))
        area = signed_area(Corners(x[a], y[a], x[b], y[b], x[c], y[c]))
        folded = segment_sum((-area).clamp_min(0), self.batch.triangle_offsets)
        return torch.stack([folded, segment_count(area <= 0, self.batch.triangle_offsets).to(folded)], 1)

    def moved(self) -> MeshBatch:
        """The meshes as they are now."""
        places = self.places.reshape(2, self.count).T * self.unit[self.vertices] + self.centre[self.vertices]
        return self.batch.with_points(self.batch.points.index_copy(0, self.vertices, places.to(self.batch.points)))

    def select(self, keep: Tensor) -> "_Averaging":
        """The meshes `keep` (B,) bool only, each where it is on its way."""
        part, rows = _Averaging(self.batch.select(keep)), keep.repeat(2)[self.owner]
        part.places, part.residual, part.way = self.places[rows], self.residual[rows], self.way[rows]
        part.power = self.power[keep.repeat(2)]
        return part
