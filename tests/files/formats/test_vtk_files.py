"""VTK itself is the judge: its files in every mode are read, and what we write is what VTK reads."""

import itertools
import warnings
from pathlib import Path

import numpy as np
import pytest

import torchmesh as tm
from torchmesh.files.source import Source

vtk = numpy_support = None

POINTS = ((0, 0), (1, 0), (1, 1), (0, 1), (1.4, 0.5), (2, 0), (2, 1))
FACES = ((0, 1, 4), (1, 2, 4), (1, 5, 6, 2), (2, 3, 4), (3, 0, 4))
LINES = ((0, 1), (1, 5, 6))  # the second one is a polyline, of which we make two lines
KINDS = (np.uint8, np.int8, np.int16, np.uint16, np.int32, np.uint32, np.int64, np.uint64, np.float32, np.float64)


@pytest.fixture(scope="module", autouse=True)
def judge() -> None:
    """VTK, which takes a second to load: only the worker that runs these tests does."""
    global vtk, numpy_support
    vtk = pytest.importorskip("vtk")
    numpy_support = pytest.importorskip("vtk.util.numpy_support")


def added(where, name: str, values: np.ndarray) -> None:
    array = numpy_support.numpy_to_vtk(values, deep=1)
    array.SetName(name)
    where.AddArray(array)


def grid(kind: str):
    """Triangles, a quad and lines, with data of every type of numbers, and text."""
    made = vtk.vtkUnstructuredGrid() if kind == "UnstructuredGrid" else vtk.vtkPolyData()
    points = vtk.vtkPoints()
    points.SetDataTypeToDouble()
    for x, y in POINTS:
        points.InsertNextPoint(x, y, 0)
    made.SetPoints(points)
    if kind == "UnstructuredGrid":
        for nodes in FACES:
            made.InsertNextCell({3: 5, 4: 9}[len(nodes)], len(nodes), nodes)
        for nodes in LINES:
            made.InsertNextCell({2: 3, 3: 4}[len(nodes)], len(nodes), nodes)
    else:
        faces, lines = vtk.vtkCellArray(), vtk.vtkCellArray()
        for array, rows in ((faces, FACES), (lines, LINES)):
            for nodes in rows:
                array.InsertNextCell(len(nodes), nodes)
        made.SetPolys(faces)
        made.SetLines(lines)
    for dtype in KINDS:
        added(made.GetPointData(), np.dtype(dtype).name, np.arange(7).astype(dtype))
    added(made.GetPointData(), "a vector", np.arange(21).reshape(7, 3) / 7)
    added(made.GetCellData(), "material", np.ones(7, np.int32))
    added(made.GetCellData(), "stress", np.arange(7) / 3)
    added(made.GetFieldData(), "TIME", np.array([0.25]))
    text = vtk.vtkStringArray()
    text.SetName("case")
    text.InsertNextValue("hello world")
    made.GetFieldData().AddArray(text)
    made.GetPointData().SetActiveScalars("float64")
    made.GetPointData().SetActiveVectors("a vector")
    return made


def content(reader, path: Path) -> dict:
    """Everything in a file, as VTK reads it."""
    reader.SetFileName(str(path))
    reader.Update()
    made = reader.GetOutput()
    assert made.GetNumberOfPoints() == 7
    ids = [[made.GetCell(i).GetPointId(k) for k in range(made.GetCell(i).GetNumberOfPoints())] for i in range(7)]
    found = {"points": numpy_support.vtk_to_numpy(made.GetPoints().GetData())}
    found["cells"] = [(made.GetCellType(i), nodes) for i, nodes in enumerate(ids)]
    for name, data in (("p", made.GetPointData()), ("c", made.GetCellData()), ("f", made.GetFieldData())):
        for i in range(data.GetNumberOfArrays()):
            array = data.GetAbstractArray(i)
            numbers = isinstance(array, vtk.vtkDataArray)
            found[name, array.GetName()] = numpy_support.vtk_to_numpy(array) if numbers else array.GetValue(0)
    return found


def quietly(*arrays, **quads) -> tm.MeshBatch:
    """The mesh of these arrays, whatever is to be said of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tm.MeshWarning)
        return tm.MeshBatch.from_arrays(*arrays, **quads)


def check(path: Path, make_reader) -> None:
    """What is read and written unchanged has the same bytes; a flip and a move change cells and points alone."""
    source = Source.open(path)
    assert len(source.mesh.triangles) == 4
    out = path.with_stem("out")
    tm.write(out, source.mesh, like=source)
    assert out.read_bytes() == path.read_bytes()
    points, faces = source.mesh.points.clone(), source.mesh.triangles.clone()
    points[4, 0] = 0.5
    faces[0], faces[1] = source.mesh.triangles[1], source.mesh.triangles[0]
    mesh = quietly(points, faces, source.mesh.fixed, source.mesh.constrained_edges, quads=source.mesh.quads)
    with pytest.warns(tm.MeshWarning, match="not carried over .*: cell data 'stress'$"):
        tm.write(out, mesh, like=source)
    before, after = content(make_reader(), path), content(make_reader(), out)
    before["points"] = before["points"].copy()
    before["points"][4, 0] = 0.5
    rows = [i for i, (kind, _) in enumerate(before["cells"]) if kind == 5]
    cells = before["cells"]
    cells[rows[0]], cells[rows[1]] = cells[rows[1]], cells[rows[0]]
    del before["c", "stress"]
    assert set(after) == set(before)
    assert after["cells"] == cells
    for key in set(before) - {"cells"}:
        np.testing.assert_array_equal(after[key], before[key])
        assert getattr(after[key], "dtype", None) == getattr(before[key], "dtype", None)


MODES, PACKED = ("Ascii", "Binary", "Appended"), ("None", "ZLib", "LZMA", "LZ4")
XML = [
    (mode, packed, header, order, encode)
    for mode, packed, header, order, encode in itertools.product(MODES, PACKED, (32, 64), ("Little", "Big"), (0, 1))
    if (mode == "Appended" or not encode)
    and (mode != "Ascii" or (packed, header, order) == ("None", 32, "Little"))
    and (packed in ("None", "ZLib") or (header, order) in ((32, "Little"), (64, "Big")))
]


@pytest.mark.parametrize("kind", ["UnstructuredGrid", "PolyData"])
@pytest.mark.parametrize(("mode", "packed"), dict.fromkeys(case[:2] for case in XML))
def test_xml_files_of_every_coding(tmp_path, kind, mode, packed):
    for _, _, header, order, encode in [case for case in XML if case[:2] == (mode, packed)]:
        writer = getattr(vtk, f"vtkXML{kind}Writer")()
        writer.SetInputData(grid(kind))
        path = tmp_path / {"UnstructuredGrid": "a.vtu", "PolyData": "a.vtp"}[kind]
        writer.SetFileName(str(path))
        getattr(writer, f"SetDataModeTo{mode}")()
        getattr(writer, f"SetCompressorTypeTo{packed}")()
        getattr(writer, f"SetHeaderTypeToUInt{header}")()
        getattr(writer, f"SetByteOrderTo{order}Endian")()
        writer.SetEncodeAppendedData(encode)
        writer.Write()
        check(path, getattr(vtk, f"vtkXML{kind}Reader"))


@pytest.mark.parametrize("kind", ["UnstructuredGrid", "PolyData"])
@pytest.mark.parametrize("binary", [False, True])
@pytest.mark.parametrize("version", [42, 51])
def test_legacy_files_of_every_version(tmp_path, kind, binary, version):
    made = grid(kind)
    ids, bits = vtk.vtkIdTypeArray(), vtk.vtkBitArray()
    for array, name in ((ids, "ids"), (bits, "bits")):
        array.SetName(name)
        for k in range(7):
            array.InsertNextValue(k % 2)
        made.GetPointData().AddArray(array)
    writer = getattr(vtk, f"vtk{kind}Writer")()
    writer.SetInputData(made)
    writer.SetFileName(str(tmp_path / "a.vtk"))
    writer.SetFileVersion(version)
    (writer.SetFileTypeToBinary if binary else writer.SetFileTypeToASCII)()
    writer.Write()

    def reader():
        read = getattr(vtk, f"vtk{kind}Reader")()
        for what in ("Scalars", "Vectors", "Fields"):
            getattr(read, f"ReadAll{what}On")()
        return read

    check(tmp_path / "a.vtk", reader)


@pytest.mark.parametrize("kind", ["UnstructuredGrid", "PolyData"])
def test_files_in_hdf5(tmp_path, kind):
    writer = vtk.vtkHDFWriter()
    made = grid(kind)
    made.GetFieldData().RemoveArray("case")  # VTK does not write text there
    writer.SetInputDataObject(made)
    writer.SetFileName(str(tmp_path / "a.vtkhdf"))
    writer.Write()
    check(tmp_path / "a.vtkhdf", vtk.vtkHDFReader)


@pytest.mark.parametrize("name", ["a.vtu", "a.vtp", "a.vtk"])
def test_a_mesh_with_more_vertices_is_written_in_the_style_of_its_file(tmp_path, name):
    kind = "PolyData" if name == "a.vtp" else "UnstructuredGrid"
    writer = getattr(vtk, f"vtk{kind}Writer" if name == "a.vtk" else f"vtkXML{kind}Writer")()
    made = grid(kind)
    writer.SetInputData(made)
    writer.SetFileName(str(tmp_path / name))
    if name == "a.vtk":
        writer.SetFileTypeToASCII()
    else:
        writer.SetDataModeToAppended()
        writer.SetCompressorTypeToLZ4()
        writer.SetByteOrderToBigEndian()
        writer.EncodeAppendedDataOff()
    writer.Write()
    source = Source.open(tmp_path / name)
    mesh, report = tm.improve(source.mesh, tm.ImproveOptions(topology="full"))
    points = np.concatenate([mesh.points.numpy(), mesh.points[mesh.triangles[0]].mean(0, keepdim=True).numpy()])
    a, b, c = mesh.triangles[0].tolist()
    faces = np.concatenate(
        [mesh.triangles[1:].numpy(), [[a, b, len(points) - 1], [b, c, len(points) - 1], [c, a, len(points) - 1]]]
    )
    full = quietly(points, faces, None, mesh.constrained_edges, quads=mesh.quads)
    assert report.valid.all()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tm.MeshWarning)
        tm.write(tmp_path / f"out{Path(name).suffix}", full, like=source)
    data = (tmp_path / f"out{Path(name).suffix}").read_bytes()
    for mark in [b"\nASCII\n"] if name == "a.vtk" else [b"BigEndian", b"LZ4", b'encoding="raw"']:
        assert mark in data
    reader = getattr(vtk, f"vtk{kind}Reader" if name == "a.vtk" else f"vtkXML{kind}Reader")()
    reader.SetFileName(str(tmp_path / f"out{Path(name).suffix}"))
    reader.Update()
    assert reader.GetOutput().GetNumberOfPoints() == len(points)
    assert np.array_equal(tm.read(tmp_path / f"out{Path(name).suffix}").triangles, full.triangles)
