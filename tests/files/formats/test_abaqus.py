"""Abaqus decks: what is not moved or flipped stays to the letter, and loads stay on their edges."""

import json
import re
import warnings

import meshio
import numpy as np
import pytest
from decks import POINTS, TRIANGLES, changed_lines, flip_and_move, stale

import torchmesh as tm
from torchmesh.commands.main import main
from torchmesh.files.documents import load
from torchmesh.files.drafts import Draft
from torchmesh.files.formats.abaqus import ABAQUS
from torchmesh.files.formats.abaqus_cards import element_kind
from torchmesh.files.source import Source

NODES = "".join(f"{10 * (k + 1)},  {x!r},{y!r}\n" for k, (x, y) in enumerate(POINTS))


def elements(rows, first=1):
    return "".join(f" {first + k}, {', '.join(str(10 * (v + 1)) for v in row)}\n" for k, row in enumerate(rows))


DECK = f"""*Heading
** made by hand
*Node, nset=ALL
{NODES}*Element, type=CPE3, elset=STEEL
{elements(TRIANGLES[:4])}*ELEMENT, TYPE=CPE3,
 ELSET=RUBBER
{elements(TRIANGLES[4:], 5)}*Nset, nset=LEFT, generate
 10, 40, 30
*Elset, elset=_TOP_S2, internal
 6,
*Surface, type=ELEMENT, name=TOP
_TOP_S2, S2
*Surface, name=RIGHT
5, S2
*Solid Section, elset=STEEL, material=Iron
1.
*Solid Section, elset=RUBBER, material=Gum
*Step, name=Load   ** a comment
*Dload
 6, P2,  -3.5
STEEL, GRAV, 9.81, 0., -1., 0.
*Film
5, F1, 20., 0.1
*End Step
"""


def sides(path):
    """The edges of all surfaces and loads, as sets of coordinates."""
    document = ABAQUS.read(path)
    points = document.mesh.points
    return {
        re.sub(r" \d+$", "", name): {frozenset(map(tuple, points[edge].tolist())) for edge in edges}
        for name, edges in document.sides.items()
    }


def test_only_moved_nodes_flipped_elements_and_their_sides_change(tmp_path):
    source, target = tmp_path / "in.inp", tmp_path / "out.inp"
    source.write_text(DECK)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.write(target, flip_and_move(tm.read(source)), like=source)
    assert changed_lines(source, target) == [
        ("70,  0.25,0.5", "70,  0.3333333333333333,0.55"),
        (" 5, 20, 30, 60", " 5, 20, 30, 50"),
        (" 6, 20, 60, 50", " 6, 30, 60, 50"),
        ("5, S2", "6, S1"),
    ]
    assert sides(source) == sides(target)


def test_a_surface_by_a_set_names_its_elements_where_their_sides_have_changed(tmp_path):
    source, target = tmp_path / "in.inp", tmp_path / "out.inp"
    # The set holds sides 2 of elements 5 and 6: after the flip, these edges are the sides 1 and 2 of element 6.
    source.write_text(DECK.replace(" 6,\n*Surface", " 5, 6\n*Surface"))
    tm.write(target, flip_and_move(tm.read(source)), like=source)
    text = target.read_text()
    assert "name=TOP\n6, S1\n6, S2\n*Surface" in text
    assert "*Elset, elset=_TOP_S2, internal\n 5, 6\n" in text
    assert sides(source) == sides(target)


def test_materials_are_regions_and_sets_of_a_surface_are_not(tmp_path):
    (tmp_path / "in.inp").write_text(DECK)
    assert tm.read(tmp_path / "in.inp").constrained_edges.tolist() == [[1, 4]]


def test_edges_that_a_load_names_are_not_flipped(tmp_path):
    (tmp_path / "in.inp").write_text(DECK.replace(" 6, P2", " 6, P1"))
    assert [1, 5] in tm.read(tmp_path / "in.inp").constrained_edges.tolist()


@pytest.mark.parametrize("kind", ["CPS3", "CAX3", "S3R", "CPEG3", "DC2D3", "M3D3"])
def test_the_type_of_elements_stays(tmp_path, kind):
    plain = DECK[: DECK.index("*Elset")]  # the faces of shells are no sides
    (tmp_path / "in.inp").write_text(plain.replace("CPE3", kind))
    tm.write(tmp_path / "out.inp", flip_and_move(tm.read(tmp_path / "in.inp")), like=tmp_path / "in.inp")
    assert (tmp_path / "out.inp").read_text().count(kind) == 2


def test_parts_have_numbers_of_their_own(tmp_path):
    def part(name, rows, nodes):
        # Each part numbers its nodes from 1.
        number = {v: k + 1 for k, v in enumerate(nodes)}
        at = "".join(f"{number[v]}, {POINTS[v][0]!r}, {POINTS[v][1]!r}\n" for v in nodes)
        faces = "".join(f"{k + 1}, {', '.join(str(number[v]) for v in row)}\n" for k, row in enumerate(rows))
        return f"*Part, name={name}\n*Node\n{at}*Element, type=CPS3\n{faces}*End Part\n"

    deck = part("A", TRIANGLES[:4], [0, 1, 4, 3, 6]) + part("B", TRIANGLES[4:], [1, 2, 5, 4])
    deck += "*Assembly, name=X\n*Instance, name=A-1, part=A\n*End Instance\n*Instance, name=B-1, part=B\n"
    deck += (
        "*End Instance\n*Elset, elset=_S_S2, internal, instance=B-1\n1,2\n*Surface, type=ELEMENT, name=S\n_S_S2, S2\n"
    )
    deck += "*End Assembly\n"
    (tmp_path / "in.inp").write_text(deck)
    source = Source.open(tmp_path / "in.inp")
    mesh = source.mesh
    assert len(mesh.points) == 9
    assert len(mesh.constrained_edges) == 0  # the parts share no vertices
    flipped = mesh.triangles.clone()
    flipped[4], flipped[5] = mesh.triangles.new_tensor([5, 6, 8]), mesh.triangles.new_tensor([6, 7, 8])
    tm.write(tmp_path / "out.inp", tm.MeshBatch.from_arrays(mesh.points, flipped, mesh.fixed), like=source)
    text = (tmp_path / "out.inp").read_text()
    assert "1, 1, 2, 4\n2, 2, 3, 4\n" in text
    assert "B-1.2, S1\nB-1.2, S2\n" in text
    assert sides(tmp_path / "in.inp") == sides(tmp_path / "out.inp")


@pytest.mark.parametrize(
    ("card", "message"),
    [
        ("*INCLUDE, INPUT=more.inp\n", r"\*INCLUDE; put the text of the included file"),
        ("*NGEN\n1, 5\n", r"\*NGEN"),
        ("*Element, type=CPS3, input=e.txt\n", r"INPUT=e.txt"),
        ("*System\n1., 0., 0.\n", r"\*SYSTEM"),
    ],
)
def test_what_does_not_stand_in_the_text_is_refused_by_name(tmp_path, card, message):
    (tmp_path / "in.inp").write_text(DECK + card)
    with pytest.raises(tm.MeshError, match=message):
        tm.read(tmp_path / "in.inp")


def test_no_number_is_wider_than_calculix_reads():
    for value in (-1.2345678901234567e-5, 1 / 3, -2 / 3, 1e300, -1.2345678901234567e-200, 5.0, 1e22):
        text = ABAQUS.number(value, 0)
        assert len(text) <= 20
        assert float(text) == pytest.approx(value, rel=1e-12)
        assert "." in text or "e" in text


def test_a_coordinate_that_was_left_out_is_added(tmp_path):
    (tmp_path / "in.inp").write_text(DECK.replace("70,  0.25,0.5", "70,  0.25"))
    mesh = tm.read(tmp_path / "in.inp")
    tm.write(tmp_path / "out.inp", flip_and_move(mesh), like=tmp_path / "in.inp")
    assert "70,  0.3333333333333333, 0.55\n" in (tmp_path / "out.inp").read_text()


def test_volumes_lines_and_plates_are_told_apart():
    assert element_kind("C3D4", 4) == "tetra"
    assert element_kind("CPS4R", 4) == "quad"
    assert element_kind("B32", 3) == "line3"
    assert element_kind("SAX1", 2) == "line"
    with pytest.raises(ValueError, match="CPS3 with 5 nodes"):
        element_kind("CPS3", 5)


def test_line_ends_and_foreign_bytes_stay(tmp_path):
    data = DECK.replace("made by hand", "gr\xf6\xdfe").encode("latin-1").replace(b"\n", b"\r\n")
    (tmp_path / "in.inp").write_bytes(data)
    tm.write(tmp_path / "out.inp", tm.read(tmp_path / "in.inp"), like=tmp_path / "in.inp")
    assert (tmp_path / "out.inp").read_bytes() == data


def test_other_vertices_are_refused_and_another_format_names_the_cards(tmp_path):
    (tmp_path / "in.inp").write_text(DECK)
    mesh = tm.read(tmp_path / "in.inp")
    fewer = tm.MeshBatch.from_arrays(mesh.points[:3].clone(), mesh.triangles.new_tensor([[0, 1, 2]]))
    with pytest.raises(tm.MeshIOError, match=r"changed in place.*topology 'full'"):
        tm.write(tmp_path / "out.inp", fewer, like=tmp_path / "in.inp")
    assert not (tmp_path / "out.inp").exists()
    with pytest.warns(tm.MeshWarning, match=r"\*SOLID SECTION, \*STEP, \*DLOAD.*sides 'TOP'"):
        tm.write(tmp_path / "out.vtu", mesh, like=tmp_path / "in.inp")


def test_a_value_by_element_is_named_when_elements_change(tmp_path):
    (tmp_path / "in.inp").write_text(DECK + "*Initial Conditions, type=STRESS\n5, 1., 2., 3.\n6, 4., 5., 6.\n")
    mesh = tm.read(tmp_path / "in.inp")
    with pytest.warns(tm.MeshWarning, match=r"values by element of \*INITIAL"):
        tm.write(tmp_path / "out.inp", flip_and_move(mesh), like=tmp_path / "in.inp")


@pytest.mark.parametrize(
    ("cards", "said"),
    [
        ("*Temperature\n70, 20.\n10, 30.\n", ["*TEMPERATURE at 1 node"]),
        ("*Temperature\nALL, 20.\n60, 30.\n", ["*TEMPERATURE at 1 node"]),
        ("*Initial Conditions, type=Temperature\n70, 2D1\n", ["*INITIAL CONDITIONS TYPE=TEMPERATURE at 1 node"]),
        ("*Boundary\n70, 1, 2, 1e-3\n*Cload\nALL, 2, -3.\n", ["*BOUNDARY at 1 node, *CLOAD at 1 node"]),
        ("*Temperature, input=t.txt\n", ["*TEMPERATURE at 1 node"]),
        # A field that is the same everywhere, supports of zero and names, and values at nodes that stay.
        ("*Initial Conditions, type=TEMPERATURE\nALL, 20.\n", []),
        ("*Boundary\n70, 1, 2\n70, 3, 3, 0.\n70, ENCASTRE\nLEFT, 1, 1, 0.5\n", []),
        ("*Cload\n70, 1, 0.\n20, 1, 5.\n*Temperature\nLEFT, 20.\n30, 25.\n", []),
        ("*Temperature\nALL, 0.\n", []),
    ],
)
def test_values_at_nodes_that_moved_are_named(tmp_path, cards, said):
    (tmp_path / "in.inp").write_text(DECK + cards)
    assert stale(tmp_path / "in.inp") == said
    assert (tmp_path / "moved.inp").read_text().endswith(cards)


def test_values_at_nodes_of_an_instance_are_found(tmp_path):
    part = f"*Part, name=P\n{DECK[DECK.index('*Node') : DECK.index('*Elset')]}*End Part\n"
    part += "*Assembly, name=A\n*Instance, name=P-1, part=P\n*End Instance\n"
    part += "*Nset, nset=MID, instance=P-1\n70,\n*End Assembly\n"
    (tmp_path / "in.inp").write_text(part + "*Temperature\nMID, 3.\n*Cload\nP-1.ALL, 1, 2.\n*Field\nP-1.70, 1.\n")
    assert stale(tmp_path / "in.inp") == ["*TEMPERATURE at 1 node, *CLOAD at 1 node, *FIELD at 1 node"]


def test_a_temperature_at_a_node_is_no_value_of_the_element_of_that_number(tmp_path):
    deck = DECK.replace("70,", "5,").replace(", 70", ", 5")
    (tmp_path / "in.inp").write_text(deck + "*Initial Conditions, type=TEMPERATURE\n5, 20.\n")
    document = ABAQUS.read(tmp_path / "in.inp")
    assert document.by_element == ()
    assert document.at_nodes["*INITIAL CONDITIONS TYPE=TEMPERATURE"].tolist() == [6]


def test_strict_refuses_values_at_nodes_that_would_move(tmp_path, capsys):
    source, target = tmp_path / "in.inp", tmp_path / "out.inp"
    source.write_text(DECK.replace("70,  0.25,0.5", "70,  1.5,0.5") + "*Temperature\n70, 20.\n")
    line = "values at nodes that moved {} as they were: *TEMPERATURE at 1 node"
    assert main(["improve", str(source), str(target), "--strict", "-q"]) == 2
    assert f"not written, because {line.format('would stay')} (strict)" in capsys.readouterr().err
    assert not target.exists()
    assert main(["improve", str(source), str(target), "-q", "--report", str(tmp_path / "r.json")]) == 0
    assert capsys.readouterr().err.count(line.format("stay")) == 1
    lost = json.loads((tmp_path / "r.json").read_text())["lost"]
    assert lost == ["values of *TEMPERATURE at 1 node that moved"]
    # Values that are to ride with their nodes are right as they stand.
    assert main(["improve", str(source), str(target), "-q", "--strict", "--fields", "carry"]) == 0


@pytest.mark.parametrize(("tilt", "kinds"), [(0, ["CPS3", "CPS4", "T2D2"]), (1, ["S3", "S4", "T3D2"])])
def test_a_new_deck_has_plane_elements_or_shells(tmp_path, tilt, kinds):
    points = np.array([[0, 0, 0], [1, 0, tilt], [1, 1, tilt], [0, 1, 0], [2, 0, 2 * tilt]])
    cells = [("triangle", np.array([[1, 4, 2]])), ("quad", np.array([[0, 1, 2, 3]])), ("line", np.array([[0, 1]]))]
    before = dict(meshio.abaqus._abaqus.meshio_to_abaqus_type)
    Draft.of(tmp_path / "a.inp", meshio.Mesh(points, cells)).save()
    assert re.findall(r"TYPE=(\w+)", (tmp_path / "a.inp").read_text()) == kinds
    assert before == meshio.abaqus._abaqus.meshio_to_abaqus_type
    assert [block.type for block in load(tmp_path / "a.inp").mesh.cells] == ["triangle", "quad", "line"]
