"""What triangles should look like, where that is not equilateral.

There are two kinds of targets, since one can say two kinds of things of an ideal triangle:

- Target matrices W (T, 2, 2), one a triangle: the columns are the edges from its corner a to b and
  to c of the ideal.  They say which edge is the long one, and nothing of how the triangle is turned
  in the plane: a layer of thin triangles that is bent with its wall keeps its shape.  They belong
  to triangles in their order of corners, and are lost when an edge flips.
- A metric M, one symmetric positive definite matrix a position or vertex: a triangle is ideal if it is
  equilateral when lengths are measured as sqrt(e^T M e).  It says in which direction of the plane
  triangles are long, and nothing of which edge that is; so edges may flip.

Both tell shapes, not sizes: a multiple of W or M is the same target (Knupp, Target-matrix
construction algorithms, Sandia report SAND2009-7003P, 2009; Loseille & Alauzet, Continuous mesh
framework, SIAM Journal on Numerical Analysis 49, 2011).
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch, triangle_mesh
from ..mesh.measure import refuse_inverted
from ..mesh.quads import HALVES, SAMPLES, halved, has_quads, sample_offsets, sampled, spread_to_halves, worst_of_samples
from ..mesh.ragged import spread
from ..mesh.triangle import SQRT3, Corners, corners, inverse_mean_ratio, signed_area, squared_edge_lengths
from ..mesh.typed import typed
from .jacobian import Target, equilateral, invariants, select_rows, target_of
from .metric_field import MetricField, edge_map_of, mean_at_vertices
from .metric_tensors import edge_matrices, equilateral_metric, metric_of_targets, shape_edges, turned
from .objective import MeshObjective, Packing

Targets = Tensor | MetricField

# What becomes a tensor.
ArrayLike = Any


# Positions (N, 2) to target matrices (N, 2, 2).
TargetFunction = Callable[[Tensor], Tensor]


def target_from(reference: MeshBatch | ArrayLike, triangles: ArrayLike | None = None) -> Tensor:
    """(T, 2, 2) the triangles of `reference` as target matrices, for `SmoothOptions(targets=...)`.

    reference  a batch; or the positions (V, 3) of a surface in space, which then needs its triangles, as texture
               coordinates have it: the triangles of the plane take the shapes that they have on the surface
    triangles  (T, 3) rows of these positions

    They serve a batch with the same triangles in the same order, for example the mesh after a deformation.  With quads
    they are (T + 4Q, 2, 2): mesh by mesh those of the triangles, and then four a quad, one for each of its corners in
    their order, with the edges to the next corner and to the one before.
    Raises InvalidMeshError, naming the row, where a triangle is inverted or flat, and for arrays of another shape.
    """
    if isinstance(reference, MeshBatch):
        if triangles is not None:
            raise InvalidMeshError("target_from takes triangles with positions (V, 3) only: a batch has its own")
        refuse_inverted(reference, ", so it is no target; improve the reference first")
        return edge_matrices(sampled(reference))
    if triangles is None:
        raise InvalidMeshError("target_from needs the triangles (T, 3) of a surface beside its positions (V, 3)")
    return _surface_targets(torch.as_tensor(reference), torch.as_tensor(triangles))


def _surface_targets(points: Tensor, triangles: Tensor) -> Tensor:
    """(T, 2, 2) each triangle of a surface laid into the plane, its first edge along x."""
    if points.ndim != 2 or points.shape[1] != 3 or points.is_complex():
        raise InvalidMeshError(
            f"positions of a surface must be (V, 3), not {tuple(points.shape)}; for a plane reference give a MeshBatch"
        )
    if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.is_floating_point():
        raise InvalidMeshError(f"triangles must be (T, 3) whole numbers, not {tuple(triangles.shape)}")
    points, triangles = points.detach().to(torch.float64), triangles.to(points.device, torch.int64)
    strays = ((triangles < 0) | (triangles >= len(points))).any(1)
    if bool(strays.any()):
        row = int(strays.nonzero()[0])
        raise InvalidMeshError(f"triangles row {row} is {triangles[row].tolist()}: there are {len(points)} positions")
    a, b, c = points[triangles].unbind(1)
    e1, e2 = b - a, c - a
    # In units of each triangle, so that squares neither overflow nor underflow.
    unit = torch.maximum(e1.abs().amax(1), e2.abs().amax(1))[:, None]
    one, two = e1 / unit, e2 / unit
    length, area = one.norm(dim=1), torch.linalg.cross(one, two).norm(dim=1)
    flat = ~((area > 0) & area.isfinite())
    if bool(flat.any()):
        row = int(flat.nonzero()[0])
        raise InvalidMeshError(f"triangles row {row} of the surface is flat or not finite, so it is no target")
    along, across = (one * two).sum(1) / length, area / length
    rows = torch.stack([torch.stack([length, along], 1), torch.stack([torch.zeros_like(length), across], 1)], 1)
    return unit[:, :, None] * rows


@typed
def metric_from(reference: MeshBatch, moved: MeshBatch | None = None) -> MetricField:
    """The metric in which the triangles of `reference` are nearly equilateral, at its vertices.

    moved  the same triangles after a deformation: the metric keeps its anisotropy, and turns so that
           triangles are long in the direction in which the deformed ones are.  A layer of thin
           triangles follows a wall that bends, whatever shear the deformation brought

    At each vertex this is the mean over its triangles of the metric in which that triangle is equilateral,
    M = E^-T W^T W E^-1 with W the equilateral triangle, each scaled to determinant 1.  Raises
    InvalidMeshError as `target_from` does, and when `moved` has other triangles.
    """
    refuse_inverted(reference, ", so it is no target; improve the reference first")
    reference = halved(reference)
    metric = metric_of_targets(shape_edges(reference), "targets")
    if moved is not None:
        moved = halved(moved)
        if not torch.equal(reference.triangles, moved.triangles):
            raise InvalidMeshError("metric_from needs a moved mesh with the reference's triangles, in their order")
        metric = turned(metric, equilateral_metric(shape_edges(moved)))
    return MetricField(mean_at_vertices(reference, metric))


@typed
def target_quality(batch: MeshBatch, targets: Targets) -> Tensor:
    """(T,) inverse mean ratio towards the targets: 1 for an ideal triangle, infinite for a flat one.

    This is to the targets what `quality(batch).inverse_mean_ratio` is to equilateral triangles; an inverted
    triangle has the value of its mirror image.  With quads it is (T + 4Q,), in the order of `target_from`.
    """
    if batch.rows_per_quad == HALVES:
        values = target_quality(sampled(batch), targets)
        return spread_to_halves(batch, *worst_of_samples(batch, values))
    if has_quads(batch):
        return target_quality(sampled(batch), targets)
    t = corners(batch.points.to(torch.float64), batch.triangles)
    target = ideal(batch)
    if isinstance(targets, MetricField):
        t = edge_map_of(targets.at_vertices(batch), batch.triangles).corners(t)
        if not len(batch.quads):
            return inverse_mean_ratio(t)
    else:
        target = _target(batch, targets)
    stretch, det = invariants(t, target)
    det = det.abs()
    return torch.where(det > 0, stretch / (2 * torch.where(det > 0, det, 1.0)), torch.inf)


def ideal(batch: MeshBatch, size: Tensor | float = 1.0, quads: Tensor | None = None) -> Target:
    """The target of each triangle (T,) where nothing else is meant: equilateral ones with sides of this size.

    Where triangles are the corners of quads (`mesh.quads.sampled`), they aim at the corner of a square, the right
    isosceles triangle, of the same area.

    quads  (4Q, 2, 2) what the corners aim at instead, of any size
    """
    plain = equilateral(size)
    if not len(batch.quads):
        return plain
    corner = batch.of_quads
    square = (2 / SQRT3) / (size * size) * torch.ones(len(corner), dtype=torch.float64, device=corner.device)
    right = square, torch.zeros_like(square), square, square
    made = Target(
        *(torch.where(corner, r, torch.as_tensor(p, dtype=r.dtype)) for r, p in zip(right, plain, strict=True))
    )
    if quads is None:
        return made
    own = _unit_targets(batch, quads, int(corner.sum()))
    pairs = ((torch.as_tensor(v), torch.as_tensor(mine)) for v, mine in zip(made, own, strict=True))
    return Target(*(value.index_put((corner,), mine) for value, mine in pairs))


def quad_targets_from(reference: MeshBatch) -> Tensor:
    """(4Q, 2, 2) the corners of the quads of `reference` as target matrices, for `SmoothOptions(quad_targets=...)`."""
    corners_alone = sampled(reference)
    return edge_matrices(corners_alone)[corners_alone.of_quads]


def aim(objective: MeshObjective, batch: MeshBatch, packing: Packing, targets: Targets) -> MeshObjective:
    """`objective`, whose target are equilateral triangles, with these targets in their place."""
    scale = packing.spread_vertices(vertex_height(batch) / spread(packing.unit, batch.point_offsets))
    if isinstance(targets, MetricField):
        edge_map = edge_map_of(targets.at_vertices(batch), batch.triangles[packing.triangles])
        return replace(objective, edge_map=edge_map, scale=scale)
    return replace(objective, target=select_rows(_target(batch, targets), packing.triangles), scale=scale)


def vertex_height(batch: MeshBatch) -> Tensor:
    """(V,) the least height of the triangles round each vertex: about how far it may move before one inverts."""
    t = corners(batch.points.to(torch.float64), batch.triangles)
    ab, bc, ca = squared_edge_lengths(t)
    longest = torch.maximum(ab, torch.maximum(bc, ca)).sqrt()
    height = 2 * signed_area(t).abs() / torch.where(longest > 0, longest, 1.0)
    least = height.new_full((len(batch.points),), torch.inf)
    for corner in range(3):
        least.scatter_reduce_(0, batch.triangles[:, corner], height, "amin")
    return torch.where(least.isfinite(), least, 0.0)


def _target(batch: MeshBatch, matrices: Tensor) -> Target:
    """The target matrices (T, 2, 2), checked, as coefficients of J; each is scaled to the area of a unit triangle."""
    return _unit_targets(batch, matrices, len(batch.triangles))


def _unit_targets(batch: MeshBatch, matrices: Tensor, count: int) -> Target:
    """The same of so many matrices (N, 2, 2), of triangles or of corners of quads."""
    t, area = checked_matrices(batch, matrices, count)
    size = (4 / SQRT3 * area).sqrt()
    return target_of(Corners(*(v / size for v in t)))


def checked_matrices(batch: MeshBatch, matrices: Tensor, count: int) -> tuple[Corners, Tensor]:
    """The triangles of so many target matrices (N, 2, 2), each scaled to an extent of 1, and their areas (N,).

    Raises InvalidMeshError for another shape, and for a matrix whose determinant is not positive.
    """
    if matrices.shape != (count, 2, 2):
        more = " and one a corner of each quad" if len(batch.quads) else ""
        raise InvalidMeshError(
            f"targets must be ({count}, 2, 2), one matrix a triangle{more}, not {tuple(matrices.shape)}"
        )
    w = matrices.to(batch.points.device, torch.float64)
    w = w / w.abs().amax((1, 2)).clamp_min(1e-300)[:, None, None]
    zero = torch.zeros_like(w[:, 0, 0])
    t = Corners(zero, zero, w[:, 0, 0], w[:, 1, 0], w[:, 0, 1], w[:, 1, 1])
    area = signed_area(t)
    bad = ~(area > 0)
    if bool(bad.any()):
        row = int(bad.nonzero()[0])
        where = f"mesh {int(triangle_mesh(batch)[row])}: " if count == len(batch.triangles) else "quad_"
        raise InvalidMeshError(
            f"{where}targets row {row} is {matrices[row].tolist()}: the determinant of a target matrix must be positive"
        )
    return t, area


# --- targets as they come with the options ---


def as_targets(targets: Targets | TargetFunction | None) -> Targets | None:
    """A function of positions to target matrices as its metric; all else as it is."""
    return MetricField.from_targets(targets) if callable(targets) else targets


def check_fit(batch: MeshBatch, targets: Targets) -> None:
    """Raise InvalidMeshError unless there is a proper target for every triangle, or vertex, of the batch."""
    if isinstance(targets, MetricField):
        targets.at_vertices(batch)
    else:
        _target(sampled(batch), targets)


def check(targets: object) -> None:
    """Raise ValueError unless these are targets, as far as can be told without a batch."""
    if isinstance(targets, MetricField) or (isinstance(targets, Tensor) and targets.shape[1:] == (2, 2)):
        return
    said = tuple(targets.shape) if isinstance(targets, Tensor) else type(targets).__name__
    raise ValueError(
        "SmoothOptions.targets must be a (T, 2, 2) tensor of target matrices, a function of positions to such, or a "
        f"MetricField, not {said}; for a mesh as target use target_from(mesh) or metric_from(mesh)"
    )


def check_topology(targets: Targets | TargetFunction | None, topology: str) -> None:
    """Raise ValueError where `improve` may change the triangles and these targets belong to the triangles there are."""
    if isinstance(targets, Tensor) and topology != "keep":
        raise ValueError(
            "ImproveOptions.smooth.targets are matrices of triangles, which do not last when edges flip: "
            "set topology='keep', or give a MetricField (metric_from, MetricField.from_triangles)"
        )


def narrow(targets: Targets | None, batch: MeshBatch, at: Tensor) -> Targets | None:
    """The targets for `batch.select(at)`, at (B,) bool."""
    if isinstance(targets, Tensor):
        return targets.to(at.device)[spread(at, sample_offsets(batch) if len(batch.quads) else batch.triangle_offsets)]
    if isinstance(targets, MetricField) and isinstance(targets.values, Tensor):
        return MetricField(targets.values.to(at.device)[spread(at, batch.point_offsets)])
    return targets


def narrow_quads(targets: Tensor | None, batch: MeshBatch, at: Tensor) -> Tensor | None:
    """The `SmoothOptions.quad_targets` for `batch.select(at)`, at (B,) bool."""
    return None if targets is None else targets.to(at.device)[spread(at, SAMPLES * batch.quad_offsets)]
