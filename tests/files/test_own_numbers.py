"""Rows in messages are also given as the file's own numbers."""

import meshes
import meshio
import numpy as np
import pytest

import torchmesh as tm
from torchmesh.errors import InvalidMeshError
from torchmesh.files.documents import load
from torchmesh.files.formats.format import Document
from torchmesh.files.own_numbers import triangle_numbers, with_own_numbers
from torchmesh.files.source import Source

# Numbers far from rows, in another order than rows.
NODES = [700, 30, 900, 10]

MSH = """$MeshFormat
4.1 0 8
$EndMeshFormat
$Nodes
1 4 10 900
2 1 0 4
700
30
900
10
0 0 0
1 0 0
1 1 0
0 1 0
$EndNodes
$Elements
1 2 41 77
2 1 2 2
77 700 30 900
41 700 900 10
$EndElements
"""
BDF = "BEGIN BULK\n" + "".join(
    f"GRID,{n},,{x},{y},0.\n" for n, (x, y) in zip(NODES, [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], strict=True)
)  # fmt: skip
BDF += "CTRIA3,77,1,700,30,900\nCTRIA3,41,1,700,900,10\nENDDATA\n"
INP = (
    "*NODE\n700, 0., 0.\n30, 1., 0.\n900, 1., 1.\n10, 0., 1.\n*ELEMENT, TYPE=CPS3\n77, 700, 30, 900\n41, 700, 900, 10\n"
)
MDPA = """Begin Nodes
700 0 0 0
30 1 0 0
900 1 1 0
10 0 1 0
End Nodes
Begin Elements Element2D3N
77 0 700 30 900
41 0 700 900 10
End Elements
"""


# Formats whose files have numbers of their own, or count from 1.
UNV = "    -1\n  2411\n" + "".join(
    f"{n:10d}{1:10d}{1:10d}{11:10d}\n{x:25.16E}{y:25.16E}{0:25.16E}\n"
    for n, (x, y) in zip(NODES, [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], strict=True)
)  # fmt: skip
UNV += "    -1\n    -1\n  2412\n" + "".join(
    "".join(f"{k:10d}" for k in head) + "\n" + "".join(f"{k:10d}" for k in nodes) + "\n"
    for head, nodes in [([77, 91, 1, 1, 7, 3], [700, 30, 900]), ([41, 91, 1, 1, 7, 3], [700, 900, 10])]
) + "    -1\n"  # fmt: skip
ADCIRC = "t\n2 4\n700 0 0 1\n30 1 0 1\n900 1 1 1\n10 0 1 1\n77 3 700 30 900\n41 3 700 900 10\n"
SMS = "MESH2D\nE3T 77 700 30 900 1\nE3T 41 700 900 10 1\nND 700 0 0 0\nND 30 1 0 0\nND 900 1 1 0\nND 10 0 1 0\n"
NODE = "4 2 0 0\n700 0 0\n30 1 0\n900 1 1\n10 0 1\n"
ELE = "2 3 0\n77 700 30 900\n41 700 900 10\n"
AVS = "4 2 0 0 0\n700 0 0 0\n30 1 0 0\n900 1 1 0\n10 0 1 0\n77 1 tri 700 30 900\n41 1 tri 700 900 10\n"
PERMAS = (
    "$ENTER COMPONENT NAME=A\n$STRUCTURE\n$COOR\n700 0. 0. 0.\n30 1. 0. 0.\n900 1. 1. 0.\n10 0. 1. 0.\n"
    "$ELEMENT TYPE=TRIA3\n77 700 30 900\n41 700 900 10\n$END STRUCTURE\n$EXIT COMPONENT\n$FIN\n"
)
NUMBERED = [("a.msh", MSH), ("a.bdf", BDF), ("a.inp", INP), ("a.mdpa", MDPA)]
NUMBERED += [("a.unv", UNV), ("a.14", ADCIRC), ("a.2dm", SMS), ("a.node", NODE), ("a.avs", AVS), ("a.post", PERMAS)]

# They count nodes and triangles from 1, or from another number.
FREEFEM = "4 2 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n1 2 3 0\n1 3 4 0\n"
MEDIT = (
    "MeshVersionFormatted 2\nDimension 2\nVertices\n4\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n"
    "Triangles\n2\n1 2 3 0\n1 3 4 0\nEnd\n"
)
OBJ = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3\nf 1 3 4\n"


def document(**numbers) -> Document:
    points, triangles = meshes.grid_arrays(1, 1)
    return Document(meshio.Mesh(points, [("triangle", triangles)]), "any", **numbers)


@pytest.mark.parametrize(
    ("name", "text"), [("a.msh", MSH), ("a.bdf", BDF), ("a.inp", INP), ("a.mdpa", MDPA), *NUMBERED]
)
def test_formats_with_numbers_of_their_own(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    (tmp_path / "a.ele").write_text(ELE)
    source = Source.open(tmp_path / name)
    assert [int(n) for n in source.document.node_numbers] == NODES
    assert [int(n) for n in triangle_numbers(source.document)] == [77, 41]
    said = source.explained("the boundary edge [0, 3] and the vertex 1 meet; triangles row 1 [0, 2, 3] is flat")
    assert said.endswith("(in the file: nodes 700, 10, 30, 900; element 41)")


@pytest.mark.parametrize(
    ("name", "text", "element"),
    [("a.msh", FREEFEM, "; element 2"), ("a.mesh", MEDIT, "; element 2"), ("a.obj", OBJ, "")],
)
def test_formats_that_count_from_1(tmp_path, name, text, element):
    (tmp_path / name).write_text(text)
    said = Source.open(tmp_path / name).explained("the vertex 3 is beside triangles row 1")
    assert said.endswith(f"(in the file: node 4{element})")


def test_what_a_file_writes_it_numbers(tmp_path):
    """Formats in binary: a new file counts from 1, and MED may have numbers of its own."""
    mesh = tm.MeshBatch.from_arrays(*meshes.grid_arrays(1, 1))
    for name in ("a.slf", "a.med", "a.vol"):
        tm.write(tmp_path / name, mesh)
        said = Source.open(tmp_path / name).explained("the vertex 3 is beside triangles row 1")
        assert said.endswith("(in the file: node 4; element 2)"), name
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.med", "r+") as file:
        step = next(iter(next(iter(file["ENS_MAA"].values())).values()))
        step["NOE/NUM"] = np.array(NODES)
        step["MAI/TR3/NUM"] = np.array([77, 41])
        next(iter(file["ENS_MAA"].values())).attrs["UNI"] = np.bytes_("mm".ljust(16) + "mm".ljust(16))
    assert load(tmp_path / "a.med").units == "mm"
    said = Source.open(tmp_path / "a.med").explained("the vertex 3 is beside triangles row 1")
    assert said.endswith("(in the file: node 10; element 41)")


def test_quads_have_numbers_too_and_a_file_that_counts_them_together_says_so(tmp_path):
    text = "NDIME= 2\nNELEM= 2\n5 0 1 2 0\n9 1 3 4 2 1\nNPOIN= 5\n0 0\n1 0\n1 1\n2 0\n2 1\nNMARK= 0\n"
    (tmp_path / "a.su2").write_text(text)
    source = Source.open(tmp_path / "a.su2")
    assert source.explained("the vertex 3 is beside quads row 0").endswith("quads row 0 (in the file: element 1)")
    assert source.explained("the vertex 3 is beside triangles row 0") == "the vertex 3 is beside triangles row 0"


def test_a_file_that_cannot_be_taken_says_which_element_it_is(tmp_path):
    (tmp_path / "a.bdf").write_text(BDF.replace("700,900,10", "700,900,900"))
    with pytest.raises(InvalidMeshError, match=r"triangles row 1 is .*element 41\)"):
        Source.open(tmp_path / "a.bdf")


def test_exodus_has_maps_of_numbers(tmp_path):
    netcdf = pytest.importorskip("netCDF4")
    points, triangles = meshes.grid_arrays(1, 1)
    meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("triangle", triangles)]).write(tmp_path / "a.e")
    assert list(Source.open(tmp_path / "a.e").document.node_numbers) == [1, 2, 3, 4]
    with netcdf.Dataset(str(tmp_path / "a.e"), "r+") as data:
        for name, size, numbers in (("node_num_map", "num_nodes", NODES), ("elem_num_map", "num_elem", [77, 41])):
            data.createVariable(name, "i4", (size,))[:] = numbers
    source = Source.open(tmp_path / "a.e")
    assert list(source.document.node_numbers) == NODES
    assert list(triangle_numbers(source.document)) == [77, 41]


def test_a_triangle_that_the_file_lists_for_each_of_its_groups_has_its_first_number(tmp_path):
    old = "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n" + "".join(
        f"{n} {x} {y} 0\n" for n, (x, y) in zip(NODES, [(0, 0), (1, 0), (1, 1), (0, 1)], strict=True)
    )
    old += "$EndNodes\n$Elements\n3\n5 2 2 1 1 700 30 900\n6 2 2 2 1 900 700 30\n7 2 2 1 1 700 900 10\n$EndElements\n"
    (tmp_path / "a.msh").write_text(old)
    assert list(triangle_numbers(Source.open(tmp_path / "a.msh").document)) == [5, 7]


def test_many_numbers_are_cut_and_none_are_made_up():
    given = document(node_numbers=[10, 20, 30, 40], cell_numbers={"triangle": [8, 9]})
    assert with_own_numbers("120 inverted triangles are left at (0.5, 1)", given) == (
        "120 inverted triangles are left at (0.5, 1)"
    )
    assert with_own_numbers("vertices 0 and 99", given).endswith("(in the file: node 10)")
    assert with_own_numbers("triangles rows 0, 1 and 7 share", given).endswith("(in the file: elements 8, 9)")
    assert with_own_numbers("points row 2 is [0.0, 1.0]", given).endswith("(in the file: node 30)")
    assert with_own_numbers("vertex 1", document()) == "vertex 1"
    many = document(node_numbers=range(100, 200))
    assert with_own_numbers(f"the cavity {list(range(20))}", many).endswith("110, 111 and 8 more)")


def test_what_constrained_edges_come_from_is_one_sentence(tmp_path):
    points, triangles = meshes.grid_arrays(4, 4)
    sides = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    left = points[triangles].mean(1)[:, 0] < 0.5
    inside = ((points > 0.1) & (points < [0.4, 0.9])).all(1)
    for name, tags, lines, said in (
        ("both", 1 + left, sides[inside[sides].all(1)][:1], "interfaces between regions by cell data 'gmsh:physical', "
         "and lines of the file; --regions NAME|none chooses what tells regions"),
        ("regions", 1 + left, sides[:0], "interfaces between regions by cell data 'gmsh:physical'; --regions NAME|none "
         "chooses what tells regions"),
        ("lines", 1 + 0 * left, sides[inside[sides].all(1)][:1], "lines of the file"),
    ):  # fmt: skip
        cells = [("triangle", triangles), ("line", lines)][: 1 + len(lines)]
        data = {"gmsh:physical": [tags, np.full(len(lines), 9)][: 1 + len(lines)]}
        meshio.Mesh(points, cells, cell_data=data).write(tmp_path / f"{name}.vtu")
        told = Source.open(tmp_path / f"{name}.vtu").explained("the constrained edge [1, 2] and the vertex 3 meet")
        assert told.endswith(f" (constrained edges are {said})")


def test_borders_of_regions_of_quads_are_no_lines_of_the_file(tmp_path):
    mesh = meshes.mixed(6, 5, 3)
    cells = [("triangle", mesh.triangles.numpy()), ("quad", mesh.quads.numpy())]
    left = [(mesh.points.numpy()[block].mean(1)[:, 1] < 0.5).astype(int) for _, block in cells]
    points = np.pad(mesh.points.numpy(), ((0, 0), (0, 1)))
    meshio.Mesh(points, cells, cell_data={"material": left}).write(tmp_path / "a.vtu")
    source = Source.open(tmp_path / "a.vtu")
    assert len(source.mesh.constrained_edges) > 0
    told = source.explained("the constrained edge [1, 2] and the vertex 3 meet")
    assert "interfaces between regions by cell data 'material'; --regions" in told
