"""Interiors that are merely scrambled, put back by averaging, and told in a few sweeps from those it cannot help.

Where a boundary has moved far, the interior mostly followed it smoothly, and averaging its places again
changes nothing.  Where the interior alone was disturbed, the folded area vanishes within sweeps.
"""

import itertools
from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, put
from ..mesh.connectivity import heads, tails
from ..mesh.ragged import segment_count, segment_sum, spread
from ..mesh.triangle import corners, signed_area
from ..mesh.units import centre_and_unit
from ..optimising.conjugate_gradients import Systems

# Sweeps between two looks at a mesh, and before the first glance, which is for those that hardly gain at all.
_SWEEPS, _GLANCE = 8, 2


# By what part the folded area, or the number of triangles that are not upright, must fall from look to look in a
# mesh of up to 32 x 32 free vertices.  An error as wide as the mesh takes sweeps in proportion to the vertices
# across: of a wider mesh so much less is asked.
_GAIN, _ACROSS = 0.2, 32


# A valid mesh is done when its residual has come down to this part.
_RESIDUAL = 1e-3


def average(batch: MeshBatch) -> MeshBatch:
    """Free vertices on their way to the mean of their neighbours, as `relax` has them, where that untangles.

    Conjugate gradients with the valences as preconditioner, each mesh by itself, until it is valid and nearly at
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

    Rows are the x of all vertices, mesh by mesh, then their y; those of fixed vertices have no residual and do not
    move.  Coordinates are counted from each mesh's centre in a power of two near its extent.
    """

    def __init__(self, batch: MeshBatch) -> None:
        self.batch = batch
        count = len(batch.points)
        centre, unit = centre_and_unit(batch.points, batch.point_offsets)
        self.centre, self.unit = spread(centre, batch.point_offsets), spread(unit, batch.point_offsets)[:, None]
        # Round a free vertex the triangles close: each neighbour is the head of one half-edge from it.
        tail, head = tails(batch.triangles), heads(batch.triangles)
        valence = torch.bincount(tail, minlength=count).clamp_min(1).to(torch.float64).repeat(2)
        matrix = _ValenceLaplacian(tail, head, valence, batch.fixed.repeat(2))
        self.systems = Systems(matrix, valence, torch.cat([batch.point_offsets, batch.point_offsets[1:] + count]))
        positions = ((batch.points.to(torch.float64) - self.centre) / self.unit).T.reshape(-1)
        self.now = self.systems.start(positions, matrix.residual(positions))

    def sweep(self) -> None:
        """One step of conjugate gradients."""
        self.now = self.systems.step(self.now)

    def force(self) -> Tensor:
        """(B,) the square of the residual."""
        one, other = self.now.power.chunk(2)
        return one + other

    def tangle(self) -> Tensor:
        """(B, 2) the area that lies folded over, and the number of triangles that are not upright."""
        area = signed_area(corners(self.now.x.reshape(2, -1).T, self.batch.triangles))
        folded = segment_sum((-area).clamp_min(0), self.batch.triangle_offsets)
        return torch.stack([folded, segment_count(area <= 0, self.batch.triangle_offsets).to(folded)], 1)

    def moved(self) -> MeshBatch:
        """The meshes as they are now."""
        points = (self.now.x.reshape(2, -1).T * self.unit + self.centre).to(self.batch.points)
        return self.batch.with_points(torch.where(self.batch.fixed[:, None], self.batch.points, points))

    def select(self, keep: Tensor) -> "_Averaging":
        """The meshes `keep` (B,) bool only, with all that was reached."""
        part = _Averaging(self.batch.select(keep))
        part.now = self.systems.select(self.now, keep.repeat(2))
        return part


@dataclass(frozen=True, eq=False)
class _ValenceLaplacian:
    """The valence of a vertex on the diagonal, -1 for each neighbour; zero in the rows of fixed vertices.

    tail, head  (H,) the vertices of each half-edge
    valence     (2V,) for x and for y
    fixed       (2V,) bool
    """

    tail: Tensor
    head: Tensor
    valence: Tensor
    fixed: Tensor

    def __matmul__(self, u: Tensor) -> Tensor:
        return self._add_neighbours(self.valence * u, u, -1).masked_fill_(self.fixed, 0)

    def residual(self, u: Tensor) -> Tensor:
        """(2V,) minus the product with u (2V,)."""
        around = self._add_neighbours(torch.zeros_like(u), u, 1)
        return (around - self.valence * u).masked_fill_(self.fixed, 0)

    def _add_neighbours(self, total: Tensor, values: Tensor, factor: int) -> Tensor:
        """To `total` (2V,), in place, the sums of `values` (2V,) over each vertex's neighbours, times `factor`."""
        count = len(total) // 2
        for sums, column in zip(total.split(count), values.split(count), strict=True):
            sums.index_add_(0, self.tail, column.index_select(0, self.head), alpha=factor)
        return total
