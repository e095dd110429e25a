"""Meshes with layers of thin triangles at their walls."""

import numpy as np
import torch

from torchmesh import MeshBatch


def heights(rows: int, first: float, growth: float) -> np.ndarray:
    """(rows + 1,) how high above the wall the vertices of each row stand."""
    return np.concatenate([[0.0], np.cumsum(first * growth ** np.arange(rows))])


def flat_layer(columns: int = 10, rows: int = 16, first: float = 1e-4, growth: float = 1.6) -> MeshBatch:
    """A layer over the straight wall y = 0 from 0 to 1; vertex j (columns + 1) + i is in column i and row j."""
    width = columns + 1
    points = np.array([[i / columns, y] for y in heights(rows, first, growth) for i in range(width)])
    lower = np.array([j * width + i for j in range(rows) for i in range(columns)])
    u, w, x, y = lower, lower + 1, lower + width + 1, lower + width
    return MeshBatch.from_arrays(points, np.concatenate([np.stack([u, w, x], 1), np.stack([u, x, y], 1)]))


def round_body(
    sides: int = 24, rows: int = 8, first: float = 1e-4, growth: float = 1.8, around: int = 6, far: float = 4.0
) -> MeshBatch:
    """A layer round the unit circle, in the middle of a disc whose rings grow up to the radius `far`.

    Vertex j sides + i is in column i and row j; the first `sides` vertices are the wall.  Diagonals lie both ways.
    """
    radii = 1 + heights(rows, first, growth)
    radii = np.concatenate([radii, np.geomspace(radii[-1], far, around + 1)[1:]])
    angle = -2 * np.pi * np.arange(sides) / sides
    points = np.concatenate([r * np.stack([np.cos(angle), np.sin(angle)], 1) for r in radii])
    triangles = []
    for j in range(len(radii) - 1):
        for i in range(sides):
            u, w = j * sides + i, j * sides + (i + 1) % sides
            y, x = u + sides, w + sides
            triangles += [(u, w, x), (u, x, y)] if i % 2 else [(u, w, y), (w, x, y)]
    return MeshBatch.from_arrays(points, np.array(triangles))


def turned_body(mesh: MeshBatch, sides: int, degrees: float, shift: tuple[float, float] = (0.0, 0.0)) -> MeshBatch:
    """`mesh` with its first `sides` vertices, the wall, turned about the origin and shifted; the others stay."""
    angle = np.radians(degrees)
    turn = torch.tensor([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    points = mesh.points.clone()
    points[:sides] = points[:sides] @ turn + torch.tensor(shift, dtype=torch.float64)
    return mesh.with_points(points)


def first_heights(mesh: MeshBatch, sides: int) -> torch.Tensor:
    """(N,) the heights of the triangles that stand on an edge of the wall, whose vertices are the first `sides`."""
    t = mesh.triangles[(mesh.triangles < sides).sum(1) == 2]
    a, b, c = mesh.points[t].unbind(1)
    on = t < sides
    double = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).abs()
    ends = torch.stack([mesh.points[row[mask]] for row, mask in zip(t, on, strict=True)])
    return double / (ends[:, 1] - ends[:, 0]).norm(dim=1)
