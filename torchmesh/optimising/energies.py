"""Energies of one triangle: functions phi(stretch, det) of the two invariants of its Jacobian (see `jacobian`).

Each energy states phi in plain differentiable torch (`value`), and its slopes by hand (`value_and_slopes`), which
the optimiser calls; a test holds the two together.
"""

from dataclasses import dataclass
from typing import ClassVar, Protocol

import torch
from torch import Tensor

from ..kernels.energies import Formula


class Energy(Protocol):
    """An energy of one triangle as a function of its invariants; parameters are (T,) or floats.

    stretches  whether phi depends on the stretch; if not, the kernel does not compute it, and gives det in its place
    """

    stretches: ClassVar[bool]

    def value(self, stretch: Tensor, det: Tensor) -> Tensor:
        """(T,) phi in differentiable torch operations; infinite where it has no value."""
        ...

    def value_and_slopes(self, stretch: Tensor, det: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(T,) phi, d phi / d stretch, d phi / d det, derived by hand."""
        ...


def formula_of(energy: Energy) -> Formula | None:
    """What the compiled loops call this energy; None: they do not know it.

    A class that inherits the method from another may compute something else, so it must state the method itself.
    """
    known = vars(type(energy)).get("formula")
    formula: Formula | None = None if known is None else known(energy)
    return formula


def whole_power(x: Tensor, power: int) -> Tensor:
    """x^power, power >= 1, by products: the bits of a general power depend on where in a vector a number is."""
    if power == 1:
        return x
    square = whole_power(x * x, power // 2)
    return square * x if power % 2 else square


@dataclass(frozen=True)
class InverseMeanRatio:
    """q^p with q = stretch / (2 det), the inverse mean ratio (Kim 2017, equations 2 and 4; Munson 2007).

    ceiling  if given, (q / ceiling)^8 is added, which is felt by triangles near and above it only

    Infinite for a triangle that is not upright, so that no step can invert one.
    """

    stretches: ClassVar[bool] = True
    power: int = 2
    ceiling: float | None = None

    def formula(self) -> Formula:
        return Formula(0, power=self.power, ceiling=self.ceiling or 0.0)

    def value(self, stretch: Tensor, det: Tensor) -> Tensor:
        upright = det > 0
        ratio = stretch / (2 * torch.where(upright, det, 1.0))
        phi = whole_power(ratio, self.power)
        if self.ceiling is not None:
            phi = phi + (ratio / self.ceiling).square().square().square()
        return torch.where(upright, phi, torch.inf)

    def value_and_slopes(self, stretch: Tensor, det: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        # A tiny positive number takes the place of a det that is not positive: phi is then so large that the line
        # search refuses the step.
        inverse = det.clamp_min(1e-160 if det.dtype == torch.float64 else 1e-30).reciprocal_()
        ratio = (stretch * inverse).mul_(0.5)
        lower = whole_power(ratio, self.power - 1) if self.power > 1 else torch.ones_like(ratio)
        phi = lower * ratio
        # Half of d phi / d q; the other half is that of d q / d stretch = inverse / 2.
        half = lower if self.power == 2 else (0.5 * self.power) * lower
        if self.ceiling is not None:
            excess = ratio * (1 / self.ceiling)
            eighth = excess.square().square_().square_()
            phi += eighth
            half = half + (4 * eighth).div_(ratio)
        slope = half * inverse
        return phi, slope, (ratio * slope).mul_(-2.0)


@dataclass(frozen=True)
class UntangleBeta:
    """q^2 with q = (|A - beta| - (A - beta)) / 2 and A the signed area (Kim 2017, equations 1 and 2).

    beta  in the unit of A, which is det / 2 under a target with m = 1
    """

    stretches: ClassVar[bool] = False
    beta: Tensor | float

    def formula(self) -> Formula:
        return Formula(1, parameter=self.beta)

    def value(self, stretch: Tensor, det: Tensor) -> Tensor:
        excess = 0.5 * det - self.beta
        return (0.5 * (excess.abs() - excess)).square()

    def value_and_slopes(self, stretch: Tensor, det: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        lack = (self.beta - 0.5 * det).clamp_min(0)
        return lack * lack, lack.new_zeros(()).expand_as(lack), -lack


@dataclass(frozen=True)
class Regularised:
    """(1 - theta) stretch / chi + theta (1 + det^2) / chi, chi = (det + sqrt(eps^2 + det^2)) / 2.

    Garanzha, Kaporin, Kudryavtseva, Protais, Ray & Sokolov, Foldover-free maps in 50 lines of code,
    ACM Transactions on Graphics 40, 2021.  Finite for inverted triangles; as eps falls to 0 it
    becomes an inverse mean ratio with a pull towards the target's area.
    """

    stretches: ClassVar[bool] = True
    eps: Tensor | float
    theta: float = 1 / 128

    def formula(self) -> Formula:
        return Formula(2, theta=self.theta, parameter=self.eps)

    def value(self, stretch: Tensor, det: Tensor) -> Tensor:
        return ((1 - self.theta) * stretch + self.theta * (1 + det * det)) / self.chi(det)

    def chi(self, det: Tensor) -> Tensor:
        """(T,) the regularised determinant, positive, without cancellation for det <= 0."""
        root = torch.sqrt(self.eps * self.eps + det * det)
        # (det + root) / 2 = eps^2 / (2 (root - det)).  Of these two forms the one is taken that does not subtract
        # nearly equal numbers: the first where det is positive, otherwise the second.
        large = 0.5 * (root + det.abs())
        return torch.where(det > 0, large, 0.25 * self.eps * self.eps / large)

    def value_and_slopes(self, stretch: Tensor, det: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        root = torch.sqrt(self.eps * self.eps + det * det)
        large = 0.5 * (root + det.abs())
        chi = torch.where(det > 0, large, 0.25 * self.eps * self.eps / large)
        inverse = 1.0 / chi
        phi = ((1 - self.theta) * stretch + self.theta * (1 + det * det)) * inverse
        # d chi / d det = chi / root.
        return phi, (1 - self.theta) * inverse, 2 * self.theta * det * inverse - phi / root

    def curvatures(self, stretch: Tensor, det: Tensor) -> Tensor:
        """(3, T) the second derivatives by stretch twice, by both, and by det twice."""
        root = torch.sqrt(self.eps * self.eps + det * det)
        phi, by_s, by_d = self.value_and_slopes(stretch, det)
        inverse, part = by_s / (1 - self.theta), det / root
        twice = 2 * self.theta * inverse * (1 - part) + (phi * part / root - by_d) / root
        return torch.stack([torch.zeros_like(phi), -by_s / root, twice])


@dataclass(frozen=True)
class TotalLiftedContent:
    """sqrt(det^2 + alpha stretch + alpha^2), the area of the triangle when it is lifted into more dimensions.

    Du, Aigerman, Zhou, Kovalsky, Yan, Kaufman & Ju, Lifting simplices to find injectivity, ACM Transactions on
    Graphics 39, 2020.  As alpha falls to 0 it becomes the absolute area, whose sum is lowest where no triangle is
    inverted.  It is no barrier: a triangle may pass through zero area, which it may have to.
    """

    stretches: ClassVar[bool] = True
    alpha: Tensor | float = 1e-2

    def value(self, stretch: Tensor, det: Tensor) -> Tensor:
        return torch.sqrt(det * det + self.alpha * stretch + self.alpha * self.alpha)

    def value_and_slopes(self, stretch: Tensor, det: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        phi = self.value(stretch, det)
        return phi, 0.5 * self.alpha / phi, det / phi

    def curvatures(self, stretch: Tensor, det: Tensor) -> Tensor:
        """(3, T) the second derivatives by stretch twice, by both, and by det twice."""
        phi, by_s, by_d = self.value_and_slopes(stretch, det)
        return torch.stack([-by_s * by_s, -by_s * by_d, 1 - by_d * by_d]) / phi


def slopes_and_curvatures(energy: Energy, stretch: Tensor, det: Tensor) -> tuple[Tensor, Tensor]:
    """The first and second derivatives of phi, by hand where the energy has them, and else by autograd of `value`.

    Returns (2, T) by stretch and by det, and (3, T) by stretch twice, by both, and by det twice.
    """
    if isinstance(energy, Regularised | TotalLiftedContent):
        return torch.stack(energy.value_and_slopes(stretch, det)[1:]), energy.curvatures(stretch, det)
    return derivatives_by_autograd(energy, stretch, det)


def derivatives_by_autograd(energy: Energy, stretch: Tensor, det: Tensor) -> tuple[Tensor, Tensor]:
    """`slopes_and_curvatures` by autograd of `value`."""
    # Tensors of inference mode have no graph; copies that are made outside it do.
    with torch.inference_mode(False), torch.enable_grad():
        s, d = stretch.detach().clone().requires_grad_(), det.detach().clone().requires_grad_()
        slopes = _derivatives(energy.value(s, d), s, d, again=True)
        (ss, sd), (_, dd) = (_derivatives(slope, s, d) for slope in slopes)
    return torch.stack(slopes).detach(), torch.stack([ss, sd, dd])


def _derivatives(of: Tensor, s: Tensor, d: Tensor, again: bool = False) -> tuple[Tensor, Tensor]:
    """The derivatives of `of` (T,) by s and by d, zero where it does not depend on them; may they be derived again?"""
    if not of.requires_grad:
        return torch.zeros_like(s), torch.zeros_like(d)
    by_s, by_d = torch.autograd.grad(
        of.sum(), (s, d), retain_graph=True, create_graph=again, allow_unused=True, materialize_grads=True
    )
    return by_s, by_d
