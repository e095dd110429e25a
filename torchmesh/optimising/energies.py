"""What is minimised: energies of one triangle, and their gradient over a mesh.

Every energy here is a function phi(stretch, det) of two invariants of J = E W^-1, where
E = [b - a, c - a] and W is the target triangle's E (Knupp 2001; Kim 2017 writes A for E):

    stretch = ||J||_F^2 = g11 |e1|^2 + 2 g12 e1.e2 + g22 |e2|^2       det = det J = m det E

so one kernel gathers corners, asks the energy for phi and its two slopes, and scatters forces.
Each energy states phi in plain differentiable torch (`value`), and its slopes by hand
(`value_and_slopes`); a test holds the two together.
"""

import dataclasses
import itertools
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol, TypeVar

import torch
from torch import Tensor

from ..mesh.triangle import SQRT3, Corners


class Target(NamedTuple):
    """The target triangle as J's coefficients, one float for all triangles or (T,) one each.

    g11, g12, g22 are the entries of W^-1 W^-T, m = det W^-1.
    """

    g11: Tensor | float
    g12: Tensor | float
    g22: Tensor | float
    m: Tensor | float


def equilateral(side: Tensor | float = 1.0) -> Target:
    """The equilateral target W = side [[1, 1/2], [0, sqrt(3)/2]] (Kim 2017, equation 3)."""
    inverse_square = 1.0 / (side * side)
    return Target(4 / 3 * inverse_square, -2 / 3 * inverse_square, 4 / 3 * inverse_square, 2 / SQRT3 * inverse_square)


def target_of(t: Corners) -> Target:
    """Each triangle of `t`, which must be upright, as the target of itself."""
    e1x, e1y, e2x, e2y = t.bx - t.ax, t.by - t.ay, t.cx - t.ax, t.cy - t.ay
    det = e1x * e2y - e1y * e2x
    square = det * det
    return Target(
        (e2x * e2x + e2y * e2y) / square,
        -(e1x * e2x + e1y * e2y) / square,
        (e1x * e1x + e1y * e1y) / square,
        1.0 / det,
    )


_R = TypeVar("_R")


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

    def value(self, stretch: Tensor, det: Tensor) -> Tensor:
        upright = det > 0
        ratio = stretch / (2 * torch.where(upright, det, 1.0))
        phi = whole_power(ratio, self.power)
        if self.ceiling is not None:
            phi = phi + (ratio / self.ceiling).square().square().square()
        return torch.where(upright, phi, torch.inf)

    def value_and_slopes(self, stretch: Tensor, det: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        # A det that is not positive becomes tiny: its phi overflows the line search's test.
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

    def value(self, stretch: Tensor, det: Tensor) -> Tensor:
        return ((1 - self.theta) * stretch + self.theta * (1 + det * det)) / self.chi(det)

    def chi(self, det: Tensor) -> Tensor:
        """(T,) the regularised determinant, positive, without cancellation for det <= 0."""
        root = torch.sqrt(self.eps * self.eps + det * det)
        # (det + root) / 2 = eps^2 / (2 (root - det)); |det| takes the well-conditioned one's place.
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


@dataclass(frozen=True)
class TotalLiftedContent:
    """sqrt(det^2 + alpha stretch + alpha^2) (Du, Aigerman, Zhou, Kovalsky, Yan, Kaufman & Ju,
    Lifting simplices to find injectivity, ACM Transactions on Graphics 39, 2020)."""

    stretches: ClassVar[bool] = True
    alpha: Tensor | float = 1e-2

    def value(self, stretch: Tensor, det: Tensor) -> Tensor:
        return torch.sqrt(det * det + self.alpha * stretch + self.alpha * self.alpha)

    def value_and_slopes(self, stretch: Tensor, det: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        phi = self.value(stretch, det)
        return phi, 0.5 * self.alpha / phi, det / phi


def invariants(t: Corners, target: Target) -> tuple[Tensor, Tensor]:
    """(T,) stretch and det of J for each triangle, in differentiable torch operations."""
    e1x, e1y, e2x, e2y = t.bx - t.ax, t.by - t.ay, t.cx - t.ax, t.cy - t.ay
    stretch = (
        target.g11 * (e1x * e1x + e1y * e1y)
        + 2 * target.g12 * (e1x * e2x + e1y * e2y)
        + target.g22 * (e2x * e2x + e2y * e2y)
    )
    return stretch, target.m * (e1x * e2y - e1y * e2x)


class Piece(NamedTuple):
    """T triangles that are worked on at a time, with what belongs to them.

    rows    (6 T,) int64, where all ax, then all ay, bx, by, cx and cy stand in the vector of coordinates
    edges   (2, 2, T) x and y of e1 and of e2 where all coordinates are zero; None: zero
    energy, target  theirs
    """

    rows: Tensor
    edges: Tensor | None
    energy: Energy
    target: Target

    def edges_at(self, coordinates: Tensor) -> Tensor:
        """(2, 2, T) x and y of e1 and of e2."""
        corner = coordinates.index_select(0, self.rows).view(3, 2, -1)
        edges = corner[1:] - corner[0]
        return edges if self.edges is None else edges.add_(self.edges)


def pieces_of(
    rows: Tensor, energy: Energy, target: Target, borders: list[int] | None = None, edges: Tensor | None = None
) -> list[Piece]:
    """Triangles cut into pieces for `energy_and_forces`.

    rows     (6, T) where the corner coordinates ax, ay, bx, by, cx, cy stand in the vector of coordinates
    borders  where pieces begin and end, from `chunk_borders`; None: those of one mesh
    edges    (4, T) the x and y of e1 and of e2 where all coordinates are zero, which then are
             displacements; None: zero
    """
    pieces = []
    for start, end in itertools.pairwise(chunk_borders([0, rows.shape[1]]) if borders is None else borders):
        here = slice(start, end)
        before = None if edges is None else edges[:, here].reshape(2, 2, -1)
        own = rows[:, here].reshape(-1).to(torch.int64)
        pieces.append(Piece(own, before, select_rows(energy, here), select_rows(target, here)))
    return pieces


def energy_and_forces(coordinates: Tensor, pieces: list[Piece]) -> tuple[Tensor, Tensor, Tensor]:
    """Energy of every triangle and the gradient of their sum, by hand-derived slopes.

    coordinates  (N,) all coordinates in one vector, in any order

    Returns phi (T,), the gradient (N,) and the smallest-det input det (T,).
    """
    gradient = torch.zeros_like(coordinates)
    parts = [_add_forces(piece, coordinates, gradient) for piece in pieces]
    if not parts:
        return coordinates[:0], gradient, coordinates[:0]
    phi, det = parts[0] if len(parts) == 1 else (torch.cat(part) for part in zip(*parts, strict=True))
    return phi, gradient, det


# Triangles at a time: what one chunk computes stays in the cache.
_CHUNK = 32768


def chunk_borders(offsets: list[int]) -> list[int]:
    """Where to cut the triangles of the meshes that `offsets` (B+1,) tells apart.

    Forces on a vertex are summed chunk by chunk, so a mesh is cut, if at all, at the same of its
    own triangles whatever else is in the batch: its sums keep their bits.
    """
    borders = [0]
    for start, end in itertools.pairwise(offsets):
        if end - borders[-1] > _CHUNK and start > borders[-1]:
            borders.append(start)
        while end - borders[-1] > _CHUNK:
            borders.append(borders[-1] + _CHUNK)
    return [*borders, offsets[-1]] if offsets[-1] > borders[-1] else borders


def _add_forces(piece: Piece, coordinates: Tensor, gradient: Tensor) -> tuple[Tensor, Tensor]:
    """phi and det of the triangles of a piece; their forces are added to `gradient`."""
    e, target = piece.edges_at(coordinates), piece.target
    e1x, e1y, e2x, e2y = e.view(4, -1).unbind(0)
    det = (e1x * e2y).addcmul_(e1y, e2x, value=-1).mul_(target.m)
    # On a, and on b and c.
    every = e.new_empty((3, *e.shape[1:]))
    forces = every[1:]
    f1x, f1y, f2x, f2y = forces.view(4, -1).unbind(0)
    if piece.energy.stretches:
        # Half the derivative of the stretch by e1 and by e2.
        _combine(target.g11, e[0], target.g12, e[1], out=forces[0])
        _combine(target.g22, e[1], target.g12, e[0], out=forces[1])
        stretch = (f1x * e1x).addcmul_(f1y, e1y).addcmul_(f2x, e2x).addcmul_(f2y, e2y)
        phi, by_stretch, by_det = piece.energy.value_and_slopes(stretch, det)
        by_det = by_det * target.m
        forces.mul_(2 * by_stretch)
        f1x.addcmul_(by_det, e2y)
        f1y.addcmul_(by_det, e2x, value=-1)
        f2x.addcmul_(by_det, e1y, value=-1)
        f2y.addcmul_(by_det, e1x)
    else:
        phi, _, by_det = piece.energy.value_and_slopes(det, det)
        by_det = by_det * target.m
        torch.mul(e2y, by_det, out=f1x)
        torch.mul(e1x, by_det, out=f2y)
        by_det.neg_()
        torch.mul(e2x, by_det, out=f1y)
        torch.mul(e1y, by_det, out=f2x)
    torch.add(forces[0], forces[1], out=every[0])
    every[0].neg_()
    gradient.scatter_add_(0, piece.rows, every.view(-1))
    return phi, det


def _combine(p: Tensor | float, u: Tensor, q: Tensor | float, v: Tensor, out: Tensor) -> None:
    """p u + q v."""
    torch.mul(u, p, out=out)
    if isinstance(q, float):
        out.add_(v, alpha=q)
    else:
        out.addcmul_(v, q)


def select_rows(record: _R, keep: Tensor | slice) -> _R:
    """An energy or target for some of the triangles: its (T,) parameters at `keep`, floats as they are."""
    if isinstance(record, tuple):
        return type(record)(*(v[keep] if isinstance(v, Tensor) else v for v in record))
    changes = {name: value[keep] for name, value in vars(record).items() if isinstance(value, Tensor)}
    return dataclasses.replace(record, **changes) if changes else record  # type: ignore[type-var]
