"""A triangulation of the vertices of a tangled mesh stays inside its boundary and keeps its interfaces."""

import exact
import meshes
import numpy as np
import pytest

from torchmesh import MeshBatch
from torchmesh.transferring.domain import domain_triangles


def triangulated(mesh: MeshBatch) -> np.ndarray:
    return domain_triangles(mesh.points.numpy(), mesh.triangles.numpy(), mesh.constrained_edges.numpy())


def double_areas(mesh: MeshBatch, triangles: np.ndarray) -> list:
    points = mesh.points.tolist()
    return [exact.double_area(*(points[v] for v in row)) for row in triangles.tolist()]


@pytest.mark.parametrize(
    "mesh",
    [meshes.jittered(8, 7, 0.6), meshes.disturbed(meshes.ring(), 0.1, 1),
     meshes.disturbed(MeshBatch.from_arrays(*meshes.holed_arrays()), 0.5, 1)],
    ids=["square", "ring", "hole"],
)  # fmt: skip
def test_it_covers_the_domain_and_no_hole(mesh):
    made = triangulated(mesh)
    assert exact.inverted(mesh) > 0
    # Signed areas of a tangled mesh add up to that of its domain, in exact rationals.
    areas = double_areas(mesh, made)
    assert min(areas) > 0
    assert sum(areas) == sum(exact.double_areas(mesh))


def test_an_interface_is_kept():
    mesh = meshes.disturbed(meshes.l_shape(), 0.12, 2)
    made = triangulated(mesh)
    edges = {tuple(sorted(edge)) for row in made.tolist() for edge in zip(row, row[1:] + row[:1], strict=True)}
    assert {tuple(sorted(edge)) for edge in mesh.constrained_edges.tolist()} <= edges


def test_a_boundary_that_crosses_itself_leaves_what_it_goes_round():
    points = np.array([[0, 0], [2, 2], [2, 0], [0, 2], [1, 3.0], [1, 1.5]])
    fan = np.array([[0, 1, 5], [1, 2, 5], [2, 3, 5], [3, 4, 5], [4, 0, 5]])
    made = domain_triangles(points, fan, np.zeros((0, 2), np.int64))
    assert len(made)
    assert min(exact.double_area(*points[row].tolist()) for row in made) > 0


def test_coinciding_vertices_do_no_harm():
    mesh = meshes.jittered(6, 6, 0.6)
    points = mesh.points.clone()
    inner = (~mesh.fixed).nonzero().squeeze(1)
    points[inner[1]] = points[inner[0]]
    points[inner[2]] = points[0]
    mesh = mesh.with_points(points)
    areas = double_areas(mesh, triangulated(mesh))
    assert min(areas) > 0
    assert sum(areas) == 2
