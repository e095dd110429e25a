"""How long edges should be: size fields over the vertices, and how well a mesh follows one.

Sizes may come from the boundary, from a mesh, or from the user; they are edge lengths, in the
unit of the points.
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
from ..mesh.means import sums_at_vertices
from ..mesh.metrics import percentiles
from ..mesh.ragged import (
    counts_from_offsets,
    offsets_from_counts,
    owner_of,
    segment_count,
    segment_max,
    segment_sum,
    spread,
)
from ..mesh.triangle import SQRT3, corners, signed_area
from ..optimising.conjugate_gradients import solve
from ..optimising.laplacian import InnerStiffness, cotangent_weights, harmonic_extension

# A name, (V,) one length a vertex, or a function of points (N, 2) that returns (N,).
Sizes: TypeAlias = Literal["boundary", "keep", "uniform"] | Tensor | Callable[[Tensor], Tensor]


NAMES = ("boundary", "keep", "uniform")


# Cotangents outside these make the matrix of the harmonic extension indefinite, or stiff, on poor meshes.
_LEAST_WEIGHT, _MOST_WEIGHT = 0.05, 20.0


# Balancing changes the logarithm of the interior's sizes by this much at most: refining costs
# irregular vertices, coarsening gives a user fewer triangles than before, which is meant.
_FINER, _COARSER = 0.25, 1.0


_BISECTIONS = 30


def size_field(
    batch: MeshBatch, sizes: Sizes = "boundary", *, triangles: Tensor | None = None, accuracy: float | None = None
) -> Tensor:
    """(V,) float64 the edge length wanted at each vertex.

    sizes      "boundary": the boundary and constrained edges' lengths, continued into the interior so
               that equilateral triangles fit best (see `boundary_sizes`); "keep": the lengths of the
               edges now at each vertex; "uniform": one length a mesh, by its area and number of
               triangles; a tensor (V,); or a function that takes points (N, 2) and returns (N,)
    triangles  (B,) how many triangles "boundary" and "uniform" aim at; None: as many as there are
    accuracy   of "boundary": the part of the residuals that may be left of its linear systems, which are then
               solved by conjugate gradients; None: they are solved exactly, by scipy, which must be loaded

    Raises ValueError for an unknown name, InvalidMeshError for sizes that are not (V,) positive
    finite numbers, naming the vertex.
    """
    check_sizes(sizes)
    if isinstance(sizes, str):
        wanted = counts_from_offsets(batch.triangle_offsets) if triangles is None else triangles
        if sizes == "boundary":
            return boundary_sizes(batch, wanted, accuracy)
        if sizes == "uniform":
            return uniform_sizes(batch, wanted)
        edges = connectivity.edges(batch.triangles, batch.twin)
        size = _mean_at_vertices(edges, edge_lengths(batch, edges), batch)[0]
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
    """Raises ValueError for a name that is none."""
    if isinstance(sizes, str) and sizes not in NAMES:
        raise ValueError(f"sizes must be one of {list(NAMES)}, a tensor (V,) or a function, not {sizes!r}")


def boundary_sizes(batch: MeshBatch, triangles: Tensor, accuracy: float | None = None) -> Tensor:
    """(V,) the sizes of the boundary, continued inwards: log h = u + c v.

    u is harmonic and equal to the logarithm of the mean length of the boundary and constrained
    edges at their vertices.  Then the metric of the mesh is flat: h = |f'| of a conformal map f, and
    the image of a lattice of equilateral triangles under f has no irregular vertex (Gauss-Bonnet;
    Bunin, A continuum theory for unstructured mesh generation in two dimensions, Computer Aided
    Geometric Design 25, 2008).  v bends it evenly, -laplace v = exp(-2 u), 0 at the boundary; and c
    is such that the triangles number `triangles` (B,), as far as c is between -0.25 and 1 over the
    maximum of v: refining and coarsening beyond that spoils the shapes.  `accuracy` as in `size_field`.
    """
    inward = continue_inwards(batch, accuracy)
    v = inward.bend
    peak = segment_max(v, batch.point_offsets).clamp_min(1e-300)
    v = v / spread(peak, batch.point_offsets)
    low, high = torch.full_like(peak, -_FINER), torch.full_like(peak, _COARSER)
    wanted = triangles.to(peak) * (SQRT3 / 4)
    for _ in range(_BISECTIONS):
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

    known      is the vertex on the boundary, on a constrained edge, or of no triangle?
    length     the mean length of such edges at those vertices
    logarithm  u of `boundary_sizes`;  relative: less the mesh's largest, whose exponential is the unit of `mass`
    mass       the area that is a vertex's, a third of its triangles'
    bend       v of `boundary_sizes`: in the middle of a strip, half the square of its half width in units of exp u
    """

    known: Tensor
    length: Tensor
    logarithm: Tensor
    relative: Tensor
    mass: Tensor
    bend: Tensor


def continue_inwards(batch: MeshBatch, accuracy: float | None = None) -> Inwards:
    """Read the sizes at the boundary and constrained edges, and continue them; `accuracy` as in `size_field`."""
    twin = batch.twin
    edges = torch.cat([connectivity.boundary_edges(batch.triangles, twin), batch.constrained_edges])
    length, known = _mean_at_vertices(edges, edge_lengths(batch, edges), batch)
    t = corners(batch.points.to(torch.float64), batch.triangles)
    upright = signed_area(t) > 0
    at_a, at_b, at_c = (torch.where(upright, w, 1.0).clamp(_LEAST_WEIGHT, _MOST_WEIGHT) for w in cotangent_weights(t))
    idle = connectivity.vertex_triangle_counts(batch.triangles, len(batch.points)) == 0
    known = known | idle
    offsets = batch.point_offsets
    weights = at_a, at_b, at_c
    solved = _exactly(batch, weights, known) if accuracy is None else _nearly(batch, twin, weights, known, accuracy)
    # Sizes relative to each mesh's largest, which is a known one, so that no square leaves the range of numbers.
    logarithm = log(length.clamp_min(1e-300))
    top = segment_max(torch.where(known & ~idle, logarithm, -torch.inf), offsets)
    relative = solved(logarithm - spread(top, offsets), torch.zeros_like(logarithm))
    share = t.ax.new_zeros(len(batch.points))
    area = signed_area(t).abs()
    for corner in batch.triangles.unbind(1):
        share.index_add_(0, corner, area)
    unit = spread(exp(top), offsets)
    mass = share / 3 / unit / unit
    bend = solved(torch.zeros_like(mass), mass * exp(-2 * relative))
    return Inwards(known, length, relative + spread(top, offsets), relative, mass, bend)


# Of values (V,), of which the known rows count, and a source (V,), of which the others do: the solution (V,).
_Solver: TypeAlias = Callable[[Tensor, Tensor], Tensor]


def _exactly(batch: MeshBatch, weights: tuple[Tensor, Tensor, Tensor], known: Tensor) -> _Solver:
    """By factorisation."""

    def solved(values: Tensor, source: Tensor) -> Tensor:
        columns = values[:, None], batch.point_offsets, source[:, None]
        return harmonic_extension(batch.triangles, weights, known, *columns)[:, 0]

    return solved


def _nearly(
    batch: MeshBatch, twin: Tensor, weights: tuple[Tensor, Tensor, Tensor], known: Tensor, accuracy: float
) -> _Solver:
    """By conjugate gradients, until the residuals are down to this part of what they were at first."""
    stiffness = InnerStiffness.of(batch.triangles, twin, weights, known)
    offsets = offsets_from_counts(segment_count(~known, batch.point_offsets))

    def solved(values: Tensor, source: Tensor) -> Tensor:
        right = stiffness.load(values) + source[~known]
        return values.masked_scatter(~known, solve(stiffness, right, offsets, tolerance=accuracy).x)

    return solved


def uniform_sizes(batch: MeshBatch, triangles: Tensor) -> Tensor:
    """(V,) one length a mesh: the side of `triangles` (B,) equilateral triangles of its area."""
    area = signed_area(corners(batch.points.to(torch.float64), batch.triangles)).abs()
    per_mesh = (segment_sum(area, batch.triangle_offsets) / triangles * (4 / SQRT3)).sqrt()
    return spread(per_mesh, batch.point_offsets)


def scaled_to_fit(batch: MeshBatch, size: Tensor) -> Tensor:
    """(V,) the sizes times a factor a mesh with which as many equilateral triangles fill it as it has triangles."""
    per_triangle = size[batch.triangles].mean(1)
    share = signed_area(corners(batch.points.to(torch.float64), batch.triangles)) / per_triangle / per_triangle
    fitting = segment_sum(share, batch.triangle_offsets) * (4 / SQRT3)
    factor = (fitting / counts_from_offsets(batch.triangle_offsets)).sqrt()
    return size * spread(factor, batch.point_offsets)


@dataclass(frozen=True, eq=False)
class SizeConformity:
    """Edge length over the size wanted (the mean of its two ends'), per mesh (B,): 1 is what was asked.

    mean  over all edges;  low, high  the 5th and 95th percentile
    """

    mean: Tensor
    low: Tensor
    high: Tensor


def size_conformity(batch: MeshBatch, sizes: Sizes = "boundary") -> SizeConformity:
    """How well the edges of each mesh follow a size field; `sizes` as in `size_field`."""
    return conformity(batch, size_field(batch, sizes), lambda edges: edge_lengths(batch, edges))


def conformity(batch: MeshBatch, size: Tensor, lengths: Callable[[Tensor], Tensor]) -> SizeConformity:
    """How well the edges of each mesh follow the sizes (V,); `lengths` takes edges (E, 2) to their lengths (E,)."""
    edges = connectivity.edges(batch.triangles, batch.twin)
    owner = owner_of(edges[:, 0], batch.point_offsets)
    edges, offsets = edges[owner.argsort(stable=True)], offsets_from_counts(torch.bincount(owner, minlength=len(batch)))
    ratio = 2 * lengths(edges) / (size[edges[:, 0]] + size[edges[:, 1]])
    low, high = percentiles(ratio, offsets, (5, 95)).unbind(1)
    return SizeConformity(segment_sum(ratio, offsets) / counts_from_offsets(offsets), low, high)


def carried(batch: MeshBatch, size: Tensor, places: Tensor) -> Tensor:
    """(V,) the field `size` (V,) over `batch`, read where its vertices have gone: `places` (V, 2).

    To first order, by the mean gradient of the triangles at each vertex, and never outside the
    values of the vertex and its neighbours.
    """
    points = batch.points.to(torch.float64)
    t = corners(points, batch.triangles)
    a, b, c = (size[corner] for corner in batch.triangles.unbind(1))
    # The gradient of a linear function times the double area.
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
    move = places.to(torch.float64) - points
    change = (x * move[:, 0] + y * move[:, 1]) / torch.where(whole > 0, whole, torch.inf)
    return torch.minimum(torch.maximum(size + change, low), high)


def edge_lengths(batch: MeshBatch, edges: Tensor) -> Tensor:
    """(E,) float64 lengths of the edges (E, 2)."""
    points = batch.points.to(torch.float64)
    step = (points[edges[:, 0]] - points[edges[:, 1]]).abs()
    larger = torch.maximum(step[:, 0], step[:, 1])
    scale = torch.where(larger > 0, larger, 1.0)
    # The bits of torch.hypot depend on where in a vector a number stands.
    x, y = step[:, 0] / scale, step[:, 1] / scale
    return larger * (x * x + y * y).sqrt()


def _mean_at_vertices(edges: Tensor, length: Tensor, batch: MeshBatch) -> tuple[Tensor, Tensor]:
    """(V,) the mean length of the edges at each vertex, the mesh's where there are none; (V,) bool: are there any."""
    count = len(batch.points)
    number = torch.bincount(edges.reshape(-1), minlength=count)
    total = sums_at_vertices(edges, length, count)
    mean = segment_sum(total, batch.point_offsets) / segment_sum(number.to(total), batch.point_offsets).clamp_min(1)
    there = number > 0
    return torch.where(there, total / number.clamp_min(1), spread(mean, batch.point_offsets)), there


def log(values: Tensor) -> Tensor:
    """The logarithm by numpy, whose bits do not depend on where in a vector a number stands."""
    return torch.from_numpy(np.log(values.cpu().numpy())).to(values.device)


def exp(values: Tensor) -> Tensor:
    return torch.from_numpy(np.exp(values.cpu().numpy())).to(values.device)
