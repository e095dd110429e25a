"""The compiled mesher against its twin in Python: the same vertices at the same positions, and the same triangles."""

import pytest
import torch
from both_loops import need_compiled_loops
from meshes import TANGLED, crowded_square, delaunay, disc, disturbed, dragged_interface, grid, moved_hole, ring

from torchmesh import MeshBatch
from torchmesh.kernels.meshing import OutlineMesher
from torchmesh.mesh.connectivity import boundary_edges
from torchmesh.mesh.interfaces import interface_vertices
from torchmesh.triangulating.front_twin import OutlineMesher as Twin


def both_meshers(mesh: MeshBatch):
    need_compiled_loops()
    edges = boundary_edges(mesh.triangles, mesh.twin)
    held = mesh.fixed | interface_vertices(mesh)
    return [made(mesh.points, held, edges, mesh.constrained_edges) for made in (OutlineMesher, Twin)]


def lattice(generator) -> MeshBatch:
    """A grid with its free vertices on few places: vertices on each other, on edges and on circles of others."""
    mesh = grid(9, 8)
    at = torch.randint(0, 5, mesh.points.shape, generator=generator).to(mesh.points) / 4
    return mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, at * mesh.points.max()))


def outlines(generator) -> dict[str, MeshBatch]:
    return {
        "hole": moved_hole(),
        "interface": dragged_interface(),
        "outside": disturbed(disc(), 3.0, 1),
        "ring": ring(24, 3),
        "hull": delaunay(60, seed=2),
        "lattice": lattice(generator),
        "crowded": crowded_square(6),
    }


@pytest.mark.parametrize("name", ["hole", "interface", "outside", "ring", "hull", "lattice", "crowded"])
def test_the_same_vertices_and_triangles(generator, name):
    mesh = outlines(generator)[name]
    compiled, twin = both_meshers(mesh)
    assert compiled.fault == twin.fault == 0
    assert torch.equal(compiled.background(), twin.background())
    edges = mesh.points[boundary_edges(mesh.triangles, mesh.twin)]
    least = float((edges[:, 0] - edges[:, 1]).norm(dim=1).mean()) / 2
    size = least * (1 + 0.5 * torch.rand(len(mesh.points), generator=generator, dtype=torch.float64))
    made = [mesher.mesh(size, 0.7071, 0.5, 0.05) for mesher in (compiled, twin)]
    assert len(made[0][1]) > 5
    for one, other in zip(*made, strict=True):
        assert torch.equal(one, other)


@pytest.mark.parametrize("name", ["interface", "ring"])
def test_the_same_vertices_where_circles_are_largest(generator, name):
    mesh = outlines(generator)[name]
    edges = mesh.points[boundary_edges(mesh.triangles, mesh.twin)]
    size = torch.full((len(mesh.points),), float((edges[:, 0] - edges[:, 1]).norm(dim=1).mean())).double()
    placed = len(both_meshers(mesh)[0].mesh(size, 0.7071, 0.5, 0.05)[1])
    for few, wanted, count in ((0, placed + 7, placed + 7), (placed + 1, placed + 7, placed)):
        made = [mesher.mesh(size, 0.7071, 0.5, 0.05, (few, wanted)) for mesher in both_meshers(mesh)]
        assert len(made[0][1]) == count
        for one, other in zip(*made, strict=True):
            assert torch.equal(one, other)


@pytest.mark.parametrize("name", list(TANGLED))
def test_the_same_faults(name):
    compiled, twin = both_meshers(TANGLED[name]())
    assert compiled.fault == twin.fault
    if not twin.fault:
        assert torch.equal(compiled.background(), twin.background())
