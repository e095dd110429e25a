"""The path of a moving boundary, and how far a mesh can move along straight lines before a triangle is flat."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from ..kernels import geometry
from ..kernels.library import library_for
from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.detached import without_autograd
from ..mesh.quads import HALVES, quads_as_halves, sampled, spread_to_halves, worst_of_samples
from ..mesh.ragged import offsets_from_counts, segment_min, segment_sum, spread, true_rows
from ..mesh.triangle import corners
from ..mesh.units import centre_and_unit_of_triangles
from .femwarp import checked_new_points

# A body turns if shift and turn leave at most this part of the motion that a shift alone leaves (root mean square).
_RIGID = 0.25


@without_autograd
@quads_as_halves
def largest_step(batch: MeshBatch, new_points: Tensor) -> Tensor:
    """(B,) the part of the straight way to `new_points` on which no triangle or quad of a mesh inverts.

    On the way p + t (new - p) the area of a triangle is a quadratic in t.  The result is the least positive root over
    the triangles of the mesh: infinity if there is none, and 0 for a mesh that is tangled already.  More than 1 means
    that the whole way is safe.

    new_points  (V, 2) in the unit of the batch; all rows are read

    Raises InvalidMeshError if new_points has another shape or type.
    """
    target = checked_new_points(batch, new_points)
    return segment_min(first_flat(batch, target), batch.triangle_offsets)


def first_flat(batch: MeshBatch, target: Tensor) -> Tensor:
    """(T,) the t at which each triangle is first flat on the straight way to `target` (V, 2); infinity for never.

    A triangle that stands for a quad has the least t of the quad's corners.
    """
    if batch.rows_per_quad == HALVES:
        least = worst_of_samples(batch, -first_flat(sampled(batch), target))
        return -spread_to_halves(batch, *least)
    centre, unit = centre_and_unit_of_triangles(batch.points, batch.triangles, batch.point_offsets)
    if library_for(batch.points) is not None:
        return geometry.first_flat(batch.points, target, batch.triangles, batch.triangle_offsets, centre, unit)
    # Dividing by a power of two changes no root, and keeps every product within the range of numbers.
    scale = spread(unit, batch.point_offsets)[:, None]
    here = corners((batch.points.to(torch.float64) - spread(centre, batch.point_offsets)) / scale, batch.triangles)
    way = corners((target.to(torch.float64) - batch.points.to(torch.float64)) / scale, batch.triangles)
    px, py, qx, qy = here.bx - here.ax, here.by - here.ay, here.cx - here.ax, here.cy - here.ay
    dx, dy, ex, ey = way.bx - way.ax, way.by - way.ay, way.cx - way.ax, way.cy - way.ay
    return least_positive_root(dx * ey - dy * ex, px * ey - py * ex + dx * qy - dy * qx, px * qy - py * qx)


def least_positive_root(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """(N,) the least t > 0 with a t^2 + b t + c = 0, for c > 0; infinity if there is none, and 0 where c <= 0.

    The lesser of two positive roots is 2 c / (s - b), where s is the square root of the discriminant.  For b > 0 the
    difference would lose digits, and -(b + s) / 2 a is the same number.
    """
    size = torch.maximum(torch.maximum(a.abs(), b.abs()), c.abs())
    size = torch.where(size > 0, size, 1.0)
    a, b, c = a / size, b / size, c / size
    discriminant = b * b - 4 * a * c
    s = discriminant.clamp_min(0).sqrt()
    falling = torch.where(b > 0, -(b + s), 2 * c)
    divisor = torch.where(b > 0, 2 * a, s - b)
    exists = (discriminant >= 0) & torch.where(b > 0, a < 0, divisor > 0)
    root = falling / torch.where(exists, divisor, 1.0)
    return torch.where(c > 0, torch.where(exists, root, torch.inf), 0.0)


@dataclass(frozen=True, eq=False)
class BoundaryPath:
    """The way of the fixed vertices of a batch from their positions at t = 0 to their positions at t = 1.

    Each loop of the boundary, and each net of constrained edges away from the boundary, is a body.  A body whose motion
    is rigid, or nearly so, turns about its moving centre at a steady rate, and the rest of its motion grows in
    proportion to t.  Every other vertex goes straight.  If a body that turns by 180 degrees went straight, it would
    shrink to a point on the way.

    batch       the batch at t = 0
    start, end  (V, 2) float64, the positions at t = 0 and at t = 1
    straight    whether all vertices go straight
    """

    batch: MeshBatch
    start: Tensor
    end: Tensor
    straight: bool

    @classmethod
    def of(cls, batch: MeshBatch, new_points: Tensor, straight: bool = False) -> "BoundaryPath":
        """The path from the positions of the fixed vertices in `batch` to their rows of `new_points` (V, 2).

        straight  whether all vertices go straight
        """
        start, end = batch.points.to(torch.float64), new_points.to(torch.float64)
        return cls(batch, start, torch.where(batch.fixed[:, None], end, start), straight)

    @cached_property
    def bodies(self) -> "Bodies | None":
        """The bodies that turn; None: nothing does.  A way that is gone in one step does not ask for them."""
        if self.straight:
            return None
        found = Bodies.of(self.batch, self.start, self.end)
        return found if bool((found.angle != 0).any()) else None

    @property
    def turns(self) -> bool:
        """Whether any body turns."""
        return self.bodies is not None

    def at(self, t: Tensor) -> Tensor:
        """(V, 2) the positions at t (B,), one in [0, 1] for each mesh; free vertices stay at their start."""
        if bool((t >= 1).all()):
            return self.end
        t = spread(t.to(torch.float64), self.batch.point_offsets)[:, None]
        position = torch.where(t >= 1, self.end, torch.lerp(self.start, self.end, t))
        if self.bodies is None:
            return position
        bodies = self.bodies
        rows = true_rows((bodies.angle[bodies.body] != 0) & (t[:, 0] < 1))
        t, body = t[rows], bodies.body[rows]
        angle = bodies.angle[body]
        p = self.start[rows] - bodies.origin[body]
        # The end of a vertex, turned back, is where it would go if the body did not turn.
        back = _turned(self.end[rows] - bodies.goal[body], -angle)
        centre = torch.lerp(bodies.origin[body], bodies.goal[body], t)
        position = position.clone()
        position[rows] = centre + _turned(torch.lerp(p, back, t), angle * t[:, 0])
        return position


@dataclass(frozen=True, eq=False)
class Bodies:
    """The bodies of a `BoundaryPath`, L in number.

    body          (V,) int64, the body of each vertex; L for vertices in none
    angle         (L+1,) float64, the angle by which each body turns, in radians in (-pi, pi]; the last is 0
    origin, goal  (L+1, 2) float64, the centre of each body at t = 0 and at t = 1
    """

    body: Tensor
    angle: Tensor
    origin: Tensor
    goal: Tensor

    @classmethod
    def of(cls, batch: MeshBatch, start: Tensor, end: Tensor) -> "Bodies":
        """The bodies that go from `start` to `end`, (V, 2) float64."""
        body, count = _bodies(batch)
        rows = true_rows(body < count)
        rows = rows[body[rows].sort(stable=True).indices]
        offsets = offsets_from_counts(torch.bincount(body[rows], minlength=count)[:count])
        size = (offsets[1:] - offsets[:-1]).clamp_min(1)

        def mean(values: Tensor) -> Tensor:
            return segment_sum(values, offsets) / size

        origin, goal = (torch.stack([mean(p[rows, i].contiguous()) for i in (0, 1)], 1) for p in (start, end))
        p, q = start[rows] - spread(origin, offsets), end[rows] - spread(goal, offsets)
        dot, cross = mean(p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1]), mean(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
        spin = mean((p * p).sum(1)) + mean((q * q).sum(1))
        # The least squares that a shift leaves, and that a shift and a turn leave (Kabsch 1976, in the plane).
        shifted, turned = spin - 2 * dot, spin - 2 * torch.hypot(dot, cross)
        rigid = (turned <= _RIGID**2 * shifted) & (shifted > 1e-24 * spin)
        # The bits of a vectorised arctangent would depend on where in a vector a number stands.
        angles = [math.atan2(c, d) if r else 0.0 for c, d, r in zip(*(v.tolist() for v in (cross, dot, rigid)))]  # noqa: B905
        nowhere = start.new_zeros((1, 2))
        return cls(body, start.new_tensor([*angles, 0.0]), torch.cat([origin, nowhere]), torch.cat([goal, nowhere]))


def _turned(points: Tensor, angle: Tensor) -> Tensor:
    """`points` (N, 2) turned counter-clockwise by `angle` (N,) about the origin."""
    values, body = angle.unique(return_inverse=True)
    # There are only as many angles as bodies.  Vectorised, their bits would depend on where in a vector they stand.
    cosine = values.new_tensor([math.cos(a) for a in values.tolist()])[body]
    sine = values.new_tensor([math.sin(a) for a in values.tolist()])[body]
    x, y = points.unbind(1)
    return torch.stack([x * cosine - y * sine, x * sine + y * cosine], 1)


def _bodies(batch: MeshBatch) -> tuple[Tensor, int]:
    """(V,) the body of each vertex, in the order of the meshes, and the number of bodies, which stands for none."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(batch.points)
    boundary = connectivity.boundary_edges(batch.triangles, batch.twin)
    on_boundary = torch.zeros(count, dtype=torch.bool, device=boundary.device)
    on_boundary[boundary.reshape(-1)] = True
    inner = batch.constrained_edges[~on_boundary[batch.constrained_edges].any(1)]
    ends = torch.cat([boundary, inner])
    used, place = ends.reshape(-1).unique(return_inverse=True)
    i, j = place.reshape(-1, 2).cpu().numpy().T
    graph = coo_matrix((np.ones(len(i), np.int8), (i, j)), shape=(len(used),) * 2)
    number, label = connected_components(graph, directed=False)
    # Bodies are numbered by their first vertex, and so in the order of the meshes.
    first = np.full(number, len(used))
    np.minimum.at(first, label, np.arange(len(used)))
    rank = np.empty(number, np.int64)
    rank[first.argsort()] = np.arange(number)
    body = torch.full((count,), number, device=boundary.device)
    body[used] = torch.from_numpy(rank[label]).to(boundary.device)
    return body, number
