"""What the triangles of a layer should look like: shapes and sizes, both of which may be learnt."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch, triangle_mesh
from ..mesh.ragged import spread
from ..mesh.triangle import SQRT3
from ..optimising.energies import Energy, Regularised
from ..smoothing.smoothing import SmoothOptions


@dataclass(frozen=True, eq=False)
class Aims:
    """The aims of a forward pass; a tensor among them may require a gradient.

    targets       (T, 2, 2) target matrices, of which the shapes count; None: equilateral
    sizes         (T,) or (V,) edge lengths in the batch's unit; None: sizes do not count
    of_triangles  whether `sizes` are those of triangles
    weight        of area against shape, between 0 and 1, where there are sizes
    """

    targets: Tensor | None = None
    sizes: Tensor | None = None
    of_triangles: bool = False
    weight: float = 0.0

    @classmethod
    def of(cls, mesh: MeshBatch, targets: Tensor | None, sizes: Tensor | None, weight: float) -> "Aims":
        """The aims, checked against the batch.  Raises InvalidMeshError, naming mesh and row."""
        triangles, vertices = len(mesh.triangles), len(mesh.points)
        if targets is not None:
            if not isinstance(targets, Tensor) or targets.shape != (triangles, 2, 2):
                raise InvalidMeshError(f"targets must be a ({triangles}, 2, 2) tensor, not {_said(targets)}")
            bad = ~(torch.linalg.det(targets.detach().to(torch.float64)) > 0)
            if bool(bad.any()):
                row = int(bad.nonzero()[0])
                raise InvalidMeshError(
                    f"mesh {int(triangle_mesh(mesh)[row])}: targets row {row} is {targets[row].tolist()}: the "
                    "determinant of a target matrix must be positive"
                )
        if sizes is not None:
            if not isinstance(sizes, Tensor) or sizes.shape not in ((triangles,), (vertices,)):
                raise InvalidMeshError(f"sizes must be a ({triangles},) or ({vertices},) tensor, not {_said(sizes)}")
            bad = ~((sizes.detach() > 0) & sizes.detach().isfinite())
            if bool(bad.any()):
                row = int(bad.nonzero()[0])
                raise InvalidMeshError(f"sizes row {row} is {float(sizes[row])}: sizes must be positive numbers")
        of_triangles = sizes is not None and sizes.shape == (triangles,) and triangles != vertices
        return cls(targets, sizes, of_triangles, weight)

    def select(self, mesh: MeshBatch, keep: Tensor) -> "Aims":
        """The aims of `mesh.select(keep)`."""
        offsets = mesh.triangle_offsets if self.of_triangles else mesh.point_offsets
        targets = None if self.targets is None else self.targets[spread(keep, mesh.triangle_offsets)]
        sizes = None if self.sizes is None else self.sizes[spread(keep, offsets)]
        return Aims(targets, sizes, self.of_triangles, self.weight)

    def energy(self, options: SmoothOptions) -> Energy:
        """What is minimised: the sum of q^p, or with sizes the limit, for eps to 0, of the regularised functional."""
        return options.energy if self.sizes is None else Regularised(0.0, self.weight)

    def coefficients(self, mesh: MeshBatch) -> Tensor | None:
        """(4, T) float64 g11, g12, g22 and m of the targets (`jacobian.Target`), differentiable; None: equilateral."""
        if self.targets is None and self.sizes is None:
            return None
        count = len(mesh.triangles)
        if self.targets is None:
            shape = mesh.points.new_tensor([4 / 3, -2 / 3, 4 / 3], dtype=torch.float64)[:, None].expand(3, count)
        else:
            w = self.targets.to(mesh.points.device, torch.float64)
            (a, b), (c, d) = w.unbind(1)[0].unbind(1), w.unbind(1)[1].unbind(1)
            det = a * d - b * c
            # Scaled to the area of the equilateral triangle of side 1, whose det is sqrt(3) / 2.
            scale = 2 / SQRT3 / det
            shape = torch.stack([b * b + d * d, -(a * b + c * d), a * a + c * c]) * scale
        side = self._of_triangles(mesh)
        return torch.cat([shape, shape.new_full((1, count), 2 / SQRT3)]) / (side * side)

    def _of_triangles(self, mesh: MeshBatch) -> Tensor:
        """(T,) or (1,) the edge length that each triangle should have; 1 where sizes do not count."""
        if self.sizes is None:
            return mesh.points.new_ones(1, dtype=torch.float64)
        sizes = self.sizes.to(mesh.points.device, torch.float64)
        return sizes if self.of_triangles else sizes[mesh.triangles].mean(1)


def _said(value: object) -> str:
    return str(tuple(value.shape)) if isinstance(value, Tensor) else type(value).__name__
