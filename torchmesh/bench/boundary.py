"""The edges and the closed curves of a mesh's boundary."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from ..mesh import connectivity


def edges(triangles: Tensor) -> Tensor:
    """(E, 2) the directed boundary edges, the mesh on their left."""
    return connectivity.boundary_edges(triangles, connectivity.twins(triangles))


def loops(triangles: Tensor) -> list[Tensor]:
    """The vertices along each closed curve of the boundary, in order, the mesh on the left."""
    return connectivity.boundary_loops(edges(triangles))


def polygon_area(polygon: np.ndarray) -> float:
    """The signed area inside a closed polyline (n, 2)."""
    x, y = polygon.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
