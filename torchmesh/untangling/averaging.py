"""Scrambled interiors, restored by averaging: every free vertex moves to the mean of its neighbours.

Where a boundary has moved far, the interior mostly followed it smoothly, and averaging its positions changes
nothing.  Where only the interior was disturbed, the folded area vanishes within a few sweeps.  Few sweeps tell both
cases apart.
"""

import itertools
from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, put
from ..mesh.connectivity import heads, tails
from ..mesh.interfaces import Interfaces, check_interfaces, holding, released
from ..mesh.quads import diagonals, sampled
from ..mesh.ragged import segment_count, segment_sum, spread, take
from ..mesh.triangle import corners, signed_area
from ..mesh.units import centre_and_unit_of_triangles
from ..optimising.conjugate_gradients import Systems


@dataclass(frozen=True)
class AverageOptions:
    """When `average` stops.

    sweeps    steps of conjugate gradients between two looks at a mesh
    glance    steps before the very first look, which ends the meshes that gain hardly anything; with it such
              meshes take a third of the time
    gain      part by which the folded area, or the number of inverted triangles, must fall from look to look
    across    the gain is asked of meshes with up to `across` squared free vertices.  An error as wide as the mesh
              takes sweeps in proportion to the vertices across, so of a wider mesh less is asked in proportion
    residual  a valid mesh is done when its residual has fallen to this part of what it was
    interfaces  "free": the ends of constrained edges move like any vertex; otherwise they stay
    """

    sweeps: int = 8
    glance: int = 2
    gain: float = 0.2
    across: int = 32
    residual: float = 1e-3
    interfaces: Interfaces | None = None

    def __post_init__(self) -> None:
        for name in ("sweeps", "glance", "across"):
            if getattr(self, name) < 1:
                raise ValueError(f"AverageOptions.{name} must be at least 1, not {getattr(self, name)}")
        check_interfaces(self.interfaces, "AverageOptions.interfaces")
        for name in ("gain", "residual"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"AverageOptions.{name} must lie between 0 and 1, not {getattr(self, name)}")


def average(batch: MeshBatch, options: AverageOptions | None = None) -> MeshBatch:
    """Move free vertices towards the mean of their neighbours, as `relax` has them, where that untangles.

    Each mesh takes steps of conjugate gradients, with the valences as preconditioner, until it is valid and nearly
    at rest, or until it no longer gains.  A mesh that gained nothing comes back as it was.
    """
    options = options or AverageOptions()
    before, batch = batch, holding(batch, options.interfaces)
    result, work = batch, _Averaging(batch)
    going = torch.ones(len(batch), dtype=torch.bool, device=batch.points.device)
    across = segment_count(~batch.fixed, batch.point_offsets).to(torch.float64).sqrt().clamp_min(options.across)
    gain = (options.gain * options.across / across)[:, None]
    given = last = work.tangle()
    rest = options.residual**2 * work.force()
    for sweep in itertools.count(1):
        work.sweep()
        if sweep != options.glance and sweep % options.sweeps:
            continue
        now = work.tangle()
        # At the glance the gain is asked for in proportion to the sweeps done.
        left = 1 - gain[going] * min(sweep, options.sweeps) / options.sweeps
        valid, was_valid = now[:, 1] == 0, last[:, 1] == 0
        stays = torch.where(valid, work.force() > rest[going], (now < left * last).any(1))
        better = valid | (~stays & ~was_valid & (now < left * given[going]).any(1))
        if bool(better.any()):
            result = put(result, going.masked_scatter(going, better), work.moved().select(better))
        if not bool(stays.any()):
            break
        if sweep != options.glance:
            last = now
        if not bool(stays.all()):
            going, last, work = going.masked_scatter(going, stays), last[stays], work.select(stays)
    return released(result, before)


class _Averaging:
    """Two linear systems for each mesh, one for x and one for y: every free vertex at the mean of its neighbours.

    The rows are the x of all vertices, mesh by mesh, and then their y.  Rows of fixed vertices have no residual, so
    these do not move.  Coordinates are counted from each mesh's centre in a power of two near its extent.
    """

    def __init__(self, batch: MeshBatch) -> None:
        self.batch = batch
        count = len(batch.points)
        centre, unit = centre_and_unit_of_triangles(batch.points, batch.triangles, batch.point_offsets)
        self.centre, self.unit = spread(centre, batch.point_offsets), spread(unit, batch.point_offsets)[:, None]
        # The triangles around a free vertex close: each neighbour is the head of exactly one half-edge from it.
        tail, head = tails(batch.triangles), heads(batch.triangles)
        if len(batch.quads):
            # The diagonal of a quad, last in both of its halves, makes no neighbours.
            sides = ~diagonals(batch)
            tail, head = tail[sides], head[sides]
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
        """(B, 2) the area of the inverted triangles or corners of quads, and the number of inverted or flat ones."""
        batch = sampled(self.batch)
        area = signed_area(corners(self.now.x.reshape(2, -1).T, batch.triangles))
        folded = segment_sum((-area).clamp_min(0), batch.triangle_offsets)
        return torch.stack([folded, segment_count(area <= 0, batch.triangle_offsets).to(folded)], 1)

    def moved(self) -> MeshBatch:
        """The meshes as they are now."""
        points = (self.now.x.reshape(2, -1).T * self.unit + self.centre).to(self.batch.points)
        return self.batch.with_points(torch.where(self.batch.fixed[:, None], self.batch.points, points))

    def select(self, keep: Tensor) -> "_Averaging":
        """The meshes `keep` (B,) bool only, as far as they have come."""
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
        """Add the sums of `values` (2V,) over each vertex's neighbours, times `factor`, to `total` (2V,) in place."""
        count = len(total) // 2
        for sums, column in zip(total.split(count), values.split(count), strict=True):
            sums.index_add_(0, self.tail, take(column, self.head), alpha=factor)
        return total
