"""The vertices and regions of a file are found again in a changed mesh."""

import meshes
import meshio
import numpy as np
import pytest
import torch
from file_contents import flipped, grid, grid_arrays, load, save, side_of, triangle_data

from torchmesh import MeshBatch
from torchmesh.errors import MeshWarning
from torchmesh.files.mesh_files import read, write


def test_a_clockwise_file_stays_clockwise(tmp_path):
    points, faces = grid_arrays()
    source = save(tmp_path / "in.vtu", meshio.Mesh(points, [("triangle", faces[:, ::-1])]))
    with pytest.warns(MeshWarning, match=r"in\.vtu: all triangles were wound clockwise"):
        mesh = read(source)
    write(tmp_path / "same.vtu", mesh, like=source)
    np.testing.assert_array_equal(load(tmp_path / "same.vtu").cells[0].data, faces[:, ::-1])
    write(tmp_path / "out.vtu", flipped(mesh), like=source)
    a, b, c = np.moveaxis(points[load(tmp_path / "out.vtu").cells[0].data][:, :, :2], 1, 0)
    assert ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0).all()


def test_triangles_in_another_order_take_the_tags_of_their_region(tmp_path):
    source = save(tmp_path / "in.msh", grid())
    mesh = flipped(read(source))
    shuffled = mesh.with_triangles(mesh.triangles[torch.randperm(32, generator=torch.Generator().manual_seed(0))])
    with pytest.warns(MeshWarning, match="cell data 'p'"):
        write(tmp_path / "out.msh", shuffled, like=source)
    after = load(tmp_path / "out.msh")
    np.testing.assert_array_equal(triangle_data(after, "gmsh:physical"), side_of(shuffled))


def test_regions_that_cannot_be_told_are_dropped_by_name(tmp_path):
    source = save(tmp_path / "in.vtu", grid(point_data={}))
    other = MeshBatch.from_arrays([[50, 0], [51, 0], [50, 1.0]], [[0, 1, 2]])
    with pytest.warns(MeshWarning, match=r"cell data 'region'.*4 cells whose vertices are gone"):
        write(tmp_path / "out.vtu", other, like=source)
    assert load(tmp_path / "out.vtu").cell_data == {}


@pytest.mark.parametrize("motion", [lambda p: p * 2 + 1, lambda p: p.flip(0)], ids=["grown", "turned by half"])
def test_a_boundary_moved_as_a_whole_keeps_everything(tmp_path, motion):
    source = save(tmp_path / "in.vtu", grid())
    mesh = read(source)
    write(tmp_path / "out.vtu", mesh.with_points(motion(mesh.points)), like=source)
    after = load(tmp_path / "out.vtu")
    assert set(after.cell_data) == {"region", "p"}
    np.testing.assert_array_equal(after.cells_dict["line"], grid().cells_dict["line"])


def test_a_triangle_that_comes_back_wound_the_other_way_is_written_so(tmp_path):
    """When a vertex has travelled, the same three corners in the same row may be wound the other way."""
    mesh = meshes.grid(2, 1)
    write(tmp_path / "in.vtu", mesh)
    over = mesh.triangles.clone()
    over[0] = over[0].flip(0)
    mirrored = mesh.with_triangles(over)
    write(tmp_path / "out.vtu", mirrored, like=tmp_path / "in.vtu")
    written = meshio.read(tmp_path / "out.vtu").cells_dict["triangle"]
    turns = [np.roll(over.numpy(), k, 1) for k in range(3)]
    assert np.any([(written == t).all(1) for t in turns], 0).all()
