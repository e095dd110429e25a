"""Which boxes of two sets touch, mesh by mesh: the candidates for everything exact that follows."""

from dataclasses import dataclass

import numpy as np
import torch

from ..kernels.library import library
from ..kernels.overlaps import touching_boxes as compiled
from ..mesh.batch import MeshBatch, triangle_mesh, vertex_mesh
from ..mesh.ragged import counts_from_offsets
from ..mesh.units import centre_and_unit

# Meshes stand side by side in the search tree, this far apart in units of their half extents.
_SPACING = 8.0

# Boxes are widened by this part of the half extent, which is far above the rounding of their positions in the tree.
# Each pair is then tested in the coordinates of its mesh.
_MARGIN = 1e-9


@dataclass(frozen=True, eq=False)
class Side:
    """One of the two batches, in numpy and in units of length near the extent of each mesh.

    x, y       (V,) float64 coordinates over the unit of the mesh, which is a power of two: nothing is rounded
    triangles  (T, 3) rows of the vertices
    vertex     (V,) the mesh of each vertex
    triangle   (T,) the mesh of each triangle
    centre     (B, 2) the middle of the mesh *before*, in these units
    slack      (B,) distances of this size are rounding
    """

    x: np.ndarray
    y: np.ndarray
    triangles: np.ndarray
    vertex: np.ndarray
    triangle: np.ndarray
    centre: np.ndarray
    slack: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """(V, 2) the coordinates."""
        return np.stack([self.x, self.y], 1)

    def triangle_boxes(self) -> tuple[np.ndarray, np.ndarray]:
        """(T, 2) the lower left and the upper right corners of the boxes round the triangles."""
        # Column by column: numpy is slow at the least of three numbers in each row.
        low, high = (np.empty((len(self.triangles), 2)) for _ in range(2))
        for k, coordinate in enumerate((self.x, self.y)):
            a, b, c = (coordinate[corner] for corner in self.triangles.T)
            low[:, k] = np.minimum(np.minimum(a, b), c)
            high[:, k] = np.maximum(np.maximum(a, b), c)
        return low, high


def both_sides(before: MeshBatch, after: MeshBatch) -> tuple[Side, Side]:
    """The two batches in the units of the meshes of `before`."""
    centre, unit = centre_and_unit(_of_triangles(before), before.point_offsets.cpu())
    centre = torch.where(counts_from_offsets(before.point_offsets.cpu())[:, None] > 0, centre, 0.0) / unit[:, None]
    sides = []
    largest = torch.ones(len(before), dtype=torch.float64)
    for batch in (before, after):
        vertex, triangle = vertex_mesh(batch).cpu(), triangle_mesh(batch).cpu()
        given, used = batch.points.detach().cpu().to(torch.float64), _of_triangles(batch)
        points = torch.where(given.isfinite(), given, used) / unit[vertex][:, None]
        largest.scatter_reduce_(0, vertex, (used / unit[vertex][:, None]).abs().amax(1), "amax")
        sides.append((points, batch.triangles.cpu(), vertex, triangle))
    epsilon = max(torch.finfo(batch.points.dtype).eps for batch in (before, after))
    slack = (32 * epsilon * largest).numpy()
    one, two = (
        Side(
            points[:, 0].contiguous().numpy(), points[:, 1].contiguous().numpy(), faces.numpy(), vertex.numpy(),
            triangle.numpy(), centre.numpy(), slack,
        )
        for points, faces, vertex, triangle in sides
    )  # fmt: skip
    return one, two


def _of_triangles(batch: MeshBatch) -> torch.Tensor:
    """(V, 2) float64 the points; those of no triangle, which may be far outside or NaN, stand at a corner of one."""
    points, faces = batch.points.detach().cpu().to(torch.float64), batch.triangles.cpu()
    used = torch.zeros(len(points), dtype=torch.bool)
    used[faces.reshape(-1)] = True
    if bool(used.all()) or not len(faces):
        return points
    first = batch.triangle_offsets[:-1].cpu().clamp(max=len(faces) - 1)
    corner = points[faces[first, 0]][vertex_mesh(batch).cpu()]
    return torch.where(used[:, None], points, corner)


def touching_boxes(
    side: Side,
    here: tuple[np.ndarray, np.ndarray, np.ndarray],
    there: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """The pairs of a box of `here` and a box of `there` that touch and are of one mesh, each (P,).

    here, there  the lower left corners (N, 2), the upper right corners (N, 2) and the meshes (N,) of the boxes; those
                 of `there` are in the order of their meshes

    Pairs come in ascending order of the first and then of the second.  One tree holds the boxes of all meshes
    (shapely.STRtree: Leutenegger, Lopez & Edgington, STR: a simple and efficient algorithm for R-tree packing, 1997).
    """
    if library() is not None:
        slack = side.slack[here[2]][:, None]
        return compiled((here[0] - slack, here[1] + slack, here[2]), there, len(side.centre))
    import shapely

    placed = [_placed(side, *boxes) for boxes in (here, there)]
    i, j = shapely.STRtree(placed[1]).query(placed[0])
    near = here[2][i] == there[2][j]
    slack = side.slack[here[2]]
    for axis in (0, 1):
        near &= (here[0][:, axis] - slack)[i] <= there[1][:, axis][j]
        near &= there[0][:, axis][j] <= (here[1][:, axis] + slack)[i]
    i, j = i[near], j[near]
    order = np.argsort(i * np.int64(len(there[2])) + j, kind="stable")
    return i[order], j[order]


def _placed(side: Side, low: np.ndarray, high: np.ndarray, mesh: np.ndarray) -> np.ndarray:
    """Diagonals of the boxes, each in the column of its mesh; a line costs a quarter of what a polygon does."""
    import shapely

    margin = max(_MARGIN, 8 * np.finfo(float).eps * _SPACING * len(side.centre))
    shift = np.stack([_SPACING * mesh, np.zeros(len(mesh))], 1)
    ends = [
        np.clip(corner - side.centre[mesh], -3, 3) + shift + sign * margin for corner, sign in ((low, -1), (high, 1))
    ]
    return shapely.linestrings(np.stack(ends, 1))
