"""The scales and targets that losses take from a batch: constants, which torch.compile does not look into.

Each is an operator of torch (`torch.library.custom_op`), so that a compiled loss is one graph whatever it takes to
compute them.
"""

import functools
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.measure import refuse_inverted
from ..mesh.ragged import counts_from_offsets, segment_sum, spread
from ..mesh.triangle import SQRT3, corners, signed_area
from ..optimising.jacobian import target_of
from ..untangling.local_size import local_size
from .mesh_buffers import MESH_FIELDS

# The fields of a mesh but its points.
_OTHERS = tuple(name for name in MESH_FIELDS if name != "points")


def mean_side(mesh: MeshBatch) -> Tensor:
    """(T,) float64 the side of the equilateral triangle that has the mean absolute area of the mesh."""
    return _mean_side(_tensors(mesh))


def own_targets(mesh: MeshBatch) -> Tensor:
    """(4, T) float64 the coefficients (`Target`) of each triangle as the target of itself.

    Raises InvalidMeshError where one is inverted.
    """
    return _own_targets(_tensors(mesh))


def local_sides(mesh: MeshBatch) -> Tensor:
    """(T,) float64 the local edge length of the mesh at each triangle; `mean_side` where no area is enclosed."""
    return _local_sides(_tensors(mesh))


def _tensors(mesh: MeshBatch) -> list[Tensor]:
    # The points are constants here, whatever they are elsewhere.
    return [mesh.points.detach(), *(getattr(mesh, name) for name in _OTHERS)]


def _mesh(tensors: list[Tensor]) -> MeshBatch:
    fields: dict[str, Any] = dict(zip(("points", *_OTHERS), tensors, strict=True))
    return MeshBatch(**fields)


def _remembered(compute: Callable[[list[Tensor]], Tensor]) -> Callable[[list[Tensor]], Tensor]:
    """`compute`, which gives the last result again for the same tensors with the same values.

    A network is mostly trained on one batch of meshes for many steps, or sees each batch several times in one.  Tensors
    are the same if they lie at the same place in memory, which they keep as long as they are remembered, and if torch
    counts no change of them since.
    """
    last: list[tuple[list[Tensor], list[int], Tensor]] = []

    @functools.wraps(compute)
    def again(mesh: list[Tensor]) -> Tensor:
        if any(tensor.is_inference() for tensor in mesh):
            return compute(mesh)  # torch counts no changes of these
        versions = [tensor._version for tensor in mesh]
        for tensors, known, result in last:
            if known == versions and all(map(_in_one_place, tensors, mesh)):
                return result.clone()
        result = compute(mesh)
        last[:] = [(list(mesh), versions, result)]
        # The compiler may write into what an operator returned.
        return result.clone()

    return again


def _in_one_place(a: Tensor, b: Tensor) -> bool:
    """Whether two tensors are views of the same numbers in the same order."""
    views = ((t.data_ptr(), t.shape, t.stride(), t.dtype, t.device) for t in (a, b))
    return next(views) == next(views)


@torch.library.custom_op("torchmesh::mean_side", mutates_args=())
@_remembered
def _mean_side(mesh: list[Tensor]) -> Tensor:
    batch = _mesh(mesh)
    area = signed_area(corners(batch.points.to(torch.float64), batch.triangles)).abs()
    offsets = batch.triangle_offsets
    mean = segment_sum(area, offsets) / counts_from_offsets(offsets)
    return spread(torch.where(mean > 0, (mean * (4 / SQRT3)).sqrt(), 1.0), offsets)


@torch.library.custom_op("torchmesh::own_targets", mutates_args=())
@_remembered
def _own_targets(mesh: list[Tensor]) -> Tensor:
    batch = _mesh(mesh)
    refuse_inverted(batch, ", so it is no reference; give the undeformed mesh, or reference=False")
    return torch.stack(list(target_of(corners(batch.points.to(torch.float64), batch.triangles))))  # type: ignore[arg-type]


@torch.library.custom_op("torchmesh::local_sides", mutates_args=())
@_remembered
def _local_sides(mesh: list[Tensor]) -> Tensor:
    batch = _mesh(mesh)
    sides = local_size(batch)[batch.triangles].mean(1)
    return torch.where(sides > 0, sides, mean_side(batch))


def _one_per_triangle(mesh: list[Tensor]) -> Tensor:
    """What the operators give, as far as a compiler needs to know it."""
    return mesh[0].new_empty(_mesh(mesh).triangles.shape[0], dtype=torch.float64)


_mean_side.register_fake(_one_per_triangle)
_local_sides.register_fake(_one_per_triangle)
_own_targets.register_fake(lambda mesh: mesh[0].new_empty((4, _mesh(mesh).triangles.shape[0]), dtype=torch.float64))
