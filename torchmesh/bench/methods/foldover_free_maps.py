"""Foldover-free maps, in scipy."""

from __future__ import annotations

import itertools

import numpy as np

from ..exact_check import double_areas
from ..stopwatch import Stopwatch
from .outcome import Outcome

Array = np.ndarray


def foldover_free(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """Foldover-free maps (Garanzha, Kaporin, Kudryavtseva, Protais, Ray & Sokolov 2021), with scipy's L-BFGS.

    The authors' program is in no package registry.  This is their section 3 with its constants: theta is 1/128;
    epsilon starts at 1 and follows the ratio of energies; an inner minimisation ends when the gradient is below 1e-4
    or after 10,000 steps; the mesh lies in a box of side 10.  Nothing is known of an undeformed mesh, so all targets
    are equilateral and have one area, the domain's over the number of triangles.
    """
    from scipy.optimize import minimize

    free = np.flatnonzero(~fixed)
    low, high = points.min(0), points.max(0)
    unit = 10.0 / (high - low).max()
    where = (points - low) * unit
    side = np.sqrt(0.5 * double_areas(where, triangles).sum() / len(triangles) * 4 / np.sqrt(3))
    # Rows of (b - a, c - a) times the inverse of the target, as coefficients of the three corners.
    inverse = np.linalg.inv(side * np.array([[1.0, 0.5], [0.0, np.sqrt(3) / 2]]))
    corner = np.concatenate([-inverse.sum(0, keepdims=True), inverse])
    weight, theta = np.sqrt(3) / 4 * side**2, 1 / 128

    def energy(unknowns: Array, eps: float) -> tuple[float, Array, float]:
        where[free] = unknowns.reshape(-1, 2)
        j = np.einsum("tvd,vk->tdk", where[triangles], corner)
        det = j[:, 0, 0] * j[:, 1, 1] - j[:, 0, 1] * j[:, 1, 0]
        root = np.hypot(eps, det)
        chi = np.where(det > 0, 0.5 * (det + root), 0.5 * eps**2 / np.where(det > 0, 1.0, root - det))
        slope = 0.5 + 0.5 * det / root
        shape, area = (j**2).sum((1, 2)) / chi, (1 + det**2) / chi
        cofactor = np.stack([j[:, 1, 1], -j[:, 1, 0], -j[:, 0, 1], j[:, 0, 0]], 1).reshape(-1, 2, 2)
        by_det = (theta * (2 * det - area * slope) - (1 - theta) * shape * slope) / chi
        by_j = (1 - theta) * 2 * j / chi[:, None, None] + by_det[:, None, None] * cofactor
        force = np.einsum("tdk,vk->tvd", by_j, corner).reshape(-1, 2) * weight
        gradient = np.stack([np.bincount(triangles.ravel(), force[:, d], len(points)) for d in (0, 1)], 1)
        return float(((1 - theta) * shape + theta * area).sum() * weight), gradient[free].ravel(), float(det.min())

    unknowns, eps = where[free].ravel().copy(), 1.0
    with Stopwatch() as watch:
        for rounds in itertools.count(1):
            before = energy(unknowns, eps)[0]
            unknowns = minimize(  # type: ignore[call-overload]
                lambda u, eps=eps: energy(u, eps)[:2], unknowns, jac=True, method="L-BFGS-B",
                options={"maxiter": 10_000, "maxfun": 20_000, "gtol": 1e-4, "ftol": 1e-9},
            ).x  # fmt: skip
            after, _, lowest = energy(unknowns, eps)
            sigma = max(1 - after / before, 0.1)
            root = np.hypot(eps, lowest)
            chi = 0.5 * (lowest + root) if lowest > 0 else 0.5 * eps**2 / (root - lowest)
            mu = (1 - sigma) * chi
            still = eps
            eps = max(1e-9, 2 * float(np.sqrt(mu * (mu - lowest)))) if lowest < mu else 1e-9
            settled = abs(before - after) < 1e-5 * after if lowest > 0 else eps >= still
            if settled or rounds == 100:
                break
    moved = points.copy()
    moved[free] = unknowns.reshape(-1, 2) / unit + low
    return Outcome(moved, triangles, watch.seconds, f"{rounds} values of epsilon")
