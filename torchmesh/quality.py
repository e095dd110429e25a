"""How good a mesh is: areas, shapes, angles, per triangle and per mesh."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from . import triangle
from .mesh import MeshBatch
from .predicates import orientation
from .segments import counts_from_offsets, segment_count, segment_max, segment_min, segment_sum, spread
from .triangle import corners, inverse_mean_ratio, signed_area


@dataclass(frozen=True, eq=False)
class Quality:
    """The quality of a batch; (T,) per triangle, (B,) per mesh.

    area                (T,) signed, in the mesh's unit squared
    inverse_mean_ratio  (T,) 1 for an equilateral triangle, infinite for a flat one
    upright             (T,) bool, area positive by exact sign
    mean, max           (B,) of the inverse mean ratio, over all triangles
    inverted            (B,) int64, triangles that are not upright: area negative or zero
    """

    area: Tensor
    inverse_mean_ratio: Tensor
    upright: Tensor
    mean: Tensor
    max: Tensor
    inverted: Tensor

    def put(self, at: Tensor, triangle_offsets: Tensor, part: "Quality") -> "Quality":
        """This quality with that of the meshes `at` (B,) bool replaced by `part`."""
        if len(part.mean) == len(self.mean):
            return part
        rows = spread(at, triangle_offsets)

        def put(whole: Tensor, where: Tensor, values: Tensor) -> Tensor:
            whole = whole.clone()
            whole[where] = values
            return whole

        return Quality(
            put(self.area, rows, part.area),
            put(self.inverse_mean_ratio, rows, part.inverse_mean_ratio),
            put(self.upright, rows, part.upright),
            put(self.mean, at, part.mean),
            put(self.max, at, part.max),
            put(self.inverted, at, part.inverted),
        )


def quality(batch: MeshBatch) -> Quality:
    """Measure a batch; inverted triangles count with the shape of their mirror image (Kim 2017)."""
    t = corners(batch.points.to(torch.float64), batch.triangles)
    ratio = inverse_mean_ratio(t)
    upright = orientation(*t) > 0
    offsets = batch.triangle_offsets
    return Quality(
        area=signed_area(t),
        inverse_mean_ratio=ratio,
        upright=upright,
        mean=segment_sum(ratio, offsets) / counts_from_offsets(offsets),
        max=segment_max(ratio, offsets),
        inverted=segment_count(~upright, offsets),
    )


def upright(batch: MeshBatch) -> Tensor:
    """(T,) bool: the triangle's area is positive, by exact sign."""
    return orientation(*corners(batch.points, batch.triangles)) > 0


def minimum_angle(batch: MeshBatch) -> Tensor:
    """(B,) smallest unsigned angle of each mesh, in degrees."""
    angle = triangle.minimum_angle(corners(batch.points.to(torch.float64), batch.triangles))
    return segment_min(angle, batch.triangle_offsets) * (180 / math.pi)
