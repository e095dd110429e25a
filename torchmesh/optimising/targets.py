"""What triangles should look like, where that is not equilateral.

Two kinds of targets, since two things can be told of an ideal triangle:

- Target matrices W (T, 2, 2), one a triangle: the columns are the edges from its corner a to b and
  to c of the ideal.  They say which edge is the long one, and nothing of how the triangle is turned
  in the plane: a layer of thin triangles that is bent with its wall keeps its shape.  They belong
  to triangles in their order of corners, and are lost when an edge flips.
- A metric M, one symmetric positive definite matrix a place or vertex: a triangle is ideal if it is
  equilateral when lengths are measured as sqrt(e^T M e).  It says in which direction of the plane
  triangles are long, and nothing of which edge that is; so edges may flip.

Both tell shapes, not sizes: a multiple of W or M is the same target (Knupp, Target-matrix
construction algorithms, Sandia report SAND2009-7003P, 2009; Loseille & Alauzet, Continuous mesh
framework, SIAM Journal on Numerical Analysis 49, 2011).
"""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch, triangle_mesh, vertex_mesh
from ..mesh.measure import upright
from ..mesh.ragged import spread
from ..mesh.triangle import SQRT3, Corners, corners, inverse_mean_ratio, signed_area
from .energies import Target, target_of

# A matrix that is symmetric but for this part of its largest entry was rounded, in single precision perhaps.
_ROUNDING = 1e-6


@dataclass(frozen=True, eq=False)
class MetricField:
    """A metric for the plane, in which ideal triangles are equilateral.

    values  (V, 3) entries m11, m12, m22 or (V, 2, 2) matrices, one a vertex of the batch, which
            moves with the vertex; or a function of places (N, 2) to (N, 3) or (N, 2, 2), asked for
            the vertices' places at the start of every smoothing and flipping.  Within a triangle
            the metric is the mean of its corners', each scaled to determinant 1.

    Raises ValueError for a tensor of another shape; positive definite they must be where used.
    """

    values: Tensor | Callable[[Tensor], Tensor]

    def __post_init__(self) -> None:
        if isinstance(self.values, Tensor) and self.values.shape[1:] not in ((3,), (2, 2)):
            raise ValueError(f"MetricField.values must be (V, 3) or (V, 2, 2), not {tuple(self.values.shape)}")
        if not isinstance(self.values, Tensor) and not callable(self.values):
            raise ValueError(f"MetricField.values must be a tensor or a function, not {type(self.values).__name__}")

    @classmethod
    def from_targets(cls, matrices: Tensor | Callable[[Tensor], Tensor]) -> "MetricField":
        """The metric in which triangles with the target matrix W of their place are equilateral.

        matrices  (V, 2, 2) one W a vertex, or a function of places (N, 2) to (N, 2, 2): the columns are two edges of
                  the ideal triangle as it lies there, its corner a to b and to c, counter-clockwise; of any size

        M = W^-T E^T E W^-1 with E the equilateral triangle's matrix.  Which edge is the long one, W does not say
        here, only in which direction triangles are long: so edges may flip.  SmoothOptions(targets=...) takes such a
        function as it is.  Raises InvalidMeshError, naming the row, where det W is not positive.
        """
        if isinstance(matrices, Tensor):
            return cls(_metric_of_targets(matrices, "targets"))
        return cls(lambda places: _metric_of_targets(matrices(places), "the target function's result"))

    @classmethod
    def from_triangles(cls, batch: MeshBatch, matrices: Tensor) -> "MetricField":
        """The metric of target matrices W (T, 2, 2), one a triangle of the batch: the mean of those round each vertex.

        Each is scaled to determinant 1 first.  Raises InvalidMeshError, naming the row, where det W is not positive.
        """
        if len(matrices) != len(batch.triangles):
            raise InvalidMeshError(
                f"targets must be {len(batch.triangles)} matrices, one a triangle, not {len(matrices)}"
            )
        return cls(_mean_at_vertices(batch, _metric_of_targets(matrices, "targets")))

    @classmethod
    def stretched(
        cls,
        direction: Tensor | Callable[[Tensor], Tensor],
        aspect: float | Tensor | Callable[[Tensor], Tensor],
    ) -> "MetricField":
        """The metric of triangles `aspect` times as long in `direction` as they are wide.

        direction  (V, 2) of any length, or a function of places (N, 2) to (N, 2); where it is 0, equilateral
        aspect     a number, (V,), or a function of places to (N,), all positive

        I + (1 / aspect^2 - 1) d d^T, d the direction of length 1.  Raises ValueError for a number or tensor that is
        not positive; what a function returns is checked where it is used.
        """
        if not callable(aspect) and not bool((torch.as_tensor(aspect) > 0).all()):
            raise ValueError(f"MetricField.stretched needs a positive aspect, not {aspect}")
        if not callable(direction) and not callable(aspect):
            return cls(_stretching(direction, torch.as_tensor(aspect)))

        def metric(places: Tensor) -> Tensor:
            there = direction(places) if callable(direction) else direction
            ratio = aspect(places) if callable(aspect) else torch.as_tensor(aspect, device=places.device)
            return _stretching(there, ratio)

        return cls(metric)

    def at_vertices(self, batch: MeshBatch) -> Tensor:
        """(V, 3) float64 entries of the metric at the batch's vertices, scaled to determinant 1.

        Raises InvalidMeshError, naming the vertex, where it is not positive definite.
        """
        values, count = self.values, len(batch.points)
        name = "MetricField.values"
        if not isinstance(values, Tensor):
            values, name = values(batch.points), "the metric function's result"
        if values.shape not in ((count, 3), (count, 2, 2)):
            raise InvalidMeshError(f"{name} must be ({count}, 3) or ({count}, 2, 2), not {tuple(values.shape)}")
        values = values.to(batch.points.device, torch.float64)
        if values.ndim == 3:
            skew = (values[:, 0, 1] - values[:, 1, 0]).abs() > _ROUNDING * values.abs().amax((1, 2))
            if bool(skew.any()):
                row = int(skew.nonzero()[0])
                raise InvalidMeshError(f"{name} row {row} is {values[row].tolist()}: a metric is symmetric")
            mean = 0.5 * values[:, 0, 1] + 0.5 * values[:, 1, 0]
            values = torch.stack([values[:, 0, 0], mean, values[:, 1, 1]], 1)
        # Near 1 before it is squared.
        size = (values[:, 0] + values[:, 2])[:, None]
        values = values / torch.where(size > 0, size, 1.0)
        determinant = values[:, 0] * values[:, 2] - values[:, 1] * values[:, 1]
        bad = ~((size[:, 0] > 0) & (values[:, 0] > 0) & (determinant > 0) & values.isfinite().all(1))
        if bool(bad.any()):
            row = int(bad.nonzero()[0])
            raise InvalidMeshError(
                f"mesh {int(vertex_mesh(batch)[row])}: {name} row {row} is not positive definite "
                "(or so thin that it rounds to that)"
            )
        return values / determinant.sqrt()[:, None]


Targets = Tensor | MetricField


# Places (N, 2) to target matrices (N, 2, 2).
TargetFunction = Callable[[Tensor], Tensor]


def target_from(reference: MeshBatch) -> Tensor:
    """(T, 2, 2) the triangles of `reference` as target matrices, for `SmoothOptions(targets=...)`.

    For a batch with the same triangles in the same order: the mesh before it was deformed, say.
    Raises InvalidMeshError, naming the row, where a triangle is not upright.
    """
    fallen = ~upright(reference)
    if bool(fallen.any()):
        row = int(fallen.nonzero()[0])
        raise InvalidMeshError(
            f"mesh {int(triangle_mesh(reference)[row])}: triangles row {row} is inverted, so it is no target; "
            "improve the reference first"
        )
    a, b, c = reference.points.to(torch.float64)[reference.triangles].unbind(1)
    return torch.stack([b - a, c - a], 2)


def metric_from(reference: MeshBatch, moved: MeshBatch | None = None) -> MetricField:
    """The metric in which the triangles of `reference` are nearly equilateral, at its vertices.

    moved  the same triangles after a deformation: the metric keeps its anisotropy, and turns so that
           triangles are long in the direction in which the deformed ones are.  A layer of thin
           triangles follows a wall that bends, whatever shear the deformation brought

    At each vertex the mean over its triangles of the metric in which that triangle is equilateral,
    M = E^-T W^T W E^-1 with W the equilateral triangle, each scaled to determinant 1.  Raises
    InvalidMeshError as `target_from` does, and when `moved` has other triangles.
    """
    metric = _metric_of_targets(target_from(reference), "targets")
    if moved is not None:
        if not torch.equal(reference.triangles, moved.triangles):
            raise InvalidMeshError("metric_from needs a moved mesh with the reference's triangles, in their order")
        a, b, c = moved.points.to(torch.float64)[moved.triangles].unbind(1)
        metric = _turned(metric, _equilateral_metric(torch.stack([b - a, c - a], 2)))
    return MetricField(_mean_at_vertices(reference, metric))


def _mean_at_vertices(batch: MeshBatch, metric: Tensor) -> Tensor:
    """(V, 3) a multiple of the mean of the metrics (T, 3) of the triangles round each vertex."""
    total = metric.new_zeros((len(batch.points), 3))
    for corner in range(3):
        total.index_add_(0, batch.triangles[:, corner], metric)
    # Vertices of no triangle have any metric.
    total[total[:, 0] == 0] = total.new_tensor([1.0, 0.0, 1.0])
    return total


def _metric_of_targets(matrices: Tensor, name: str) -> Tensor:
    """(N, 3) the metrics of determinant 1 in which triangles with the matrices W (N, 2, 2) are equilateral."""
    if matrices.ndim != 3 or matrices.shape[1:] != (2, 2):
        raise InvalidMeshError(f"{name} must be (N, 2, 2), not {tuple(matrices.shape)}")
    w = matrices.to(torch.float64)
    size = w.abs().amax((1, 2))
    unit = w / torch.where(size > 0, size, 1.0)[:, None, None]
    determinant = unit[:, 0, 0] * unit[:, 1, 1] - unit[:, 0, 1] * unit[:, 1, 0]
    bad = ~(determinant > 0)
    if bool(bad.any()):
        row = int(bad.nonzero()[0])
        raise InvalidMeshError(
            f"{name} row {row} is {matrices[row].tolist()}: the determinant of a target matrix must be positive"
        )
    metric = _equilateral_metric(w)
    determinant = metric[:, 0] * metric[:, 2] - metric[:, 1] * metric[:, 1]
    return metric / determinant.sqrt()[:, None]


def _stretching(direction: Tensor, aspect: Tensor) -> Tensor:
    """(N, 3) I + (1 / aspect^2 - 1) d d^T."""
    if direction.ndim != 2 or direction.shape[1] != 2:
        raise InvalidMeshError(f"directions must be (N, 2), not {tuple(direction.shape)}")
    d = direction.to(torch.float64)
    largest = d.abs().amax(1, keepdim=True)
    d = d / torch.where(largest > 0, largest, 1.0)
    x, y = d.unbind(1)
    square = x * x + y * y
    factor = (1 / aspect.to(d).square() - 1) / torch.where(square > 0, square, 1.0)
    return torch.stack([1 + factor * x * x, factor * x * y, 1 + factor * y * y], 1)


def _equilateral_metric(edges: Tensor) -> Tensor:
    """(T, 3) a metric in which the triangles of `edges` (T, 2, 2) are equilateral, of any size.

    The adjugate of E C E^T with C = [[1, -1/2], [-1/2, 1]], which is W^-1 W^-T up to a factor.
    """
    size = edges.abs().amax((1, 2))
    e = edges / torch.where(size > 0, size, 1.0)[:, None, None]
    e1x, e1y, e2x, e2y = e[:, 0, 0], e[:, 1, 0], e[:, 0, 1], e[:, 1, 1]
    return torch.stack(
        [
            e1y * e1y + e2y * e2y - e1y * e2y,
            -(e1x * e1y + e2x * e2y - 0.5 * (e1x * e2y + e2x * e1y)),
            e1x * e1x + e2x * e2x - e1x * e2x,
        ],
        1,
    )


def _turned(metric: Tensor, direction: Tensor) -> Tensor:
    """(T, 3) metrics with the eigenvalues of `metric` and the eigenvectors of `direction`, each (T, 3).

    A symmetric matrix is its half trace times I plus a deviator, whose size is half the difference
    of the eigenvalues and whose ratio of entries tells the directions.
    """
    half_trace, own = 0.5 * (metric[:, 0] + metric[:, 2]), 0.5 * (metric[:, 0] - metric[:, 2])
    size = (own * own + metric[:, 1] * metric[:, 1]).sqrt()
    plain, oblique = 0.5 * (direction[:, 0] - direction[:, 2]), direction[:, 1]
    there = (plain * plain + oblique * oblique).sqrt()
    factor = size / torch.where(there > 0, there, 1.0)
    plain, oblique = torch.where(there > 0, factor * plain, own), torch.where(there > 0, factor * oblique, metric[:, 1])
    return torch.stack([half_trace + plain, oblique, half_trace - plain], 1)


def target_quality(batch: MeshBatch, targets: Targets) -> Tensor:
    """(T,) inverse mean ratio towards the targets: 1 for an ideal triangle, infinite for a flat one.

    As `quality(batch).inverse_mean_ratio` is towards equilateral ones.
    """
    t = corners(batch.points.to(torch.float64), batch.triangles)
    if isinstance(targets, MetricField):
        return inverse_mean_ratio(_stretched(t, _roots(targets.at_vertices(batch), batch.triangles)))
    target = _target(batch, targets)
    e1x, e1y, e2x, e2y = t.bx - t.ax, t.by - t.ay, t.cx - t.ax, t.cy - t.ay
    stretch = target.g11 * (e1x * e1x + e1y * e1y) + target.g22 * (e2x * e2x + e2y * e2y)
    stretch = stretch + 2 * target.g12 * (e1x * e2x + e1y * e2y)
    det = target.m * (e1x * e2y - e1y * e2x).abs()
    return torch.where(det > 0, stretch / (2 * torch.where(det > 0, det, 1.0)), torch.inf)


def as_targets(targets: Targets | TargetFunction | None) -> Targets | None:
    """A function of places to target matrices as its metric; all else as it is."""
    return MetricField.from_targets(targets) if callable(targets) else targets


def check(targets: object) -> None:
    """Raise ValueError unless these are targets, as far as can be told without a batch."""
    if isinstance(targets, MetricField) or (isinstance(targets, Tensor) and targets.shape[1:] == (2, 2)):
        return
    said = tuple(targets.shape) if isinstance(targets, Tensor) else type(targets).__name__
    raise ValueError(
        "SmoothOptions.targets must be a (T, 2, 2) tensor of target matrices, a function of places to such, or a "
        f"MetricField, not {said}; for a mesh as target use target_from(mesh) or metric_from(mesh)"
    )


def check_topology(targets: Targets | TargetFunction | None, topology: str) -> None:
    """Raise ValueError where `improve` may change the triangles in ways that these targets do not bear."""
    if isinstance(targets, Tensor) and topology != "keep":
        raise ValueError(
            "ImproveOptions.smooth.targets are matrices of triangles, which do not last when edges flip: "
            "set topology='keep', or give a MetricField (metric_from, MetricField.from_triangles)"
        )


def narrow(targets: Targets | None, batch: MeshBatch, at: Tensor) -> Targets | None:
    """The targets for `batch.select(at)`."""
    if isinstance(targets, Tensor):
        return targets.to(at.device)[spread(at, batch.triangle_offsets)]
    if isinstance(targets, MetricField) and isinstance(targets.values, Tensor):
        return MetricField(targets.values.to(at.device)[spread(at, batch.point_offsets)])
    return targets


def _target(batch: MeshBatch, matrices: Tensor) -> Target:
    """The (T, 2, 2) target matrices, checked, as the kernel's coefficients; sizes fall out."""
    count = len(batch.triangles)
    if matrices.shape != (count, 2, 2):
        raise InvalidMeshError(f"targets must be ({count}, 2, 2), one matrix a triangle, not {tuple(matrices.shape)}")
    w = matrices.to(batch.points.device, torch.float64)
    w = w / w.abs().amax((1, 2)).clamp_min(1e-300)[:, None, None]
    zero = torch.zeros_like(w[:, 0, 0])
    t = Corners(zero, zero, w[:, 0, 0], w[:, 1, 0], w[:, 0, 1], w[:, 1, 1])
    area = signed_area(t)
    bad = ~(area > 0)
    if bool(bad.any()):
        row = int(bad.nonzero()[0])
        raise InvalidMeshError(
            f"mesh {int(triangle_mesh(batch)[row])}: targets row {row} is {matrices[row].tolist()}: "
            "the determinant of a target matrix must be positive"
        )
    size = (4 / SQRT3 * area).sqrt()
    return target_of(Corners(*(v / size for v in t)))


def _roots(metric: Tensor, triangles: Tensor) -> Tensor:
    """(T, 3) entries h11, h12, h22 of the square roots of the triangles' metrics, the mean of their corners'."""
    return _root(sum(metric[triangles[:, corner]] for corner in range(3)))  # type: ignore[arg-type]


def _root(metric: Tensor) -> Tensor:
    """(N, 3) square roots of symmetric matrices M, up to scale: M + sqrt(det M) I (Cayley & Hamilton), det 1."""
    determinant = (metric[:, 0] * metric[:, 2] - metric[:, 1] * metric[:, 1]).sqrt()
    root = torch.stack([metric[:, 0] + determinant, metric[:, 1], metric[:, 2] + determinant], 1)
    size = (root[:, 0] * root[:, 2] - root[:, 1] * root[:, 1]).sqrt()
    return root / size[:, None]


def _stretched(t: Corners, root: Tensor) -> Corners:
    """The triangles as the metric sees them, their corners counted from a."""
    h11, h12, h22 = root.unbind(1)
    e1x, e1y, e2x, e2y = t.bx - t.ax, t.by - t.ay, t.cx - t.ax, t.cy - t.ay
    zero = torch.zeros_like(e1x)
    return Corners(
        zero, zero, h11 * e1x + h12 * e1y, h12 * e1x + h22 * e1y, h11 * e2x + h12 * e2y, h12 * e2x + h22 * e2y
    )
