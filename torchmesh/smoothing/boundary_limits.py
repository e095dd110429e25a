r"""What the boundary allows: the best angle and the best ratio that the triangles at a boundary vertex can have.

                      q
                    / |
                 b /   \         A fan of k triangles fills the angle alpha at o, between the
                  /     |        boundary edges o-p and o-q.  Here k = 2.
                o alpha |
                  \ ----+- m
                 a  \   |
                      \ p

The triangles of a fan have angles t at o and ratios r of sides.  No angle of such a triangle is below theta if and only
if t >= theta and |log r| <= log(sin(t + theta) / sin(theta)).  This is a convex set in (t, log r), so the best fan of k
triangles is the one of equal triangles, and the limit is the best over all k.  The same holds for the inverse mean
ratio (r + 1 / r - cos t) / (sqrt(3) sin t), which is the cosh of a hyperbolic distance.
"""

import numpy as np
import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.connectivity import next_in_triangle
from ..mesh.ragged import take, true_rows
from ..mesh.triangle import SQRT3

# A fan of more triangles than this has an angle of less than 15 degrees.
_MOST_IN_A_FAN = 24


def fan_limits(batch: MeshBatch, complete: Tensor) -> tuple[Tensor, Tensor]:
    """(V,) radians and (V,) inverse mean ratios that no triangulation at a boundary vertex can pass.

    In every triangulation some angle is at most the first, and some inverse mean ratio at least the second.  The
    limits are infinity and 1 at all vertices that do not lie on exactly one pair of boundary edges.

    complete  (V,) bool, all triangles at the vertex are in the batch
    """
    angle_limit = torch.full((len(batch.points),), torch.inf, dtype=torch.float64, device=complete.device)
    ratio_limit = torch.ones_like(angle_limit)
    out = true_rows(batch.twin < 0)
    vertex = batch.triangles.reshape(-1)
    number = torch.bincount(vertex[out], minlength=len(angle_limit))
    # The vertex before each along the boundary.
    preceding = torch.zeros_like(number)
    preceding[vertex[next_in_triangle(out)]] = vertex[out]
    out = out[(complete & (number == 1))[vertex[out]]]
    here = vertex[out]
    points = batch.points.to(torch.float64).cpu().numpy()
    p, q, o = (points[v.cpu().numpy()] for v in (vertex[next_in_triangle(out)], preceding[here], here))
    angle, ratio = _best_fans(p - o, q - o)
    angle_limit[here] = torch.from_numpy(angle).to(angle_limit.device)
    ratio_limit[here] = torch.from_numpy(ratio).to(angle_limit.device)
    return angle_limit, ratio_limit


def asked_of(
    batch: MeshBatch, limits: tuple[Tensor, Tensor], angle: float, ratio: float, share: float
) -> tuple[Tensor, Tensor]:
    """(T,) radians and (T,) inverse mean ratios that may be asked of each triangle: less where the boundary is sharp.

    limits        what `fan_limits` says
    angle, ratio  what is asked, in radians and as an inverse mean ratio
    share         where the boundary allows less than that, this part of what it allows suffices
    """
    corner = [v.contiguous() for v in batch.triangles.unbind(1)]
    least = torch.stack([take(limits[0], v) for v in corner]).amin(0)
    most = torch.stack([take(limits[1], v) for v in corner]).amax(0)
    return torch.where(least < angle, share * least, angle), torch.where(most > ratio, most / share, ratio)


def _best_fans(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) smallest angle in radians and (N,) largest ratio of the best fans from the sides `first` to `last` (N, 2).

    By numpy, where the bits of a result do not depend on its position in the vector.
    """
    (ux, uy), (vx, vy) = first.T, last.T
    turn = np.arctan2(ux * vy - uy * vx, ux * vx + uy * vy)
    alpha = np.where(turn > 0, turn, turn + 2 * np.pi)[:, None]
    log_ratio = 0.5 * np.abs(np.log(ux * ux + uy * uy) - np.log(vx * vx + vy * vy))[:, None]
    k = np.arange(1, _MOST_IN_A_FAN + 1)
    t = alpha / k
    r = np.exp(log_ratio / k)
    angle = np.where(t < np.pi, np.minimum(t, np.arctan2(np.sin(t), r - np.cos(t))), 0.0)
    shape = np.where(t < np.pi, (r + 1 / r - np.cos(t)) / (SQRT3 * np.where(t < np.pi, np.sin(t), 1.0)), np.inf)
    return angle.max(1, initial=0.0), shape.min(1, initial=np.inf)
