"""The judge: what a method made of a case, by exact signs and by counting, without torchmesh's own checks.

A result is valid if every triangle (and every corner of a quad) is counter-clockwise by exact signs, the boundary, the
fixed vertices and the interfaces between regions are where they were, the Euler number is
the same, and no edge has two triangles on one side.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..mesh.batch import MeshBatch
from ..mesh.means import vertex_size
from ..mesh.measure import minimum_angle, quality
from . import exact_check
from .case import Case

Array = np.ndarray


@dataclass(frozen=True)
class Verdict:
    """What the judge found.

    valid          whether the result is a valid mesh of the same domain
    fault          what is wrong, in words; "" if nothing is
    inverted       triangles, and corners of quads, that are inverted or flat
    mean, max      the inverse mean ratio of the triangles; infinite with one that is inverted
    minimum_angle  in degrees
    fields_kept    whether values at vertices still fit: there are as many vertices, the fixed ones in their rows
    cells_kept     whether values in triangles still fit: the triangles are the same, row by row
    travel_median  how far free vertices went from where they were given, in mean edge lengths there: the median.
                   None where the fields are not kept, so that it cannot be told
    travel_max     the same, of the vertex that went furthest
    """

    valid: bool
    fault: str
    inverted: int
    mean: float
    max: float
    minimum_angle: float
    fields_kept: bool
    cells_kept: bool
    travel_median: float | None
    travel_max: float | None


def judge(case: Case | MeshBatch, after: Any) -> Verdict:
    """Judge `after` as what a method made of the tangled mesh of a case.  It may be anything: a fault is told."""
    given = case.mesh if isinstance(case, Case) else case
    fault = unfit(after)
    if fault:
        return Verdict(False, fault, 0, np.inf, np.inf, 0.0, False, False, None, None)
    faults = exact_check.faults(given, after) + lost_interfaces(given, after) + folded_quads(given, after)
    measured = quality(after)
    rows = len(after.points) == len(given.points) and torch.equal(after.points[given.fixed], given.points[given.fixed])
    median, largest = _travel(given, after) if rows else (None, None)
    return Verdict(
        not faults,
        "; ".join(faults),
        exact_check.inverted(after.points.numpy(), after.triangles.numpy()),
        float(measured.mean),
        float(measured.max),
        float(minimum_angle(after)),
        rows,
        rows and torch.equal(after.triangles, given.triangles) and torch.equal(after.quads, given.quads),
        median,
        largest,
    )


def unfit(after: Any) -> str:
    """What keeps the answer from being a mesh at all, in words; "" if it is one."""
    if not isinstance(after, MeshBatch):
        return f"no MeshBatch but {type(after).__name__}"
    if len(after) != 1:
        return f"{len(after)} meshes, not one"
    if after.points.dtype != torch.float64 or after.points.device.type != "cpu":
        return f"points are {after.points.dtype} on {after.points.device}, not float64 on the CPU"
    if not bool(torch.isfinite(after.points).all()):
        return "positions that are not finite"
    if len(after.triangles) and not 0 <= int(after.triangles.min()) <= int(after.triangles.max()) < len(after.points):
        return "triangles of vertices that are not there"
    return ""


def lost_interfaces(given: MeshBatch, after: MeshBatch) -> list[str]:
    """In words, whether an edge between two regions is no edge any more."""
    if not len(given.constrained_edges):
        return []
    wanted = _edges_by_position(given.points, given.constrained_edges)
    corner = after.triangles
    sides = torch.cat([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]])
    lost = len(wanted - _edges_by_position(after.points, sides))
    return [f"{lost} edges between regions are gone"] if lost else []


def folded_quads(given: MeshBatch, after: MeshBatch) -> list[str]:
    """In words, whether quads are gone or have a corner that is inverted or flat."""
    before, now = given.quads, after.quads
    if len(before) != len(now):
        return [f"{len(before)} quads became {len(now)}"]
    if not len(now):
        return []
    corners = torch.cat([now.roll(k, 1)[:, :3] for k in range(4)])
    folded = exact_check.inverted(after.points.numpy(), corners.numpy())
    return [f"{folded} corners of quads inverted or flat"] if folded else []


def _edges_by_position(points: torch.Tensor, edges: torch.Tensor) -> set[frozenset[tuple[float, ...]]]:
    """The edges as pairs of positions, which do not depend on the rows of vertices."""
    return {frozenset((tuple(a), tuple(b))) for a, b in points[edges].tolist()}


def _travel(given: MeshBatch, after: MeshBatch) -> tuple[float, float]:
    """The median and the largest distance of free vertices from where they were given, in local edge lengths there."""
    free = ~given.fixed
    if not bool(free.any()):
        return 0.0, 0.0
    size = vertex_size(given)[free]
    far = torch.linalg.vector_norm(after.points - given.points, dim=1)[free] / torch.where(size > 0, size, 1.0)
    return float(far.median()), float(far.max())
