"""MED files: what meshio does wrong with names in UTF-8 and with quads of nine nodes is mended."""

import meshio
import numpy as np
import pytest

import torchmesh as tm
from torchmesh.files.documents import load
from torchmesh.files.formats.registry import FORMATS

h5py = pytest.importorskip("h5py")

POINTS = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [1.4, 0.5]])
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
NAMES = ["Flügel", "固体" * 20]


def square(path):
    mesh = meshio.Mesh(POINTS, [("triangle", FACES), ("line", np.array([[0, 1], [1, 2]]))])
    mesh.cell_data = {"cell_tags": [np.array([-2, -2, -2, -2]), np.array([-1, 0])]}
    mesh.cell_tags, mesh.point_tags = {-1: [NAMES[0]], -2: [NAMES[1], "b"]}, {}
    FORMATS["med"].write(path, mesh, None, False)
    return path


def test_names_in_utf8_are_kept(tmp_path):
    source = square(tmp_path / "a.med")
    short = ("固体" * 20).encode()[:78].decode()  # 80 bytes hold 26 of these characters
    with h5py.File(source) as file:
        raw = [row.tobytes() for row in file["FAS/mesh/ELEME"].values() for row in row["GRO/NOM"][()]]
    assert {r.split(b"\0")[0].decode() for r in raw} == {"Flügel", short, "b"}
    assert load(source).mesh.cell_tags == {-1: ["Flügel"], -2: [short, "b"]}
    after, report = tm.improve(tm.read(source))
    report.check()
    tm.write(tmp_path / "b.med", after, like=source)
    assert load(tmp_path / "b.med").mesh.cell_tags == load(source).mesh.cell_tags
    assert meshio.med._med._read_families.__module__ == "meshio.med._med", "it is meshio's own again"


def test_names_that_are_not_utf8_are_read_as_latin_1(tmp_path):
    source = square(tmp_path / "a.med")
    with h5py.File(source, "r+") as file:
        for family in file["FAS/mesh/ELEME"].values():
            rows = family["GRO/NOM"]
            rows[0] = np.frombuffer("Flügel".encode("latin-1").ljust(80, b"\0"), np.int8)
    assert load(source).mesh.cell_tags[-1] == ["Flügel"]


def test_quads_of_nine_nodes_are_read_and_written(tmp_path):
    nine = np.array([[0, 0], [2, 0], [2, 2], [0, 2], [1, 0], [2, 1], [1, 2], [0, 1], [1, 1.0]])
    FORMATS["med"].write(tmp_path / "a.med", meshio.Mesh(nine, [("quad9", np.arange(9)[None])]), None, False)
    with h5py.File(tmp_path / "a.med") as file:
        assert "QU9" in next(iter(next(iter(file["ENS_MAA"].values())).values()))["MAI"]
    assert len(tm.read(tmp_path / "a.med").quads) == 1
    tm.write(tmp_path / "b.med", tm.read(tmp_path / "a.med"), like=tmp_path / "a.med")
    assert load(tmp_path / "b.med").mesh.cells[0].data.tolist() == [[*range(9)]]


def test_blocks_of_one_type_become_one(tmp_path):
    cells = [("triangle", FACES[:1]), ("line", np.array([[0, 1]])), ("triangle", FACES[1:])]
    mesh = meshio.Mesh(POINTS, cells, cell_data={"k": [np.array([1.0]), np.array([5.0]), np.array([2.0, 3, 4])]})
    FORMATS["med"].write(tmp_path / "a.med", mesh, None, False)
    found = {b.type: (b.data.tolist(), load(tmp_path / "a.med").mesh.cell_data["k"][i].ravel().tolist())
             for i, b in enumerate(load(tmp_path / "a.med").mesh.cells)}  # fmt: skip
    assert found["triangle"] == (FACES.tolist(), [1, 2, 3, 4])
    assert found["line"] == ([[0, 1]], [5])
