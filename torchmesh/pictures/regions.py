"""Rectangles of the plane: the view of a picture, and where its close-up is taken."""

from collections.abc import Sequence

import numpy as np
import torch

from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality

# A rectangle in the mesh's length unit: lowest x and y, highest x and y.
Box = tuple[float, float, float, float]

# The margin of a view, as a part of its longer side.
_MARGIN = 0.02

# A mesh of which nothing is inverted shows as many of its worst triangles; of inverted ones so many are looked at.
_WORST = 5
_MOST_INVERTED = 5000

# How far from one another triangles of one cluster lie, as a part of the mesh's diagonal.
_REACH = 0.05

# Half the height of a close-up: so many median triangle sides, but no less and no more than these parts of the
# diagonal.  Some ten triangles one above another show a reader where the close-up is.
_HALF_IN_SIDES = 7.5
_LEAST_HALF, _MOST_HALF = 0.01, 0.25


def corner_points(mesh: MeshBatch) -> np.ndarray:
    """(T, 3, 2) float64: the corners of every triangle; with quads (T + Q, 4, 2), where triangles end twice."""
    points, rows = mesh.points.detach().to("cpu", torch.float64).numpy(), mesh.triangles.cpu().numpy()
    if len(mesh.quads):
        rows = np.concatenate([rows[:, [0, 1, 2, 2]], mesh.quads.cpu().numpy()])
    return points[rows]


def of_elements(quality: Quality) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(T + Q,) each: the areas, the inverse mean ratios and the uprightness of triangles and then quads."""
    columns = (
        (quality.area, quality.quad_area),
        (quality.inverse_mean_ratio, quality.quad_inverse_mean_ratio),
        (quality.upright, quality.quad_upright),
    )
    area, ratio, upright = (torch.cat([one.cpu(), other.cpu()]).numpy() for one, other in columns)
    return area, ratio, upright


def view_of(*meshes: MeshBatch, more: Sequence[np.ndarray] = ()) -> Box:
    """The rectangle that holds all triangles of the meshes, and more points (N, 2), with a narrow margin."""
    boxes = [*map(_extent, meshes), *((*p.min(0).tolist(), *p.max(0).tolist()) for p in more if len(p))]
    low_x, low_y, high_x, high_y = zip(*boxes, strict=True)
    return _grown((min(low_x), min(low_y), max(high_x), max(high_y)), _MARGIN)


def worst_region(mesh: MeshBatch, quality: Quality, aspect: float = 1.0) -> Box:
    """Where to look first: a rectangle round the densest cluster of inverted triangles, or else of the worst ones.

    aspect  the rectangle's height over its width
    """
    from scipy.spatial import cKDTree

    shape = corner_points(mesh)
    bad = _worst_triangles(quality)
    extent = _extent(mesh)
    diagonal = float(np.hypot(extent[2] - extent[0], extent[3] - extent[1])) or 1.0
    reach = _REACH * diagonal
    centre = shape[bad].mean(1)
    tree = cKDTree(centre)
    neighbours = tree.query_ball_point(centre, reach, return_length=True)
    cluster = centre[tree.query_ball_point(centre[int(np.argmax(neighbours))], reach)]
    low, high = cluster.min(0), cluster.max(0)
    middle = (low + high) / 2
    near = (np.abs(shape.mean(1) - middle) <= np.maximum(high - low, reach)).all(1)
    side = float(np.sqrt(np.median(np.abs(of_elements(quality)[0])[near])))
    least = float(np.clip(_HALF_IN_SIDES * side, _LEAST_HALF * diagonal, _MOST_HALF * diagonal))
    half = np.maximum(0.75 * (high - low), least * np.array([1 / max(aspect, 1.0), 1.0]))
    return shaped((*(middle - half).tolist(), *(middle + half).tolist()), aspect)


def shaped(box: Box, aspect: float) -> Box:
    """The least box about the same middle that holds `box` and is `aspect` times as high as wide."""
    x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    width = max(box[2] - box[0], (box[3] - box[1]) / aspect)
    return x - width / 2, y - width * aspect / 2, x + width / 2, y + width * aspect / 2


def within(box: Box, view: Box) -> Box:
    """The box moved into the view, as far as it fits there."""
    dx = max(view[0] - box[0], 0.0) + min(view[2] - box[2], 0.0)
    dy = max(view[1] - box[1], 0.0) + min(view[3] - box[3], 0.0)
    return box[0] + dx, box[1] + dy, box[2] + dx, box[3] + dy


def _worst_triangles(quality: Quality) -> np.ndarray:
    """Rows of the inverted triangles, or of a few upright ones, from the worst shape on."""
    _, ratio, upright = of_elements(quality)
    bad = np.flatnonzero(~upright)
    if not len(bad):
        bad = np.argsort(-ratio, kind="stable")[:_WORST]
    return bad[np.argsort(-ratio[bad], kind="stable")][:_MOST_INVERTED]


def _extent(mesh: MeshBatch) -> Box:
    shape = corner_points(mesh).reshape(-1, 2)
    return (*shape.min(0).tolist(), *shape.max(0).tolist())


def _grown(box: Box, part: float) -> Box:
    margin = part * (max(box[2] - box[0], box[3] - box[1]) or 1.0)
    return box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin
