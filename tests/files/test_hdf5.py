"""Files of many meshes: every bit comes back, also of a part that is read alone; errors name broken files."""

import dataclasses
import os

import h5py
import numpy as np
import pytest
import torch
from meshes import TANGLED, VALID, grid, l_shape

import torchmesh as tm
from torchmesh.files import hdf5_layout, hdf5_reading
from torchmesh.mesh.batch import MeshBatch

TILTED = tm.MeshBatch.from_arrays([[0.0, 0, 1], [1, 0, 2], [0, 1, 1], [1, 1, 2]], [[0, 1, 2], [1, 3, 2]])


def everything() -> MeshBatch:
    made = [make() for make in (*VALID.values(), *TANGLED.values())]
    return tm.join([*made, l_shape(), TILTED])


def same(a: MeshBatch, b: MeshBatch) -> bool:
    names = [f.name for f in dataclasses.fields(a) if not f.name.startswith("_")]
    return all(getattr(a, n).dtype == getattr(b, n).dtype and torch.equal(getattr(a, n), getattr(b, n)) for n in names)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "meshes.h5"


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_all_comes_back_bit_for_bit(path, dtype):
    batch = everything().to(dtype)
    assert len(batch.constrained_edges)
    assert not torch.equal(batch.frames[0], batch.frames[-1])
    tm.save_batch(path, batch)
    assert same(tm.load_batch(path), batch)
    assert os.listdir(path.parent) == [path.name]


def test_special_numbers_come_back(path):
    points = torch.tensor([[0.0, -0.0], [float("nan"), float("inf")], [5e-324, 1e150], [-1e-300, 1.0]])
    mesh = TILTED.with_points(points.double())
    tm.save_batch(path, mesh)
    back = tm.load_batch(path).points
    assert torch.equal(back.view(torch.int64), mesh.points.view(torch.int64))


@pytest.mark.parametrize("meshes", [0, 3, -1, slice(2, 5), slice(None, None, -2), [4, 1, 1, -2], [], np.array([6, 7])])
def test_a_part_is_read_alone(path, meshes):
    batch = everything()
    tm.save_batch(path, batch, point_fields={"x": batch.points[:, 0]}, mesh_fields={"n": torch.arange(len(batch))})
    wanted = np.atleast_1d(np.arange(len(batch))[np.array(meshes, dtype=int) if isinstance(meshes, list) else meshes])
    split = batch.split()
    part = tm.load_batch(path, meshes)
    assert len(part) == len(wanted)
    points, records = tm.load_fields(path, meshes)
    assert records["n"].tolist() == wanted.tolist()
    if len(wanted):
        expected = tm.join([split[b] for b in wanted])
        assert same(part, expected)
        assert torch.equal(points["x"], expected.points[:, 0])


@pytest.mark.parametrize("number", [15, -16, 100])
def test_a_mesh_that_is_not_there_is_told(path, number):
    tm.save_batch(path, everything())
    with pytest.raises(IndexError, match=f"has 15 meshes; there is no mesh {number}"):
        tm.load_batch(path, number)


def test_meshes_are_asked_for_by_whole_numbers(path):
    tm.save_batch(path, grid())
    with pytest.raises(TypeError, match="whole numbers"):
        tm.load_batch(path, [0.5])


def test_fields_come_back(path):
    batch = everything()
    tensors = {"undeformed": batch.points + 1, "label": torch.arange(len(batch.points)), "on": batch.fixed}
    records = {"family": [f"kind {b}" for b in range(len(batch))], "matrix": torch.rand(len(batch), 2, 2)}
    tm.save_batch(path, batch, point_fields=tensors, mesh_fields=records)
    points, meshes = tm.load_fields(path)
    assert set(points) == set(tensors)
    assert all(torch.equal(points[k], v) and points[k].dtype == v.dtype for k, v in tensors.items())
    assert meshes["family"] == records["family"]
    assert torch.equal(meshes["matrix"], records["matrix"])


def test_batch_after_batch_is_the_whole(path):
    batch = everything()
    fields = torch.arange(len(batch.points))
    with tm.BatchWriter(path) as writer:
        for b, mesh in enumerate(batch.split()):
            part = fields[batch.point_offsets[b] : batch.point_offsets[b + 1]]
            writer.append(mesh, point_fields={"row": part}, mesh_fields={"name": [str(b)]})
        assert not path.exists()
    assert same(tm.load_batch(path), batch)
    points, meshes = tm.load_fields(path)
    assert torch.equal(points["row"], fields)
    assert meshes["name"] == [str(b) for b in range(len(batch))]


def test_an_error_leaves_the_old_file(path):
    tm.save_batch(path, grid())
    old = path.read_bytes()

    def stopped() -> None:
        with tm.BatchWriter(path) as writer:
            writer.append(l_shape())
            raise RuntimeError("stopped")

    with pytest.raises(RuntimeError, match="stopped"):
        stopped()
    assert path.read_bytes() == old
    assert os.listdir(path.parent) == [path.name]


def test_a_file_without_meshes_is_not_written(path):
    with pytest.raises(tm.InvalidMeshError, match="no mesh"), tm.BatchWriter(path):
        pass
    assert os.listdir(path.parent) == []


def test_files_are_compressed(path):
    batch = tm.join([grid(40, 40)] * 50)
    tm.save_batch(path, batch)
    assert path.stat().st_size < 0.2 * (batch.points.nbytes + batch.triangles.nbytes)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"point_fields": {"x": torch.zeros(3)}}, "point_fields/x must have 42 rows, not 3"),
        ({"mesh_fields": {"x": torch.zeros(3)}}, "mesh_fields/x must have 1 rows, not 3"),
        ({"mesh_fields": {"a/b": torch.zeros(1)}}, "slash"),
        ({"mesh_fields": {"": torch.zeros(1)}}, "empty"),
        ({"mesh_fields": {".": torch.zeros(1)}}, "no dot"),
        ({"mesh_fields": {"x": torch.tensor(1.0)}}, "mesh_fields/x is a single number"),
        ({"point_fields": {"x": torch.zeros(42, 0)}}, "nothing to store"),
        ({"point_fields": {"x": torch.zeros(42, dtype=torch.bfloat16)}}, "use .to.torch.float32."),
    ],
)
def test_wrong_fields_are_refused(path, fields, message):
    with pytest.raises(tm.InvalidMeshError, match=message):
        tm.save_batch(path, grid(), **fields)
    assert not path.exists()


def test_batches_of_one_file_agree(path):
    with tm.BatchWriter(path) as writer:
        writer.append(grid(), mesh_fields={"n": torch.zeros(1)})
        with pytest.raises(tm.InvalidMeshError, match=r"points was float64 .* now float32"):
            writer.append(grid().to(torch.float32), mesh_fields={"n": torch.zeros(1)})
        with pytest.raises(tm.InvalidMeshError, match="must have the fields"):
            writer.append(grid())


def test_a_missing_file_is_told(path):
    with pytest.raises(tm.MeshIOError, match=r"meshes\.h5: there is no such file"):
        tm.load_batch(path)


def test_a_missing_folder_is_told(path):
    with pytest.raises(tm.MeshIOError, match="nowhere"):
        tm.save_batch(path.parent / "nowhere" / "meshes.h5", grid())


@pytest.mark.parametrize("content", [b"", b"not HDF5 at all", b"\x89HDF\r\n\x1a\n" + bytes(100)])
def test_files_of_another_kind_are_told(path, content):
    path.write_bytes(content)
    with pytest.raises(tm.MeshIOError, match=r"meshes\.h5: cannot be read"):
        tm.load_batch(path)


def test_hdf5_of_another_kind_is_told(path):
    with h5py.File(path, "w") as file:
        file["points"] = np.zeros((3, 2))
    with pytest.raises(tm.MeshIOError, match="no file of torchmesh"):
        tm.load_batch(path)


@pytest.mark.parametrize("part", [0.3, 0.6, 0.9, 0.99])
def test_a_file_cut_short_is_told(path, part):
    tm.save_batch(path, everything())
    content = path.read_bytes()
    path.write_bytes(content[: int(part * len(content))])
    with pytest.raises(tm.MeshIOError, match=r"meshes\.h5"):
        tm.load_batch(path)


def test_damaged_data_is_told_by_its_checksum(path):
    tm.save_batch(path, everything())
    with h5py.File(path) as file:
        chunk = file["points"].id.get_chunk_info(0)
    content = bytearray(path.read_bytes())
    content[chunk.byte_offset + chunk.size // 2] ^= 0xFF
    path.write_bytes(bytes(content))
    with pytest.raises(tm.MeshIOError, match=r"meshes\.h5: cannot be read"):
        tm.load_batch(path)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("points_offsets", lambda v: v[::-1], "points_offsets do not fit"),
        ("triangles_offsets", lambda v: v + 1, "triangles_offsets do not fit"),
        ("triangles_offsets", lambda v: np.delete(v, 1), "number of meshes"),
        ("triangles", lambda v: v + 1000, "points that are not there"),
        ("fixed", lambda v: v[1:], "differ in length"),
        ("frames", None, "lacks frames"),
    ],
)
def test_tables_that_do_not_fit_are_told(path, name, change, message):
    tm.save_batch(path, everything())
    with h5py.File(path, "a") as file:
        values = file[name][:]
        del file[name]
        if change is not None:
            file[name] = change(values)
    with pytest.raises(tm.MeshIOError, match=message):
        tm.load_batch(path)


def test_a_newer_version_is_told(path):
    tm.save_batch(path, grid())
    with h5py.File(path, "a") as file:
        file.attrs["version"] = hdf5_layout.VERSION + 1
    with pytest.raises(tm.MeshIOError, match="newer torchmesh"):
        tm.load_batch(path)


@pytest.mark.parametrize(
    ("name", "table", "message"),
    [
        ("points", np.zeros((15, 3)), "points is a table of float64"),
        ("points", np.zeros((15, 2), np.float16), "neither single nor double"),
        ("points", np.zeros((15, 2), int), "points is a table of int64"),
        ("triangles", np.zeros((15, 3)), "triangles is a table of float64"),
        ("triangles", np.zeros(15, int), "not of rows of shape"),
        ("constrained_edges", np.zeros((0, 3), int), "constrained_edges is a table"),
        ("frames", np.zeros((15, 9)), "frames is a table"),
        ("points_offsets", np.zeros(16), "points_offsets is a table"),
        ("points_offsets", 3, "points_offsets is no table"),
        ("point_fields", 3, "point_fields is no group"),
        ("point_fields/u", np.zeros(3), "point_fields/u does not have"),
    ],
)
def test_tables_of_another_shape_or_type_are_told_when_the_file_is_opened(path, name, table, message):
    tm.save_batch(path, everything())
    with h5py.File(path, "a") as file:
        if name in file:
            del file[name]
        file[name] = table
    with pytest.raises(tm.MeshIOError, match=message):
        tm.BatchFile(path)
    with pytest.raises(tm.MeshIOError, match=message):
        tm.datasets.MeshDataset(path)


@pytest.mark.parametrize("name", ["points", "triangles", "mesh_fields/n"])
def test_a_table_that_states_more_than_it_can_hold_is_told(path, name):
    tm.save_batch(path, grid(), mesh_fields={"n": torch.zeros(1)})
    with h5py.File(path, "a") as file:
        table = file[name]
        shape, kind = (10**12, *table.shape[1:]), table.dtype
        del file[name]
        file.create_dataset(name, shape, kind, chunks=(1000, *shape[1:]))
    with pytest.raises(tm.MeshIOError, match=rf"{name} says that it has .* bytes, and is stored in 0"):
        tm.load_batch(path)


def test_the_version_is_a_number(path):
    tm.save_batch(path, grid())
    with h5py.File(path, "a") as file:
        file.attrs["version"] = "one"
    with pytest.raises(tm.MeshIOError, match=r"meshes\.h5: cannot be read"):
        tm.load_batch(path)


def test_many_meshes_that_are_the_same_come_back_and_are_read_in_parts_if_they_swell(path, monkeypatch):
    batch = tm.join([grid()] * 200)
    tm.save_batch(path, batch)
    assert torch.equal(tm.load_batch(path).points, batch.points)
    monkeypatch.setattr(hdf5_reading, "_AT_ONCE", 1000)
    monkeypatch.setattr(hdf5_reading, "_FACTOR", 1)
    with pytest.raises(tm.MeshIOError, match="read fewer meshes at once"):
        tm.load_batch(path)
    assert torch.equal(tm.load_batch(path, 7).points, grid().points)
