"""Nodes inside are moved until elements next to curved boundaries are upright: curved inwards, and no farther.

    boundary
 ---__________---       Round the elements that are not upright, patches grow ring by ring.  In a patch the nodes of
   \\          /        sides inside move, and if that is not enough the vertices inside, too, towards the least
     \\_____  /         distortion
           \\/
                        sum over samples of  |F|^2 / chi(det F),   chi(d) = (d + sqrt(e^2 + d^2)) / 2

F is the derivative of the map from the straight triangle or quad, or from an equilateral one or a square where vertices
move.  The number e
falls to zero as the triangles unfold (Garanzha, Kaporin, Kudryavtseva, Protais, Ray & Sokolov, Foldover-free maps in 50
lines of code, ACM Transactions on Graphics 40, 2021).  What counts in the end is the exact sign.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from .elements import Elements
from .middles import Middles


@dataclass(frozen=True)
class Unfolding:
    """How mid-side nodes are moved to mend triangles.

    straightenings  how often the nodes of inverted triangles are put into the middles of their edges
    rings           rings of triangles round the inverted ones whose sides take part: at first, and at each further try
    order           samples of the Jacobian lie on a lattice with so many steps to a side
    stages          how often e is set anew
    iterations      iterations of the minimiser in each stage
    gain            stages end when the least Jacobian grows by less than this part of the mean one
    aim             an element is worked on where its scaled Jacobian is below this times that of the straight element,
                    unless it was so when it was given.  Work on its patch ends when no element is below that, or after
                    all stages
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
    elements: Elements,
    side: np.ndarray,
    middles: Middles,
    free: np.ndarray,
    fixed: np.ndarray,
    bad: np.ndarray,
    may: np.ndarray,
    options: Unfolding,
) -> np.ndarray:
    """(V, 2) the points with elements mended as far as that goes; none that was upright is inverted by it.

    A patch is taken over if fewer of its elements are not upright, or as few and the least scaled Jacobian has grown.

    points    (V, 2)
    elements  all N curved triangles and quads
    side      (N, 4) the rows in `middles` of their sides
    free      (E,) bool, nodes that may move
    fixed     (V,) bool, corners that must not
    bad       (N,) bool, elements to mend: not upright, or with a scaled Jacobian below the aim
    may       (N,) bool, elements that are to be mended where they are such
    """
    corners = elements.corners
    for corners_too in (False, True):
        for rings in options.rings if bad.any() else ():
            for patch in _patches(corners, bad, rings + 1):
                sides = np.unique(side[_within(corners, bad & _mask(patch, len(bad)), rings)])
                some = elements.some(patch)
                moving = middles.nodes[sides[free[sides]]]
                if corners_too:
                    moving = np.concatenate([moving, _enclosed(corners, patch, fixed)])
                trial = _relaxed(points, some, moving, corners_too, options)
                if _is_better(points, trial, some):
                    points = trial
                    bad = bad.copy()
                    bad[patch] = needs_mending(trial, some, options.aim) & may[patch]
            if not bad.any():
                return points
    return points


def needs_mending(points: np.ndarray, elements: Elements, aim: float) -> np.ndarray:
    """(N,) bool: the element is not upright, or its scaled Jacobian is below `aim` times that of the straight one."""
    return ~elements.upright(points) | (elements.scaled(points) < aim * elements.scaled_straight(points))


def _is_better(points: np.ndarray, trial: np.ndarray, elements: Elements) -> bool:
    was, now = elements.upright(points), elements.upright(trial)
    if bool((was & ~now).any()) or not np.isfinite(trial[elements.nodes]).all():
        return False
    if int(now.sum()) != int(was.sum()):
        return int(now.sum()) > int(was.sum())
    return float(elements.scaled(trial).min()) > float(elements.scaled(points).min())


def _patches(corners: np.ndarray, bad: np.ndarray, rings: int) -> list[np.ndarray]:
    """The rows of elements within so many rings of the inverted ones, in ascending order, patch by connected patch.

    corners  (N, 4) of all elements
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    inside = np.flatnonzero(_within(corners, bad, rings))
    rows_of, place = np.unique(corners[inside], return_inverse=True)
    rows = np.repeat(np.arange(len(inside)), corners.shape[1])
    entries = np.ones(len(rows), np.int64), (rows, place.reshape(-1))
    has = coo_matrix(entries, (len(inside), len(rows_of))).tocsr()
    _, label = connected_components(has @ has.T, directed=False)
    order = label.argsort(kind="stable")
    return np.split(inside[order], np.flatnonzero(np.diff(label[order])) + 1)


def _within(corners: np.ndarray, rows: np.ndarray, rings: int) -> np.ndarray:
    """(N,) bool: the elements `rows` (N,) bool and those within so many rings of elements that share a corner."""
    near = rows
    for _ in range(rings):
        touched = np.zeros(int(corners.max()) + 1, bool)
        touched[corners[near]] = True
        near = touched[corners].any(1)
    return near


def _enclosed(corners: np.ndarray, patch: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """The corners that may move with a patch: the whole fan of such a one is in the patch."""
    fans = np.bincount(corners.reshape(-1), minlength=len(fixed))
    own = np.bincount(corners[patch].reshape(-1), minlength=len(fixed))
    return np.flatnonzero((own > 0) & (own == fans) & ~fixed)


def _mask(rows: np.ndarray, count: int) -> np.ndarray:
    """(count,) bool: the rows that are listed."""
    mask = np.zeros(count, bool)
    mask[rows] = True
    return mask


def _relaxed(
    points: np.ndarray, elements: Elements, moving: np.ndarray, corners_too: bool, options: Unfolding
) -> np.ndarray:
    """The points with the rows `moving` where the distortion of the elements is least."""
    from scipy.optimize import minimize

    if not len(moving):
        return points
    here = np.union1d(elements.nodes, moving)
    local = torch.from_numpy(points[here])
    unit = float((local.amax(0) - local.amin(0)).max())
    start = (local - local.mean(0)) / unit
    slot = torch.from_numpy(np.searchsorted(here, moving))
    energy = _Energy(start, elements, here, corners_too, options.order)
    at = start.clone()

    def value(x: np.ndarray) -> tuple[float, np.ndarray]:
        moved = torch.from_numpy(x.reshape(-1, 2)).requires_grad_()
        total = energy(at.index_copy(0, slot, moved), e)
        (slope,) = torch.autograd.grad(total, moved)
        return float(total.detach()), slope.numpy().reshape(-1)

    def in_file(at: torch.Tensor) -> np.ndarray:
        trial = points.copy()
        trial[moving] = (at[slot] * unit + local.mean(0)).numpy()
        return elements.settled(trial)

    x = start[slot].numpy().reshape(-1)
    last = -math.inf
    for _ in range(options.stages):
        at[slot] = torch.from_numpy(x.reshape(-1, 2))
        least = energy.least(at)
        if least < last + options.gain and last < 0:
            break
        last = least
        # As in the paper: e is of the size of the worst Jacobian while there is a negative one.
        e = math.sqrt(1e-12 + 0.04 * min(least, 0.0) ** 2)
        x = minimize(value, x, jac=True, method="L-BFGS-B", options={"maxiter": options.iterations}).x
        at[slot] = torch.from_numpy(x.reshape(-1, 2))
        if not needs_mending(in_file(at), elements, options.aim).any():
            break
    return in_file(at)


class _Energy:
    """The distortion of curved elements at sample points; the middles of quads follow from their other nodes."""

    def __init__(self, start: torch.Tensor, elements: Elements, here: np.ndarray, regular: bool, order: int) -> None:
        """The ideals are the straight elements at the start, or regular ones.

        start  (L, 2) the positions of the rows `here` (L,) of nodes
        """
        self._kinds = []
        for nodes, gradients, straight, shape in (
            (elements.six, *_of_triangles(order)), (elements.nine[:, :8], *_of_quads(order))
        ):  # fmt: skip
            if len(nodes):
                rows = torch.from_numpy(np.searchsorted(here, nodes))
                inverse = _inverse_ideals(start[rows[:, : straight.shape[2]]], straight, shape, regular)
                self._kinds.append((rows, gradients, inverse))

    def _samples(self, at: torch.Tensor) -> list[torch.Tensor]:
        """(N, S, 2, 2) for each kind the derivatives of the map from the ideal elements to those with nodes at `at`."""
        return [torch.einsum("dsk,nkc->nscd", g, at[rows]) @ inverse for rows, g, inverse in self._kinds]

    def least(self, at: torch.Tensor) -> float:
        """The least determinant of the samples."""
        return min(float(torch.linalg.det(f).min()) for f in self._samples(at))

    def __call__(self, at: torch.Tensor, e: float) -> torch.Tensor:
        total = at.new_zeros(())
        for f in self._samples(at):
            determinant = f[..., 0, 0] * f[..., 1, 1] - f[..., 0, 1] * f[..., 1, 0]
            chi = (determinant + (determinant**2 + e * e).sqrt()) / 2
            total = total + ((f**2).sum((2, 3)) / chi + 0.1 * (determinant**2 + 1) / chi).sum()
        return total


_Kind = tuple[torch.Tensor, torch.Tensor, torch.Tensor]


def _of_triangles(order: int) -> _Kind:
    """The derivatives (2, S, 6) by the nodes at S samples, those (2, S, 3) of the straight triangle, a regular one."""
    i, j = np.meshgrid(np.arange(order + 1), np.arange(order + 1))
    keep = i + j <= order
    x, y = i[keep] / order, j[keep] / order
    z, none = 1 - x - y, np.zeros_like(x)
    along = np.stack([1 - 4 * z, 4 * x - 1, none, 4 * (z - x), 4 * y, -4 * y], 1)
    across = np.stack([1 - 4 * z, none, 4 * y - 1, -4 * x, 4 * x, 4 * (z - y)], 1)
    straight = np.stack([np.tile([-1.0, 1, 0], (len(x), 1)), np.tile([-1.0, 0, 1], (len(x), 1))])
    shape = torch.tensor([[1.0, 0.5], [0.0, math.sqrt(0.75)]], dtype=torch.float64) / 0.75**0.25
    return torch.from_numpy(np.stack([along, across])), torch.from_numpy(straight), shape


def _of_quads(order: int) -> _Kind:
    """Likewise (2, S, 8) of the serendipity quad, (2, S, 4) of the straight one, and a square."""
    u, v = (g.reshape(-1) / order for g in np.meshgrid(np.arange(order + 1), np.arange(order + 1)))

    def straight_by(u: np.ndarray, v: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray]]:
        return [v - 1, 1 - v, v, -v], [u - 1, -u, u, 1 - u]

    # A mid-side node has the function 4 t (1 - t) along its side times the distance from the opposite one; of each,
    # half is taken from the functions of the two corners beside it.
    bubble, slope_u, slope_v = (4 * u * (1 - u), 4 * v * (1 - v)), 4 - 8 * u, 4 - 8 * v
    middle_u = [slope_u * (1 - v), bubble[1], slope_u * v, -bubble[1]]
    middle_v = [-bubble[0], slope_v * u, bubble[0], slope_v * (1 - u)]
    linear = straight_by(u, v)
    tables = []
    for corners, middles in zip(linear, (middle_u, middle_v), strict=True):
        own = [corners[k] - (middles[k] + middles[k - 1]) / 2 for k in range(4)]
        tables.append(np.stack([*own, *middles], 1))
    straight = np.stack([np.stack(one, 1) for one in linear])
    return torch.from_numpy(np.stack(tables)), torch.from_numpy(straight), torch.eye(2, dtype=torch.float64)


def _inverse_ideals(corners: torch.Tensor, straight: torch.Tensor, shape: torch.Tensor, regular: bool) -> torch.Tensor:
    """(N, S, 2, 2) the inverse derivatives of the ideal elements: the straight ones, or regular ones of their size."""
    ideal = torch.einsum("dsk,nkc->nscd", straight, corners)
    size = torch.linalg.det(ideal)
    own = size.amin(1)
    poor = regular | (own <= 1e-9 * size.abs().mean())
    mean = size.abs().mean().sqrt()
    return torch.linalg.inv(torch.where(torch.as_tensor(poor)[..., None, None, None], shape * mean, ideal))
