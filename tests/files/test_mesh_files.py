"""Reading and writing a mesh; which vertices of a file must not slide."""

import meshes
import meshio
import numpy as np
import pytest
import torch
from file_contents import grid_arrays, save

from torchmesh import MeshBatch, join
from torchmesh.errors import InvalidMeshError
from torchmesh.files.mesh_files import held, read, write
from torchmesh.mesh.connectivity import boundary_vertices


def test_a_new_file_needs_no_like(tmp_path):
    points, faces = grid_arrays()
    mesh = MeshBatch.from_arrays(points, faces, constrained_edges=[[6, 7], [7, 8]])
    write(tmp_path / "a.msh", mesh)
    assert b"4.1 1 8" in (tmp_path / "a.msh").read_bytes()
    back = read(tmp_path / "a.msh")
    assert torch.equal(back.points, mesh.points)
    assert back.constrained_edges.tolist() == [[6, 7], [7, 8]]


def test_pieces_that_do_not_touch_are_one_mesh(tmp_path):
    points, faces = grid_arrays()
    both = meshio.Mesh(
        np.concatenate([points, points + np.array([9, 0, 0])]), [("triangle", np.concatenate([faces, faces + 25]))]
    )
    mesh = read(save(tmp_path / "a.off", both))
    assert len(mesh) == 1
    assert len(mesh.triangles) == 64


@pytest.fixture
def mesh() -> MeshBatch:
    return MeshBatch.from_arrays(*grid_arrays())


def test_a_batch_is_no_file(tmp_path, mesh):
    with pytest.raises(InvalidMeshError, match=r"this batch has 2: write each of mesh.split\(\)"):
        write(tmp_path / "a.vtu", join([mesh, mesh]))


def test_held_are_seams_between_markers_and_what_is_marked(tmp_path):
    points, triangles = meshes.grid_arrays(4, 4)
    quads = [("quad", np.array([[0, 1, 6, 5]]))]
    triangles = triangles[~np.isin(triangles, [0, 1, 6, 5]).all(1)]
    bottom, top = np.array([[10, 15], [15, 20]]), np.array([[4, 9], [9, 14], [14, 19], [19, 24]])
    tags = [np.full(len(triangles), 1), np.array([1]), np.array([2, 3]), np.array([4, 4, 4, 4])]
    mesh = meshio.Mesh(
        np.pad(points, ((0, 0), (0, 1))),
        [("triangle", triangles), *quads, ("line", bottom), ("line", top)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
    )
    mesh.write(tmp_path / "a.msh", file_format="gmsh22")
    assert held(tmp_path / "a.msh").nonzero().squeeze(1).tolist() == [15]
    mesh.point_data["fixed"] = np.arange(25) == 22
    mesh.point_data["fixed"] = mesh.point_data["fixed"].astype(float)
    mesh.write(tmp_path / "b.msh", file_format="gmsh22")
    assert held(tmp_path / "b.msh").nonzero().squeeze(1).tolist() == [15, 22]


def test_a_file_that_marks_the_whole_boundary_holds_none_of_it(tmp_path):
    mesh = meshes.grid()
    inner = MeshBatch.from_arrays(mesh.points, mesh.triangles, torch.arange(len(mesh.points)) == 8)
    write(tmp_path / "a.vtu", inner)
    assert bool(meshio.read(tmp_path / "a.vtu").point_data["fixed"].any())
    assert not bool(held(tmp_path / "a.vtu").any())


def test_an_interface_is_not_marked_fixed_in_a_file(tmp_path):
    points, faces = grid_arrays()
    right = points[faces, 0].mean(1) > points[:, 0].max() / 2
    regions = meshio.Mesh(points, [("triangle", faces)], cell_data={"region": [right + 1]})
    mesh = read(save(tmp_path / "a.vtu", regions))
    inner = mesh.constrained_edges.unique()
    rim = boundary_vertices(mesh.triangles, mesh.twin, len(mesh.points))
    assert torch.equal(mesh.fixed, rim)
    assert len(inner[~rim[inner]]) > 2
    for like in (None, tmp_path / "a.vtu"):
        write(tmp_path / "b.vtu", mesh, like=like)
        assert "fixed" not in meshio.read(tmp_path / "b.vtu").point_data
        back = read(tmp_path / "b.vtu")
        assert torch.equal(back.fixed, mesh.fixed)
        assert len(back.constrained_edges) == len(mesh.constrained_edges)
