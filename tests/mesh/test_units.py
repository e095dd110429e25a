"""Units of length near the extent of a mesh, which unused vertices do not change."""

import meshes
import torch
from both_loops import both, need_compiled_loops

from torchmesh import join
from torchmesh.mesh.ragged import offsets_from_counts
from torchmesh.mesh.units import centre_and_unit, centre_and_unit_of_triangles


def test_unused_vertices_do_not_count_and_a_mesh_without_triangles_has_the_unit_one():
    need_compiled_loops()
    batch = join([meshes.ring(), meshes.grid()])
    counts = [len(mesh.points) for mesh in batch.split()]
    far = torch.tensor([[1e140, -3.0]], dtype=torch.float64)
    # A vertex behind those of each mesh, and a mesh of one vertex.
    points = torch.cat([batch.points[: counts[0]], far, batch.points[counts[0] :], far, far])
    triangles = torch.where(batch.triangles < counts[0], batch.triangles, batch.triangles + 1)
    offsets = offsets_from_counts(torch.tensor([counts[0] + 1, counts[1] + 1, 1]))
    centre, unit = centre_and_unit(batch.points, batch.point_offsets)
    for found in both(lambda: centre_and_unit_of_triangles(points, triangles, offsets)):
        assert torch.equal(found[0], torch.cat([centre, torch.zeros_like(centre[:1])]))
        assert torch.equal(found[1], torch.cat([unit, torch.ones_like(unit[:1])]))
    for found in both(lambda: centre_and_unit_of_triangles(batch.points, batch.triangles, batch.point_offsets)):
        assert torch.equal(found[0], centre)
        assert torch.equal(found[1], unit)
