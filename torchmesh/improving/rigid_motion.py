"""Vertices that follow a body exactly: they shift and turn with the wall to which they belong.

. . . . . .       #  the wall: fixed vertices, whose motion is known
. r r r r .       r  rigid vertices, joined to it by edges
. r # # r .       .  the rest of the mesh
. r # # r .
. r r r r .       At any time the best shift and turn of the wall is found (Kabsch 1976, in the plane), and the
. . . . . .       rigid vertices take it.  Where the wall moves as a body, they do so to rounding.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.connectivity import keys_of
from ..mesh.ragged import true_rows
from .layered_motion import Path

# A wall moves as a body if no vertex is off by more than this part of its extent: positions may come from files.
_RIGID = 1e-6


@dataclass(frozen=True, eq=False)
class Body:
    """A wall and the vertices that follow it, as rows of the batch.

    wall       (N,) int64, fixed vertices
    followers  (M,) int64
    """

    wall: Tensor
    followers: Tensor

    def placed(self, start: Tensor, now: Tensor) -> Tensor:
        """(M, 2) float64: where the followers are when the wall has gone from `start` to `now`, both (V, 2)."""
        p, q, r = (
            v.cpu().numpy().astype(np.float64) for v in (start[self.wall], now[self.wall], start[self.followers])
        )
        if np.array_equal(p, q):
            return torch.from_numpy(r).to(start.device)
        turn, here, there = _fit(p, q)
        return torch.from_numpy((r - here) @ turn.T + there).to(start.device)

    def strain(self, start: Tensor, now: Tensor) -> float:
        """By how much the wall is bent at most, as a part of its extent."""
        p, q = (v[self.wall].cpu().numpy().astype(np.float64) for v in (start, now))
        turn, here, there = _fit(p, q)
        off = np.abs((p - here) @ turn.T + there - q).max()
        extent = np.abs(np.concatenate([p - here, q - there])).max()
        # Coordinates far from the origin are rounded by more.
        return float(off / max(extent, 1e-9 * np.abs(q).max(), 1e-300))


def _fit(p: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The turn (2, 2), and the means of `p` and `q`, (N, 2) each, that take p to q best in the least squares."""
    here, there = p.mean(0), q.mean(0)
    a, b = p - here, q - there
    dot, cross = float((a * b).sum()), float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())
    size = float(np.hypot(dot, cross))
    c, s = (dot / size, cross / size) if size > 0 else (1.0, 0.0)
    return np.array([[c, -s], [s, c]]), here, there


@dataclass(frozen=True, eq=False)
class RigidPath:
    """A path on which the followers of bodies go as their walls do.

    walls   the path of everything else
    bodies  the bodies of the batch
    start   (V, 2) the positions at the start
    """

    walls: Path
    bodies: tuple[Body, ...]
    start: Tensor

    def at(self, t: Tensor) -> Tensor:
        """(V, 2) the positions at t (B,), one in [0, 1] for each mesh."""
        return placed(self.bodies, self.start, self.walls.at(t))


def placed(bodies: tuple[Body, ...], start: Tensor, now: Tensor) -> Tensor:
    """(V, 2) `now` with the followers of the bodies where their walls have taken them from `start`."""
    points = now.clone()
    for body in bodies:
        points[body.followers] = body.placed(start, now).to(points)
    return points


def bodies_of(batch: MeshBatch, rigid: Tensor, goal: Tensor) -> tuple[Body, ...]:
    """The bodies to which the vertices `rigid` (V,) bool belong; `goal` (V, 2) is where their walls go.

    Rigid vertices that edges join are of one body.  Its wall is its own fixed vertices, or, if it has none, the fixed
    vertices to which edges join it.  Raises InvalidMeshError for a body without a wall, or one whose wall bends.
    """
    pairs = connectivity.edges(batch.triangles, batch.twin)
    inside = rigid[pairs]
    label = connectivity.edge_components(pairs[inside.all(1)], len(batch.points))
    # Fixed vertices beside a body, by the label of the body.
    tail, head = torch.cat([pairs, pairs.flip(1)]).unbind(1)
    beside = rigid[tail] & batch.fixed[head] & ~rigid[head]
    bodies = []
    for name in label[rigid].unique().tolist():
        mine = rigid & (label == name)
        followers = true_rows(mine & ~batch.fixed)
        wall = true_rows(mine & batch.fixed)
        if not len(wall):
            wall = head[beside & mine[tail]].unique()
        if not len(followers):
            continue
        if not len(wall):
            row = int(followers[0])
            raise InvalidMeshError(f"rigid row {row}: no edge joins these rigid vertices to a fixed one, a wall")
        body = Body(wall, followers)
        strain = body.strain(batch.points, goal)
        if strain > _RIGID:
            raise InvalidMeshError(
                f"rigid row {int(followers[0])}: its wall does not move as a body, but bends by {strain:.2g} of its "
                "extent; layer=... follows walls that bend"
            )
        bodies.append(body)
    return tuple(bodies)


def holding_edges(batch: MeshBatch, held: Tensor) -> MeshBatch:
    """The batch with the vertices `held` (V,) bool fixed, and with all edges between them constrained."""
    pairs = connectivity.edges(batch.triangles, batch.twin)
    inner = connectivity.boundary_edges(batch.triangles, batch.twin)
    keys = keys_of(pairs[held[pairs].all(1)], len(batch.points))
    known = keys_of(torch.cat([batch.constrained_edges, inner]), len(batch.points))
    keys = keys[~torch.isin(keys, known)].unique()
    more = torch.stack([keys // len(batch.points), keys % len(batch.points)], 1)
    edges = torch.cat([batch.constrained_edges, more])
    return replace(batch, fixed=batch.fixed | held, constrained_edges=edges)
