"""How a boundary travels, and how far a mesh can follow a straight line before a triangle flattens."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.ragged import offsets_from_counts, segment_min, segment_sum, spread
from ..mesh.triangle import corners
from ..mesh.units import centre_and_unit

# A loop turns as a body when that explains its motion to this part of what a mere shift leaves over.
_RIGID = 0.25


def largest_step(batch: MeshBatch, new_points: Tensor) -> Tensor:
    """(B,) the part of the straight way to `new_points` on which no triangle of a mesh inverts.

    Along p + t (new - p) a triangle's area is a quadratic in t; the answer is its least positive
    root over the mesh's triangles, infinite if there is none, 0 for a mesh that is tangled already.
    More than 1 means that the whole way is safe.

    new_points  (V, 2) in the batch's unit, every row counts

    Raises InvalidMeshError for another shape.
    """
    target = torch.as_tensor(new_points).to(batch.points)
    if target.shape != batch.points.shape:
        raise InvalidMeshError(f"new_points must be {tuple(batch.points.shape)}, not {tuple(target.shape)}")
    return segment_min(first_flat(batch, target), batch.triangle_offsets)


def first_flat(batch: MeshBatch, target: Tensor) -> Tensor:
    """(T,) when each triangle's area is first zero on the straight way to `target` (V, 2); infinite for never."""
    centre, unit = centre_and_unit(batch.points, batch.point_offsets)
    # A power of two changes no root and keeps every product in range.
    scale = spread(unit, batch.point_offsets)[:, None]
    here = corners((batch.points.to(torch.float64) - spread(centre, batch.point_offsets)) / scale, batch.triangles)
    way = corners((target.to(torch.float64) - batch.points.to(torch.float64)) / scale, batch.triangles)
    px, py, qx, qy = here.bx - here.ax, here.by - here.ay, here.cx - here.ax, here.cy - here.ay
    dx, dy, ex, ey = way.bx - way.ax, way.by - way.ay, way.cx - way.ax, way.cy - way.ay
    return least_positive_root(dx * ey - dy * ex, px * ey - py * ex + dx * qy - dy * qx, px * qy - py * qx)


def least_positive_root(a: Tensor, b: Tensor, c: Tensor) -> Tensor:
    """(N,) the least t > 0 where a t^2 + b t + c = 0, for c > 0; infinite if there is none, 0 where c <= 0.

    2 c / (s - b) with s the root of the discriminant: of the two positive roots the lesser.  For
    b > 0 the difference cancels, and -(b + s) / 2 a is the same number.
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
    """The way of the fixed vertices of a batch from where they are, at t = 0, to where they go, at t = 1.

    Each loop of the boundary, and each net of constrained edges off the boundary, is a body.  One
    that goes as a rigid body, or nearly, turns about its moving centre at a steady rate while the
    rest of its motion grows in proportion; every other vertex goes straight.  A straight path would
    draw a body that turns by 180 degrees together into a point.

    start, end     (V, 2) float64
    body           (V,) int64, the body of each vertex; the last number for those that are in none
    angle          (L+1,) float64 how far each body turns, in radians within (-pi, pi]; the last is 0
    origin, goal   (L+1, 2) float64 each body's centre at t = 0 and t = 1
    point_offsets  (B+1,)
    """

    start: Tensor
    end: Tensor
    body: Tensor
    angle: Tensor
    origin: Tensor
    goal: Tensor
    point_offsets: Tensor

    @classmethod
    def of(cls, batch: MeshBatch, new_points: Tensor, straight: bool = False) -> "BoundaryPath":
        """From the positions of the fixed vertices in `batch` to their rows of `new_points` (V, 2)."""
        start, end = batch.points.to(torch.float64), new_points.to(torch.float64)
        end = torch.where(batch.fixed[:, None], end, start)
        body, count = _bodies(batch)
        if straight:
            body, count = torch.zeros_like(body), 0
        rows = (body < count).nonzero().squeeze(1)
        rows = rows[body[rows].sort(stable=True).indices]
        offsets = offsets_from_counts(torch.bincount(body[rows], minlength=count)[:count])
        size = (offsets[1:] - offsets[:-1]).clamp_min(1)

        def mean(values: Tensor) -> Tensor:
            return segment_sum(values, offsets) / size

        origin, goal = (torch.stack([mean(p[rows, i].contiguous()) for i in (0, 1)], 1) for p in (start, end))
        p, q = start[rows] - spread(origin, offsets), end[rows] - spread(goal, offsets)
        dot, cross = mean(p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1]), mean(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
        spin = mean((p * p).sum(1)) + mean((q * q).sum(1))
        # Least squares (Kabsch 1976, in the plane): what is left by a shift, and by a shift and a turn.
        shifted, turned = spin - 2 * dot, spin - 2 * torch.hypot(dot, cross)
        rigid = (turned <= _RIGID**2 * shifted) & (shifted > 1e-24 * spin)
        # One by one: the bits of a vectorised arctangent depend on where in a vector a number stands.
        angles = [math.atan2(c, d) if r else 0.0 for c, d, r in zip(*(v.tolist() for v in (cross, dot, rigid)))]  # noqa: B905
        nowhere = start.new_zeros((1, 2))
        return cls(
            start,
            end,
            body,
            start.new_tensor([*angles, 0.0]),
            torch.cat([origin, nowhere]),
            torch.cat([goal, nowhere]),
            batch.point_offsets,
        )

    @property
    def turns(self) -> bool:
        """Does any body turn?"""
        return bool((self.angle != 0).any())

    def at(self, t: Tensor) -> Tensor:
        """(V, 2) the positions at t (B,), in [0, 1], one for each mesh; free vertices stay where they started."""
        t = spread(t.to(torch.float64), self.point_offsets)[:, None]
        position = torch.where(t >= 1, self.end, torch.lerp(self.start, self.end, t))
        if not self.turns:
            return position
        rows = ((self.angle[self.body] != 0) & (t[:, 0] < 1)).nonzero().squeeze(1)
        t, body = t[rows], self.body[rows]
        angle = self.angle[body]
        p = self.start[rows] - self.origin[body]
        # The goal, turned back, is where the body would go if it did not turn.
        back = _turned(self.end[rows] - self.goal[body], -angle)
        centre = torch.lerp(self.origin[body], self.goal[body], t)
        position = position.clone()
        position[rows] = centre + _turned(torch.lerp(p, back, t), angle * t[:, 0])
        return position


def _turned(points: Tensor, angle: Tensor) -> Tensor:
    """`points` (N, 2) turned counter-clockwise by `angle` (N,) about the origin."""
    values, body = angle.unique(return_inverse=True)
    # As few as there are bodies, one by one for the same bits wherever they stand.
    cosine = values.new_tensor([math.cos(a) for a in values.tolist()])[body]
    sine = values.new_tensor([math.sin(a) for a in values.tolist()])[body]
    x, y = points.unbind(1)
    return torch.stack([x * cosine - y * sine, x * sine + y * cosine], 1)


def _bodies(batch: MeshBatch) -> tuple[Tensor, int]:
    """(V,) the body of each vertex, in the meshes' order, and the number of bodies, which is the label of none."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(batch.points)
    boundary = connectivity.boundary_edges(batch.triangles, batch.twin)
    on_boundary = torch.zeros(count, dtype=torch.bool, device=boundary.device)
    on_boundary[boundary.reshape(-1)] = True
    inner = batch.constrained_edges[~on_boundary[batch.constrained_edges].any(1)]
    ends = torch.cat([boundary, inner])
    i, j = ends.cpu().numpy().T
    graph = coo_matrix((np.ones(len(i), np.int8), (i, j)), shape=(count, count))
    label = torch.from_numpy(connected_components(graph, directed=False)[1].astype(np.int64)).to(boundary.device)
    used = torch.zeros(count, dtype=torch.bool, device=boundary.device)
    used[ends.reshape(-1)] = True
    names = label[used].unique()
    return torch.where(used, torch.searchsorted(names, label), len(names)), len(names)
