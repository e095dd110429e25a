"""The edges and the closed curves of a mesh's boundary."""

from __future__ import annotations

from torch import Tensor

from torchmesh.mesh import connectivity


def edges(triangles: Tensor) -> Tensor:
    """(E, 2) the directed boundary edges, the mesh on their left."""
    return connectivity.boundary_edges(triangles, connectivity.twins(triangles))


def loops(triangles: Tensor) -> list[Tensor]:
    """The vertices along each closed curve of the boundary, in order, the mesh on the left."""
    return connectivity.boundary_loops(edges(triangles))
