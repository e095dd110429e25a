"""Fields, sets and other cells of a file come back with a changed mesh, or are named."""

import warnings

import meshio
import numpy as np
import pytest
import torch
from file_contents import (
    LEFT,
    RIGHT,
    N,
    flipped,
    grid,
    grid_arrays,
    load,
    moved,
    save,
    side_of,
    split_and_shuffled,
    triangle_data,
    warned,
)

from torchmesh import MeshBatch
from torchmesh.errors import MeshWarning
from torchmesh.files.mesh_files import read, write


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".msh", ".xdmf", ".med"])
def test_fields_and_lines_are_carried_over(tmp_path, suffix):
    source = save(tmp_path / f"in{suffix}", grid())
    before = load(source)
    write(tmp_path / f"out{suffix}", moved(read(source)), like=source)
    after = load(tmp_path / f"out{suffix}")
    assert set(after.point_data) == set(before.point_data)
    assert set(after.cell_data) == set(before.cell_data)
    for name, values in before.point_data.items():
        np.testing.assert_array_equal(after.point_data[name], values)
    for name, blocks in before.cell_data.items():
        np.testing.assert_array_equal(np.concatenate(after.cell_data[name]), np.concatenate(blocks))
    np.testing.assert_array_equal(after.cells_dict["line"], before.cells_dict["line"])


def test_flips_keep_tags_and_point_data_and_drop_fields_of_triangles(tmp_path):
    source = save(tmp_path / "in.vtu", grid(cell_data=grid().cell_data | {"id": [np.arange(4), np.arange(4, 36)]}))
    with pytest.warns(MeshWarning, match=r"not carried over.*cell data 'p'") as record:
        write(tmp_path / "out.vtu", flipped(read(source)), like=source)
    assert "'region'" not in warned(record)
    before, after = load(source), load(tmp_path / "out.vtu")
    assert set(after.cell_data) == {"region", "id"}
    np.testing.assert_array_equal(triangle_data(after, "region"), triangle_data(before, "region"))
    np.testing.assert_array_equal(after.point_data["u"], before.point_data["u"])
    assert after.cells_dict["triangle"][0].tolist() == [0, 1, N]


@pytest.mark.parametrize("suffix", [".vtu", ".msh"])
def test_other_counts_keep_regions_and_lines_and_name_what_goes(tmp_path, suffix):
    names = {"left": np.array([LEFT, 2]), "right": np.array([RIGHT, 2]), "wall": np.array([5, 1])}
    numbered = grid().cell_data | {"id": [np.arange(4), np.arange(4, 36)]}
    source = save(tmp_path / f"in{suffix}", grid(field_data=names, cell_data=numbered))
    new = split_and_shuffled(read(source))
    target = tmp_path / f"out{suffix}"
    with pytest.warns(MeshWarning, match="not carried over") as record:
        write(target, new, like=source)
    for gone in ("point data 'u'", "point data 'v'", "cell data 'p'", "cell data 'id'"):
        assert gone in warned(record)
    after = load(target)
    tag = "gmsh:physical" if suffix == ".msh" else "region"
    np.testing.assert_array_equal(triangle_data(after, tag), side_of(new))
    ends = after.points[after.cells_dict["line"]]
    np.testing.assert_array_equal(ends, grid().points[grid().cells_dict["line"]])
    assert set(after.field_data) == set(names)
    back = read(target)
    assert torch.equal(back.triangles, new.triangles)
    assert len(back.constrained_edges) == N - 1


def test_a_tilted_plane_comes_back_without_jitter(tmp_path):
    points, faces = grid_arrays()
    axes = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    space = points @ axes + [100.0, -3, 1 / 3]
    source = save(tmp_path / "in.vtu", meshio.Mesh(space, [("triangle", faces)]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)  # which side of a plane is up is anyone's choice
        mesh = read(source)
    write(tmp_path / "out.vtu", moved(mesh), like=source)
    after = load(tmp_path / "out.vtu").points
    np.testing.assert_array_equal(after[mesh.fixed.numpy()], space[mesh.fixed.numpy()])
    free = ~mesh.fixed.numpy()
    # Free vertices moved by 0.01 in both directions of the plane, and stay in it.
    np.testing.assert_allclose(np.linalg.norm(after[free] - space[free], axis=1), 0.01 * np.sqrt(2), rtol=1e-9)
    normal = np.cross(space[1] - space[0], space[N] - space[0])
    assert np.abs((after - space[0]) @ normal).max() < 1e-12  # rounding at a distance of 100


def test_single_precision_files_stay_single_precision(tmp_path):
    points, faces = grid_arrays()
    source = save(tmp_path / "in.vtk", meshio.Mesh(points.astype(np.float32), [("triangle", faces)]))
    mesh = read(source)
    assert mesh.points.dtype == torch.float32
    write(tmp_path / "out.vtk", mesh, like=source)
    assert load(tmp_path / "out.vtk").points.dtype.itemsize == 4


def test_fixed_comes_from_point_data_and_goes_back(tmp_path):
    points, faces = grid_arrays()
    marks = np.zeros(25, np.int32)
    marks[12] = 7
    source = save(tmp_path / "in.vtu", meshio.Mesh(points, [("triangle", faces)], point_data={"fixed": marks}))
    mesh = read(source)
    assert mesh.fixed.sum() == 16 + 1
    assert mesh.fixed[12]
    write(tmp_path / "out.vtu", mesh, like=source)
    np.testing.assert_array_equal(load(tmp_path / "out.vtu").point_data["fixed"], marks)


@pytest.mark.parametrize("suffix", [".vtu", ".msh"])
def test_fixed_is_stored_only_where_read_would_not_find_it(tmp_path, suffix):
    points, faces = grid_arrays()
    source = save(tmp_path / f"in{suffix}", grid())
    plain = read(source)
    write(tmp_path / f"plain{suffix}", plain, like=source)
    assert "fixed" not in load(tmp_path / f"plain{suffix}").point_data
    inner = torch.zeros(25, dtype=torch.bool)
    inner[8] = True
    more = MeshBatch.from_arrays(points, faces, inner, plain.constrained_edges)
    for like in (source, None):
        write(tmp_path / f"more{suffix}", more, like=like)
        assert torch.equal(read(tmp_path / f"more{suffix}").fixed, more.fixed)
    inner[16] = True  # the file to follow has a field of that name, which no longer holds
    most = MeshBatch.from_arrays(points, faces, inner, plain.constrained_edges)
    write(tmp_path / f"most{suffix}", most, like=tmp_path / f"more{suffix}")
    assert torch.equal(read(tmp_path / f"most{suffix}").fixed, most.fixed)
