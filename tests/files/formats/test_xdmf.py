"""XDMF files as FEniCSx writes them: a mesh and its tags in several grids, with arrays as text or in HDF5."""

import h5py
import numpy as np
import pytest
from decks import changed_lines
from dialects import divided, named
from file_contents import grid, load, save

import torchmesh as tm

POINTS = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [1.4, 0.5]])
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
TAGGED = np.array([[4, 2, 1], [0, 4, 1]])  # two of the cells, with their vertices in another order
FACETS = np.array([[0, 1], [1, 2], [2, 3]])
ITEMS = {
    "/Mesh/mesh/topology": FACES, "/Mesh/mesh/geometry": POINTS, "/MeshTags/cells/topology": TAGGED,
    "/MeshTags/cells/Values": np.array([[7], [7]], np.int32), "/MeshTags/facets/topology": FACETS,
    "/MeshTags/facets/Values": np.array([[1], [2], [2]], np.int32),
}  # fmt: skip
TEXT = """<?xml version="1.0"?>
<!DOCTYPE Xdmf SYSTEM "Xdmf.dtd" []>
<Xdmf Version="3.0" xmlns:xi="https://www.w3.org/2001/XInclude">
  <Domain>
    <Grid Name="mesh" GridType="Uniform">
      <Topology TopologyType="Triangle" NumberOfElements="4" NodesPerElement="3">
        {topology}
      </Topology>
      <Geometry GeometryType="XY">
        {geometry}
      </Geometry>
    </Grid>
    <Grid Name="cells" GridType="Uniform">
      <xi:include xpointer="xpointer(/Xdmf/Domain/Grid[@GridType=&apos;Uniform&apos;][1]/Geometry)" />
      <Topology TopologyType="Triangle" NumberOfElements="2" NodesPerElement="3">
        {cells}
      </Topology>
      <Attribute Name="materials" AttributeType="Scalar" Center="Cell">
        {materials}
      </Attribute>
    </Grid>
    <Grid Name="facets" GridType="Uniform">
      <xi:include xpointer="xpointer(/Xdmf/Domain/Grid[@GridType=&apos;Uniform&apos;][1]/Geometry)" />
      <Topology TopologyType="PolyLine" NumberOfElements="3" NodesPerElement="2">
        {facets}
      </Topology>
      <Attribute Name="walls" AttributeType="Scalar" Center="Cell">
        {walls}
      </Attribute>
    </Grid>
  </Domain>
</Xdmf>
"""
NAMES = ("topology", "geometry", "cells", "materials", "facets", "walls")


def item(name: str, values: np.ndarray, form: str) -> str:
    kind = "" if values.dtype.kind == "f" else ' NumberType="Int"'
    text = f"mesh.h5:{name}" if form == "HDF" else "\n".join(" ".join(map(str, row)) for row in values.tolist())
    size = " ".join(map(str, values.shape))
    return f'<DataItem Dimensions="{size}"{kind} Precision="8" Format="{form}">{text}</DataItem>'


@pytest.fixture(params=["HDF", "XML"])
def source(tmp_path, request):
    items = [item(name, values, request.param) for name, values in ITEMS.items()]
    (tmp_path / "mesh.xdmf").write_text(TEXT.format(**dict(zip(NAMES, items, strict=True))))
    if request.param == "HDF":
        with h5py.File(tmp_path / "mesh.h5", "w") as file:
            for name, values in ITEMS.items():
                file[name] = values
            file["Mesh/mesh"].attrs["partition"] = 3
    return tmp_path / "mesh.xdmf"


def test_tags_are_cell_data_and_walls(source):
    mesh = load(source)
    assert [block.type for block in mesh.cells] == ["triangle", "line"]
    assert [values.tolist() for values in mesh.cell_data["materials"]] == [[7, 7, 0, 0], [0, 0, 0]]
    assert [values.tolist() for values in mesh.cell_data["walls"]] == [[0] * 4, [1, 2, 2]]
    assert named(source) == {"walls-1": [[0, 1]], "walls-2": [[1, 2], [2, 3]]}
    assert tm.read(source).constrained_edges.tolist() == [[0, 4], [2, 4]]


def test_only_the_moved_vertex_changes(source, tmp_path):
    mesh = tm.read(source)
    points = mesh.points.clone()
    points[4, 0] = 0.5  # the vertex lies between regions, where improve would leave it
    tm.write(tmp_path / "out.xdmf", mesh.with_points(points), like=source)
    assert np.array_equal(tm.read(tmp_path / "out.xdmf").points, points)
    changed = changed_lines(source, tmp_path / "out.xdmf")
    if (tmp_path / "mesh.h5").exists():
        assert [new for _, new in changed] == [old.replace("mesh.h5:", "out.h5:") for old, _ in changed]
        assert len(changed) == 6
        with h5py.File(tmp_path / "out.h5") as file:
            assert file["Mesh/mesh"].attrs["partition"] == 3
            for name, values in ITEMS.items():
                wanted = tm.read(tmp_path / "out.xdmf").points if "geometry" in name else values
                np.testing.assert_array_equal(file[name], wanted)
    else:
        ((old, new),) = changed
        assert old.startswith("1.4 0.5</DataItem>")
        assert new.endswith("</DataItem>")


def test_tagged_cells_follow_flips(source, tmp_path):
    mesh = tm.read(source)
    faces = mesh.triangles[[1, 0, 2, 3]]  # rows 0 and 1 have one tag, so that they may change places
    turned = tm.MeshBatch.from_arrays(mesh.points, faces, mesh.fixed, mesh.constrained_edges)
    tm.write(tmp_path / "out.xdmf", turned, like=source)
    assert [v.tolist() for v in load(tmp_path / "out.xdmf").cell_data["materials"]] == [[7, 7, 0, 0], [0, 0, 0]]
    assert np.array_equal(tm.read(tmp_path / "out.xdmf").triangles, faces)


def test_a_file_without_changes_comes_back(source, tmp_path):
    (tmp_path / "again").mkdir()
    out = tmp_path / "again" / "mesh.xdmf"
    tm.write(out, tm.read(source), like=source)
    assert out.read_bytes() == source.read_bytes()
    assert changed_lines(source, out) == []
    assert (tmp_path / "again" / "mesh.h5").exists() is (tmp_path / "mesh.h5").exists()


def test_new_files_have_no_mixed_cells(source, tmp_path):
    mesh, _ = divided(source)
    tm.write(tmp_path / "out.xdmf", mesh, like=source)
    text = (tmp_path / "out.xdmf").read_text()
    assert "Mixed" not in text
    assert "xi:include" in text
    assert np.array_equal(tm.read(tmp_path / "out.xdmf").triangles, mesh.triangles)
    assert named(tmp_path / "out.xdmf") == named(source)
    save(tmp_path / "b.xdmf", grid())
    assert "Mixed" not in (tmp_path / "b.xdmf").read_text()
    found = load(tmp_path / "b.xdmf")
    assert {block.type: len(block.data) for block in found.cells} == {"triangle": 32, "line": 4}
    assert {values.tolist()[0] for values in found.cell_data["region"]} == {1, 5}


def test_fixed_vertices_are_added_in_place(source, tmp_path):
    mesh = tm.read(source)
    held = tm.MeshBatch.from_arrays(mesh.points, mesh.triangles, np.ones(5, bool), mesh.constrained_edges)
    tm.write(tmp_path / "out.xdmf", held, like=source)
    assert tm.read(tmp_path / "out.xdmf").fixed.all()
    assert (tmp_path / "out.xdmf").read_text().count("<Grid") == 3


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("4 2 1", "4 2 3", None),
        ("4 2 1", "3 2 1", "its grid 'cells' has cells that the mesh has not"),
        ("<Domain>", "<Domains>", "no XML|mismatched tag"),
        ("</Grid>", "", "no XML|mismatched tag"),
        ('Grid Name="facets" GridType="Uniform"', 'Grid Name="facets" GridType="Collection"', "a collection of grids"),
    ],
)
def test_mistakes_are_named(tmp_path, old, new, what):
    items = [item(name, values, "XML") for name, values in ITEMS.items()]
    text = TEXT.format(**dict(zip(NAMES, items, strict=True)))
    (tmp_path / "a.xdmf").write_text(text.replace(old, new))
    if what is None:
        tm.read(tmp_path / "a.xdmf")
        return
    with pytest.raises(tm.MeshIOError, match=what):
        tm.read(tmp_path / "a.xdmf")


def test_tags_may_name_the_geometry_of_the_first_grid_without_its_type(source, tmp_path):
    text = source.read_text().replace("Grid[@GridType=&apos;Uniform&apos;][1]/Geometry", "Grid/Geometry")
    (tmp_path / "plain.xdmf").write_text(text)
    assert "Uniform&apos;" not in text
    mesh = load(tmp_path / "plain.xdmf")
    assert [block.type for block in mesh.cells] == ["triangle", "line"]
    assert mesh.cell_data["walls"][1].tolist() == [1, 2, 2]


def test_lists_of_mixed_cells_hold_curved_ones_and_polygons(tmp_path):
    rng = np.random.default_rng(0)
    cells = [(36, range(6)), (37, range(8)), (37, range(1, 9)), (35, range(9)), (34, range(3)), (2, (0, 1)),
             (3, (2, 1, 0)), (3, (4, 5, 6, 7)), (4, (3, 4, 5))]  # fmt: skip
    numbers = [n for kind, nodes in cells for n in (kind, *([len(nodes)] if kind in (2, 3) else []), *nodes)]
    points = rng.random((9, 2))
    items = [item("", values, "XML") for values in (np.array(numbers)[:, None], points)]
    grids = f'<Topology TopologyType="Mixed">{items[0]}</Topology><Geometry GeometryType="XY">{items[1]}</Geometry>'
    (tmp_path / "a.xdmf").write_text(f'<Xdmf Version="3.0"><Domain><Grid Name="m">{grids}</Grid></Domain></Xdmf>')
    found = [(block.type, block.data.tolist()) for block in load(tmp_path / "a.xdmf").cells]
    assert found == [
        ("triangle6", [[*range(6)]]), ("quad8", [[*range(8)], [*range(1, 9)]]), ("quad9", [[*range(9)]]),
        ("line3", [[0, 1, 2]]), ("line", [[0, 1]]), ("triangle", [[2, 1, 0]]), ("quad", [[4, 5, 6, 7]]),
        ("triangle", [[3, 4, 5]]),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("numbers", "text"),
    [
        ([99, 0, 1], "type 99"),
        ([36, 0, 1, 2], "cut short"),
        ([3, 5, 0, 1, 2, 3, 4], "type 3 with 5 nodes"),
        ([3], "type 3 with 0"),
    ],
)
def test_damaged_lists_of_mixed_cells_are_told(tmp_path, numbers, text):
    items = [item("", values, "XML") for values in (np.array(numbers)[:, None], POINTS)]
    grids = f'<Topology TopologyType="Mixed">{items[0]}</Topology><Geometry GeometryType="XY">{items[1]}</Geometry>'
    (tmp_path / "a.xdmf").write_text(f'<Xdmf Version="3.0"><Domain><Grid Name="m">{grids}</Grid></Domain></Xdmf>')
    with pytest.raises(tm.MeshIOError, match=text):
        tm.read(tmp_path / "a.xdmf")
