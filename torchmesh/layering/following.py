"""Layers that follow their walls: each vertex is carried along rigidly with the wall below it.

    before                         after
n------                             \\  n
|  d                                 \\/ \\       The way d from the foot to the vertex is turned as the wall
f=====u     the wall turns          /f    \\      at the foot turns, and keeps its length: heights stay what
                                          \\u    they were, whatever the wall does.
"""

import torch
from torch import Tensor

from ..mesh.ragged import true_rows
from .layers import Layers


def follow_walls(layers: Layers, before: Tensor, after: Tensor) -> Tensor:
    """(V, 2) float64: `after` with the vertices of the layers put where their walls take them.

    before  (V, 2) positions of the mesh in which the layers were found
    after   (V, 2) other positions, of which those of the walls are read

    The wall at a vertex turns by the mean of the turns of the edges whose strips the vertex belongs to.  In a rigid
    motion of a wall its layer therefore moves as one body, to rounding.
    """
    old, new = before.to(torch.float64), after.to(torch.float64).clone()
    if not len(layers):
        return new
    foot = _feet(layers, len(old))
    turn = _turns(layers, old, new)
    # The sums over the strips of a vertex run in the order of the rows, which other meshes do not change.
    total = torch.zeros_like(new)
    for corner in (2, 3):
        total.index_add_(0, layers.corners[:, corner], turn)
    rows = true_rows(layers.vertices(len(old)))
    total = total[rows]
    # Where the turns on both sides cancel, the wall is folded; the vertex keeps its direction there.
    length = (total * total).sum(1).sqrt()[:, None]
    still = torch.tensor([1.0, 0.0], dtype=total.dtype, device=total.device)
    unit = torch.where(length > 0, total / length.clamp_min(1e-300), still)
    d = old[rows] - old[foot[rows]]
    turned = torch.stack([unit[:, 0] * d[:, 0] - unit[:, 1] * d[:, 1], unit[:, 1] * d[:, 0] + unit[:, 0] * d[:, 1]], 1)
    # What has neither turned nor moved keeps its bits.
    rests = (unit == still).all(1) & (new[foot[rows]] == old[foot[rows]]).all(1)
    new[rows] = torch.where(rests[:, None], old[rows], new[foot[rows]] + turned)
    return new


def _feet(layers: Layers, count: int) -> Tensor:
    """(V,) int64 the vertex of the wall at the lower end of each column; elsewhere the vertex itself."""
    foot = torch.arange(count, device=layers.wall.device)
    for row in range(1, int(layers.row.max()) + 1):
        lower_left, lower_right, upper_right, upper_left = layers.corners[layers.row == row].unbind(1)
        # The feet below are all known, and are read before any is written.
        left, right = foot[lower_left], foot[lower_right]
        foot[upper_left], foot[upper_right] = left, right
    return foot


def _turns(layers: Layers, old: Tensor, new: Tensor) -> Tensor:
    """(N, 2) by how much the wall's edge below each quadrilateral has turned: cosine and sine."""
    first = layers.row == 1
    place = torch.full((int(layers.wall.max()) + 1,), -1, device=old.device)
    place[layers.wall[first]] = torch.arange(int(first.sum()), device=old.device)
    ends = layers.corners[first, :2][place[layers.wall]]
    a, b = (p[ends[:, 1]] - p[ends[:, 0]] for p in (old, new))
    turn = torch.stack([(a * b).sum(1), a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]], 1)
    length = (turn * turn).sum(1).sqrt()[:, None]
    return torch.where(length > 0, turn / length.clamp_min(1e-300), torch.zeros_like(turn))
