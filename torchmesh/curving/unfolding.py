"""Nodes inside are moved until triangles next to curved boundaries are upright: curved inwards, and no farther.

    boundary
 ---__________---       Round the triangles that are not upright, patches grow ring by ring.  In a patch the nodes of
   \\          /        sides inside move, and if that is not enough the vertices inside, too, towards the least
     \\_____  /         distortion
           \\/
                        sum over samples of  |F|^2 / chi(det F),   chi(d) = (d + sqrt(e^2 + d^2)) / 2

F is the derivative of the map from the straight triangle, or from an equilateral one where vertices move.  The number e
falls to zero as the triangles unfold (Garanzha, Kaporin, Kudryavtseva, Protais, Ray & Sokolov, Foldover-free maps in 50
lines of code, ACM Transactions on Graphics 40, 2021).  What counts in the end is the exact sign.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from .middles import Middles
from .validity import scaled_jacobian, upright


@dataclass(frozen=True)
class Unfolding:
    """How mid-side nodes are moved to mend triangles.

    straightenings  how often the nodes of inverted triangles are put into the middles of their edges
    rings           rings of triangles round the inverted ones whose sides take part: at first, and at each further try
    order           samples of the Jacobian lie on a lattice with so many steps to a side
    stages          how often e is set anew
    iterations      iterations of the minimiser in each stage
    gain            stages end when the least Jacobian grows by less than this part of the mean one
    aim             a triangle with a smaller scaled Jacobian is worked on, unless it came so; and a patch until all
                    of its triangles have that much, if the stages suffice
    """

    straightenings: int = 3
    rings: tuple[int, ...] = (0, 1, 3)
    order: int = 4
    stages: int = 10
    iterations: int = 40
    gain: float = 1e-3
    aim: float = 0.1


def unfold(
    points: np.ndarray,
    six: np.ndarray,
    side: np.ndarray,
    middles: Middles,
    free: np.ndarray,
    fixed: np.ndarray,
    bad: np.ndarray,
    may: np.ndarray,
    options: Unfolding,
) -> np.ndarray:
    """(V, 2) the points with triangles mended as far as that goes; none that was upright is inverted by it.

    A patch is taken over if fewer of its triangles are not upright, or as few and the least scaled Jacobian has grown.

    points  (V, 2)
    six     (N, 6) the nodes of all triangles
    side    (N, 3) the rows in `middles` of their sides
    free    (E,) bool, nodes that may move
    fixed   (V,) bool, corners that must not
    bad     (N,) bool, triangles to mend: not upright, or with a scaled Jacobian below the aim
    may     (N,) bool, triangles that are to be mended where they are such
    """
    for corners_too in (False, True):
        for rings in options.rings if bad.any() else ():
            for patch in _patches(six, bad, rings + 1):
                sides = np.unique(side[_within(six, bad & _mask(patch, len(bad)), rings)])
                trial = _relaxed(points, six, side, middles, sides[free[sides]], fixed, patch, corners_too, options)
                if _is_better(points, trial, six[patch]):
                    points = trial
                    bad = bad.copy()
                    bad[patch] = needs_mending(trial, six[patch], options.aim) & may[patch]
            if not bad.any():
                return points
    return points


def needs_mending(points: np.ndarray, six: np.ndarray, aim: float) -> np.ndarray:
    """(N,) bool: the triangle of the nodes `six` (N, 6) is not upright, or its scaled Jacobian is below `aim`."""
    at, rows = torch.from_numpy(points), torch.from_numpy(six)
    return (~upright(at, rows) | (scaled_jacobian(at, rows) < aim)).numpy()


def _is_better(points: np.ndarray, trial: np.ndarray, six: np.ndarray) -> bool:
    rows = torch.from_numpy(six)
    was, now = (upright(torch.from_numpy(at), rows) for at in (points, trial))
    if bool((was & ~now).any()) or not np.isfinite(trial[six]).all():
        return False
    if int(now.sum()) != int(was.sum()):
        return int(now.sum()) > int(was.sum())
    before, after = (float(scaled_jacobian(torch.from_numpy(at), rows).min()) for at in (points, trial))
    return after > before


def _patches(six: np.ndarray, bad: np.ndarray, rings: int) -> list[np.ndarray]:
    """The rows of triangles within so many rings of the inverted ones, connected patch by connected patch."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    inside = np.flatnonzero(_within(six, bad, rings))
    corners, place = np.unique(six[inside][:, :3], return_inverse=True)
    rows = np.repeat(np.arange(len(inside)), 3)
    entries = np.ones(len(rows), np.int64), (rows, place.reshape(-1))
    has = coo_matrix(entries, (len(inside), len(corners))).tocsr()
    _, label = connected_components(has @ has.T, directed=False)
    order = label.argsort(kind="stable")
    return np.split(inside[order], np.flatnonzero(np.diff(label[order])) + 1)


def _within(six: np.ndarray, rows: np.ndarray, rings: int) -> np.ndarray:
    """(N,) bool: the triangles `rows` (N,) bool and those within so many rings of triangles that share a corner."""
    near = rows
    for _ in range(rings):
        touched = np.zeros(int(six.max()) + 1, bool)
        touched[six[near][:, :3]] = True
        near = touched[six[:, :3]].any(1)
    return near


def _mask(rows: np.ndarray, count: int) -> np.ndarray:
    """(count,) bool: the rows that are listed."""
    mask = np.zeros(count, bool)
    mask[rows] = True
    return mask


def _relaxed(
    points: np.ndarray, six: np.ndarray, side: np.ndarray, middles: Middles, sides: np.ndarray, fixed: np.ndarray,
    patch: np.ndarray, corners_too: bool, options: Unfolding,
) -> np.ndarray:  # fmt: skip
    """The points with nodes of `sides` inside a patch where distortion is least; `corners_too`: its vertices, too."""
    from scipy.optimize import minimize

    moving = middles.nodes[sides]
    if corners_too:
        # The whole fan of a vertex that moves is in the patch.
        fans = np.bincount(six[:, :3].reshape(-1), minlength=len(points))
        own = np.bincount(six[patch][:, :3].reshape(-1), minlength=len(points))
        moving = np.concatenate([moving, np.flatnonzero((own > 0) & (own == fans) & ~fixed)])
    if not len(moving):
        return points
    here, place = np.unique(six[patch], return_inverse=True)
    rows = torch.from_numpy(place.reshape(-1, 6))
    local = torch.from_numpy(points[here])
    unit = float((local.amax(0) - local.amin(0)).max())
    start = (local - local.mean(0)) / unit
    slot = torch.from_numpy(np.searchsorted(here, moving))
    energy = _Energy(start[rows[:, :3]], corners_too, options.order)
    at = start.clone()

    def value(x: np.ndarray) -> tuple[float, np.ndarray]:
        moved = torch.from_numpy(x.reshape(-1, 2)).requires_grad_()
        total = energy(at.index_copy(0, slot, moved)[rows], e)
        (slope,) = torch.autograd.grad(total, moved)
        return float(total.detach()), slope.numpy().reshape(-1)

    x = start[slot].numpy().reshape(-1)
    last = -math.inf
    for _ in range(options.stages):
        at[slot] = torch.from_numpy(x.reshape(-1, 2))
        least = energy.least(at[rows])
        if least < last + options.gain and last < 0:
            break
        last = least
        # As in the paper: e is of the size of the worst Jacobian while there is a negative one.
        e = math.sqrt(1e-12 + 0.04 * min(least, 0.0) ** 2)
        x = minimize(value, x, jac=True, method="L-BFGS-B", options={"maxiter": options.iterations}).x
        at[slot] = torch.from_numpy(x.reshape(-1, 2))
        if float(scaled_jacobian(at, rows).min()) > options.aim:
            break
    trial = points.copy()
    trial[moving] = (at[slot] * unit + local.mean(0)).numpy()
    return trial


class _Energy:
    """The distortion of six-node triangles at sample points."""

    def __init__(self, corners: torch.Tensor, equilateral: bool, order: int) -> None:
        """`corners` (N, 3, 2) are those of the triangles at the start; they, or equilateral ones, are the ideal."""
        i, j = np.meshgrid(np.arange(order + 1), np.arange(order + 1))
        keep = i + j <= order
        x, y = i[keep] / order, j[keep] / order
        z, none = 1 - x - y, np.zeros_like(x)
        along = np.stack([1 - 4 * z, 4 * x - 1, none, 4 * (z - x), 4 * y, -4 * y], 1)
        across = np.stack([1 - 4 * z, none, 4 * y - 1, -4 * x, 4 * x, 4 * (z - y)], 1)
        self._gradients = torch.from_numpy(np.stack([along, across]))  # (2, S, 6)
        ideal = torch.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], 2)
        size = torch.linalg.det(ideal)
        shape = ideal.new_tensor([[1.0, 0.5], [0.0, math.sqrt(0.75)]]) / 0.75**0.25
        poor = equilateral | (size <= 1e-9 * size.abs().mean())
        mean = size.abs().mean().sqrt()
        self._inverse = torch.linalg.inv(torch.where(torch.as_tensor(poor)[..., None, None], shape * mean, ideal))

    def _samples(self, nodes: torch.Tensor) -> torch.Tensor:
        """(N, S, 2, 2) the derivatives of the map from the ideal triangles to those with the nodes (N, 6, 2)."""
        return torch.einsum("dsk,nkc->nscd", self._gradients, nodes) @ self._inverse[:, None]

    def least(self, nodes: torch.Tensor) -> float:
        """The least determinant of the samples."""
        return float(torch.linalg.det(self._samples(nodes)).min())

    def __call__(self, nodes: torch.Tensor, e: float) -> torch.Tensor:
        f = self._samples(nodes)
        determinant = f[..., 0, 0] * f[..., 1, 1] - f[..., 0, 1] * f[..., 1, 0]
        chi = (determinant + (determinant**2 + e * e).sqrt()) / 2
        return ((f**2).sum((2, 3)) / chi + 0.1 * (determinant**2 + 1) / chi).sum()
