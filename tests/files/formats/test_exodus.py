"""Exodus files: blocks, sets, names, results and records stay; side sets stay on their edges."""

import warnings

import meshio
import numpy as np
import pytest
from decks import POINTS, TRIANGLES, flip_and_move, stale
from file_contents import save

import torchmesh as tm
from torchmesh.files.documents import load
from torchmesh.files.source import Source

netCDF4 = pytest.importorskip("netCDF4")


def names(data, variable, dimension, texts):
    made = data.createVariable(variable, "S1", (dimension, "len_name"))
    for k, text in enumerate(texts):
        made[k] = np.array(list(text.ljust(33, "\0")), "S1")


def write_two_blocks(path, dimensions=2, steps=1, form="NETCDF3_64BIT_OFFSET", word=8):
    """Two materials; side set "outlet" is the right side, "wall" is the top right; results at nodes and in elements."""
    first = 1 if dimensions == 2 else 3
    with netCDF4.Dataset(path, "w", format=form) as d:
        d.title, d.floating_point_word_size = "made by hand", np.int32(word)
        sizes = {"len_name": 33, "num_dim": dimensions, "num_nodes": 7, "num_elem": 6, "num_el_blk": 2}
        sizes |= {"num_side_sets": 2, "num_side_ss1": 1, "num_side_ss2": 1, "num_node_sets": 1, "num_nod_ns1": 2}
        for key, size in (sizes | {"num_nod_var": 1, "num_elem_var": 1, "time_step": None}).items():
            d.createDimension(key, size)
        real = f"f{word}"
        for k, axis in enumerate("xyz"[:dimensions]):
            d.createVariable(f"coord{axis}", real, ("num_nodes",))[:] = [p[k] if k < 2 else 0 for p in POINTS]
        for k, rows in enumerate((TRIANGLES[:4], TRIANGLES[4:]), 1):
            d.createDimension(f"num_el_in_blk{k}", len(rows))
            d.createDimension(f"num_nod_per_el{k}", 3)
            made = d.createVariable(f"connect{k}", "i4", (f"num_el_in_blk{k}", f"num_nod_per_el{k}"))
            made.elem_type = "TRI3"
            made[:] = np.array(rows) + 1
        for key, dimension, values in (
            ("eb_prop1", "num_el_blk", [10, 20]),
            ("ss_prop1", "num_side_sets", [100, 200]),
            ("ns_prop1", "num_node_sets", [7]),
            ("elem_ss1", "num_side_ss1", [5]),
            ("side_ss1", "num_side_ss1", [first + 1]),
            ("elem_ss2", "num_side_ss2", [6]),
            ("side_ss2", "num_side_ss2", [first + 1]),
            ("node_ns1", "num_nod_ns1", [1, 2]),
        ):
            d.createVariable(key, "i4", (dimension,))[:] = values
        names(d, "eb_names", "num_el_blk", ["steel", "rubber"])
        names(d, "ss_names", "num_side_sets", ["outlet", "wall"])
        names(d, "ns_names", "num_node_sets", ["bottom"])
        names(d, "name_nod_var", "num_nod_var", ["T"])
        names(d, "name_elem_var", "num_elem_var", ["s"])
        d.createVariable("time_whole", "f8", ("time_step",))[:] = np.arange(steps)
        d.createVariable("vals_nod_var1", real, ("time_step", "num_nodes"))[:] = np.arange(7 * steps).reshape(steps, 7)
        for k, n in ((1, 4), (2, 2)):
            made = d.createVariable(f"vals_elem_var1eb{k}", real, ("time_step", f"num_el_in_blk{k}"))
            made[:] = np.arange(n * steps).reshape(steps, n)
    return path


def content(path):
    with netCDF4.Dataset(path) as d:
        d.set_auto_mask(False)
        return {key: np.array(d.variables[key][:]) for key in d.variables}


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("form", ["NETCDF3_64BIT_OFFSET", "NETCDF4"])
def test_only_points_corners_and_sides_change(tmp_path, dimensions, form):
    source = write_two_blocks(tmp_path / "in.e", dimensions, form=form)
    mesh = tm.read(source)
    assert mesh.constrained_edges.tolist() == [[1, 4]]
    with pytest.warns(tm.MeshWarning, match="not carried over.*cell data 's'"):
        tm.write(tmp_path / "out.e", flip_and_move(mesh), like=source)
    before, after = content(source), content(tmp_path / "out.e")
    changed = {key for key in before if not np.array_equal(before[key], after[key])}
    assert before.keys() == after.keys()
    assert changed == {"coordx", "coordy", "connect2", "elem_ss1", "side_ss1", "vals_elem_var1eb2"} - (
        {"side_ss1"} if after["side_ss1"].tolist() == before["side_ss1"].tolist() else set()
    )
    assert after["connect2"].tolist() == [[2, 3, 5], [3, 6, 5]]
    first = 1 if dimensions == 2 else 3
    assert after["elem_ss1"].tolist() == [6]
    assert after["side_ss1"].tolist() == [first]
    assert np.isnan(after["vals_elem_var1eb2"]).all()


def test_a_mesh_that_has_not_changed_keeps_every_byte_of_content(tmp_path):
    source = write_two_blocks(tmp_path / "in.e", steps=3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.write(tmp_path / "out.e", tm.read(source), like=source)
    before, after = content(source), content(tmp_path / "out.e")
    for key in before:
        np.testing.assert_array_equal(before[key], after[key])


def test_results_of_several_steps_are_columns(tmp_path):
    source = Source.open(write_two_blocks(tmp_path / "in.e", steps=3))
    np.testing.assert_array_equal(source.content.mesh.point_data["T"], np.arange(21).reshape(3, 7).T)
    assert source.content.mesh.cell_data["s"][1].shape == (2, 3)


def test_numbers_of_four_bytes_stay(tmp_path):
    source = write_two_blocks(tmp_path / "in.e", word=4)
    mesh = tm.read(source)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tm.write(tmp_path / "out.e", flip_and_move(mesh), like=source)
    assert content(tmp_path / "out.e")["coordx"].dtype == np.float32


def test_another_format_names_what_is_lost(tmp_path):
    source = write_two_blocks(tmp_path / "in.e")
    with pytest.warns(tm.MeshWarning, match="block name 'steel', block name 'rubber', side set 'outlet'"):
        tm.write(tmp_path / "out.vtu", tm.read(source), like=source)


def test_values_of_node_sets_at_nodes_that_moved_are_named(tmp_path):
    path = write_two_blocks(tmp_path / "in.exo")
    with netCDF4.Dataset(path, "r+") as d:
        d["node_ns1"][:] = [7, 2]
        factors = d.createVariable("dist_fact_ns1", "f8", ("num_nod_ns1",))
        factors[:] = [1.0, 1.0]
    assert stale(path) == []
    with netCDF4.Dataset(path, "r+") as d:
        d["dist_fact_ns1"][:] = [1.0, 2.0]
        d.createVariable("vals_nset_var1ns1", "f8", ("time_step", "num_nod_ns1"))[:] = [[3.0, 4.0]]
    factors, results = "distribution factors of node set 'bottom'", "results of node set 'bottom'"
    assert stale(path) == [f"{factors} at 1 node, {results} at 1 node"]


def square_with(**point_data):
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.5, 0.5, 0]])
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    return meshio.Mesh(points, [("triangle", faces)], point_data=point_data)


def test_vectors_become_a_result_for_each_component(tmp_path):
    values = np.arange(15.0).reshape(5, 3)
    long = "a name of more than thirty-two bytes"
    save(tmp_path / "in.vtu", square_with(velocity=values, Température=values[:, 0], **{long: values[:, :2]}))
    with pytest.warns(tm.MeshWarning) as told:
        tm.write(tmp_path / "a.e", tm.read(tmp_path / "in.vtu"), like=tmp_path / "in.vtu")
    texts = [str(one.message) for one in told]
    assert f"{tmp_path / 'a.e'}: 'velocity' is written as velocity_x, velocity_y, velocity_z" in texts
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.write(tmp_path / "b.e", tm.read(tmp_path / "a.e"), like=tmp_path / "a.e")
    data = load(tmp_path / "b.e").mesh.point_data
    assert list(data) == ["velocity_x", "velocity_y", "velocity_z", "Température", f"{long[:30]}_x", f"{long[:30]}_y"]
    for axis, name in enumerate(list(data)[:3]):
        np.testing.assert_array_equal(data[name], values[:, axis])


def test_vectors_in_the_way_of_meshio_are_read_and_stay(tmp_path):
    values = np.arange(15.0).reshape(5, 3)
    square_with(velocity=values).write(tmp_path / "a.e")
    mesh = tm.read(tmp_path / "a.e")
    points = mesh.points.clone()
    points[4] += 0.1
    tm.write(tmp_path / "b.e", mesh.with_points(points), like=tmp_path / "a.e")
    np.testing.assert_array_equal(load(tmp_path / "b.e").mesh.point_data["velocity"], values)


def test_a_result_of_a_wrong_shape_is_one_line(tmp_path):
    square_with(velocity=np.zeros((3, 3))[[0, 1, 2, 0, 1]]).write(tmp_path / "a.e")
    with netCDF4.Dataset(tmp_path / "a.e", "r+") as data:
        data.createVariable("vals_nod_var2", "f8", ("num_dim", "num_dim"))[:] = 0
        data.renameVariable("vals_nod_var1", "unused")
        data.renameVariable("vals_nod_var2", "vals_nod_var1")
    with pytest.raises(tm.MeshIOError, match=r"a\.e: .*'velocity' is a table of 3 by 3 numbers instead of steps by 5"):
        tm.read(tmp_path / "a.e")
