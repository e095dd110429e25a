"""CGNS files: changed in place, with boundary conditions by name; Gmsh and VTK read what is written."""

import io
import shutil
import warnings

import adf
import curved_meshes as cm
import meshes
import meshio
import numpy as np
import pytest

import torchmesh as tm
from torchmesh.files.documents import load
from torchmesh.files.formats.cgns_tree import _node, new_tree
from torchmesh.files.source import Source

h5py = pytest.importorskip("h5py")

ZONE = "Base/Zone"


def square(path, *, mixed=False, fields=()):
    """A square of four triangles and a quad beside it; the middle vertex lies outside.  Its wall is a condition."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [1.4, 0.5], [2, 0], [2, 1.0]])
    cells = [("triangle", np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])), ("quad", np.array([[1, 5, 6, 2]]))]
    cells.append(("line", np.array([[3, 0], [0, 1]])))
    none = np.zeros(0, np.int64)
    mesh = meshio.Mesh(points, cells, cell_sets={"wall": [none, none, np.array([0, 1])]})
    mesh.point_data = {name: points[:, 0].copy() for name in fields}
    path.write_bytes(new_tree(mesh, {"triangle": 5, "quad": 7, "line": 3}, {"wall": "BCWall"}))
    if mixed:
        with h5py.File(path, "r+", track_order=True) as file:
            zone = file[ZONE]
            nodes = [
                n for kind, rows in cells[:2] for row in rows for n in ({"triangle": 5, "quad": 7}[kind], *row + 1)
            ]
            del zone["triangle-1"], zone["quad-2"]
            section = _node(zone, "faces", "Elements_t", np.array([20, 0], np.int32))
            _node(section, "ElementRange", "IndexRange_t", np.array([1, 5], np.int32))
            _node(section, "ElementConnectivity", "DataArray_t", np.array(nodes, np.int64))
    return path


@pytest.mark.parametrize("mixed", [False, True])
def test_only_the_moved_vertex_changes(tmp_path, mixed):
    source = square(tmp_path / "a.cgns", mixed=mixed, fields=["T"])
    improved, report = tm.improve(tm.read(source))
    report.check()
    tm.write(tmp_path / "b.cgns", improved, like=source, fields="interpolate")
    was, now = {}, {}
    for path, found in ((source, was), (tmp_path / "b.cgns", now)):
        with h5py.File(path, "r") as file:
            file.visititems(lambda n, o, found=found: found.update({n: o[()]}) if isinstance(o, h5py.Dataset) else None)
    changed = {name for name in was if not np.array_equal(was[name], now[name])}
    data = f"{ZONE}/GridCoordinates/Coordinate"
    assert changed <= {f"{data}X/ data", f"{data}Y/ data", f"{ZONE}/FlowSolution/T/ data"} | {
        name for name in was if "ElementConnectivity" in name
    }
    assert f"{data}X/ data" in changed
    assert set(was) == set(now)
    after = load(tmp_path / "b.cgns")
    assert tm.quality(tm.read(tmp_path / "b.cgns")).inverted.tolist() == [0]
    assert [b.type for b in after.mesh.cells] == ["triangle", "quad", "line"]
    assert [len(rows) for rows in after.mesh.cell_sets["wall"]] == [0, 0, 2]
    source = Source.open(source)
    assert source.explained("the vertex 3 is beside quads row 0").endswith("(in the file: node 4; element 5)")


def test_flips_change_the_nodes_of_their_triangles(tmp_path):
    source = square(tmp_path / "a.cgns", mixed=True)
    mesh = tm.read(source)
    turned = mesh.triangles.clone()
    turned[[0, 1]] = turned[[1, 0]]
    other = tm.MeshBatch.from_arrays(mesh.points, turned, quads=mesh.quads)
    tm.write(tmp_path / "b.cgns", other, like=source)
    assert np.array_equal(tm.read(tmp_path / "b.cgns").triangles, turned)
    assert np.array_equal(tm.read(tmp_path / "b.cgns").quads, mesh.quads)


def test_six_nodes_are_mended(tmp_path):
    points, six = cm.tangled_annulus()
    (tmp_path / "a.cgns").write_bytes(new_tree(meshio.Mesh(points, [("triangle6", six)]), {"triangle6": 6}, {}))
    improved, _ = tm.improve(tm.read(tmp_path / "a.cgns"))
    tm.write(tmp_path / "b.cgns", improved, like=tmp_path / "a.cgns")
    after = load(tmp_path / "b.cgns").mesh
    assert (cm.jacobians(after.points, after.cells[0].data).min(1) > 0).all()
    assert all((after.points[m] == points[cm.edges(six)[e]]).all() for e, m in cm.edges(after.cells[0].data).items()
               if e in cm.boundary(six))  # fmt: skip


def test_more_vertices_make_a_new_file_with_the_conditions_and_their_types(tmp_path):
    source = square(tmp_path / "a.cgns")
    improved, report = tm.improve(tm.read(source), tm.ImproveOptions(topology="full"))
    tm.write(tmp_path / "b.cgns", improved, like=source, vertex_map=report.vertex_map)
    with h5py.File(tmp_path / "b.cgns", "r") as file:
        condition = file[f"{ZONE}/ZoneBC/wall"]
        assert condition[" data"][()].tobytes() == b"BCWall"
    assert len(load(tmp_path / "b.cgns").mesh.cell_sets["wall"][-1]) == 2


def test_gmsh_and_vtk_read_what_is_written(tmp_path):
    gmsh, vtk = pytest.importorskip("gmsh"), pytest.importorskip("vtk")
    source = square(tmp_path / "a.cgns", fields=["T"])
    shutil.copy(source, tmp_path / "b.cgns")
    improved, _ = tm.improve(tm.read(source))
    tm.write(tmp_path / "b.cgns", improved, like=source)
    for name in ("a.cgns", "b.cgns"):
        reader = vtk.vtkCGNSReader()
        reader.SetFileName(str(tmp_path / name))
        reader.UpdateInformation()
        reader.EnableAllBases()
        reader.EnableAllPointArrays()
        reader.Update()
        found = reader.GetOutput().NewIterator().GetCurrentDataObject()
        assert (found.GetNumberOfPoints(), found.GetNumberOfCells()) == (7, 5)
        assert found.GetPointData().HasArray("T")
        gmsh.initialize(interruptible=False)
        try:
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.open(str(tmp_path / name))
            _, elements, _ = gmsh.model.mesh.getElements(2)
            assert sum(map(len, elements)) == 5
            assert "wall" in [gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups()]
        finally:
            gmsh.finalize()


def test_zones_lie_side_by_side_and_are_regions(tmp_path):
    points, triangles = meshes.grid_arrays(2, 2)
    memory = io.BytesIO(new_tree(meshio.Mesh(points, [("triangle", triangles)]), {"triangle": 5}, {}))
    with h5py.File(memory, "r+") as file:
        file.copy(ZONE, "Base/Zone2")
        file["Base/Zone2/GridCoordinates/CoordinateX/ data"][...] += 5
    (tmp_path / "a.cgns").write_bytes(memory.getvalue())
    document = load(tmp_path / "a.cgns")
    assert set(document.mesh.cell_sets) == {"Zone", "Zone2"}
    mesh = tm.read(tmp_path / "a.cgns")
    assert len(mesh.points) == 2 * len(points)
    moved = mesh.points.clone()
    moved[-5] += 0.1
    tm.write(tmp_path / "b.cgns", mesh.with_points(moved), like=tmp_path / "a.cgns")
    assert np.array_equal(tm.read(tmp_path / "b.cgns").points, moved)


def test_the_unit_of_length_is_told(tmp_path):
    source = square(tmp_path / "a.cgns")
    with h5py.File(source, "r+", track_order=True) as file:
        words = "".join(word.ljust(32) for word in ("Kilogram", "Meter", "Second", "Kelvin", "Radian"))
        _node(file["Base"], "DimensionalUnits", "DimensionalUnits_t", words)
    assert load(source).units == "Meter"


def put(name, values):
    """A change of a file: other data in a node of it."""

    def change(file):
        group = file[name]
        del group[" data"]
        group[" data"] = np.asarray(values)

    return change


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (put(f"{ZONE}/ZoneType", np.frombuffer(b"Structured", np.int8)), "structured by 1 indices"),
        (put(f"{ZONE}/ZoneType", np.frombuffer(b"Odd", np.int8)), "neither structured nor unstructured"),
        (put(f"{ZONE}/triangle-1", np.array([22, 0])), r"polygons \(NGON_n\) of 5 corners|is cut short"),
        (put(f"{ZONE}/triangle-1", np.array([23, 0])), r"polyhedra \(NFACE_n\)"),
        (put(f"{ZONE}/triangle-1", np.array([17, 0])), "elements of type 17"),
        (put(f"{ZONE}/triangle-1/ElementConnectivity", np.array([1, 2, 99])), "none of 1 to 7"),
        (put(f"{ZONE}/triangle-1/ElementConnectivity", np.array([1, 2])), "no rows of 3"),
        (put(f"{ZONE}/GridCoordinates/CoordinateX", np.zeros(3)), "says 7 vertices and has 3"),
        (put(f"{ZONE}/ZoneBC/wall/PointList", np.array([0.5])), "no whole numbers"),
        (lambda file: file.pop("Base"), "no zone"),
        (lambda file: file[ZONE].pop("GridCoordinates"), "no CoordinateX"),
    ],
)
def test_mistakes_are_named(tmp_path, change, what):
    source = square(tmp_path / "a.cgns")
    with h5py.File(source, "r+") as file:
        change(file)
    with pytest.raises(tm.MeshIOError, match=what):
        tm.read(source)


def structured(path, low=(1, 1), high=(1, 3), place=None):
    """A zone of four by three vertices, of which one inside lies outside; and a condition on a range."""
    x, y = np.meshgrid(np.arange(4.0), np.arange(3.0))
    x[1, 1] = 4.5
    with h5py.File(path, "w", track_order=True) as file:
        base = _node(file, "Base", "CGNSBase_t", np.array([2, 2], np.int32))
        zone = _node(base, "Blk", "Zone_t", np.array([[4, 3], [3, 2], [0, 0]], np.int32))
        _node(zone, "ZoneType", "ZoneType_t", "Structured")
        grid = _node(zone, "GridCoordinates", "GridCoordinates_t")
        for name, values in (("CoordinateX", x), ("CoordinateY", y)):
            _node(grid, name, "DataArray_t", values)
        condition = _node(_node(zone, "ZoneBC", "ZoneBC_t"), "wall", "BC_t", "BCWall")
        _node(condition, "PointRange", "IndexRange_t", np.array([low, high], np.int32))
        if place:
            _node(condition, "GridLocation", "GridLocation_t", place)
    return path


def test_cells_of_a_structured_zone_are_quads_and_its_vertices_are_moved_in_place(tmp_path):
    source = structured(tmp_path / "a.cgns")
    mesh = tm.read(source)
    assert (len(mesh.points), len(mesh.triangles), len(mesh.quads)) == (12, 0, 6)
    improved, report = tm.improve(mesh)
    report.check()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.write(tmp_path / "b.cgns", improved, like=source)
    with h5py.File(source) as one, h5py.File(tmp_path / "b.cgns") as other:
        was, now = (f["Base/Blk/GridCoordinates/CoordinateX/ data"][()] for f in (one, other))
        assert was.shape == now.shape == (3, 4)
        assert np.argwhere(was != now).tolist() == [[1, 1]]
        assert (one["Base/Blk/ data"][()] == other["Base/Blk/ data"][()]).all()
    with pytest.warns(tm.MeshWarning, match="the structure of the zone 'Blk'"):
        tm.write(tmp_path / "b.vtu", improved, like=source)


@pytest.mark.parametrize(
    ("low", "high", "place", "edges"),
    [
        ((1, 1), (1, 3), None, [[0, 4], [4, 8]]),
        ((2, 3), (4, 3), "Vertex", [[9, 10], [10, 11]]),
        ((1, 1), (3, 1), "JFaceCenter", [[0, 1], [1, 2], [2, 3]]),
        ((4, 2), (4, 2), "IFaceCenter", [[7, 11]]),
        ((1, 3), (3, 3), "FaceCenter", [[8, 9], [9, 10], [10, 11]]),
    ],
)
def test_conditions_on_sides_of_a_structured_zone_are_walls(tmp_path, low, high, place, edges):
    mesh = load(structured(tmp_path / "a.cgns", low, high, place)).mesh
    (members,) = mesh.cell_sets.values()
    assert list(mesh.cell_sets) == ["wall"]
    assert [block.data[rows].tolist() for block, rows in zip(mesh.cells, members, strict=True)] == [[], edges]


def test_conditions_on_whole_ranges_of_a_structured_zone_are_vertices(tmp_path):
    mesh = load(structured(tmp_path / "a.cgns", (1, 2), (2, 3))).mesh
    assert mesh.point_sets["wall"].tolist() == [4, 5, 8, 9]
    for low, high in (((1, 1), (5, 1)), ((0, 1), (2, 1))):
        with pytest.raises(tm.MeshIOError, match="'wall' leaves the zone 'Blk'"):
            load(structured(tmp_path / "b.cgns", low, high))


@pytest.mark.parametrize("offsets", [True, False])
def test_polygons_of_three_and_four_corners_are_triangles_and_quads(tmp_path, offsets):
    source = square(tmp_path / "a.cgns", mixed=True)
    rows = [[1, 2, 5], [2, 3, 5], [3, 4, 5], [4, 1, 5], [2, 6, 7, 3]]
    with h5py.File(source, "r+") as file:
        section = file[f"{ZONE}/faces"]
        section[" data"][...] = [22, 0]
        del section["ElementConnectivity"]
        numbers = [n for row in rows for n in ([] if offsets else [len(row)]) + row]
        _node(section, "ElementConnectivity", "DataArray_t", np.array(numbers, np.int64))
        if offsets:
            _node(section, "ElementStartOffset", "DataArray_t", np.cumsum([0, *map(len, rows)]).astype(np.int64))
    mesh = tm.read(source)
    assert (len(mesh.triangles), len(mesh.quads)) == (4, 1)
    improved, report = tm.improve(mesh)
    report.check()
    tm.write(tmp_path / "b.cgns", improved, like=source)
    back = tm.read(tmp_path / "b.cgns")
    assert (back.points == improved.points).all()
    with h5py.File(source, "r+") as file:
        section = file[f"{ZONE}/faces"]
        if offsets:
            section["ElementStartOffset/ data"][...] = [0, 3, 6, 9, 11, 16]
        else:
            section["ElementConnectivity/ data"][0] = 5
    with pytest.raises(tm.MeshIOError, match=r"polygons \(NGON_n\) of . corners; those of three and four"):
        tm.read(source)


@pytest.mark.parametrize(("version", "pieces"), [("A", 1), ("A", 3), ("B", 1)])
def test_the_old_form_is_changed_in_place(tmp_path, version, pieces):
    source = square(tmp_path / "new.cgns", mixed=True, fields=["T", "p"])
    with h5py.File(source, "r") as file:
        (tmp_path / "a.cgns").write_bytes(adf.from_hdf5(file, version, pieces))
    one, other = load(source), load(tmp_path / "a.cgns")
    assert (one.mesh.points == other.mesh.points).all()
    assert all((a.data == b.data).all() for a, b in zip(one.mesh.cells, other.mesh.cells, strict=True))
    assert set(other.mesh.cell_sets) == {"wall"}
    mesh = tm.read(tmp_path / "a.cgns")
    tm.write(tmp_path / "same.cgns", mesh, like=tmp_path / "a.cgns")
    assert (tmp_path / "same.cgns").read_bytes() == (tmp_path / "a.cgns").read_bytes()
    improved, _ = tm.improve(mesh)
    for fields, left in (("interpolate", {"T", "p"}), ("drop", set())):
        tm.write(tmp_path / "b.cgns", improved, like=tmp_path / "a.cgns", fields=fields)
        back = load(tmp_path / "b.cgns").mesh
        assert set(back.point_data) == left
        assert (back.points == improved.points.numpy()).all()
        assert (np.sort(back.cells[0].data, 1) == np.sort(improved.triangles.numpy(), 1)).all()
    more = tm.MeshBatch.from_arrays(*meshes.grid_arrays(2, 2))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        tm.write(tmp_path / "c.cgns", more, like=tmp_path / "a.cgns")
    assert any("in HDF5 instead of ADF" in str(one.message) for one in said)


@pytest.mark.parametrize("version", ["A", "B"])
def test_damage_in_the_old_form_is_one_line(tmp_path, version):
    """Whatever byte is wrong, it is a MeshError or a mesh."""
    source = square(tmp_path / "new.cgns")
    with h5py.File(source, "r") as file:
        data = adf.from_hdf5(file, version)
    random, said = np.random.default_rng(0), []
    for _ in range(150):
        bad = bytearray(data[: random.integers(300, len(data))] if random.random() < 0.2 else data)
        for at in random.integers(266, len(bad), 3):
            bad[at] = random.integers(256)
        (tmp_path / "bad.cgns").write_bytes(bad)
        try:
            load(tmp_path / "bad.cgns")
        except tm.MeshIOError as error:
            said.append(str(error))
    assert len(said) > 30
    assert not any("\n" in text for text in said)
