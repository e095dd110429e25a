"""The certificate that a mesh has the boundary, constrained edges and fixed vertices of another."""

import dataclasses

import meshes
import torch

from torchmesh.mesh.certificate import same_frame
from torchmesh.remeshing.options import RemeshOptions
from torchmesh.remeshing.remeshing import remesh


def test_the_certificate_sees_a_moved_a_missing_and_a_cut_frame():
    mesh = meshes.l_shape(3)
    after, info = remesh(mesh, RemeshOptions(sizes=torch.full((len(mesh.points),), 0.15)))
    assert same_frame(mesh, after, mesh.fixed, info.vertex_map).tolist() == [True]
    moved = after.points.clone()
    moved[info.vertex_map.old_to_new[0]] += 1e-9
    assert same_frame(mesh, after.with_points(moved), mesh.fixed, info.vertex_map).tolist() == [False]
    without = dataclasses.replace(after, constrained_edges=after.constrained_edges[1:])
    assert same_frame(mesh, without, mesh.fixed, info.vertex_map).tolist() == [False]
    bitten = dataclasses.replace(
        after, triangles=after.triangles[1:], triangle_offsets=torch.tensor([0, len(after.triangles) - 1])
    )
    assert same_frame(mesh, bitten, mesh.fixed, info.vertex_map).tolist() == [False]
