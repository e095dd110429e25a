"""Interiors that are merely scrambled, put back by averaging, and told in a few sweeps from those it cannot help.

Where a boundary has moved far, the interior mostly followed it smoothly, and averaging its places again
changes nothing.  Where the interior alone was disturbed, the folded area vanishes within sweeps.
"""

import itertools

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, put
from ..mesh.connectivity import heads, tails
from ..mesh.ragged import segment_count, segment_ids, segment_sum, spread
from ..mesh.triangle import corners, signed_area
from ..mesh.units import centre_and_unit

# Sweeps between two looks at a mesh, and before the first glance, which is for those that hardly gain at all.
_SWEEPS, _GLANCE = 8, 2


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
    rest, or gains no more: at the first glance, in proportion to the sweeps.  A mesh that gained nothing comes
    back as it was.
    """
    result, work = batch, _Averaging(batch)
    going = torch.ones(len(batch), dtype=torch.bool, device=batch.points.device)
    across = segment_count(~batch.fixed, batch.point_offsets).to(torch.float64).sqrt().clamp_min(_ACROSS)
    gain = (_GAIN * _ACROSS / across)[:, None]
    given = last = work.tangle()
    rest = _RESIDUAL**2 * work.force()
    for sweep in itertools.count(1):
        work.sweep()
        if sweep != _GLANCE and sweep % _SWEEPS:
            continue
        now = work.tangle()
        left = 1 - gain[going] * min(sweep, _SWEEPS) / _SWEEPS
        valid, was_valid = now[:, 1] == 0, last[:, 1] == 0
        stays = torch.where(valid, work.force() > rest[going], (now < left * last).any(1))
        better = valid | (~stays & ~was_valid & (now < left * given[going]).any(1))
        if bool(better.any()):
            result = put(result, going.masked_scatter(going, better), work.moved().select(better))
        if not bool(stays.any()):
            break
        if sweep != _GLANCE:
            last = now
        if not bool(stays.all()):
            going, last, work = going.masked_scatter(going, stays), last[stays], work.select(stays)
    return result


class _Averaging:
    """Linear systems, one for the x of each mesh and one for its y: every free vertex at the mean of its neighbours.

    Rows are the x of all vertices, mesh by mesh, then their y; those of fixed vertices have no residual and no
    way to go.  Coordinates are counted from each mesh's centre in a power of two near its extent.
    """

    def __init__(self, batch: MeshBatch) -> None:
        self.batch = batch
        self.count = count = len(batch.points)
        centre, unit = centre_and_unit(batch.points, batch.point_offsets)
        self.centre, self.unit = spread(centre, batch.point_offsets), spread(unit, batch.point_offsets)[:, None]
        self.offsets = torch.cat([batch.point_offsets, batch.point_offsets[1:] + count])
        self.owner = segment_ids(self.offsets)
        # Round a free vertex the triangles close: each neighbour is the head of one half-edge from it.
        self.tail, self.head = tails(batch.triangles), heads(batch.triangles)
        valence = torch.bincount(self.tail, minlength=count).clamp_min(1)
        self.valence = valence.to(torch.float64).repeat(2)
        self.stays = batch.fixed.repeat(2)
        self.places = ((batch.points.to(torch.float64) - self.centre) / self.unit).T.reshape(-1)
        around = self._add_neighbours(torch.zeros_like(self.places), self.places, 1)
        self.residual = (around - self.valence * self.places).masked_fill_(self.stays, 0)
        self.way = self.residual / self.valence
        self.power = segment_sum(self.residual * self.way, self.offsets)

    def _add_neighbours(self, total: Tensor, values: Tensor, factor: int) -> Tensor:
        """To `total` (2V,), in place, the sums of `values` (2V,) over each vertex's neighbours, times `factor`."""
        for sums, column in zip(total.split(self.count), values.split(self.count), strict=True):
            sums.index_add_(0, self.tail, column.index_select(0, self.head), alpha=factor)
        return total

    def sweep(self) -> None:
        """One step of conjugate gradients."""
        image = self._add_neighbours(self.valence * self.way, self.way, -1).masked_fill_(self.stays, 0)
        curved = segment_sum(self.way * image, self.offsets)
        step = torch.where(curved > 0, self.power / curved, 0.0).index_select(0, self.owner)
        self.places = self.places + step * self.way
        self.residual = self.residual - step * image
        short = self.residual / self.valence
        power = segment_sum(self.residual * short, self.offsets)
        again = torch.where(self.power > 0, power / self.power, 0.0).index_select(0, self.owner)
        self.way = short + again * self.way
        self.power = power

    def force(self) -> Tensor:
        """(B,) the square of the residual."""
        one, other = self.power.chunk(2)
        return one + other

    def tangle(self) -> Tensor:
        """(B, 2) the area that lies folded over, and the number of triangles that are not upright."""
        area = signed_area(corners(self.places.reshape(2, -1).T, self.batch.triangles))
        folded = segment_sum((-area).clamp_min(0), self.batch.triangle_offsets)
        return torch.stack([folded, segment_count(area <= 0, self.batch.triangle_offsets).to(folded)], 1)

    def moved(self) -> MeshBatch:
        """The meshes as they are now."""
        places = (self.places.reshape(2, -1).T * self.unit + self.centre).to(self.batch.points)
        return self.batch.with_points(torch.where(self.batch.fixed[:, None], self.batch.points, places))

    def select(self, keep: Tensor) -> "_Averaging":
        """The meshes `keep` (B,) bool only, each where it is on its way."""
        part, rows = _Averaging(self.batch.select(keep)), keep.repeat(2)[self.owner]
        part.places, part.residual, part.way = self.places[rows], self.residual[rows], self.way[rows]
        part.power = self.power[keep.repeat(2)]
        return part
