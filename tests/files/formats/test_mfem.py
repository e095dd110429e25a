"""MFEM's meshes: told from Medit's by their content, changed in place, written anew where rows change."""

import curved_meshes as cm
import meshio
import numpy as np
import pytest
from dialects import divided, improved, named, turned

import torchmesh as tm
from torchmesh.batches.file_improvement import improve_series, open_mesh
from torchmesh.files.documents import load
from torchmesh.files.formats.mfem import MFEM

SQUARE = """MFEM mesh v1.0

#
# MFEM Geometry Types (see fem/geom.hpp):
#
# SEGMENT     = 1
# TRIANGLE    = 2
#

dimension
2

elements
4
1 2 0 1 4
1 2 1 2 4
1 2 2 3 4
1 2 3 0 4

boundary
4
1 1 0 1
2 1 1 2
3 1 2 3
4 1 3 0

vertices
5
2
0 0
1 0
1 1
0 1
1.4 0.5
"""

VERTICES = SQUARE.split("vertices\n5\n")[1]

# As MFEM writes straight elements after SetCurvature(1).
NODES = (
    "\nnodes\nFiniteElementSpace\nFiniteElementCollection: H1_2D_P1\nVDim: 2\nOrdering: 1\n\n"
    + VERTICES.split("2\n", 1)[1]
)


@pytest.fixture
def source(tmp_path):
    (tmp_path / "square.mesh").write_text(SQUARE)
    return tmp_path / "square.mesh"


def test_only_the_moved_vertex_changes(source, tmp_path):
    assert improved(source, tmp_path / "out.mesh") == [("1.4 0.5", "0.5 0.5")]
    names = {f"attribute-{k}": [edge] for k, edge in enumerate(([0, 1], [1, 2], [2, 3], [0, 3]), 1)}
    assert named(source) == names


def test_flips_change_the_rows_of_their_triangles(source, tmp_path):
    assert turned(source, tmp_path / "out.mesh") == [("1 2 0 1 4", "1 2 1 2 4"), ("1 2 1 2 4", "1 2 0 1 4")]


def test_names_of_attributes_are_those_of_walls(source, tmp_path):
    sets = 'bdr_attribute_sets\n2\n"outer wall" 2 1 2\n"lid" 1 3\n\nvertices\n'
    source.write_text(SQUARE.replace("v1.0", "v1.3").replace("vertices\n", sets) + "\nmfem_mesh_end\n")
    assert named(source)["outer wall"] == [[0, 1], [1, 2]]
    assert improved(source, tmp_path / "out.mesh") == [("1.4 0.5", "0.5 0.5")]
    with pytest.warns(tm.MeshWarning, match="not carried over .*: the bdr_attribute_sets"):
        tm.write(tmp_path / "b.vtu", tm.read(source), like=source)


def test_numbers_of_a_set_of_attributes_may_stand_on_further_lines(source):
    sets = 'bdr_attribute_sets\n2\n"outer wall"\n2\n1\n2\nlid 1\n3\n\nvertices\n'
    source.write_text(SQUARE.replace("v1.0", "v1.3").replace("vertices\n", sets) + "\nmfem_mesh_end\n")
    assert named(source)["outer wall"] == [[0, 1], [1, 2]]
    assert named(source)["lid"] == [[2, 3]]


def test_a_file_of_gmsh_with_the_extension_mesh_is_told(tmp_path):
    (tmp_path / "a.mesh").write_text("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n")
    with pytest.raises(tm.MeshIOError, match=r"a\.mesh: it is one of Gmsh's files; give it the extension \.msh"):
        tm.read(tmp_path / "a.mesh")


def test_quads_and_coordinates_in_space_are_read(source):
    quad = SQUARE.replace("elements\n4\n", "elements\n5\n1 3 1 5 6 2\n").replace("5\n2\n0 0\n1 0\n", "7\n2\n0 0\n1 0\n")
    source.write_text(quad + "2 0\n2 1\n")
    cells = load(source).mesh.cells
    assert [(block.type, len(block.data)) for block in cells] == [("quad", 1), ("triangle", 4), ("line", 4)]
    points = SQUARE.split("5\n2\n")[1].replace("\n", " 0\n")
    source.write_text(SQUARE.split("5\n2\n")[0] + "5\n3\n" + points)
    assert tm.read(source).points.shape == (5, 2)


def test_a_mesh_with_more_vertices_is_written_anew_in_the_same_format(source, tmp_path):
    mesh, _ = divided(source)
    with pytest.warns(tm.MeshWarning, match="comments"):
        tm.write(tmp_path / "out.mesh", mesh, like=source)
    assert (tmp_path / "out.mesh").read_text().startswith("MFEM mesh v1.0\n")
    assert np.array_equal(tm.read(tmp_path / "out.mesh").triangles, mesh.triangles)
    assert named(tmp_path / "out.mesh") == named(source)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("v1.0", "v2.0", "not of the versions"),
        ("MFEM mesh v1.0", "MFEM INLINE mesh v1.0", "not of the versions"),
        ("dimension\n2", "dimension\n3", "dimension is not 2"),
        ("1 2 0 1 4", "1 4 0 1 4 2", "geometry 4 is not planar"),
        ("5\n2\n0 0\n", "5\n\nnodes\nFiniteElementSpace\n", "a row FiniteElementCollection"),
        (VERTICES, NODES.replace("P1", "P3"), "curved by H1_2D_P3"),
        (VERTICES, NODES.replace("H1_2D_P1", "L2_T1_2D_P1"), "periodic or torn"),
        (VERTICES, NODES.replace("P1", "P2"), "5 positions instead of 13"),
        (VERTICES, NODES + "7\n", "no rows of 2"),
        ("elements\n4", "elements\n4000", "elements says 4000"),
        ("\nboundary", "\nborder", "its section 'border' is not known"),
    ],
)
def test_mistakes_are_named(source, old, new, what):
    source.write_text(SQUARE.replace(old, new))
    with pytest.raises(tm.MeshIOError, match=what):
        tm.read(source)


def test_nodes_of_order_1_are_positions_and_one_of_them_changes(source, tmp_path):
    source.write_text(SQUARE.replace(VERTICES, NODES))
    assert improved(source, tmp_path / "out.mesh") == [("1.4 0.5", "0.5 0.5")]
    by_axis = NODES.replace("Ordering: 1", "Ordering: 0").split("\n\n")[0] + "\n\n0\n1\n1\n0\n1.4\n0\n0\n1\n1\n0.5\n"
    source.write_text(SQUARE.replace(VERTICES, by_axis))
    assert improved(source, tmp_path / "out.mesh") == [("1.4", "0.5")]


def curved(path, by_axis=False, ring=cm.tangled_annulus):
    """A ring of six-node triangles, whose rows are in MFEM's order of nodes."""
    points, six = ring()
    vertices = int(six[:, :3].max()) + 1
    edges = cm.boundary(six)
    text = ["MFEM mesh v1.0", "", "dimension", "2", "", "elements", str(len(six))]
    text += [f"7 2 {a} {b} {c}" for a, b, c in six[:, :3].tolist()]
    text += ["", "boundary", str(len(edges)), *(f"3 1 {a} {b}" for a, b in edges), "", "vertices", str(vertices)]
    text += ["", "nodes", "FiniteElementSpace", "FiniteElementCollection: H1_2D_P2", "VDim: 2"]
    text += [f"Ordering: {int(not by_axis)}", ""]
    flat = points[:, :2].T.reshape(-1, 1) if by_axis else points[:, :2]
    text += [" ".join(map(repr, row)) for row in flat.tolist()]
    path.write_text("\n".join(text) + "\n")
    return points, six


@pytest.mark.parametrize("by_axis", [False, True])
def test_curved_elements_are_mended_and_their_nodes_stand_in_mfems_order(tmp_path, by_axis):
    points, six = curved(tmp_path / "ring.mesh", by_axis)
    before = load(tmp_path / "ring.mesh").mesh
    assert (before.cells[0].data == six).all()
    assert (before.points == points[:, :2]).all()
    assert before.cells[1].type == "line3"
    (done,) = improve_series([open_mesh(tmp_path / "ring.mesh")], tm.ImproveOptions())
    done.write(tmp_path / "out.mesh")
    after = load(tmp_path / "out.mesh").mesh
    assert (cm.jacobians(np.pad(after.points, ((0, 0), (0, 1))), after.cells[0].data).min(1) > 0).all()
    old, new = cm.edges(six), cm.edges(after.cells[0].data)
    assert set(new) != set(old), "an edge has flipped, so that MFEM counts the edges in another order"
    assert all((after.points[new[e]] == points[old[e], :2]).all() for e in cm.boundary(six))
    was, now = ((tmp_path / name).read_text().split("nodes")[0] for name in ("ring.mesh", "out.mesh"))
    assert was.split("boundary")[1] == now.split("boundary")[1]


def test_curved_elements_that_nothing_moves_come_back_to_the_letter(tmp_path):
    curved(tmp_path / "ring.mesh", ring=cm.annulus)
    tm.write(tmp_path / "same.mesh", tm.read(tmp_path / "ring.mesh"), like=tmp_path / "ring.mesh")
    assert (tmp_path / "same.mesh").read_text() == (tmp_path / "ring.mesh").read_text()


def test_curved_elements_of_other_formats_become_nodes(tmp_path):
    points, six = cm.annulus()
    meshio.Mesh(points, [("triangle6", six)]).write(tmp_path / "ring.vtu")
    tm.write(tmp_path / "ring.mfem", tm.read(tmp_path / "ring.vtu"), like=tmp_path / "ring.vtu")
    back = load(tmp_path / "ring.mfem").mesh
    assert (back.cells[0].data == six).all()
    assert (back.points == points[:, :2]).all()


def test_quads_of_order_2_have_a_node_inside(tmp_path):
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0.0], [0.5, -0.1], [1, 0.5], [0.5, 1], [0, 0.5]])
    more = np.array([[1.5, 0.0], [1.6, 0.6], [0.5, 0.45]])
    cells = [("quad9", np.array([[0, 1, 2, 3, 5, 6, 7, 8, 11]])), ("triangle6", np.array([[1, 4, 2, 9, 10, 6]]))]
    meshio.Mesh(np.pad(np.concatenate([points, more]), ((0, 0), (0, 1))), cells).write(tmp_path / "a.vtu")
    document = load(tmp_path / "a.vtu")
    MFEM.write(tmp_path / "a.mfem", document.mesh, None, False)
    back = load(tmp_path / "a.mfem").mesh
    assert [b.type for b in back.cells] == ["quad9", "triangle6"]
    for one, two in zip(document.mesh.cells, back.cells, strict=True):
        assert (document.mesh.points[one.data, :2] == back.points[two.data]).all()
