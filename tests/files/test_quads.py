"""Quads in files: read, moved, written in their blocks and order, split with their cell data, stored and drawn."""

import warnings

import meshio
import numpy as np
import pytest
import torch

import torchmesh as tm
from tests.meshes import disturbed, mixed, mixed_arrays

COLUMNS, ROWS, QUADS = 6, 5, 3


def save(path, shift=0.0, tags=None, **more):
    """A file with a block of quads, one of triangles, and another one of quads, the first of them clockwise."""
    points, triangles, quads = mixed_arrays(COLUMNS, ROWS, QUADS)
    if shift:
        points = disturbed(mixed(COLUMNS, ROWS, QUADS), shift, 1).points.numpy()
    blocks = [("quad", quads[:4]), ("triangle", triangles), ("quad", quads[4:])]
    tags = [np.full(len(rows), 1) for _, rows in blocks] if tags is None else tags
    numbers = np.split(np.arange(sum(len(r) for _, r in blocks)), np.cumsum([len(r) for _, r in blocks])[:-1])
    mesh = meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), blocks, cell_data={"material": tags, "id": numbers}, **more)
    mesh.write(path, **({"file_format": "gmsh22"} if path.suffix == ".msh" else {}))
    return mesh


@pytest.mark.parametrize("name", ["a.vtu", "a.vtk", "a.msh", "a.xdmf", "a.inp"])
def test_tangled_quads_of_a_file_are_mended_in_their_blocks(tmp_path, name):
    given = save(tmp_path / name, 0.07)
    mesh = tm.read(tmp_path / name)
    assert len(mesh.quads) == QUADS * ROWS
    assert int(tm.quality(mesh).inverted) > 0
    after, report = tm.improve(mesh)
    assert report.valid.all()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tm.MeshWarning)
        tm.write(tmp_path / f"out-{name}", after, like=tmp_path / name)
    again = tm.read(tmp_path / f"out-{name}")
    assert torch.equal(again.quads, mesh.quads)
    assert int(tm.quality(again).inverted) == 0
    assert (again.points - after.points).abs().max() < 1e-6
    written = meshio.read(tmp_path / f"out-{name}").get_cells_type("quad")
    np.testing.assert_array_equal(written, np.concatenate([b.data for b in given.cells if b.type == "quad"]))


def test_a_file_of_quads_alone_is_a_mesh(tmp_path):
    points, _, quads = mixed_arrays(4, 4, 4)
    meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("quad", quads)], cell_data={"f": [np.arange(16.0)]}).write(
        tmp_path / "quads.vtu"
    )
    mesh = tm.read(tmp_path / "quads.vtu")
    assert (len(mesh.triangles), len(mesh.quads)) == (0, 16)
    moved = disturbed(mesh, 0.05, 2)
    after, report = tm.improve(moved)
    assert report.valid.all()
    tm.write(tmp_path / "out.vtu", after, like=tmp_path / "quads.vtu", fields="interpolate")
    out = meshio.read(tmp_path / "out.vtu")
    np.testing.assert_array_equal(out.cells_dict["quad"], quads)
    np.testing.assert_allclose(out.cell_data["f"][0], np.arange(16.0), atol=0.2)
    tm.write(tmp_path / "new.vtu", after)
    assert torch.equal(tm.read(tmp_path / "new.vtu").quads, after.quads)


def test_clockwise_quads_stay_as_the_file_has_them(tmp_path):
    points, triangles, quads = mixed_arrays(3, 3, 2)
    quads[0] = quads[0][::-1]
    cells = [("triangle", triangles), ("quad", quads)]
    meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), cells).write(tmp_path / "in.vtu")
    with pytest.warns(tm.MeshWarning, match="1 of 12 triangles and quads were wound against the others"):
        mesh = tm.read(tmp_path / "in.vtu")
    assert int(tm.quality(mesh).inverted) == 0
    tm.write(tmp_path / "out.vtu", mesh, like=tmp_path / "in.vtu")
    np.testing.assert_array_equal(meshio.read(tmp_path / "out.vtu").cells_dict["quad"], quads)


def test_split_quads_leave_their_block_and_both_halves_have_its_data(tmp_path):
    points, triangles, quads = mixed_arrays(COLUMNS, ROWS, QUADS)
    fixed = np.zeros(len(points))
    bad = quads[7]
    points[bad[2]] = points[bad].mean(0) - 0.4 * (points[bad[2]] - points[bad].mean(0))
    fixed[bad] = 1
    blocks = [("quad", quads[:4]), ("triangle", triangles), ("quad", quads[4:])]
    material = [np.arange(4) + 1, np.full(len(triangles), 1), np.arange(4, len(quads)) + 1]
    mesh = meshio.Mesh(
        np.pad(points, ((0, 0), (0, 1))), blocks, point_data={"fixed": fixed}, cell_data={"density": material}
    )
    mesh.write(tmp_path / "in.vtu")
    given = tm.read(tmp_path / "in.vtu")
    after, report = tm.improve(given, tm.ImproveOptions(quads="split", scope="damage"))
    assert report.split_quads.nonzero().squeeze(1).tolist() == [7]
    tm.write(tmp_path / "out.vtu", after, like=tmp_path / "in.vtu", fields="interpolate")
    out = meshio.read(tmp_path / "out.vtu")
    assert [(b.type, len(b.data)) for b in out.cells] == [
        ("quad", 4), ("triangle", len(triangles)), ("quad", len(quads) - 5), ("triangle", 2),
    ]  # fmt: skip
    assert out.cell_data["density"][3].tolist() == [8, 8]
    np.testing.assert_array_equal(out.cell_data["density"][0], material[0])
    assert int(tm.quality(tm.read(tmp_path / "out.vtu")).inverted) == 0


def test_regions_bind_edges_between_quads_but_not_what_tells_only_the_kind_of_element(tmp_path):
    points, triangles, quads = mixed_arrays(COLUMNS, ROWS, QUADS)
    count = len(triangles), len(quads)
    half = np.arange(count[1]) // ROWS
    cells = [("triangle", triangles), ("quad", quads)]
    for name, of_triangles, of_quads, edges in (
        ("same.vtu", np.full(count[0], 1), np.full(count[1], 1), 0),
        ("kinds.vtu", np.full(count[0], 1), np.full(count[1], 2), 0),
        ("columns.vtu", np.full(count[0], 9), half, 3 * ROWS),
    ):
        data = {"material": [of_triangles, of_quads]}
        meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), cells, cell_data=data).write(tmp_path / name)
        assert len(tm.read(tmp_path / name).constrained_edges) == edges, name


def test_batches_are_stored_with_quads_and_without(tmp_path):
    meshes = [mixed(3, 3, 2), mixed(2, 2, 0), mixed(2, 3, 2)]
    batch = tm.join(meshes)
    tm.save_batch(tmp_path / "all.h5", batch)
    again = tm.load_batch(tmp_path / "all.h5")
    for name in ("points", "triangles", "quads", "quad_offsets", "fixed"):
        assert torch.equal(getattr(again, name), getattr(batch, name)), name
    with tm.BatchWriter(tmp_path / "bit.h5") as file:
        for mesh in (meshes[1], meshes[0], meshes[2]):
            file.append(mesh)
    with tm.BatchFile(tmp_path / "bit.h5") as file:
        assert torch.equal(file.read([2]).quads, meshes[2].quads)
        assert len(file.read(0).quads) == 0
        assert file.read().quad_offsets.tolist() == [0, 0, 6, 12]


def test_quads_are_cells_of_pyvista():
    pytest.importorskip("pyvista")
    mesh = disturbed(mixed(4, 3, 2), 0.05, 1)
    data = tm.to_pyvista(mesh)
    q = tm.quality(mesh)
    assert data.n_cells == len(mesh.triangles) + len(mesh.quads)
    np.testing.assert_array_equal(data.cell_data["inverted"], torch.cat([~q.upright, ~q.quad_upright]))
    areas = data.compute_cell_sizes(length=False, volume=False).cell_data["Area"]
    valid = ~data.cell_data["inverted"]
    np.testing.assert_allclose(areas[valid], data.cell_data["area"][valid], rtol=1e-6)


def test_a_page_and_a_picture_show_quads(tmp_path):
    pytest.importorskip("matplotlib")
    from torchmesh.pictures.mesh_plot import plot_mesh
    from torchmesh.pictures.regions import worst_region

    before = disturbed(mixed(5, 4, 3), 0.07, 3)
    after, _ = tm.improve(before)
    tm.report_page(tmp_path / "page.html", [("before", before), ("after", after)])
    text = (tmp_path / "page.html").read_text()
    assert '"quads": 12' in text
    assert "16 triangles and 12 quads" in text
    from matplotlib.figure import Figure

    axes = Figure().add_subplot()
    fill = plot_mesh(axes, before, tm.quality(before))
    assert sum(len(c.get_paths()) for c in axes.collections) >= 28
    assert len(fill.get_paths()) <= 28
    assert len(worst_region(before, tm.quality(before))) == 4


@pytest.mark.parametrize(("name", "tag"), [("a.msh", "gmsh:physical"), ("a.mesh", "medit:ref"), ("a.vtu", "material")])
def test_groups_of_gmsh_and_medit_are_regions_even_if_each_has_one_kind_of_element(tmp_path, name, tag):
    points, triangles, quads = mixed_arrays(COLUMNS, ROWS, QUADS)
    blocks = [("quad", quads), ("triangle", triangles)]
    tags = {tag: [np.full(len(rows), k + 1) for k, (_, rows) in enumerate(blocks)]}
    if tag == "gmsh:physical":
        tags["gmsh:geometrical"] = tags[tag]
    mesh = meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), blocks, cell_data=tags)
    mesh.write(tmp_path / name, **({"file_format": "gmsh22"} if name == "a.msh" else {}))
    border = np.intersect1d(triangles, quads)
    assert len(border) == ROWS + 1
    between = tm.read(tmp_path / name).constrained_edges.unique().tolist()
    assert between == ([] if tag == "material" else border.tolist())
