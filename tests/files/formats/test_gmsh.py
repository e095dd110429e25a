"""Gmsh files: groups, numbers and foreign sections survive a change of the mesh; Gmsh itself is the judge."""

import contextlib
import re
import warnings
from pathlib import Path

import meshes
import meshio
import numpy as np
import pytest
import torch
from file_contents import SU2, grid, grid_arrays, load, moved, rebuilt, save, triangle_data, warned

import torchmesh as tm
from torchmesh.batches.file_improvement import improve_series, open_mesh
from torchmesh.errors import MeshIOError, MeshWarning
from torchmesh.files.formats import gmsh_new, gmsh_write
from torchmesh.files.mesh_files import held, read, write
from torchmesh.files.source import Source


@pytest.fixture(scope="module")
def gmsh_model(tmp_path_factory):
    """Gmsh, and files that it wrote of a rectangle in two materials: groups of lines and surfaces, which overlap."""
    gmsh = pytest.importorskip("gmsh")
    folder = tmp_path_factory.mktemp("gmsh")
    gmsh.initialize(["", "-v", "0"], interruptible=False)
    geo = gmsh.model.geo
    p = [geo.addPoint(x, y, 0, 0.4) for x, y in ((0, 0), (2, 0), (2, 1), (0, 1), (1, 0), (1, 1))]
    e = [geo.addLine(p[a], p[b]) for a, b in ((0, 4), (4, 1), (1, 2), (2, 5), (5, 3), (3, 0), (4, 5))]
    left = geo.addPlaneSurface([geo.addCurveLoop([e[0], e[6], e[4], e[5]])])
    right = geo.addPlaneSurface([geo.addCurveLoop([e[1], e[2], e[3], -e[6]])])
    geo.synchronize()
    gmsh.model.mesh.setPeriodic(1, [e[5]], [e[2]], [1, 0, 0, -2, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])
    gmsh.model.addPhysicalGroup(2, [left], 7, "steel")
    gmsh.model.addPhysicalGroup(2, [left, right], 9, "all of it")
    gmsh.model.addPhysicalGroup(1, [e[0]], 7, "steel")  # the same name in another dimension
    gmsh.model.addPhysicalGroup(1, [e[6]], 3, "seam")
    gmsh.model.mesh.generate(2)
    files = {}
    for version in (2.2, 4.1):
        for binary in (0, 1):
            for everything in (0, 1):
                gmsh.option.setNumber("Mesh.MshFileVersion", version)
                gmsh.option.setNumber("Mesh.Binary", binary)
                gmsh.option.setNumber("Mesh.SaveAll", everything)
                path = folder / f"{version}-{binary}-{everything}.msh"
                gmsh.write(str(path))
                files[version, binary, everything] = path
    gmsh.option.setNumber("Mesh.SaveParametric", 1)  # nodes with their parameters on curve and surface
    files["parametric"] = folder / "parametric.msh"
    gmsh.write(str(files["parametric"]))
    gmsh.finalize()
    return gmsh, files


def groups_of(gmsh, path: Path) -> dict:
    """What Gmsh finds in a file: its groups by dimension, number and name, with their elements and nodes."""
    gmsh.initialize(["", "-v", "0"], interruptible=False)
    gmsh.option.setNumber("General.AbortOnError", 2)
    try:
        gmsh.open(str(path))
        found = {}
        for dim, tag in gmsh.model.getPhysicalGroups():
            cells = []
            for entity in gmsh.model.getEntitiesForPhysicalGroup(dim, tag):
                _, numbers, _ = gmsh.model.mesh.getElements(dim, entity)
                cells += [int(n) for group in numbers for n in group]
            nodes = sorted(int(n) for n in gmsh.model.mesh.getNodesForPhysicalGroup(dim, tag)[0])
            found[dim, tag, gmsh.model.getPhysicalName(dim, tag)] = (sorted(cells), nodes)
        return found
    finally:
        gmsh.finalize()


CASES = [(v, b, e) for v in (2.2, 4.1) for b in (0, 1) for e in (0, 1)]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_gmsh_finds_its_groups_again(tmp_path, gmsh_model, case):
    gmsh, files = gmsh_model
    mesh = read(files[case])
    with pytest.warns(MeshWarning, match="group 0") if case[::2] == (4.1, 1) else contextlib.nullcontext():
        write(tmp_path / "out.msh", moved(mesh), like=files[case])
    before, after = groups_of(gmsh, files[case]), groups_of(gmsh, tmp_path / "out.msh")
    assert {key: found for key, found in after.items() if key[1]} == before
    # meshio takes a file in which all cells have a group or none has; those without one are in the group 0.
    groups = load(files[case]).cell_data.get("gmsh:physical", [])
    by_meshio = meshio.read(tmp_path / "out.msh").cell_data.get("gmsh:physical", [])
    if groups or case[0] == 4.1:
        np.testing.assert_array_equal(np.concatenate([[], *by_meshio]), np.concatenate([[], *groups]))
    without = sum(int((values == 0).sum()) for values in groups) if case[0] == 4.1 else 0
    assert sum(len(cells) for (_, tag, _), (cells, _) in after.items() if tag == 0) == without
    assert without or case[::2] != (4.1, 1)
    if case != (2.2, 0, 1) and case != (2.2, 1, 1):  # version 2.2 forgets the groups when all is saved
        assert (1, 3, "seam") in before
        assert len(mesh.constrained_edges) > 0
    assert torch.equal(read(tmp_path / "out.msh").points, moved(mesh).points)


@pytest.mark.parametrize("case", [(4.1, 1, 0), (4.1, 1, 1), "parametric"], ids=str)
def test_an_unchanged_binary_file_comes_back_byte_for_byte(tmp_path, gmsh_model, case):
    source = gmsh_model[1][case]
    grouped = case == (4.1, 1, 0)  # otherwise cells that have no group get the group 0, in $Entities alone
    with contextlib.nullcontext() if grouped else pytest.warns(MeshWarning, match="group 0"):
        write(tmp_path / "first.msh", read(source), like=source)
    write(tmp_path / "out.msh", read(tmp_path / "first.msh"), like=tmp_path / "first.msh")
    first = (tmp_path / "first.msh").read_bytes()
    assert (tmp_path / "out.msh").read_bytes() == first
    (head, entities, rest), (*before, after) = (
        re.split(rb"\$Entities|\$EndEntities", b) for b in (source.read_bytes(), first)
    )
    assert (head, rest) == (before[0], after)
    assert grouped is (entities == before[1])


def test_a_mesh_with_other_triangles_is_read_by_meshio_too(tmp_path, gmsh_model):
    source = gmsh_model[1][4.1, 0, 1]
    mesh = read(source)
    a, b, c = mesh.triangles[0].tolist()
    points = torch.cat([mesh.points, mesh.points[[a, b, c]].mean(0, keepdim=True)])
    d = len(mesh.points)
    faces = torch.cat([mesh.triangles[1:], torch.tensor([[a, b, d], [b, c, d], [c, a, d]])])
    with pytest.warns(MeshWarning, match="group 0|Periodic"):
        write(tmp_path / "out.msh", rebuilt(mesh, points.numpy(), faces.numpy()), like=source)
    ours = np.concatenate(load(tmp_path / "out.msh").cell_data["gmsh:physical"])
    np.testing.assert_array_equal(np.concatenate(meshio.read(tmp_path / "out.msh").cell_data["gmsh:physical"]), ours)
    assert {0, 3, 7} <= set(ours.tolist())


@pytest.mark.parametrize("binary", [0, 1])
def test_cells_without_a_group_are_read(gmsh_model, binary):
    groups = np.concatenate(load(gmsh_model[1][4.1, binary, 1]).cell_data["gmsh:physical"])
    assert set(groups.tolist()) == {0, 3, 7, 9}  # meshio refuses such files


@pytest.mark.parametrize("case", [(2.2, 0, 0), (4.1, 1, 0)], ids=str)
def test_groups_outlive_another_number_of_triangles(tmp_path, gmsh_model, case):
    gmsh, files = gmsh_model
    mesh = read(files[case])
    points, faces = mesh.points.numpy(), mesh.triangles.numpy()
    a, b, c = faces[0]
    points = np.concatenate([points, points[faces[0]].mean(0, keepdims=True)])
    new = [[a, b, len(points) - 1], [b, c, len(points) - 1], [c, a, len(points) - 1]]
    full = rebuilt(mesh, points, np.concatenate([faces[1:], new]))
    with warnings.catch_warnings(record=True) as record:
        warnings.simplefilter("always")
        write(tmp_path / "out.msh", full, like=files[case])
    assert ("$Periodic" in warned(record)) == (b"$Periodic" in files[case].read_bytes())
    before, after = groups_of(gmsh, files[case]), groups_of(gmsh, tmp_path / "out.msh")
    assert set(after) == set(before)
    assert len(after[1, 3, "seam"][0]) == len(before[1, 3, "seam"][0])
    steel, everything = (2, 7, "steel"), (2, 9, "all of it")  # the left half is in both
    inside = int(points[-1][0] < 1)  # is the split triangle in steel: one vertex more
    assert len(after[steel][1]) == len(before[steel][1]) + inside
    assert len(after[everything][1]) == len(before[everything][1]) + 1
    assert set(after[steel][0]) < set(after[everything][0])


def test_names_go_from_su2_to_gmsh_and_back(tmp_path):
    gmsh = pytest.importorskip("gmsh")
    source = tmp_path / "in.su2"
    source.write_text(SU2)
    mesh = read(source)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)  # the FFD lines have no place in a .msh file
        write(tmp_path / "out.msh", mesh, like=source)
    names = {name for _, _, name in groups_of(gmsh, tmp_path / "out.msh")}
    assert {"wall", "far_field"} <= names
    write(tmp_path / "back.su2", read(tmp_path / "out.msh"), like=tmp_path / "out.msh")
    assert "MARKER_TAG= far_field\nMARKER_ELEMS= 2\n" in (tmp_path / "back.su2").read_text()


MSH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
4
30 0 0 0
7 1 0 0
100 1 1 0
8 0 1 0
$EndNodes
$Elements
2
55 2 2 1 1 30 7 100
12 2 2 2 1 30 100 8
$EndElements
$ElementData
1
"stress"
1
0.5
3
0
1
1
12 4.25
$EndElementData
$Comments
kept
$EndComments
"""


def test_gmsh_numbers_and_foreign_sections_stay(tmp_path):
    source = tmp_path / "in.msh"
    source.write_text(MSH)
    mesh = read(source)
    assert mesh.triangles.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.constrained_edges.tolist() == [[0, 2]]
    np.testing.assert_array_equal(triangle_data(load(source), "stress"), [np.nan, 4.25])
    write(tmp_path / "out.msh", mesh.with_points(mesh.points * 3), like=source)
    text = (tmp_path / "out.msh").read_text()
    for line in ("100 3.0 3.0 0.0", "12 2 2 2 1 30 100 8", "12 4.25", "kept"):
        assert f"\n{line}\n" in text
    source.write_text(MSH.replace("30 7 100", "31 7 100"))
    with pytest.raises(MeshIOError, match="refers to node 31, which it does not have"):
        read(source)


def test_meshio_reads_new_files_in_which_some_cells_have_no_group(tmp_path):
    mesh = grid(point_data={}, cell_data={"region": [np.zeros(4, int), np.arange(32) // 16]})
    path = save(tmp_path / "a.msh", mesh)
    np.testing.assert_array_equal(
        np.concatenate(meshio.read(path).cell_data["gmsh:physical"])[-32:], np.arange(32) // 16
    )
    assert len(read(path).constrained_edges)


PERIODIC = {
    "2.2": "1\n1 2 1\nAffine 1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1\n2\n3 1\n4 2\n",
    "4.1": "1\n1 2 1\n16 1 0 0 1 0 1 0 0 0 0 1 0 0 0 0 1\n2\n3 1\n4 2\n",
}


@pytest.mark.parametrize("version", ["2.2", "4.1"])
def test_nodes_that_are_paired_are_held(tmp_path, version):
    path = tmp_path / "a.msh"
    form = {"2.2": "gmsh22", "4.1": "gmsh"}[version]
    points, faces = grid_arrays()
    save(path, meshio.Mesh(points, [("triangle", faces)]), file_format=form, binary=False)
    before = held(path)
    path.write_text(path.read_text() + f"$Periodic\n{PERIODIC[version]}$EndPeriodic\n")
    after = held(path)
    assert after[:4].all()
    assert not before[1]
    assert int(after.sum()) == int(before.sum()) + int((~before[:4]).sum())


def text_file(path: Path, points: np.ndarray, triangles: np.ndarray) -> Path:
    """A file of version 2.2 without fields; nodes and elements are numbered from 1."""
    content = meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("triangle", triangles)])
    gmsh_write.write(path, *gmsh_new.new_file(content, "2.2", False, None))
    return path


def data_section(kind: str, name: str, rows: np.ndarray, time: float = 0.0, step: int = 0) -> str:
    """A data section as text; `rows` (n, 2) are numbers of nodes or elements and their values."""
    lines = "".join(f"{int(number)} {float(value)!r}\n" for number, value in rows)
    return f'${kind}\n1\n"{name}"\n1\n{time}\n3\n{step}\n1\n{len(rows)}\n{lines}$End{kind}\n'


@pytest.mark.parametrize("topology", ["keep", "flip"])
def test_fields_of_every_step_are_interpolated(tmp_path, topology):
    """Linear fields at nodes stay exact in each of their steps, with their times; integrals of cell fields are kept."""
    mesh, out = meshes.jittered(7, 6, 0.3, 3), tmp_path / "b.msh"
    path = text_file(tmp_path / "a.msh", mesh.points.numpy(), mesh.triangles.numpy())
    nodes = np.arange(1, len(mesh.points) + 1)
    x, y = mesh.points.numpy().T
    cells = np.random.default_rng(0).uniform(1, 2, len(mesh.triangles))
    more = data_section("NodeData", "u", np.stack([nodes, x], 1), 0.5, 1)
    more += data_section("NodeData", "u", np.stack([nodes, 2 * y - x], 1), 1.5, 2)
    more += data_section("ElementData", "c", np.stack([1 + np.arange(len(cells)), cells], 1), 0.25, 7)
    corners = "".join(f"{1 + row} 3 1 2 3\n" for row in range(len(cells)))
    more += f'$ElementNodeData\n1\n"e"\n1\n0\n3\n0\n1\n{len(cells)}\n{corners}$EndElementNodeData\n'
    path.write_bytes(path.read_bytes() + more.encode())
    (improved,) = improve_series([open_mesh(path)], tm.ImproveOptions(topology=topology))
    flips = int(improved.report.flipped[0]) > 0
    assert flips is (topology == "flip")
    with pytest.warns(tm.MeshWarning, match="ElementNodeData") if flips else contextlib.nullcontext():
        improved.write(out)
    after = Source.open(out)
    points = after.mesh.points.numpy()
    assert np.abs(points - mesh.points.numpy()).max() > 0.01
    found = after.document.mesh
    np.testing.assert_allclose(found.point_data["u"], points[:, 0], atol=1e-14)
    np.testing.assert_allclose(found.point_data["u:2"], 2 * points[:, 1] - points[:, 0], atol=1e-14)
    areas = [tm.quality(m).area.numpy() for m in (mesh, after.mesh)]
    assert found.cell_data["c"][0] @ areas[1] == pytest.approx(cells @ areas[0], rel=1e-12)
    written = out.read_text()
    for line in ('"u"\n1\n0.5\n3\n1\n', '"u"\n1\n1.5\n3\n2\n', '"c"\n1\n0.25\n3\n7\n'):
        assert line in written
    assert ("$ElementNodeData" in written) is not flips


def test_times_that_a_new_file_does_not_state_are_named(tmp_path):
    path = text_file(tmp_path / "a.msh", *meshes.grid_arrays(2, 2))
    rows = np.stack([1 + np.arange(9), np.arange(9.0)], 1)
    path.write_text(path.read_text() + data_section("NodeData", "u", rows, 0.5) + data_section("NodeData", "v", rows))
    with pytest.warns(tm.MeshWarning, match=r"not carried over .*: times and steps of 'u'$"):
        tm.write(tmp_path / "b.vtu", tm.read(path), like=path)


def test_partitions_and_further_groups_are_named_where_they_are_lost(tmp_path, gmsh_model):
    path = text_file(tmp_path / "a.msh", *meshes.grid_arrays(2, 2))
    lines = path.read_text().split("\n")
    # Elements of version 2.2 with four tags: group, entity, number of partitions, partition.
    path.write_text("\n".join(line.replace(" 2 2 ", " 2 4 ", 1).replace(" 0 0 ", " 0 0 1 1 ", 1) for line in lines))
    assert Source.open(path).document.rest.elements[0].tags.shape[1] == 4
    with pytest.warns(tm.MeshWarning, match="not carried over .*: partitions of elements$"):
        tm.write(tmp_path / "b.vtu", tm.read(path), like=path)
    tm.write(tmp_path / "b.msh", tm.read(path), like=path)
    assert Source.open(tmp_path / "b.msh").document.rest.elements[0].tags.shape[1] == 4
    several = gmsh_model[1][4.1, 0, 0]
    with pytest.warns(tm.MeshWarning, match="further physical groups of entities"):
        tm.write(tmp_path / "c.vtu", tm.read(several), like=several)


VERSION_4 = """$MeshFormat
4 0 8
$EndMeshFormat
$PhysicalNames
1
2 7 "fluid"
$EndPhysicalNames
$Entities
0 0 1 0
1 0 0 0 1 1 0 1 7 0
$EndEntities
$Nodes
1 5
1 2 0 5
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
5 1.4 0.5 0
$EndNodes
$Elements
1 4
1 2 2 4
1 1 2 5
2 2 3 5
3 3 4 5
4 4 1 5
$EndElements
"""


def test_version_4_is_that_of_gmsh_4_0_and_becomes_4_1(tmp_path):
    source = tmp_path / "a.msh"
    source.write_text(VERSION_4)
    mesh = tm.read(source)
    assert (len(mesh.points), len(mesh.triangles)) == (5, 4)
    after, report = tm.improve(mesh)
    report.check()
    with pytest.warns(tm.MeshWarning, match=r"it is in version 4\.1 instead of 4\.0"):
        tm.write(tmp_path / "b.msh", after, like=source)
    assert (tmp_path / "b.msh").read_bytes().startswith(b"$MeshFormat\n4.1 0 8\n")
    assert load(tmp_path / "b.msh").cell_data["gmsh:physical"][0].tolist() == [7] * 4
