r"""Newton's method with the Hessian of each triangle made positive, for energies that many steps of L-BFGS leave stuck.

The map J of a triangle is a conformal part a and an anticonformal part b, each a vector of two numbers:

    stretch = |J|^2 = 2 (p + q)     det J = p - q        with p = |a|^2, q = |b|^2

So phi(stretch, det) is a function F(p, q), and its Hessian over (a, b) has the eigenvalues 2 F_p (across a), 2 F_q
(across b) and the two of a 2x2 block along a and b.  Those that are not positive are raised to a small positive number
(Teran, Sifakis, Irving & Fedkiw, Robust quasistatic finite elements and flesh simulation, SCA 2005; Smith, de Goes &
Kim, Analytic eigensystems for isotropic distortion energies, ACM Transactions on Graphics 38, 2019).  The direction is
then one of descent, and Armijo's rule halves the step.

Each mesh is minimised alone, by a sparse factorisation of its own.  Compiled loops do the same for the energies that
`untangle` minimises so (torchmesh/kernels/projected.py).
"""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ..mesh.triangle import Corners
from .energies import Energy, Regularised, TotalLiftedContent, slopes_and_curvatures
from .jacobian import Target, invariants

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

    from ..kernels.projected import CompiledSystem


@dataclass(frozen=True)
class ProjectedOptions:
    """When `minimise_by_projection` stops, and how it makes Hessians positive.

    max_iterations    steps at most
    slope_tolerance   stop when a whole step promises to lower the energy by less than this part of it
    energy_tolerance  stop when a step lowers the energy by less than this part of it
    decrease          part of the decrease that the slope promises which a step must reach (Armijo)
    shortest          stop when a step would be shorter than this part of the whole one
    floor             eigenvalues of a triangle are raised to this part of its greatest one
    common_floor      and to this part of the greatest one of the mesh: for energies that most triangles do not feel
    """

    max_iterations: int = 10
    slope_tolerance: float = 1e-4
    energy_tolerance: float = 1e-5
    decrease: float = 1e-4
    shortest: float = 1e-8
    floor: float = 1e-9
    common_floor: float = 0.0

    def __post_init__(self) -> None:
        if self.max_iterations < 1:
            raise ValueError(f"ProjectedOptions.max_iterations must be at least 1, not {self.max_iterations}")
        for name in ("slope_tolerance", "energy_tolerance", "decrease", "shortest", "floor", "common_floor"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"ProjectedOptions.{name} must be at least 0 and below 1, not {getattr(self, name)}")


@dataclass(frozen=True)
class Minimum:
    """What a second-order minimisation came to.

    points       (V, 2) float64
    det          (T,) det J of each triangle there
    start, energy  the sums of the energy at the start and there
    iterations   the steps that were taken
    """

    points: Tensor
    det: Tensor
    start: float
    energy: float
    iterations: int


class NewtonSystem:
    """The free vertices of one mesh, and the places of their Hessian in a sparse matrix.

    points     (V, 2) float64, in whatever unit
    triangles  (T, 3) int64
    free       (V,) bool
    target     of the triangles, in the same unit
    weight     (T,) of the energies in their sum; None: all alike
    """

    def __init__(
        self, points: Tensor, triangles: Tensor, free: Tensor, target: Target, weight: Tensor | None = None
    ) -> None:
        touched = free[triangles].any(1)
        self.points, self.triangles = points, triangles[touched].contiguous()
        # A vertex of no triangle stays: nothing holds it, so that no damping would make its system regular.
        self.free = free & torch.zeros_like(free).index_fill_(0, self.triangles.ravel(), True)
        count = len(self.triangles)
        self.target = Target(*(torch.as_tensor(v, dtype=torch.float64).expand(len(triangles))[touched] for v in target))
        self.weight = torch.ones(count, dtype=torch.float64) if weight is None else weight[touched]
        self.columns = _columns_of_corners(self.target)
        self.moving = self.free.nonzero().squeeze(1)
        self.size = 2 * len(self.moving)

    @cached_property
    def by_triangle(self) -> Tensor:
        """(T, 4, 6) the linear map from the corners of a triangle to the parts of its J."""
        return _parts_of_corners(self.columns)

    @cached_property
    def number(self) -> np.ndarray:
        """(N,) the numbers of the unknowns in an order of few fill-ins; those of a vertex follow each other."""
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        n = len(self.moving)
        if not n:
            return np.zeros(0, np.int64)
        row = torch.full((len(self.points),), -1, dtype=torch.int64)
        row[self.moving] = torch.arange(n)
        rows = row[self.triangles].numpy()
        i, j = np.repeat(rows, 3, 1).ravel(), np.tile(rows, (1, 3)).ravel()
        used = (i >= 0) & (j >= 0)
        whole = np.arange(n)
        i, j = np.append(i[used], whole), np.append(j[used], whole)
        pattern = csc_matrix((np.ones(len(i)), (i, j)), shape=(n, n))
        like = csc_matrix((np.full(pattern.nnz, -1.0), pattern.indices, pattern.indptr), shape=(n, n))
        like.setdiag(float(np.diff(pattern.indptr).max()) + 1)
        factors = splu(like, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        number: np.ndarray = (2 * factors.perm_c.astype(np.int64)[:, None] + np.arange(2)).ravel()
        return number

    @cached_property
    def places(self) -> "Places":
        """Where products of the corners' coordinates go in the matrix."""
        return Places.of(self)

    @cached_property
    def compiled(self) -> "CompiledSystem | None":
        """The same for the compiled loops; None where they are not in use."""
        from ..kernels.library import library
        from ..kernels.projected import CompiledSystem

        if library() is None:
            return None
        row = torch.full((len(self.points),), -1, dtype=torch.int32)
        row[self.moving] = torch.from_numpy(self.number[::2] // 2).to(torch.int32)
        return CompiledSystem(self.triangles, row, len(self.moving), self.columns)

    def invariants(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """(T,) stretch and det of J."""
        corner = points[self.triangles]
        return invariants(Corners(*corner.reshape(-1, 6).T), self.target)

    def energy(self, points: Tensor, energy: Energy) -> tuple[float, Tensor]:
        """The sum of the energy, and det J (T,)."""
        stretch, det = self.invariants(points)
        return float((self.weight * energy.value(stretch, det)).sum()), det

    def at_rest(self, points: Tensor, energy: Energy) -> Minimum:
        """The minimum of a mesh in which no vertex moves."""
        value, det = self.energy(points, energy)
        return Minimum(points, det, value, value, 0)

    def direction(self, points: Tensor, energy: Energy, options: ProjectedOptions) -> tuple[np.ndarray, float]:
        """The Newton step (N,) in the coordinates of the free vertices, and the slope along it.

        Raises RuntimeError where the matrix is singular.
        """
        gradient, hessian = self.derivatives(points, energy, options)
        step = self.solved(hessian, -gradient)
        return step, float(gradient @ step)

    def derivatives(self, points: Tensor, energy: Energy, options: ProjectedOptions) -> tuple[np.ndarray, np.ndarray]:
        """The gradient (N,), and the entries of the positive Hessian in the order of `indices` and `indptr`."""
        a, b = self.jacobian_parts(points)
        slopes, curvatures = slopes_and_curvatures(energy, *self.invariants(points))
        slope, block = _of_parts(a, b, slopes, curvatures, options)
        gradient, hessian = self.assembled(slope * self.weight, block * self.weight)
        # Where nothing holds a vertex, it stays.
        held = hessian[self.places.diagonal]
        hessian[self.places.diagonal] += np.where(
            held > 0, 1e-14 * held, 1e-14 * max(float(held.max(initial=0.0)), 1e-300)
        )
        return gradient, hessian

    def jacobian_parts(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """The conformal and the anticonformal part of J, (2, T) each."""
        a, b = (self.by_triangle @ points[self.triangles].reshape(-1, 6, 1)).squeeze(2).T.split(2)
        return a, b

    def assembled(self, slope: Tensor, block: Tensor) -> tuple[np.ndarray, np.ndarray]:
        """The gradient (N,) and the matrix entries that derivatives (4, T) and (4, 4, T) by the parts of J come to."""
        parts, places = self.by_triangle, self.places
        forces = (slope.T[:, None] @ parts).squeeze(1)
        products = parts.transpose(1, 2) @ block.permute(2, 0, 1) @ parts
        gradient = np.bincount(places.dump.ravel(), forces.numpy().ravel(), self.size + 1)[: self.size]
        return gradient, np.bincount(places.cell, products.numpy().ravel()[places.used], len(places.indices))

    def solved(self, matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
        """(N,) the solution of the system with these entries; RuntimeError where the matrix is singular."""
        from scipy.sparse.linalg import splu

        self.places.matrix.data = matrix
        factors = splu(
            self.places.matrix,
            permc_spec="NATURAL",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        ordered = np.empty_like(right)
        ordered[self.number] = right
        solution: np.ndarray = factors.solve(ordered)[self.number]
        return solution

    def moved(self, points: Tensor, step: np.ndarray, length: float) -> Tensor:
        """(V, 2) the points after `length` times the step."""
        there = points.clone()
        there.index_add_(0, self.moving, torch.from_numpy(step).view(-1, 2), alpha=length)
        return there


@dataclass(frozen=True)
class Places:
    """Where the 36 products of the six coordinates of each triangle go in a sparse matrix.

    dump      (T, 6) the unknowns of the coordinates; those that are none are the last row, which is dropped
    used      (36 T,) bool, the products of two unknowns
    cell      of these, the entry of the matrix
    indices, indptr  of the matrix, whose unknowns are in the order of `NewtonSystem.number`
    diagonal  (N,) its entries on the diagonal
    matrix    with entries that change
    """

    dump: np.ndarray
    used: np.ndarray
    cell: np.ndarray
    indices: np.ndarray
    indptr: np.ndarray
    diagonal: np.ndarray
    matrix: "csc_matrix"

    @classmethod
    def of(cls, system: NewtonSystem) -> "Places":
        from scipy.sparse import csc_matrix

        n, number = system.size, system.number
        row = torch.full((len(system.points), 2), -1, dtype=torch.int64)
        row[system.free] = torch.arange(n).view(-1, 2)
        rows = row[system.triangles].reshape(-1, 6).numpy()
        i, j = np.repeat(rows, 6, 1).ravel(), np.tile(rows, (1, 6)).ravel()
        used = (i >= 0) & (j >= 0)
        # The diagonal belongs to the matrix even where no triangle touches it.
        whole = np.arange(n)
        i, j = number[np.append(i[used], whole)], number[np.append(j[used], whole)]
        cell, at = np.unique(j * n + i, return_inverse=True)
        indices = (cell % n).astype(np.int32)
        indptr = np.searchsorted(cell, np.arange(n + 1) * n).astype(np.int32)
        return cls(
            dump=np.where(rows < 0, n, rows),
            used=used,
            cell=at[: len(at) - n],
            indices=indices,
            indptr=indptr,
            diagonal=np.searchsorted(cell, np.arange(n) * (n + 1)),
            matrix=csc_matrix((np.zeros(len(cell)), indices, indptr), shape=(n, n)),
        )


def minimise_by_projection(
    system: NewtonSystem,
    points: Tensor,
    energy: Energy,
    options: ProjectedOptions | None = None,
    enough: bool = False,
) -> Minimum:
    """Take Newton steps from `points` (V, 2) until the energy settles.

    enough  stop as soon as the determinants of all triangles are positive
    """
    options = options or ProjectedOptions()
    if not system.size:
        return system.at_rest(points, energy)
    if isinstance(energy, Regularised | TotalLiftedContent) and system.compiled is not None:
        return Minimum(*system.compiled.minimised(points, system.weight, *_formula(energy), vars(options), enough))
    value, det = system.energy(points, energy)
    start, steps = value, 0
    while steps < options.max_iterations and not (enough and bool((det > 0).all())):
        try:
            step, slope = system.direction(points, energy, options)
        except RuntimeError:
            break
        if not -slope > options.slope_tolerance * abs(value):
            break
        length, found = 1.0, None
        while length > options.shortest:
            there = system.moved(points, step, length)
            now, signs = system.energy(there, energy)
            if now <= value + options.decrease * length * slope:
                found = there, now, signs
                break
            length *= 0.5
        if found is None:
            break
        before = value
        points, value, det = found
        steps += 1
        if not before - value > options.energy_tolerance * abs(before):
            break
    return Minimum(points, det, start, value, steps)


def _formula(energy: Regularised | TotalLiftedContent) -> tuple[int, float, float]:
    """The energy as the compiled loops know it: its kind, its epsilon or alpha, and theta."""
    if isinstance(energy, Regularised):
        return 0, float(energy.eps), energy.theta
    return 1, float(energy.alpha), 0.0


def _columns_of_corners(target: Target) -> Tensor:
    """(T, 3, 2) the weights of the corners in the two columns of J.

    J is E times the lower triangular root of the matrix of g11, g12, g22.  It differs from E W^-1 by a turn from the
    right, which changes neither stretch nor det.
    """
    g11, g12, g22 = (torch.as_tensor(v) for v in target[:3])
    first = g11.sqrt()
    second = g12 / first
    third = (g22 - second * second).sqrt()
    zero = torch.zeros_like(first)
    return torch.stack([-first - second, -third, first, zero, second, third], 1).view(-1, 3, 2)


def _parts_of_corners(columns: Tensor) -> Tensor:
    """(T, 4, 6) the linear maps from ax ay bx by cx cy to the parts a and b of J."""
    u, v = columns.unbind(2)
    parts = torch.zeros(len(columns), 4, 3, 2, dtype=torch.float64)
    parts[:, 0, :, 0], parts[:, 0, :, 1] = u / 2, v / 2
    parts[:, 1, :, 0], parts[:, 1, :, 1] = -v / 2, u / 2
    parts[:, 2, :, 0], parts[:, 2, :, 1] = u / 2, -v / 2
    parts[:, 3, :, 0], parts[:, 3, :, 1] = v / 2, u / 2
    return parts.view(-1, 4, 6)


def _of_parts(
    a: Tensor, b: Tensor, slopes: Tensor, curvatures: Tensor, options: ProjectedOptions
) -> tuple[Tensor, Tensor]:
    """The gradient (4, T) by the parts a and b (2, T) each, and the positive Hessian (4, 4, T).

    slopes, curvatures  (2, T) and (3, T) of phi by stretch and det
    """
    by_s, by_d = slopes
    ss, sd, dd = curvatures
    f_p, f_q = 2 * by_s + by_d, 2 * by_s - by_d
    p, q = a.square().sum(0), b.square().sum(0)
    along_a, along_b = _unit(a, p), _unit(b, q)
    aa = 2 * f_p + 4 * p * (4 * (ss + sd) + dd)
    bb = 2 * f_q + 4 * q * (4 * (ss - sd) + dd)
    ab = 4 * (p * q).sqrt() * (4 * ss - dd)
    middle, half = (aa + bb) / 2, (aa - bb) / 2
    radius = torch.hypot(half, ab)
    values = torch.stack([2 * f_p, 2 * f_q, middle + radius, middle - radius])
    top = values.abs().amax(0)
    floor = torch.maximum(options.floor * top, options.common_floor * top.max())
    across_a, across_b, high, low = torch.maximum(values, floor)
    # The block has the eigenvalues `high` and `low`, and its own eigenvectors.
    part = torch.where(radius > 0, (high - low) / torch.where(radius > 0, 2 * radius, 1.0), 0.0)
    centre = (high + low) / 2
    aa, bb, ab = centre + part * half, centre - part * half, part * ab
    block = torch.zeros(4, 4, a.shape[1], dtype=a.dtype)
    block[:2, :2] = aa * _outer(along_a, along_a) + across_a * _outer(_turned(along_a), _turned(along_a))
    block[2:, 2:] = bb * _outer(along_b, along_b) + across_b * _outer(_turned(along_b), _turned(along_b))
    block[:2, 2:] = ab * _outer(along_a, along_b)
    block[2:, :2] = block[:2, 2:].transpose(0, 1)
    return torch.cat([2 * f_p * a, 2 * f_q * b]), block


def _unit(vector: Tensor, square: Tensor) -> Tensor:
    """(2, T) the vectors at unit length; (1, 0) for one without length."""
    length = square.sqrt()
    known = length > 0
    unit = vector / torch.where(known, length, 1.0)
    return torch.where(known, unit, torch.tensor([[1.0], [0.0]], dtype=vector.dtype))


def _turned(vector: Tensor) -> Tensor:
    return torch.stack([-vector[1], vector[0]])


def _outer(u: Tensor, v: Tensor) -> Tensor:
    return u[:, None] * v[None]
