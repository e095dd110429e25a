"""Areas pushed above a bound by the method of Levenberg and Marquardt: the fastest way where triangles shear much.

Untangle-beta is a sum of squares, so the Gauss-Newton matrix needs no second derivatives; and it knows only areas, so
that shapes do not hold a triangle back.  What it leaves undecided, the damping decides: it holds J of each triangle
where it is, so that a step bends the mesh smoothly (Levenberg, A method for the solution of certain non-linear problems
in least squares, Quarterly of Applied Mathematics 2, 1944; Marquardt, SIAM Journal 11, 1963).
"""

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .energies import UntangleBeta
from .projected_newton import Minimum, NewtonSystem


@dataclass(frozen=True)
class LevenbergOptions:
    """How `push_areas` works.

    max_iterations     linear systems at most
    damping            at the start, in units of the square of det by J
    less, more         factors of the damping after a step that did as the model says, and after one that failed
    good, poor         a step that lowers the energy by at least this part of what the model says did well, by less than
                       that part badly
    most, least        the damping never leaves these bounds; beyond `most` the work ends
    energy_tolerance   stop when a step under little damping lowers the energy by less than this part; at 1e-3 none of
                       the hard meshes was lost that areas pushed upright, and hopeless ones took half of the time that
                       they took at 1e-10
    """

    max_iterations: int = 60
    damping: float = 1e-3
    less: float = 0.25
    more: float = 4.0
    good: float = 0.75
    poor: float = 0.25
    most: float = 1e8
    least: float = 1e-12
    energy_tolerance: float = 1e-3

    def __post_init__(self) -> None:
        if self.max_iterations < 1:
            raise ValueError(f"LevenbergOptions.max_iterations must be at least 1, not {self.max_iterations}")
        if not 0 < self.less < 1 < self.more:
            raise ValueError(f"LevenbergOptions.less must be below 1 and more above, not {self.less} and {self.more}")
        if not 0 < self.poor < self.good < 1:
            raise ValueError(f"LevenbergOptions.poor must be below good, not {self.poor} and {self.good}")


def push_areas(system: NewtonSystem, points: Tensor, least: float, options: LevenbergOptions | None = None) -> Minimum:
    """Minimise the squares of what det J lacks to `least`, from `points` (V, 2), until no triangle is inverted."""
    options = options or LevenbergOptions()
    energy = UntangleBeta(least / 2)
    if not system.size:
        return system.at_rest(points, energy)
    if system.compiled is not None:
        return Minimum(*system.compiled.pushed(points, system.weight, least, vars(options)))
    zero = torch.zeros(4, len(system.triangles), dtype=torch.float64)
    _, holding = system.assembled(zero, torch.eye(4, dtype=torch.float64)[:, :, None].expand(4, 4, zero.shape[1]))
    value, det = system.energy(points, energy)
    start, damping, fresh = value, options.damping, True
    gradient = matrix = np.empty(0)
    steps = 0
    while steps < options.max_iterations and not bool((det > 0).all()):
        if fresh:
            gradient, matrix = _gauss_newton(system, points, least)
        steps += 1
        try:
            step = system.solved(matrix + damping * holding, -gradient)
        except RuntimeError:
            break
        there = system.moved(points, step, 1.0)
        now, signs = system.energy(there, energy)
        # The damped model promises half of what its slope says.
        part = (value - now) / max(-0.5 * float(gradient @ step), 1e-300)
        fresh = part > 1e-4
        if not fresh:
            damping *= options.more
            if damping > options.most:
                break
            continue
        gain, points, value, det = value - now, there, now, signs
        if part > options.good:
            damping = max(options.less * damping, options.least)
        elif part < options.poor:
            damping *= 2
        if gain < options.energy_tolerance * value and damping < 1:
            break
    return Minimum(points, det, start, value, steps)


def _gauss_newton(system: NewtonSystem, points: Tensor, least: float) -> tuple[np.ndarray, np.ndarray]:
    """The gradient (N,) of the sum of (least - det)^2 / 4 over triangles that lack area, and its matrix."""
    a, b = system.jacobian_parts(points)
    det = a.square().sum(0) - b.square().sum(0)
    lack = 0.5 * (least - det).clamp_min(0)
    by_parts = torch.cat([2 * a, -2 * b])
    curved = torch.where(lack > 0, 0.5, 0.0) * by_parts[:, None] * by_parts[None]
    return system.assembled(-lack * by_parts * system.weight, curved * system.weight)
