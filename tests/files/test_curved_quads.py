"""Quads of eight and nine nodes through files: read, improved and written with their nodes; judged by samples."""

import curved_meshes as cm
import meshio
import numpy as np
import pytest

import torchmesh as tm
from torchmesh.batches.file_improvement import improve_series, open_mesh
from torchmesh.errors import InvalidMeshError, MeshWarning
from torchmesh.files.documents import load
from torchmesh.files.source import Source
from torchmesh.files.wiped import wiped

PLACES = [(0, 0), (2, 0), (2, 2), (0, 2), (1, 0), (2, 1), (1, 2), (0, 1), (1, 1)]
RADII = (0.4, 0.5, 0.7, 1.0)


def ring(width=9, around=12, radii=RADII, quad_layers=2):
    """Points (V, 2), quads (Q, width) between the inner circles, six-node triangles outside; curved on all circles."""
    turn = 2 * np.pi * np.arange(around) / around
    rows: dict[tuple, int] = {}

    def at(*position):
        key = tuple(np.round(position, 9))
        return rows.setdefault(key, len(rows))

    def on(r, i):
        t = turn[int(i) % around] if i == int(i) else turn[int(i) % around] + np.pi / around
        return at(r * np.cos(t), r * np.sin(t))

    def between(a, b):
        table = np.array(list(rows))
        return at(*((table[a] + table[b]) / 2))

    quads, six = [], []
    for k in range(len(radii) - 1):
        inner, outer = radii[k], radii[k + 1]
        for i in range(around):
            a, b, c, d = on(inner, i), on(outer, i), on(outer, i + 1), on(inner, i + 1)
            if k < quad_layers:
                middles = [between(a, b), on(outer, i + 0.5), between(c, d), on(inner, i + 0.5)]
                if width == 9:
                    middles.append(on((inner + outer) / 2, i + 0.5))
                quads.append([a, b, c, d, *middles])
            else:
                across = between(a, c)
                six += [[a, b, c, between(a, b), on(outer, i + 0.5), across],
                        [a, c, d, across, between(c, d), on(inner, i + 0.5)]]  # fmt: skip
    return np.array(list(rows)), np.array(quads), np.array(six).reshape(-1, 6)


def jacobians(points, quads, steps=24):
    """(Q, S) the Jacobian of each quad on a lattice, by differences of the map, which are exact for parabolas."""
    u, v = (g.reshape(-1) for g in np.meshgrid(np.linspace(0, 1, steps + 1), np.linspace(0, 1, steps + 1)))

    def functions(u, v):
        if quads.shape[1] == 8:
            x, y = 2 * u - 1, 2 * v - 1
            signs = (-1, -1), (1, -1), (1, 1), (-1, 1)
            corners = [(1 + a * x) * (1 + b * y) * (a * x + b * y - 1) / 4 for a, b in signs]
            p, q = 1 - x**2, 1 - y**2
            return np.array([*corners, p * (1 - y) / 2, (1 + x) * q / 2, p * (1 + y) / 2, (1 - x) * q / 2])
        one, other = ([(1 - t) * (1 - 2 * t), 4 * t * (1 - t), t * (2 * t - 1)] for t in (u, v))
        return np.array([one[i] * other[j] for i, j in PLACES])

    nodes = points[quads][:, :, :2]
    a, b = (
        np.einsum("ks,nkd->nsd", functions(u + du, v + dv) - functions(u - du, v - dv), nodes)
        for du, dv in ((0.5, 0), (0, 0.5))
    )
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def moved(step=0.3, **shape):
    """The ring after its inner circle has moved right with its nodes, and nothing else."""
    points, quads, six = ring(**shape)
    points[np.isclose(np.hypot(*points.T), RADII[0])] += [step, 0]
    return points, quads, six


def save(path, points, quads, six, **data):
    cells = [(f"quad{quads.shape[1]}", quads)] + ([("triangle6", six)] if len(six) else [])
    if path.suffix == ".cgns":
        rows = {"quads": [np.arange(len(quads)), np.zeros(0, int)], "tris": [np.zeros(0, int), np.arange(len(six))]}
        data = {"cell_sets": rows}
    mesh = meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), cells, **data)
    if path.suffix == ".cgns":
        from torchmesh.files.formats.registry import format_of

        format_of(path).write(path, mesh, None, False)
    else:
        options = {"file_format": "gmsh22", "binary": False} if path.suffix == ".msh" else {}
        mesh.write(path, **options)
    return path


def improved(path, out, **options):
    (done,) = improve_series([open_mesh(path)], tm.ImproveOptions(**options))
    done.write(out)
    return done, load(out).mesh


def of_type(mesh, start):
    return np.concatenate([b.data for b in mesh.cells if b.type.startswith(start)])


@pytest.mark.parametrize("width", [8, 9])
@pytest.mark.parametrize("topology", ["keep", "flip"])
def test_a_moved_hole_is_mended_and_the_nodes_of_curves_keep_their_bits(tmp_path, topology, width):
    points, quads, six = moved(width=width)
    assert (jacobians(points, quads).min(1) <= 0).any()
    path = save(tmp_path / "in.vtu", points, quads, six)
    done, mesh = improved(path, tmp_path / "out.vtu", topology=topology)
    assert (of_type(mesh, "quad") == quads).all()
    assert (jacobians(mesh.points, quads).min(1) > 0).all()
    assert (cm.jacobians(mesh.points, of_type(mesh, "triangle")).min(1) > 0).all()
    assert (done.curved.quads, done.curved.all_inverted) == (len(quads), 0)
    rest = np.hypot(*ring(width=width)[0].T)
    circles = np.isclose(rest, RADII[0]) | np.isclose(rest, RADII[-1])
    assert (mesh.points[circles, :2] == points[circles]).all()


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".msh", ".inp", ".med", ".xdmf", ".e", ".cgns"])
def test_every_format_keeps_the_types_and_the_nodes_of_quads(tmp_path, suffix):
    if suffix == ".e":
        pytest.importorskip("netCDF4")
    points, quads, six = moved(0.2, width=8, around=10)
    path = save(tmp_path / f"in{suffix}", points, quads, six)
    before = load(path).mesh
    done, mesh = improved(path, tmp_path / f"out{suffix}")
    assert done.curved.quads == len(quads)
    assert done.curved.all_inverted == 0
    assert (of_type(mesh, "quad") == of_type(before, "quad")).all()
    assert {b.type for b in mesh.cells} >= {"quad8", "triangle6"}
    assert (jacobians(mesh.points, of_type(mesh, "quad")).min(1) > 0).all()


def test_what_is_valid_and_does_not_move_keeps_all_its_bits(tmp_path):
    points, quads, six = ring()
    inside = quads[0, 8]
    points[inside] += 0.004  # the middle of a quad is not where its sides ask for it
    path = save(tmp_path / "in.vtu", points, quads, six)
    tm.write(tmp_path / "out.vtu", tm.read(path), like=path)
    mesh = meshio.read(tmp_path / "out.vtu")
    assert (mesh.points[:, :2] == points).all()
    assert (of_type(mesh, "quad") == quads).all()


def test_a_clockwise_file_of_curved_quads_alone_keeps_its_winding(tmp_path):
    points, quads, _ = ring(quad_layers=3)
    back = quads[:, [0, 3, 2, 1, 7, 6, 5, 4, 8]]
    path = save(tmp_path / "in.vtu", points, back, np.zeros((0, 6), int))
    with pytest.warns(MeshWarning, match="clockwise"):
        mesh = tm.read(path)
    tm.write(tmp_path / "out.vtu", mesh, like=path)
    assert (of_type(meshio.read(tmp_path / "out.vtu"), "quad") == back).all()


def test_a_quad_folded_by_one_node_counts_and_is_put_right(tmp_path):
    points, quads, six = ring()
    inner = quads[0, 5]  # on the circle between the two layers of quads
    points[inner] *= 0.6
    path = save(tmp_path / "in.vtu", points, quads, six)
    assert Source.open(path).curved.inverted_quads == (jacobians(points, quads).min(1) <= 0).sum() > 0
    done, mesh = improved(path, tmp_path / "out.vtu", topology="keep")
    assert done.curved.all_inverted == 0
    assert (jacobians(mesh.points, quads).min(1) > 0).all()


def test_sides_of_thin_quads_next_to_a_wall_that_bulges_in_are_curved_along(tmp_path):
    x = np.linspace(0, 3, 4)
    heights = np.array([0.0, 0.08, 0.16, 1.0])
    grid = np.array([[u, v] for v in heights for u in x])
    rows = np.array([[4 * j + i, 4 * j + i + 1, 4 * j + i + 5, 4 * j + i + 4] for j in range(3) for i in range(3)])
    points, nodes, quads = [tuple(p) for p in grid], {}, []
    for row in rows:
        own = []
        for a, b in zip(row, np.roll(row, -1), strict=True):
            key = tuple(sorted((int(a), int(b))))
            if key not in nodes:
                nodes[key] = len(points)
                points.append(tuple((grid[a] + grid[b]) / 2))
            own.append(nodes[key])
        quads.append([*row, *own])
    points, quads = np.array(points), np.array(quads)
    points[nodes[1, 2], 1] = 0.12  # straight sides above would cut through the wall
    path = save(tmp_path / "in.vtu", points, quads, np.zeros((0, 6), int))
    assert Source.open(path).curved.inverted_quads > 0
    done, mesh = improved(path, tmp_path / "out.vtu", topology="keep")
    assert done.curved.all_inverted == 0
    assert (jacobians(mesh.points, quads).min(1) > 0).all()
    assert (mesh.points[nodes[1, 2], :2] == points[nodes[1, 2]]).all()


@pytest.mark.parametrize("width", [8, 9])
def test_fields_at_nodes_are_read_by_the_functions_of_their_quads(tmp_path, width):
    grid = np.linspace(0, 1, 4)
    turn = {8: lambda x, y: x**2 - 3 * x * y + 2 * y, 9: lambda x, y: x**2 * 0.5 + x * y + y**2}[width]
    points, nodes, quads = [], {}, []

    def at(x, y):
        key = (round(x, 9), round(y, 9))
        if key not in nodes:
            nodes[key] = len(points)
            points.append(key)
        return nodes[key]

    h = grid[1]
    for y in grid[:-1]:
        for x in grid[:-1]:
            places = [(0, 0), (1, 0), (1, 1), (0, 1), (0.5, 0), (1, 0.5), (0.5, 1), (0, 0.5), (0.5, 0.5)][:width]
            quads.append([at(x + h * u, y + h * v) for u, v in places])
    points, quads = np.array(points), np.array(quads)
    path = save(tmp_path / "in.vtu", points, quads, np.zeros((0, 6), int), point_data={"u": turn(*points.T)})
    mesh = tm.read(path)
    shift = mesh.points.clone()
    inner = ((shift > 0.3) & (shift < 0.7)).all(1)
    shift[inner] += 0.05 * shift.new_tensor([1.0, -0.5])
    tm.write(tmp_path / "out.vtu", mesh.with_points(shift), like=path, fields="interpolate")
    made = meshio.read(tmp_path / "out.vtu")
    assert np.abs(made.points[:, :2] - points).max() > 0.04
    assert np.allclose(made.point_data["u"], turn(*made.points[:, :2].T), atol=1e-12)


def test_curved_quads_are_not_split_and_it_is_said(tmp_path):
    points, quads, six = ring()
    path = save(tmp_path / "in.vtu", points, quads, six)
    mesh = tm.read(path)
    triangles = np.concatenate([mesh.triangles.numpy(), mesh.quads[:1, :3].numpy(), mesh.quads[:1, [0, 2, 3]].numpy()])
    with pytest.warns(MeshWarning, match="belong to no triangle"):
        other = tm.MeshBatch.from_arrays(mesh.points, triangles, quads=mesh.quads[1:])
    with pytest.raises(InvalidMeshError, match="quads have mid-side nodes, and such quads do not become two triangles"):
        tm.write(tmp_path / "out.vtu", other, like=path)


def torn(width=9):
    """A ring of which every element has vertices and nodes of its own, and each element stands there twice."""
    points, quads, six = ring(width=width)
    at, cells, start = [], [], 0
    for rows in (quads, six):
        at.append(points[rows.reshape(-1)])
        own = start + np.arange(rows.size).reshape(rows.shape)
        cells.append(np.concatenate([own, own[:3]]))
        start += rows.size
    return np.concatenate(at), cells[0], cells[1], points, len(quads), len(six)


@pytest.mark.parametrize("width", [8, 9])
def test_clean_sews_curved_elements_with_their_nodes(tmp_path, width):
    at, quads, six, points, count, triangles = torn(width)
    path = save(tmp_path / "in.vtu", at, quads, six, point_data={"x": at[:, 0]})
    mesh, log = wiped(load(path), path)
    assert (log.old_vertex[log.new_vertex[log.old_vertex]] == log.old_vertex).all()
    assert len(mesh.points) == len(points)
    assert [(b.type, len(b.data)) for b in mesh.cells] == [(f"quad{width}", count), ("triangle6", triangles)]
    assert (mesh.point_data["x"] == mesh.points[:, 0]).all()
    assert (jacobians(mesh.points, of_type(mesh, "quad")).min(1) > 0).all()
    assert (cm.jacobians(mesh.points, of_type(mesh, "triangle")).min(1) > 0).all()
    assert any("mid-side nodes that were there twice became one" in line for line in log)
    mesh.write(tmp_path / "out.vtu")
    assert Source.open(tmp_path / "out.vtu").curved.all_inverted == 0


def test_clean_refuses_edges_whose_two_nodes_lie_apart_and_curved_cells_that_a_vertex_divides(tmp_path):
    at, quads, six, *_ = torn()
    at[quads[0, 5]] += 0.01
    path = save(tmp_path / "in.vtu", at, quads[:-3], six[:-3])
    with pytest.raises(InvalidMeshError, match="two mid-side nodes that lie apart"):
        wiped(load(path), path)
    mesh, _ = wiped(load(path), path, tolerance=0.02)
    assert len(of_type(mesh, "quad")) == len(quads) - 3
    points = np.array([[0, 0], [2, 0], [2, 1], [0, 1], [1, -1], [1, 0], [0.5, -0.5], [1.5, -0.5]] + [[0, 0.5]] * 4)
    points[8:] = [[1, 0], [2, 0.5], [1, 1], [0, 0.5]]
    cells = [("quad8", np.array([[0, 1, 2, 3, 8, 9, 10, 11]])), ("triangle", np.array([[0, 4, 5], [5, 4, 1]]))]
    meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), cells).write(tmp_path / "b.vtu")
    with pytest.raises(InvalidMeshError, match="hangs in the side of a quad8 cell"):
        wiped(load(tmp_path / "b.vtu"), tmp_path / "b.vtu")


def test_improve_refuses_to_split_curved_quads_before_any_work_and_proposes_it_to_nobody(tmp_path):
    points, quads, six = ring()
    points[np.isclose(np.hypot(*points.T), RADII[0])] += [0.7, 0]  # the hole leaves the mesh
    path = save(tmp_path / "in.vtu", points, quads, six)
    with pytest.raises(InvalidMeshError, match=r"in\.vtu: its quads have mid-side nodes"):
        improve_series([open_mesh(path)], tm.ImproveOptions(quads="split"))
    (done,) = improve_series([open_mesh(path)], tm.ImproveOptions())
    assert "are inverted still" in done.message()
    assert "split" not in done.message()


def test_straight_quads_beside_six_node_triangles_are_split(tmp_path):
    points, quads, six = ring(around=8)
    flat = quads[:, :4]
    fixed = np.zeros(len(points), np.int32)
    fixed[flat] = 1
    points[flat[0, 1]] *= 0.75  # a vertex between the layers comes too near to the hole for a quad
    cells = [("quad", flat), ("triangle6", six)]
    path = tmp_path / "in.vtu"
    meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), cells, point_data={"fixed": fixed}).write(path)
    with pytest.warns(MeshWarning, match="belong to no cell"):
        given = open_mesh(path)
    (done,) = improve_series([given], tm.ImproveOptions(quads="split"))
    done.write(tmp_path / "out.vtu")
    kinds = {b.type: len(b.data) for b in load(tmp_path / "out.vtu").mesh.cells}
    split = int(done.report.split_quads.sum())
    assert 0 < split < len(flat)
    assert kinds == {"quad": len(flat) - split, "triangle6": len(six), "triangle": 2 * split}


@pytest.mark.parametrize(
    ("suffix", "width", "left"), [("unv", 9, 0), ("unv", 8, 8), ("bdf", 8, 8), ("su2", 9, 0), ("mesh", 8, 0)]
)
def test_where_a_format_has_no_such_quads_their_corners_are_written_and_it_is_said(tmp_path, suffix, width, left):
    path = save(tmp_path / "in.vtu", *ring(width=width))
    mesh, out = tm.read(path), tmp_path / f"out.{suffix}"
    if not left:
        with pytest.warns(MeshWarning, match=f"mid-side nodes of quad{width} cells"):
            tm.write(out, mesh, like=path)
    else:
        tm.write(out, mesh, like=path)
    found = [b.type for b in load(out).mesh.cells if b.type.startswith("quad")]
    assert set(found) == {f"quad{left or ''}"}
    assert sum(len(b.data) for b in load(out).mesh.cells if b.type.startswith("quad")) == len(mesh.quads)
