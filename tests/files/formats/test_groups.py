"""Named groups: what a format can hold of them comes back, and what it cannot is named."""

import warnings

import meshio
import numpy as np
import pytest
from file_contents import ALL, save

import torchmesh as tm
from torchmesh.files.documents import load
from torchmesh.files.drafts import Draft
from torchmesh.files.formats import groups
from torchmesh.files.formats.registry import FORMATS
from torchmesh.files.parts import parts_of
from torchmesh.files.source import Source

POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.4, 0.5, 0], [2, 0, 0], [2, 1, 0]])
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [1, 5, 6], [1, 6, 2]])
LINES = np.array([[0, 1], [1, 5], [5, 6]])
NAMES = {"probe": [9, 0], "wall": [7, 1], "two words": [9, 1], "air": [5, 2], "Matériau solide": [7, 2]}
HOLD_NUMBERS = ("gmsh", "vtu", "vtp", "vtm", "med")


def domain() -> meshio.Mesh:
    """Two regions, two named boundaries of which one has the number of a region, and a named vertex."""
    cells = [("vertex", np.array([[0]])), ("line", LINES), ("triangle", FACES)]
    tags = [np.array([9]), np.array([7, 7, 9]), np.array([5, 5, 5, 5, 7, 7])]
    names = {name: np.array(value) for name, value in NAMES.items()}
    return meshio.Mesh(POINTS, cells, cell_data={"gmsh:physical": tags}, field_data=names)


def of_families() -> meshio.Mesh:
    """The same by families, one of which has two names."""
    mesh = domain()
    mesh.cell_data = {"cell_tags": [np.array([-1]), np.array([-2, -2, -3]), np.array([-4, -4, -4, -4, -5, -5])]}
    mesh.field_data, mesh.point_tags = {}, {}
    mesh.cell_tags = {-1: ["probe"], -2: ["wall"], -3: ["two words"], -4: ["air"], -5: ["Matériau solide", "all"]}
    return mesh


def of_sets() -> meshio.Mesh:
    mesh = domain()
    sets = groups.as_sets(groups.numbered(mesh))
    return meshio.Mesh(mesh.points, mesh.cells, cell_sets=sets, point_sets={"nodes": np.array([0, 1])})


def held(mesh: meshio.Mesh) -> dict:
    """The groups of a file, in whatever way it has them, by names in lower case without blanks."""
    found = {**groups.numbered(mesh), **groups.families(mesh), **groups.in_sets(mesh)}
    return {name.lower().replace(" ", "_"): masks for name, masks in found.items()}


def written(path, mesh: meshio.Mesh) -> list[str]:
    """What is told of the file of a mesh that is written."""
    draft = Draft.of(path, mesh)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        draft.save()
    return draft.lost


@pytest.mark.parametrize("make", [domain, of_families, of_sets])
@pytest.mark.parametrize("form", ALL)
def test_every_name_is_held_or_named(tmp_path, form, make):
    given = make()
    path = tmp_path / f"a{FORMATS[form].extensions[0]}"
    lost = written(path, given)
    document = load(path)
    after = held(document.mesh)
    for name, masks in held(make()).items():
        told = any(name in text.lower().replace(" ", "_") for text in lost)
        arrays = [known.lower().replace(" ", "_") for known in document.mesh.cell_data]  # sets as data of 0 and 1
        assert told or name in after or name in arrays, name
        if name in after and not told:
            assert sum(mask.sum() for mask in after[name]) == sum(mask.sum() for mask in masks)
    assert make is not of_sets or "nodes" in str(lost) or "nodes" in str(
        [*document.mesh.point_sets, *document.mesh.point_data]
    ).lower()  # fmt: skip


@pytest.mark.parametrize("form", HOLD_NUMBERS)
def test_groups_that_have_numbers_keep_their_names_and_can_be_moved(tmp_path, form):
    path = tmp_path / f"a{FORMATS[form].extensions[0]}"
    assert written(path, domain()) == []
    parts = parts_of(Source.open(path))
    assert {name: part.kind for name, part in parts.items() if name in NAMES} == {
        "wall": "lines",
        "two words": "lines",
        "air": "cells",
        "Matériau solide": "cells",
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tm.write(tmp_path / f"b{path.suffix}", tm.read(path), like=path)  # once more, and nothing is told
    assert held(load(tmp_path / f"b{path.suffix}").mesh).keys() == held(domain()).keys()


def test_names_of_several_words_are_told_where_they_become_one(tmp_path):
    source = save(tmp_path / "in.msh", domain())
    for name in ("a.su2", "a.vol"):
        with pytest.warns(tm.MeshWarning) as told:
            tm.write(tmp_path / name, tm.read(source), like=source)
        assert any("the name 'two words' is written as 'two_words'" in str(one.message) for one in told)
    assert "MARKER_TAG= probe\nMARKER_ELEMS= 1\n1 0" in (tmp_path / "a.su2").read_text()
    assert {"wall", "two_words", "air", "Matériau_solide"} <= parts_of(Source.open(tmp_path / "a.vol")).keys()


def test_su2_names_the_regions_that_it_does_not_hold(tmp_path):
    lost = written(tmp_path / "a.su2", domain())
    triangles = "cell data 'gmsh:physical' of triangles and quads"
    assert lost == [triangles, "field data 'Matériau solide'", "field data 'air'"]


def test_netgen_names_of_several_words_are_named(tmp_path):
    written(tmp_path / "a.vol", domain())
    text = (tmp_path / "a.vol").read_text()
    (tmp_path / "a.vol").write_text(text.replace("two_words", "two words"))
    assert load(tmp_path / "a.vol").skipped == ("the name 'two words'",)


def test_names_that_are_alike_as_one_word_stay_apart():
    assert groups.one_word_each(["a b", "a_b", "c"]) == {"a b": "a_b", "a_b": "a_b_2", "c": "c"}


def test_families_become_groups_with_positive_numbers(tmp_path):
    lost = written(tmp_path / "a.msh", of_families())
    assert lost == ["group 'all'"]  # its cells have the number of another name
    mesh = load(tmp_path / "a.msh").mesh
    assert {name: tuple(value) for name, value in mesh.field_data.items()} == {
        "probe": (1, 0),
        "wall": (2, 1),
        "two words": (3, 1),
        "air": (4, 2),
        "Matériau solide": (5, 2),
    }


def test_data_that_is_no_name_of_a_group_is_named(tmp_path):
    mesh = domain()
    mesh.field_data["time"] = np.array([0.5])
    for form in ("gmsh", "su2", "netgen", "med"):
        assert "field data 'time'" in written(tmp_path / f"a{FORMATS[form].extensions[0]}", mesh)


def test_meshio_bounding_entities_bound_no_regions(tmp_path):
    """meshio folds all sets of a file of Gmsh into one array, which the last set, of no groups, writes over."""
    mesh = domain()
    folded = "wall-Matériau+solide-gmsh:bounding_entities"
    mesh.cell_data[folded] = [np.array([-1]), np.array([0, 1, 1]), np.array([2, 1, 2, 1, 2, 1])]
    mesh.cell_data["gmsh:bounding_entities"] = [np.array([0]), np.array([0, 1, 1]), np.array([0, 1, 0, 1, 0, 1])]
    source = Source.open(save(tmp_path / "a.vtu", mesh))
    assert str(source.content.told_by) == "cell data 'gmsh:physical'"
    assert source.mesh.constrained_edges.tolist() == [[1, 2]]
    assert source.content.told_by.others == ()
