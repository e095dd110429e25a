"""How long edges should be: size fields over the vertices, and how well a mesh follows one.

Sizes are edge lengths in the unit of the points.  They come from the boundary, from a mesh, or from the user.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh import connectivity
from ..mesh.batch import MeshBatch, vertex_mesh
from ..mesh.detached import without_autograd
from ..mesh.means import means_at_vertices, sums_at_vertices
from ..mesh.quads import quads_as_halves
from ..mesh.ragged import (
    counts_from_offsets,
    offsets_from_counts,
    owner_of,
    percentiles,
    segment_count,
    segment_max,
    segment_sum,
    spread,
)
from ..mesh.triangle import SQRT3, Corners, corners, signed_area
from ..mesh.unfit import unfit_meshes
from ..optimising.conjugate_gradients import solve
from ..optimising.laplacian import ExtensionSystem, InnerStiffness, cotangent_weights

# A name, one length per vertex (V,), or a function that takes points (N, 2) to lengths (N,).
Sizes: TypeAlias = Literal["boundary", "keep", "uniform"] | Tensor | Callable[[Tensor], Tensor]


NAMES = ("boundary", "keep", "uniform")


# The weights of the edges opposite the corners a, b, c, three (T,).
_Weights: TypeAlias = tuple[Tensor, Tensor, Tensor]

# Takes values (V,), of which the known rows are read, and a source (V,), of which the others are, to the solution (V,).
_Solver: TypeAlias = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class InwardOptions:
    """How the sizes of the boundary are continued into the interior by `boundary_sizes`.

    accuracy      the part of the residuals of the linear systems that may be left; they are then solved by conjugate
                  gradients.  None means that they are solved exactly, by scipy, which takes time to load
    least_weight  smaller cotangent weights are raised to this: negative ones can make the matrix indefinite
    most_weight   larger cotangent weights are lowered to this: they make the matrix stiff on poor meshes
    finer         the logarithm of the interior's sizes may be lowered by this at most to reach the number of
                  triangles that was asked for, since refining costs irregular vertices
    coarser       and raised by this at most; the mesh then has fewer triangles than before, which is intended
    bisections    so often the interval of this change is halved; 30 times make it shorter than 1e-8
    """

    accuracy: float | None = None
    least_weight: float = 0.05
    most_weight: float = 20.0
    finer: float = 0.25
    coarser: float = 1.0
    bisections: int = 30

    def __post_init__(self) -> None:
        if self.accuracy is not None and not 0 < self.accuracy < 1:
            raise ValueError(f"InwardOptions.accuracy must be None or between 0 and 1, not {self.accuracy}")
        if not 0 < self.least_weight <= self.most_weight:
            raise ValueError(
                "InwardOptions.least_weight must be positive and at most most_weight "
                f"({self.most_weight}), not {self.least_weight}"
            )
        for name in ("finer", "coarser"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"InwardOptions.{name} must not be negative, but is {getattr(self, name)}")


@without_autograd
@quads_as_halves
def size_field(
    batch: MeshBatch, sizes: Sizes = "boundary", *, triangles: Tensor | None = None, accuracy: float | None = None
) -> Tensor:
    """(V,) float64 the edge length wanted at each vertex.

    sizes      "boundary": the lengths of the boundary and constrained edges, continued into the interior such that
               equilateral triangles fit best (see `boundary_sizes`); "keep": the lengths of the edges that each vertex
               has now; "uniform": one length for each mesh, by its area and number of triangles; a tensor (V,);
               or a function that takes points (N, 2) and returns (N,)
    triangles  (B,) how many triangles "boundary" and "uniform" aim at; None means as many as there are
    accuracy   for "boundary", how accurately its linear systems are solved (`InwardOptions.accuracy`)

    In a mesh with a position that is not finite, or beyond 1e150, they are 1 unless they are given.
    Raises ValueError for an unknown name, and InvalidMeshError, which names the vertex, for sizes that are not (V,)
    positive finite numbers.
    """
    check_sizes(sizes)
    if isinstance(sizes, str):
        unfit = unfit_meshes(batch)
        if bool(unfit.any()):
            out = torch.ones(len(batch.points), dtype=torch.float64, device=batch.points.device)
            few = None if triangles is None else triangles[~unfit]
            if not bool(unfit.all()):
                known = size_field(batch.select(~unfit), sizes, triangles=few, accuracy=accuracy)
                out[spread(~unfit, batch.point_offsets)] = known
            return out
        wanted = counts_from_offsets(batch.triangle_offsets) if triangles is None else triangles
        if sizes == "boundary":
            return boundary_sizes(batch, wanted, InwardOptions(accuracy))
        if sizes == "uniform":
            return uniform_sizes(batch, wanted)
        edges = connectivity.edges(batch.triangles, batch.twin)
        size = mean_at_vertices(edges, edge_lengths(batch, edges), batch)[0]
        # A vertex without edges, or at the position of all its neighbours, has no length to keep.
        return torch.where(size > 0, size, 1.0)
    values = sizes(batch.points) if callable(sizes) else sizes
    values = torch.as_tensor(values)
    if values.shape != (len(batch.points),):
        raise InvalidMeshError(
            f"sizes must have shape ({len(batch.points)},), one length a vertex, not {tuple(values.shape)}"
        )
    values = values.detach().to(batch.points.device, torch.float64)
    bad = ~(values.isfinite() & (values > 0))
    if bool(bad.any()):
        row = int(bad.nonzero()[0, 0])
        raise InvalidMeshError(
            f"mesh {int(vertex_mesh(batch)[row])}: sizes row {row} is {float(values[row])}: edge lengths must be "
            f"positive and finite ({int(bad.sum())} rows are not)"
        )
    return values


def check_sizes(sizes: Sizes) -> None:
    """Raise ValueError for an unknown name."""
    if isinstance(sizes, str) and sizes not in NAMES:
        raise ValueError(f"sizes must be one of {list(NAMES)}, a tensor (V,) or a function, not {sizes!r}")


def boundary_sizes(batch: MeshBatch, triangles: Tensor, options: InwardOptions | None = None) -> Tensor:
    """(V,) the sizes of the boundary, continued inwards: log h = u + c v.

    u is harmonic.  At the ends of the boundary and constrained edges it is the logarithm of their mean length.  Such a
    metric of the mesh is flat: h = |f'| for a conformal map f, and the image of a lattice of equilateral triangles
    under f has no irregular vertex (Gauss-Bonnet; Bunin, A continuum theory for unstructured mesh generation in two
    dimensions, Computer Aided Geometric Design 25, 2008).  v bends the metric evenly: -laplace v = exp(-2 u), and v = 0
    at the boundary.  c is chosen such that there are `triangles` (B,) triangles.  Its limits are -finer and coarser of
    the options over the maximum of v: refining and coarsening beyond them spoil the shapes.
    """
    options = options or InwardOptions()
    inward = continue_inwards(batch, options)
    v = inward.bend
    peak = segment_max(v, batch.point_offsets).clamp_min(1e-300)
    v = v / spread(peak, batch.point_offsets)
    low, high = torch.full_like(peak, -options.finer), torch.full_like(peak, options.coarser)
    wanted = triangles.to(peak) * (SQRT3 / 4)
    for _ in range(options.bisections):
        middle = 0.5 * (low + high)
        count = segment_sum(
            inward.mass * exp(-2 * (inward.relative + spread(middle, batch.point_offsets) * v)), batch.point_offsets
        )
        many = count > wanted
        low, high = torch.where(many, middle, low), torch.where(many, high, middle)
    h = exp(inward.logarithm + spread(0.5 * (low + high), batch.point_offsets) * v)
    return torch.where(inward.known, inward.length, h)


@dataclass(frozen=True, eq=False)
class Inwards:
    """The sizes of the boundary, continued into the interior, (V,) each.

    known      bool, the vertex is on the boundary, on a constrained edge, or in no triangle
    length     the mean length of the boundary and constrained edges at the known vertices
    logarithm  u of `boundary_sizes`
    relative   u minus the largest u of the mesh; the exponential of that largest u is the unit of length of `mass`
    mass       the area that belongs to a vertex, a third of that of its triangles
    bend       v of `boundary_sizes`: in the middle of a strip, half the square of its half width in units of exp u
    """

    known: Tensor
    length: Tensor
    logarithm: Tensor
    relative: Tensor
    mass: Tensor
    bend: Tensor


def continue_inwards(batch: MeshBatch, options: InwardOptions | None = None) -> Inwards:
    """Read the sizes at the boundary and constrained edges, and continue them into the interior."""
    options = options or InwardOptions()
    edges = torch.cat([connectivity.boundary_edges(batch.triangles, batch.twin), batch.constrained_edges])
    length, known = mean_at_vertices(edges, edge_lengths(batch, edges), batch)
    idle = connectivity.vertex_triangle_counts(batch.triangles, len(batch.points)) == 0
    known = known | idle
    t = corners(batch.points.to(torch.float64), batch.triangles)
    area = signed_area(t)
    solved = _solver(batch, _bounded_weights(t, area > 0, options), known, options.accuracy)
    # Sizes relative to each mesh's largest, which is a known one, so that no square leaves the range of numbers.
    logarithm = log(length.clamp_min(1e-300))
    offsets = batch.point_offsets
    top = segment_max(torch.where(known & ~idle, logarithm, -torch.inf), offsets)
    relative = solved(logarithm - spread(top, offsets), torch.zeros_like(logarithm))
    unit = spread(exp(top), offsets)
    mass = _vertex_areas(batch, area.abs()) / unit / unit
    bend = solved(torch.zeros_like(mass), mass * exp(-2 * relative))
    return Inwards(known, length, relative + spread(top, offsets), relative, mass, bend)


def _bounded_weights(t: Corners, upright: Tensor, options: InwardOptions) -> _Weights:
    """Three (T,) cotangent weights within the limits of the options; inverted and flat triangles have weights of 1."""
    at_a, at_b, at_c = (
        torch.where(upright, w, 1.0).clamp(options.least_weight, options.most_weight) for w in cotangent_weights(t)
    )
    return at_a, at_b, at_c


def _vertex_areas(batch: MeshBatch, area: Tensor) -> Tensor:
    """(V,) a third of the areas (T,) of the triangles at each vertex."""
    total = area.new_zeros(len(batch.points))
    for corner in batch.triangles.unbind(1):
        total.index_add_(0, corner, area)
    return total / 3


def _solver(batch: MeshBatch, weights: _Weights, known: Tensor, accuracy: float | None) -> _Solver:
    """Solves the linear systems of the harmonic extension with these weights; accuracy as in `InwardOptions`."""
    if accuracy is None:
        return _exactly(batch, weights, known)
    return _nearly(batch, batch.twin, weights, known, accuracy)


def _exactly(batch: MeshBatch, weights: _Weights, known: Tensor) -> _Solver:
    """A solver by factorisation."""

    system = ExtensionSystem(batch.triangles, weights, known, batch.point_offsets)

    def solved(values: Tensor, source: Tensor) -> Tensor:
        return system.extended(values[:, None], source[:, None])[:, 0]

    return solved


def _nearly(batch: MeshBatch, twin: Tensor, weights: _Weights, known: Tensor, accuracy: float) -> _Solver:
    """A solver by conjugate gradients, which stops when the residuals are `accuracy` times the first ones."""
    stiffness = InnerStiffness.of(batch.triangles, twin, weights, known)
    offsets = offsets_from_counts(segment_count(~known, batch.point_offsets))

    def solved(values: Tensor, source: Tensor) -> Tensor:
        right = stiffness.load(values) + source[~known]
        return values.masked_scatter(~known, solve(stiffness, right, offsets, tolerance=accuracy).x)

    return solved


def uniform_sizes(batch: MeshBatch, triangles: Tensor) -> Tensor:
    """(V,) one length for each mesh: the edge of equilateral triangles, `triangles` (B,) of which have its area."""
    area = signed_area(corners(batch.points.to(torch.float64), batch.triangles)).abs()
    per_mesh = (segment_sum(area, batch.triangle_offsets) / triangles * (4 / SQRT3)).sqrt()
    return spread(per_mesh, batch.point_offsets)


def scaled_to_fit(batch: MeshBatch, size: Tensor) -> Tensor:
    """(V,) the sizes times a factor for each mesh, which then has room for as many equilateral triangles as it has."""
    per_triangle = size[batch.triangles].mean(1)
    share = signed_area(corners(batch.points.to(torch.float64), batch.triangles)) / per_triangle / per_triangle
    fitting = segment_sum(share, batch.triangle_offsets) * (4 / SQRT3)
    factor = (fitting / counts_from_offsets(batch.triangle_offsets)).sqrt()
    return size * spread(factor, batch.point_offsets)


@dataclass(frozen=True, eq=False)
class SizeConformity:
    """Edge lengths over the sizes wanted, per mesh (B,), where 1 is ideal.

    The size wanted of an edge is the mean of those of its ends.

    mean       the mean over all edges
    low, high  the 5th and the 95th percentile
    """

    mean: Tensor
    low: Tensor
    high: Tensor


@without_autograd
@quads_as_halves
def size_conformity(batch: MeshBatch, sizes: Sizes = "boundary") -> SizeConformity:
    """How well the edges of each mesh follow a size field; `sizes` as in `size_field`."""
    return conformity(batch, size_field(batch, sizes), lambda edges: edge_lengths(batch, edges))


def conformity(batch: MeshBatch, size: Tensor, lengths: Callable[[Tensor], Tensor]) -> SizeConformity:
    """How well the edges of each mesh follow the sizes (V,), where `lengths` takes edges (E, 2) to lengths (E,)."""
    edges = connectivity.edges(batch.triangles, batch.twin)
    owner = owner_of(edges[:, 0], batch.point_offsets)
    edges, offsets = edges[owner.argsort(stable=True)], offsets_from_counts(torch.bincount(owner, minlength=len(batch)))
    ratio = 2 * lengths(edges) / (size[edges[:, 0]] + size[edges[:, 1]])
    low, high = percentiles(ratio, offsets, (5, 95)).unbind(1)
    return SizeConformity(segment_sum(ratio, offsets) / counts_from_offsets(offsets), low, high)


def carried(batch: MeshBatch, size: Tensor, positions: Tensor) -> Tensor:
    """(V,) the field `size` (V,) over `batch`, read at the new `positions` (V, 2) of its vertices.

    The value is of first order, by the mean gradient of the triangles at each vertex, and never outside the range of
    the values of the vertex and its neighbours.
    """
    points = batch.points.to(torch.float64)
    t = corners(points, batch.triangles)
    a, b, c = (size[corner] for corner in batch.triangles.unbind(1))
    # The gradient of a linear function times twice the area of its triangle.
    gx = (b - a) * (t.cy - t.ay) - (c - a) * (t.by - t.ay)
    gy = (c - a) * (t.bx - t.ax) - (b - a) * (t.cx - t.ax)
    area = 2 * signed_area(t)
    low, high = size.clone(), size.clone()
    sums = [size.new_zeros(len(size)) for _ in range(3)]
    least, most = torch.minimum(torch.minimum(a, b), c), torch.maximum(torch.maximum(a, b), c)
    for corner in batch.triangles.unbind(1):
        for total, part in zip(sums, (gx, gy, area), strict=True):
            total.index_add_(0, corner, part)
        low.scatter_reduce_(0, corner, least, "amin")
        high.scatter_reduce_(0, corner, most, "amax")
    x, y, whole = sums
    move = positions.to(torch.float64) - points
    change = (x * move[:, 0] + y * move[:, 1]) / torch.where(whole > 0, whole, torch.inf)
    return torch.minimum(torch.maximum(size + change, low), high)


def edge_lengths(batch: MeshBatch, edges: Tensor) -> Tensor:
    """(E,) float64 lengths of the edges (E, 2)."""
    points = batch.points.to(torch.float64)
    step = (points[edges[:, 0]] - points[edges[:, 1]]).abs()
    larger = torch.maximum(step[:, 0], step[:, 1])
    scale = torch.where(larger > 0, larger, 1.0)
    # The bits of torch.hypot would depend on where in a vector a number stands.
    x, y = step[:, 0] / scale, step[:, 1] / scale
    return larger * (x * x + y * y).sqrt()


def mean_at_vertices(edges: Tensor, length: Tensor, batch: MeshBatch) -> tuple[Tensor, Tensor]:
    """(V,) the mean length (E,) of the edges (E, 2) at each vertex, and (V,) bool whether there are any.

    A vertex without edges has the mean over the vertices of its mesh.
    """
    mean, there = means_at_vertices(edges, length, len(batch.points))
    offsets = batch.point_offsets
    total = segment_sum(sums_at_vertices(edges, length, len(batch.points)), offsets)
    number = segment_sum(torch.bincount(edges.reshape(-1), minlength=len(there)).to(total), offsets)
    return torch.where(there, mean, spread(total / number.clamp_min(1), offsets)), there


def log(values: Tensor) -> Tensor:
    """The logarithm; on the processor by numpy, whose bits do not depend on where in a vector a number stands."""
    return torch.from_numpy(np.log(values.numpy())) if values.device.type == "cpu" else values.log()


def exp(values: Tensor) -> Tensor:
    """The exponential, likewise."""
    return torch.from_numpy(np.exp(values.numpy())) if values.device.type == "cpu" else values.exp()
