"""Files in and out: what a format holds comes back, what it does not is said, what is broken is one clear line."""

import errno
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import meshes
import meshio
import numpy as np
import pytest
import torch

from torchmesh import MeshBatch, join
from torchmesh.errors import InvalidMeshError, MeshError, MeshIOError, MeshWarning, MissingDependencyError
from torchmesh.files import atomic
from torchmesh.files.documents import load as load_document
from torchmesh.files.documents import save as save_document
from torchmesh.files.formats.meshio_formats import MeshioFormat
from torchmesh.files.formats.registry import FORMATS
from torchmesh.files.mesh_files import held, read, write

N = 5  # vertices along a side of the small grid
LEFT, RIGHT = 1, 2
ALL = [name for name in FORMATS if name != "exodus"]  # exodus needs netCDF4, see below
# Bits are kept by every format but these: Nastran has columns of 16 characters; STL merges by place.
INEXACT = {"nastran": 1e-9}
# Which of the grid's content the format gives back; the table in the README says the same.
HOLDS_POINT_DATA = {"vtu", "vtk", "gmsh", "xdmf", "med", "ply", "tecplot"}
HOLDS_REGIONS = {"vtu", "vtk", "gmsh", "xdmf", "med", "obj", "medit", "nastran", "netgen", "avsucd"}
HOLDS_LINES = {
    "vtu",
    "vtk",
    "gmsh",
    "xdmf",
    "med",
    "obj",
    "medit",
    "nastran",
    "netgen",
    "su2",
    "abaqus",
    "mdpa",
    "permas",
}


def grid_arrays() -> tuple[np.ndarray, np.ndarray]:
    """A grid with coordinates no short decimal gives: every digit of a file is needed."""
    x, y = np.meshgrid(np.arange(N) / 3, np.arange(N) / 7)
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    q = (np.arange(N - 1)[:, None] * N + np.arange(N - 1)).ravel()
    return points, np.concatenate([np.stack([q, q + 1, q + N + 1], 1), np.stack([q, q + N + 1, q + N], 1)])


def grid(**changes) -> meshio.Mesh:
    """The grid in two regions, with line cells along a side and a field of each sort."""
    points, faces = grid_arrays()
    side = np.stack([np.arange(N - 1), np.arange(1, N)], 1)
    where = np.where(points[faces].mean(1)[:, 0] < 2 / 3, LEFT, RIGHT)
    content = {
        "point_data": {"u": np.arange(25) / 3, "v": np.arange(75).reshape(25, 3) / 7},
        "cell_data": {"region": [np.full(4, 5), where], "p": [np.zeros(4), np.arange(32) / 3]},
    }
    return meshio.Mesh(points, [("line", side), ("triangle", faces)], **(content | changes))


def save(path: Path, mesh: meshio.Mesh, **options) -> Path:
    """A file by meshio itself, except where meshio cannot write what is wanted."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if options:
            meshio.write(path, mesh, **options)
        else:
            save_document(path, mesh, None, False)
    return path


def flipped(mesh: MeshBatch) -> MeshBatch:
    """The diagonal of the first square turned: triangle rows 0 and 16."""
    faces = mesh.triangles.clone()
    faces[0], faces[16] = torch.tensor([0, 1, N]), torch.tensor([1, N + 1, N])
    return mesh.with_triangles(faces)


def moved(mesh: MeshBatch) -> MeshBatch:
    """Every free vertex displaced a little."""
    return mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, mesh.points + 0.01))


def warned(record) -> str:
    return "\n".join(str(w.message) for w in record)


def load(path: Path) -> meshio.Mesh:
    return load_document(path).mesh


def triangle_data(mesh: meshio.Mesh, name: str) -> np.ndarray:
    return np.concatenate([v for b, v in zip(mesh.cells, mesh.cell_data[name], strict=True) if b.type == "triangle"])


def side_of(mesh: MeshBatch) -> np.ndarray:
    """LEFT or RIGHT for each triangle, by where it lies."""
    centres = mesh.points[mesh.triangles].mean(1)[:, 0]
    return np.where(centres.numpy() < 2 / 3, LEFT, RIGHT)


# Round trips


@pytest.mark.parametrize("form", ALL)
@pytest.mark.parametrize("extra", [False, True], ids=["triangles", "everything"])
def test_every_format_gives_the_mesh_back(tmp_path, form, extra):
    source = grid() if extra else meshio.Mesh(*grid_arrays()[:1], [("triangle", grid_arrays()[1])])
    given = moved(read(save(tmp_path / "in.vtu", source)))
    path = tmp_path / f"out{FORMATS[form].extensions[0]}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)  # what the format cannot hold, tested below
        write(path, given, like=tmp_path / "in.vtu")
        back = read(path)
    if form == "stl":  # a soup: vertices come in the order of the triangles
        assert torch.equal(back.points[back.triangles], given.points[given.triangles])
        return
    assert torch.equal(back.triangles, given.triangles)
    torch.testing.assert_close(back.points, given.points, rtol=0, atol=INEXACT.get(form, 0))
    mesh = load(path)
    if extra:
        assert ("u" in mesh.point_data) == (form in HOLDS_POINT_DATA)
        assert any(b.type == "line" for b in mesh.cells) == (form in HOLDS_LINES)
        assert (len(back.constrained_edges) == N - 1) == (form in HOLDS_REGIONS)


@pytest.mark.parametrize("form", ALL)
def test_every_format_onto_itself_moves_nothing(tmp_path, form):
    path = tmp_path / f"a{FORMATS[form].extensions[0]}"
    save(path, grid())
    first = read(path)
    write(path, first, like=path)  # input and output may be one file
    again = read(path)
    assert torch.equal(again.points, first.points)
    assert torch.equal(again.triangles, first.triangles)
    assert torch.equal(again.constrained_edges, first.constrained_edges)
    assert os.listdir(tmp_path) == [path.name]


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".msh", ".xdmf", ".med"])
def test_fields_and_lines_are_carried_over(tmp_path, suffix):
    source = save(tmp_path / f"in{suffix}", grid())
    before = load(source)
    write(tmp_path / f"out{suffix}", moved(read(source)), like=source)
    after = load(tmp_path / f"out{suffix}")
    assert set(after.point_data) == set(before.point_data)
    assert set(after.cell_data) == set(before.cell_data)
    for name, values in before.point_data.items():
        np.testing.assert_array_equal(after.point_data[name], values)
    for name, blocks in before.cell_data.items():
        np.testing.assert_array_equal(np.concatenate(after.cell_data[name]), np.concatenate(blocks))
    np.testing.assert_array_equal(after.cells_dict["line"], before.cells_dict["line"])


@pytest.mark.parametrize(
    ("name", "options", "mark"),
    [
        ("a.vtu", {"binary": False}, b'format="ascii"'),
        ("a.vtk", {"binary": False, "file_format": "vtk42"}, b"DataFile Version 4.2\n"),
        ("a.vtk", {"binary": False}, b"\nASCII\n"),
        ("a.vtk", {"binary": True}, b"\nBINARY\n"),
        ("a.ply", {"binary": False}, b"format ascii"),
        ("a.ply", {"binary": True}, b"format binary"),
        ("a.stl", {"binary": False}, b"endsolid"),
        ("a.stl", {"binary": True}, b"meshio"),
        ("a.msh", {"binary": False, "file_format": "gmsh22"}, b"2.2 0 8"),
        ("a.msh", {"binary": True, "file_format": "gmsh22"}, b"2.2 1 8"),
        ("a.msh", {"binary": False, "file_format": "gmsh"}, b"4.1 0 8"),
        ("a.msh", {"binary": True, "file_format": "gmsh"}, b"4.1 1 8"),
    ],
)
def test_text_stays_text_and_versions_stay(tmp_path, name, options, mark):
    points, faces = grid_arrays()
    source = save(tmp_path / name, meshio.Mesh(points, [("triangle", faces.astype(np.int32))]), **options)
    mesh = read(source)
    target = tmp_path / f"out{source.suffix}"
    write(target, mesh, like=source)
    assert mark in source.read_bytes()
    assert mark in target.read_bytes()
    assert torch.equal(read(target).points, mesh.points)


def test_a_new_file_needs_no_like(tmp_path):
    points, faces = grid_arrays()
    mesh = MeshBatch.from_arrays(points, faces, constrained_edges=[[6, 7], [7, 8]])
    write(tmp_path / "a.msh", mesh)
    assert b"4.1 1 8" in (tmp_path / "a.msh").read_bytes()
    back = read(tmp_path / "a.msh")
    assert torch.equal(back.points, mesh.points)
    assert back.constrained_edges.tolist() == [[6, 7], [7, 8]]


def test_pieces_that_do_not_touch_are_one_mesh(tmp_path):
    points, faces = grid_arrays()
    both = meshio.Mesh(
        np.concatenate([points, points + np.array([9, 0, 0])]), [("triangle", np.concatenate([faces, faces + 25]))]
    )
    mesh = read(save(tmp_path / "a.off", both))
    assert len(mesh) == 1
    assert len(mesh.triangles) == 64


def test_stl_merges_vertices_where_they_coincide(tmp_path):
    facet = "facet normal 0 0 1\nouter loop\nvertex {}\nvertex {}\nvertex {}\nendloop\nendfacet\n"
    text = "solid a\n" + facet.format("0 0 0", "1 0 0", "0 1 0") + facet.format("1 -0.0 0", "1 1 0", "-0.0 1 0")
    (tmp_path / "a.stl").write_text(text + "endsolid a\n")
    assert read(tmp_path / "a.stl").triangles.tolist() == [[0, 1, 2], [1, 3, 2]]


# Positions


def test_a_tilted_plane_comes_back_without_jitter(tmp_path):
    points, faces = grid_arrays()
    axes = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    space = points @ axes + [100.0, -3, 1 / 3]
    source = save(tmp_path / "in.vtu", meshio.Mesh(space, [("triangle", faces)]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)  # which side of a plane is up is anyone's choice
        mesh = read(source)
    write(tmp_path / "out.vtu", moved(mesh), like=source)
    after = load(tmp_path / "out.vtu").points
    np.testing.assert_array_equal(after[mesh.fixed.numpy()], space[mesh.fixed.numpy()])
    free = ~mesh.fixed.numpy()
    # Free vertices moved by 0.01 in both directions of the plane, and stay in it.
    np.testing.assert_allclose(np.linalg.norm(after[free] - space[free], axis=1), 0.01 * np.sqrt(2), rtol=1e-9)
    normal = np.cross(space[1] - space[0], space[N] - space[0])
    assert np.abs((after - space[0]) @ normal).max() < 1e-12  # rounding at a distance of 100


def test_single_precision_files_stay_single_precision(tmp_path):
    points, faces = grid_arrays()
    source = save(tmp_path / "in.vtk", meshio.Mesh(points.astype(np.float32), [("triangle", faces)]))
    mesh = read(source)
    assert mesh.points.dtype == torch.float32
    write(tmp_path / "out.vtk", mesh, like=source)
    assert load(tmp_path / "out.vtk").points.dtype.itemsize == 4


def test_a_clockwise_file_stays_clockwise(tmp_path):
    points, faces = grid_arrays()
    source = save(tmp_path / "in.vtu", meshio.Mesh(points, [("triangle", faces[:, ::-1])]))
    with pytest.warns(MeshWarning, match=r"in\.vtu: all triangles were wound clockwise"):
        mesh = read(source)
    write(tmp_path / "same.vtu", mesh, like=source)
    np.testing.assert_array_equal(load(tmp_path / "same.vtu").cells[0].data, faces[:, ::-1])
    write(tmp_path / "out.vtu", flipped(mesh), like=source)
    a, b, c = np.moveaxis(points[load(tmp_path / "out.vtu").cells[0].data][:, :, :2], 1, 0)
    assert ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0] < 0).all()


def test_su2_is_flat_and_lays_a_tilted_mesh_down(tmp_path):
    points, faces = grid_arrays()
    upright = points[:, [0, 2, 1]] * [1, 1, -1]
    save(tmp_path / "in.vtu", meshio.Mesh(upright, [("triangle", faces)]))
    mesh = read(tmp_path / "in.vtu")
    with pytest.warns(MeshWarning, match="two-dimensional"):
        write(tmp_path / "out.su2", mesh, like=tmp_path / "in.vtu")
    assert torch.equal(read(tmp_path / "out.su2").points, mesh.points)


# Regions, lines, fixed vertices


def constrained(tmp_path, **changes) -> int:
    return len(read(save(tmp_path / "a.vtu", grid(**changes))).constrained_edges)


@pytest.mark.parametrize(
    ("name", "values", "edges"),
    [
        ("gmsh:physical", "sides", N - 1),
        ("anything", "sides", N - 1),
        ("anything", "sides as float", 0),
        ("anything", "number of each", 0),
        ("CellEntityIds", "number of each", 40),  # a name that means regions is taken at its word
    ],
)
def test_regions_part_where_integers_differ(tmp_path, name, values, edges):
    sides = grid().cell_data["region"][1]
    field = {"sides": sides, "sides as float": sides.astype(float), "number of each": np.arange(32)}[values]
    assert constrained(tmp_path, cell_data={name: [np.zeros(4, field.dtype), field]}) == edges


def test_cell_sets_are_regions(tmp_path):
    sides = grid().cell_data["region"][1]
    sets = {"STEEL": [np.arange(0), np.flatnonzero(sides == LEFT)]}
    save(tmp_path / "in.inp", grid(cell_data={}, point_data={}, cell_sets=sets))
    mesh = read(tmp_path / "in.inp")
    assert len(mesh.constrained_edges) == N - 1
    write(tmp_path / "out.inp", flipped(mesh), like=tmp_path / "in.inp")
    members = load(tmp_path / "out.inp").cell_sets["STEEL"]
    np.testing.assert_array_equal(np.concatenate(members), np.flatnonzero(sides == LEFT))


def test_line_cells_inside_the_mesh_are_constrained_edges(tmp_path):
    points, faces = grid_arrays()
    lines = np.array([[6, 7], [0, 1], [8, 16]])  # an inner edge, a boundary edge, a bar across edges
    curve = np.array([[11, 17, 12]])  # of second order
    source = save(tmp_path / "a.vtu", meshio.Mesh(points, [("line", lines), ("line3", curve), ("triangle", faces)]))
    mesh = read(source)
    assert mesh.constrained_edges.tolist() == [[6, 7]]
    assert mesh.fixed.sum() == 16 + 7  # the boundary and 6, 7, 8, 16, 11, 17, 12
    assert not mesh.fixed[[13, 18]].any()
    write(tmp_path / "out.vtu", mesh, like=source)
    assert load(tmp_path / "out.vtu").point_data == {}
    np.testing.assert_array_equal(load(tmp_path / "out.vtu").cells_dict["line3"], curve)


def test_vertex_cells_are_fixed_unless_all_vertices_have_one(tmp_path):
    points, faces = grid_arrays()
    some = meshio.Mesh(points, [("vertex", np.array([[12]])), ("triangle", faces)])
    assert read(save(tmp_path / "a.vtu", some)).fixed[12]
    every = meshio.Mesh(points, [("vertex", np.arange(25)[:, None]), ("triangle", faces)])
    assert not read(save(tmp_path / "a.vtu", every)).fixed[12]


def test_fixed_comes_from_point_data_and_goes_back(tmp_path):
    points, faces = grid_arrays()
    marks = np.zeros(25, np.int32)
    marks[12] = 7
    source = save(tmp_path / "in.vtu", meshio.Mesh(points, [("triangle", faces)], point_data={"fixed": marks}))
    mesh = read(source)
    assert mesh.fixed.sum() == 16 + 1
    assert mesh.fixed[12]
    write(tmp_path / "out.vtu", mesh, like=source)
    np.testing.assert_array_equal(load(tmp_path / "out.vtu").point_data["fixed"], marks)


@pytest.mark.parametrize("suffix", [".vtu", ".msh"])
def test_fixed_is_stored_only_where_read_would_not_find_it(tmp_path, suffix):
    points, faces = grid_arrays()
    source = save(tmp_path / f"in{suffix}", grid())
    plain = read(source)
    write(tmp_path / f"plain{suffix}", plain, like=source)
    assert "fixed" not in load(tmp_path / f"plain{suffix}").point_data
    inner = torch.zeros(25, dtype=torch.bool)
    inner[8] = True
    more = MeshBatch.from_arrays(points, faces, inner, plain.constrained_edges)
    for like in (source, None):
        write(tmp_path / f"more{suffix}", more, like=like)
        assert torch.equal(read(tmp_path / f"more{suffix}").fixed, more.fixed)
    inner[16] = True  # the file to follow has a field of that name, which no longer holds
    most = MeshBatch.from_arrays(points, faces, inner, plain.constrained_edges)
    write(tmp_path / f"most{suffix}", most, like=tmp_path / f"more{suffix}")
    assert torch.equal(read(tmp_path / f"most{suffix}").fixed, most.fixed)


def test_quads_stay_and_hold_their_vertices(tmp_path):
    points, faces = grid_arrays()
    more = np.concatenate([points, [[0, -1, 0], [1 / 3, -1, 0], [5, 5, 0]]])
    quad = np.array([[25, 26, 1, 0]])
    mixed = meshio.Mesh(more[:27], [("quad", quad), ("triangle", faces)], cell_data={"id": [[9], np.zeros(32, int)]})
    source = save(tmp_path / "in.vtu", mixed)
    mesh = read(source)  # no warning: 25 and 26 belong to the quad
    assert len(mesh.points) == 27
    assert mesh.fixed[[0, 1, 25, 26]].all()
    write(tmp_path / "out.vtu", moved(flipped(mesh)), like=source)
    after = load(tmp_path / "out.vtu")
    np.testing.assert_array_equal(after.cells_dict["quad"], quad)
    np.testing.assert_array_equal(after.points[:, :2], moved(mesh).points.numpy())
    save(tmp_path / "loose.vtu", meshio.Mesh(more, [("quad", quad), ("triangle", faces)]))
    with pytest.warns(MeshWarning, match="1 vertices belong to no cell"):
        read(tmp_path / "loose.vtu")


# What the changed mesh can keep


def test_flips_keep_tags_and_point_data_and_drop_fields_of_triangles(tmp_path):
    source = save(tmp_path / "in.vtu", grid(cell_data=grid().cell_data | {"id": [np.arange(4), np.arange(4, 36)]}))
    with pytest.warns(MeshWarning, match=r"not carried over.*cell data 'p'") as record:
        write(tmp_path / "out.vtu", flipped(read(source)), like=source)
    assert "'region'" not in warned(record)
    before, after = load(source), load(tmp_path / "out.vtu")
    assert set(after.cell_data) == {"region", "id"}
    np.testing.assert_array_equal(triangle_data(after, "region"), triangle_data(before, "region"))
    np.testing.assert_array_equal(after.point_data["u"], before.point_data["u"])
    assert after.cells_dict["triangle"][0].tolist() == [0, 1, N]


def rebuilt(mesh: MeshBatch, points: np.ndarray, faces: np.ndarray) -> MeshBatch:
    """A mesh of other counts that keeps the interface, as topology "full" gives."""
    row = {tuple(p): i for i, p in enumerate(points.tolist())}
    walls = [[row[tuple(p)] for p in mesh.points[e].tolist()] for e in mesh.constrained_edges]
    return MeshBatch.from_arrays(points, faces, constrained_edges=walls)


def split_and_shuffled(mesh: MeshBatch, seed: int = 0) -> MeshBatch:
    """Triangle 0 split in three at a new vertex; all rows of points and triangles in another order."""
    rng = np.random.default_rng(seed)
    points, faces = mesh.points.numpy(), mesh.triangles.numpy()
    a, b, c = faces[0]
    points = np.concatenate([points, points[faces[0]].mean(0, keepdims=True)])
    faces = np.concatenate([faces[1:], [[a, b, 25], [b, c, 25], [c, a, 25]]])
    order = rng.permutation(len(points))
    return rebuilt(mesh, points[order], rng.permutation(np.argsort(order)[faces]))


@pytest.mark.parametrize("suffix", [".vtu", ".msh"])
def test_other_counts_keep_regions_and_lines_and_name_what_goes(tmp_path, suffix):
    names = {"left": np.array([LEFT, 2]), "right": np.array([RIGHT, 2]), "wall": np.array([5, 1])}
    numbered = grid().cell_data | {"id": [np.arange(4), np.arange(4, 36)]}
    source = save(tmp_path / f"in{suffix}", grid(field_data=names, cell_data=numbered))
    new = split_and_shuffled(read(source))
    target = tmp_path / f"out{suffix}"
    with pytest.warns(MeshWarning, match="not carried over") as record:
        write(target, new, like=source)
    for gone in ("point data 'u'", "point data 'v'", "cell data 'p'", "cell data 'id'"):
        assert gone in warned(record)
    after = load(target)
    tag = "gmsh:physical" if suffix == ".msh" else "region"
    np.testing.assert_array_equal(triangle_data(after, tag), side_of(new))
    ends = after.points[after.cells_dict["line"]]
    np.testing.assert_array_equal(ends, grid().points[grid().cells_dict["line"]])
    assert set(after.field_data) == set(names)
    back = read(target)
    assert torch.equal(back.triangles, new.triangles)
    assert len(back.constrained_edges) == N - 1


def test_triangles_in_another_order_take_the_tags_of_their_place(tmp_path):
    source = save(tmp_path / "in.msh", grid())
    mesh = flipped(read(source))
    shuffled = mesh.with_triangles(mesh.triangles[torch.randperm(32, generator=torch.Generator().manual_seed(0))])
    with pytest.warns(MeshWarning, match="cell data 'p'"):
        write(tmp_path / "out.msh", shuffled, like=source)
    after = load(tmp_path / "out.msh")
    np.testing.assert_array_equal(triangle_data(after, "gmsh:physical"), side_of(shuffled))


def test_regions_that_cannot_be_told_are_dropped_by_name(tmp_path):
    source = save(tmp_path / "in.vtu", grid(point_data={}))
    other = MeshBatch.from_arrays([[50, 0], [51, 0], [50, 1.0]], [[0, 1, 2]])
    with pytest.warns(MeshWarning, match=r"cell data 'region'.*4 cells whose vertices are gone"):
        write(tmp_path / "out.vtu", other, like=source)
    assert load(tmp_path / "out.vtu").cell_data == {}


@pytest.mark.parametrize("motion", [lambda p: p * 2 + 1, lambda p: p.flip(0)], ids=["grown", "turned by half"])
def test_a_boundary_moved_as_a_whole_keeps_everything(tmp_path, motion):
    source = save(tmp_path / "in.vtu", grid())
    mesh = read(source)
    write(tmp_path / "out.vtu", mesh.with_points(motion(mesh.points)), like=source)
    after = load(tmp_path / "out.vtu")
    assert set(after.cell_data) == {"region", "p"}
    np.testing.assert_array_equal(after.cells_dict["line"], grid().cells_dict["line"])


def test_what_a_format_cannot_hold_is_named(tmp_path):
    source = save(tmp_path / "in.vtu", grid())
    with pytest.warns(MeshWarning, match=r"out\.off: off files do not hold .*'p'.*'region'.*line cells.*'u'.*'v'"):
        write(tmp_path / "out.off", read(source), like=source)


# Gmsh


@pytest.fixture(scope="module")
def gmsh_model(tmp_path_factory):
    """Files of a rectangle in two materials by Gmsh itself: groups of lines and surfaces, some in two groups."""
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
    gmsh.option.setNumber("Mesh.SaveParametric", 1)  # nodes with their place on curve and surface
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
    write(tmp_path / "out.msh", moved(mesh), like=files[case])
    before = groups_of(gmsh, files[case])
    assert groups_of(gmsh, tmp_path / "out.msh") == before
    if case != (2.2, 0, 1) and case != (2.2, 1, 1):  # version 2.2 forgets the groups when all is saved
        assert (1, 3, "seam") in before
        assert len(mesh.constrained_edges) > 0
    assert torch.equal(read(tmp_path / "out.msh").points, moved(mesh).points)


@pytest.mark.parametrize("case", [(4.1, 1, 0), (4.1, 1, 1), "parametric"], ids=str)
def test_an_unchanged_binary_file_comes_back_byte_for_byte(tmp_path, gmsh_model, case):
    source = gmsh_model[1][case]
    write(tmp_path / "out.msh", read(source), like=source)
    assert (tmp_path / "out.msh").read_bytes() == source.read_bytes()


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


# SU2 and obj


SU2 = """% a comment
NDIME= 2
NELEM= 4
5 0 1 4 0
5 1 2 4 1
5 2 3 4 2
5 3 0 4 3
NPOIN= 5 5
0 0 0
1 0 1
1 1 2
0 1 3
0.5 0.25 4
NMARK= 2
MARKER_TAG= wall
MARKER_ELEMS= 2
3 0 1
3 1 2
MARKER_TAG= far_field % the rest
MARKER_ELEMS= 2
3 2 3
3 3 0
FFD_NBOX= 1
"""


def test_su2_names_of_several_words_become_one_word_and_none_is_an_error(tmp_path):
    (tmp_path / "in.su2").write_text(SU2.replace("MARKER_TAG= wall", "MARKER_TAG=  inlet pipe % left"))
    mesh = read(tmp_path / "in.su2")
    write(tmp_path / "out.su2", mesh, like=tmp_path / "in.su2")
    assert "MARKER_TAG= inlet_pipe\nMARKER_ELEMS= 2\n" in (tmp_path / "out.su2").read_text()
    (tmp_path / "in.su2").write_text(SU2.replace("MARKER_TAG= wall", "MARKER_TAG= "))
    with pytest.raises(MeshIOError, match="MARKER_TAG has no name"):
        read(tmp_path / "in.su2")


def test_su2_markers_keep_their_names(tmp_path):
    (tmp_path / "in.su2").write_text(SU2)
    mesh = read(tmp_path / "in.su2")
    assert len(mesh.triangles) == 4
    write(tmp_path / "out.su2", mesh.with_points(mesh.points + 1), like=tmp_path / "in.su2")
    text = (tmp_path / "out.su2").read_text()
    assert "MARKER_TAG= wall\nMARKER_ELEMS= 2\n3 0 1\n3 1 2\n" in text
    assert "MARKER_TAG= far_field\nMARKER_ELEMS= 2\n3 2 3\n3 3 0\n" in text
    assert "FFD_NBOX= 1" in text
    assert "% a comment" in text
    assert "1.5 1.25\n" in text
    with pytest.warns(MeshWarning, match="FFD_NBOX"):
        write(tmp_path / "out.vtu", mesh, like=tmp_path / "in.su2")
    tags = load(tmp_path / "out.vtu")
    np.testing.assert_array_equal(np.concatenate(tags.cell_data["su2:tag"]), [0, 0, 0, 0, 1, 1, 2, 2])


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("NDIME= 2", "NDIME= 3", "NDIME is not 2"),
        ("NELEM= 4", "NELEM= 40", "NELEM says 40, the file ends after"),
        ("NMARK= 2", "NMARK= 3", "NMARK says 3 markers, the file has 2"),
        ("5 0 1 4 0", "10 0 1 4 2 0", "element type 10 is not planar"),
        ("5 0 1 4 0", "5 0 1", "needs 3 points"),
        ("5 0 1 4 0", "5 0 1 9 0", "rows of points run from 0 to 4"),
        ("NPOIN", "NPOINTS", "no NPOIN"),
    ],
)
def test_su2_mistakes_are_named(tmp_path, old, new, what):
    (tmp_path / "in.su2").write_text(SU2.replace(old, new))
    with pytest.raises(MeshError, match=rf"in\.su2: .*{what}"):
        read(tmp_path / "in.su2")


OBJ = """mtllib a.mtl
o plate
v 0 0 0 0.5 0.5 0.5
v 1 0 0
v 1.0 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vt 0.5 0.5
vn 0 0 1
usemtl red
f 1/1/1 2/2/1 3/3/1
f -4/1/1 -2/3/1 -1/4/1
"""


def test_obj_keeps_materials_texture_and_lines(tmp_path):
    (tmp_path / "in.obj").write_text(OBJ)
    mesh = read(tmp_path / "in.obj")  # five texture points on four vertices
    write(tmp_path / "same.obj", mesh, like=tmp_path / "in.obj")
    assert (tmp_path / "same.obj").read_text() == OBJ
    other = mesh.with_triangles(torch.tensor([[0, 1, 3], [1, 2, 3]]))
    write(tmp_path / "out.obj", other.with_points(mesh.points * 2), like=tmp_path / "in.obj")
    lines = (tmp_path / "out.obj").read_text().splitlines()
    assert lines[-2:] == ["f 1/1/1 2/2/1 4/4/1", "f 2/2/1 3/3/1 4/4/1"]
    assert lines[:3] == ["mtllib a.mtl", "o plate", "v 0 0 0 0.5 0.5 0.5"]
    assert lines[4] == "v 2.0 2.0 0.0"
    assert lines[-3] == "usemtl red"
    with pytest.warns(MeshWarning, match="texture coordinates, normals"):
        write(tmp_path / "out.off", mesh, like=tmp_path / "in.obj")


def test_obj_groups_are_regions(tmp_path):
    (tmp_path / "in.obj").write_text(OBJ.replace("f -4", "usemtl blue\nf -4"))
    assert read(tmp_path / "in.obj").constrained_edges.tolist() == [[0, 2]]


def test_legacy_vtk_keeps_title_and_field_data(tmp_path):
    source = save(tmp_path / "in.vtk", grid(), binary=False, file_format="vtk42")
    text = source.read_text().splitlines()
    text[1] = "a title of mine"
    text.insert(4, "FIELD FieldData 1\nTIME 1 1 double\n0.125")
    source.write_text("\n".join(text) + "\n")
    write(tmp_path / "out.vtk", read(source), like=source)
    after = (tmp_path / "out.vtk").read_text()
    assert "\na title of mine\n" in after
    assert "TIME 1 1 double\n0.125" in after
    assert torch.equal(read(tmp_path / "out.vtk").points, read(source).points)


def test_vtu_keeps_field_data(tmp_path):
    source = save(tmp_path / "in.vtu", grid(field_data={"TIME": np.array([1 / 3])}))
    write(tmp_path / "out.vtu", read(source), like=source)
    np.testing.assert_array_equal(load(tmp_path / "out.vtu").field_data["TIME"], [1 / 3])


# What is wrong is said in one line


def broken(tmp_path: Path, case: str) -> Path:
    points, faces = grid_arrays()
    path = tmp_path / "bad.vtu"
    if case == "missing":
        return path
    if case == "directory":
        path.mkdir()
    elif case == "empty":
        path.touch()
    elif case == "truncated":
        save(path, grid())
        path.write_bytes(path.read_bytes()[:-400])
    elif case == "another format":
        path.write_text("solid\nendsolid\n")
    elif case in ("extension", "no extension"):
        path = tmp_path / ("bad.xyz" if case == "extension" else "bad")
        path.write_text("1 2 3")
    elif case in ("nan", "off the plane"):
        points[7, 1 if case == "nan" else 2] = np.nan if case == "nan" else 1
        save(path, meshio.Mesh(points, [("triangle", faces)]))
    else:
        kind = {"quads": "quad", "tetrahedra": "tetra", "second order": "triangle6", "no cells": "line"}[case]
        rows = np.arange({"quad": 4, "tetra": 4, "triangle6": 6, "line": 2}[kind])[None]
        save(path, meshio.Mesh(points, [(kind, rows)]), file_format="vtu")
    return path


@pytest.mark.parametrize(
    ("case", "kind", "text"),
    [
        ("missing", MeshIOError, "no such file"),
        ("directory", MeshIOError, "is a directory"),
        ("empty", MeshIOError, "the file is empty"),
        ("truncated", MeshIOError, "cannot be read as vtu"),
        ("another format", MeshIOError, "cannot be read as vtu"),
        ("extension", MeshIOError, r"extension '\.xyz' is not known; known ones are \.vtu \.vtk \.msh"),
        ("no extension", MeshIOError, "no extension"),
        ("nan", InvalidMeshError, "points row 7 .*finite"),
        ("off the plane", InvalidMeshError, "points row .* off the plane"),
        ("quads", InvalidMeshError, "no triangles: it has quad cells only"),
        ("no cells", InvalidMeshError, "no triangles: it has line cells only"),
        ("tetrahedra", InvalidMeshError, "tetra cells; only planar"),
        ("second order", InvalidMeshError, r"second-order triangles \(triangle6\); convert"),
    ],
)
def test_a_bad_file_is_one_clear_line(tmp_path, capfd, case, kind, text):
    path = broken(tmp_path, case)
    with pytest.raises(kind, match=text) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("form", ALL)
def test_a_truncated_file_is_no_foreign_exception_and_no_endless_loop(tmp_path, form, capfd):
    class EndlessError(BaseException):
        """Caught by nobody."""

    def stop(*_):
        raise EndlessError

    suffix = FORMATS[form].extensions[0]
    whole = save(tmp_path / f"a{suffix}", grid()).read_bytes()
    before = signal.signal(signal.SIGALRM, stop)
    silent = foreign = 0
    ends = [int(part * len(whole)) for part in (*np.linspace(0, 0.9, 10), 0.92, 0.94, 0.96, 0.97, 0.98)]
    try:
        for end in [*ends, *(whole.rfind(b"\n", 0, end) + 1 for end in ends)]:
            cut = tmp_path / f"cut{suffix}"
            cut.write_bytes(whole[:end])
            signal.alarm(10)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", MeshWarning)
                    silent += len(read(cut).triangles) < 32
            except MeshError as error:
                foreign += not str(error).startswith(f"{cut}: ")
            finally:
                signal.alarm(0)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert foreign == 0
    # obj and abaqus say nowhere how long they are: a file cut between two lines is a file.
    assert silent == 0 or form in ("obj", "abaqus")
    assert capfd.readouterr() == ("", "")


def test_an_unreadable_file_says_so(tmp_path, monkeypatch):
    path = save(tmp_path / "a.vtu", grid())

    def denied(*_):
        raise PermissionError(errno.EACCES, "Permission denied")  # root may read anything: pretend

    monkeypatch.setattr(MeshioFormat, "read", denied)
    with pytest.raises(MeshIOError, match=r"a\.vtu: cannot be read: Permission denied"):
        read(path)


def test_a_reader_that_calls_exit_is_an_error(tmp_path, monkeypatch):
    path = save(tmp_path / "a.off", meshio.Mesh(*grid_arrays()[:1], [("triangle", grid_arrays()[1])]))
    monkeypatch.setattr(meshio.off, "read", lambda _: sys.exit(1))
    with pytest.raises(MeshIOError, match="cannot be read as off"):
        read(path)


def test_remarks_of_meshio_become_warnings(tmp_path, capfd, monkeypatch):
    path = save(tmp_path / "a.off", meshio.Mesh(*grid_arrays()[:1], [("triangle", grid_arrays()[1])]))
    inner = meshio.off.read

    def talking(name):
        meshio._common.warn("something odd")
        return inner(name)

    monkeypatch.setattr(meshio.off, "read", talking)
    with pytest.warns(MeshWarning, match=r"a\.off: something odd"):
        read(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("suffix", "package"), [(".exo", "netCDF4"), (".med", "h5py"), (".xdmf", "h5py")])
def test_a_missing_package_is_named(tmp_path, monkeypatch, suffix, package):
    monkeypatch.setitem(sys.modules, package, None)
    points, faces = grid_arrays()
    with pytest.raises(MissingDependencyError, match=f"need the package {package}; install it"):
        write(tmp_path / f"a{suffix}", MeshBatch.from_arrays(points, faces))
    (tmp_path / f"b{suffix}").write_text("something")
    with pytest.raises(MissingDependencyError if suffix != ".xdmf" else MeshIOError):
        read(tmp_path / f"b{suffix}")
    assert os.listdir(tmp_path) == [f"b{suffix}"]


# Writing is all or nothing


@pytest.fixture
def mesh() -> MeshBatch:
    return MeshBatch.from_arrays(*grid_arrays())


def test_a_batch_is_no_file(tmp_path, mesh):
    with pytest.raises(InvalidMeshError, match=r"this batch has 2: write each of mesh.split\(\)"):
        write(tmp_path / "a.vtu", join([mesh, mesh]))


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.xyz", "extension"), ("none/a.vtu", "the directory .*none does not exist"), ("folder.vtu", "is a directory")],
)
def test_a_place_that_cannot_be_written_is_named(tmp_path, mesh, name, text):
    (tmp_path / "folder.vtu").mkdir()
    with pytest.raises(MeshIOError, match=text):
        write(tmp_path / name, mesh)
    assert os.listdir(tmp_path) == ["folder.vtu"]


def full_disk(*args, **_):
    Path(args[0]).write_text("the beginning")
    raise OSError(errno.ENOSPC, "No space left on device")


FAILURES = {
    "no space": (full_disk, "cannot be written: No space left on device"),
    "foreign": (lambda *_, **__: 1 // 0, "cannot be written: .*division"),
    "exit": (lambda *_, **__: sys.exit(1), "cannot be written"),
}


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("existing", [False, True])
def test_a_failed_write_leaves_no_trace(tmp_path, monkeypatch, mesh, failure, existing):
    target = tmp_path / "a.vtu"
    if existing:
        target.write_text("precious")
    write_badly, text = FAILURES[failure]
    monkeypatch.setattr(meshio.vtu, "write", write_badly)
    with pytest.raises(MeshIOError, match=rf"a\.vtu: {text}"):
        write(target, mesh)
    assert os.listdir(tmp_path) == (["a.vtu"] if existing else [])
    assert not existing or target.read_text() == "precious"


def test_a_directory_that_may_not_be_written_is_named(tmp_path, monkeypatch, mesh):
    def denied(**_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(atomic.tempfile, "mkdtemp", denied)
    with pytest.raises(MeshIOError, match=r"a\.vtu: cannot be written: Permission denied"):
        write(tmp_path / "a.vtu", mesh)


def test_a_file_that_may_not_grow_leaves_no_trace(tmp_path):
    """The system itself refuses to write more than 200 bytes."""
    code = f"""
import resource, sys
from torchmesh import MeshBatch
from torchmesh.errors import MeshIOError
from torchmesh.files.mesh_files import write
mesh = MeshBatch.from_arrays({grid_arrays()[0].tolist()}, {grid_arrays()[1].tolist()})
resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))
for suffix in ("vtu", "vtk", "msh", "su2", "obj", "xdmf", "stl", "med", "off", "ply"):
    try:
        write({str(tmp_path)!r} + "/a." + suffix, mesh)
        sys.exit(suffix + ": no error")
    except MeshIOError as error:
        if suffix != "med" and "cannot be written: File too large" not in str(error):
            sys.exit(str(error))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert (done.returncode, done.stderr) == (0, "")
    assert os.listdir(tmp_path) == []


def test_permissions_and_links_stay(tmp_path, mesh):
    target = tmp_path / "a.vtu"
    write(target, mesh)
    umask = os.umask(0)
    os.umask(umask)
    assert target.stat().st_mode & 0o777 == 0o666 & ~umask
    target.chmod(0o640)
    (tmp_path / "link.vtu").symlink_to(target)
    write(tmp_path / "link.vtu", mesh)
    assert (tmp_path / "link.vtu").is_symlink()
    assert target.stat().st_mode & 0o777 == 0o640


def test_nothing_is_printed(tmp_path, capfd, mesh):
    for form in ALL:
        path = tmp_path / f"a{FORMATS[form].extensions[0]}"
        write(path, mesh)
        read(path)
    assert capfd.readouterr() == ("", "")


def test_a_region_tag_in_a_column_of_its_own_is_a_region_tag(tmp_path):
    """Gmsh's legacy VTK files have their CellEntityIds as (cells, 1)."""
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1]], float)
    cells = np.array([[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]])
    tags = np.array([[1], [1], [2], [2]], np.int32)
    path = tmp_path / "tags.vtu"
    meshio.Mesh(np.c_[points, np.zeros(6)], [("triangle", cells)], cell_data={"CellEntityIds": [tags]}).write(path)
    assert {frozenset(edge) for edge in read(path).constrained_edges.tolist()} == {frozenset((1, 2))}


# --- what must not slide -----------------------------------------------------------------------------


def test_held_are_quads_and_seams_between_markers_and_what_is_marked(tmp_path):
    points, triangles = meshes.grid_arrays(4, 4)
    quads = [("quad", np.array([[0, 1, 6, 5]]))]
    triangles = triangles[~np.isin(triangles, [0, 1, 6, 5]).all(1)]
    bottom, top = np.array([[10, 15], [15, 20]]), np.array([[4, 9], [9, 14], [14, 19], [19, 24]])
    tags = [np.full(len(triangles), 1), np.array([1]), np.array([2, 3]), np.array([4, 4, 4, 4])]
    mesh = meshio.Mesh(
        np.pad(points, ((0, 0), (0, 1))),
        [("triangle", triangles), *quads, ("line", bottom), ("line", top)],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
    )
    mesh.write(tmp_path / "a.msh", file_format="gmsh22")
    assert held(tmp_path / "a.msh").nonzero().squeeze(1).tolist() == [0, 1, 5, 6, 15]
    mesh.point_data["fixed"] = np.arange(25) == 22
    mesh.point_data["fixed"] = mesh.point_data["fixed"].astype(float)
    mesh.write(tmp_path / "b.msh", file_format="gmsh22")
    assert held(tmp_path / "b.msh").nonzero().squeeze(1).tolist() == [0, 1, 5, 6, 15, 22]


def test_a_file_that_marks_the_whole_boundary_holds_none_of_it(tmp_path):
    mesh = meshes.grid()
    inner = MeshBatch.from_arrays(mesh.points, mesh.triangles, torch.arange(len(mesh.points)) == 8)
    write(tmp_path / "a.vtu", inner)
    assert bool(meshio.read(tmp_path / "a.vtu").point_data["fixed"].any())
    assert not bool(held(tmp_path / "a.vtu").any())


def test_a_triangle_that_comes_back_wound_the_other_way_is_written_so(tmp_path):
    """A vertex that travelled may make the same three corners, in the same row, a triangle of the other side."""
    mesh = meshes.grid(2, 1)
    write(tmp_path / "in.vtu", mesh)
    over = mesh.triangles.clone()
    over[0] = over[0].flip(0)
    mirrored = mesh.with_triangles(over)
    write(tmp_path / "out.vtu", mirrored, like=tmp_path / "in.vtu")
    written = meshio.read(tmp_path / "out.vtu").cells_dict["triangle"]
    turns = [np.roll(over.numpy(), k, 1) for k in range(3)]
    assert np.any([(written == t).all(1) for t in turns], 0).all()
