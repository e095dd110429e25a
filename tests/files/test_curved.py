"""Six-node triangles through files: read, improved, and written with their nodes; judged by dense samples."""

import json

import curved_meshes as cm
import meshio
import numpy as np
import pytest
import torch

import torchmesh as tm
from torchmesh.batches.file_improvement import improve_series, open_mesh
from torchmesh.errors import InvalidMeshError
from torchmesh.files.documents import load
from torchmesh.files.source import Source


def improved(path, out, fields="interpolate", **options):
    (done,) = improve_series([open_mesh(path)], tm.ImproveOptions(**options), fields=fields)
    done.write(out)
    return done, load(out).mesh


def six_of(mesh):
    return np.concatenate([b.data for b in mesh.cells if b.type == "triangle6"])


@pytest.mark.parametrize("topology", ["keep", "flip", "full"])
def test_a_moved_hole_is_mended_and_the_nodes_of_curves_keep_their_bits(tmp_path, topology):
    points, six = cm.tangled_annulus()
    assert (cm.jacobians(points, six).min(1) <= 0).any()
    path = cm.save(tmp_path / "in.vtu", points, six)
    done, mesh = improved(path, tmp_path / "out.vtu", topology=topology)
    after = six_of(mesh)
    assert (cm.jacobians(mesh.points, after).min(1) > 0).all()
    assert (done.curved.curved, done.curved.inverted) == (len(after), 0)
    before_nodes, nodes = cm.edges(six), cm.edges(after)
    if topology != "full":
        assert len(after) == len(six)
        assert len(mesh.points) == len(points)
        assert set(nodes.values()) == set(before_nodes.values())  # every number is still a node
        for edge in cm.boundary(six):
            assert nodes[edge] == before_nodes[edge]
            assert (mesh.points[nodes[edge]] == points[nodes[edge]]).all()
        changed = (np.sort(six, 1) != np.sort(after, 1)).any()
        assert changed == (topology == "flip")
    else:
        sides = {tuple(np.round(mesh.points[nodes[e]], 12)) for e in cm.boundary(after)}
        assert sides == {tuple(np.round(points[before_nodes[e]], 12)) for e in cm.boundary(six)}
        assert len(np.unique(after)) == len(mesh.points)
    hole = set(cm.boundary(after))
    off = [np.abs(mesh.points[m] - mesh.points[list(e)].mean(0)).max() for e, m in nodes.items() if e not in hole]
    assert np.median(off) == 0  # most sides inside are straight, to the bit


def test_what_is_valid_and_does_not_move_keeps_all_its_bits(tmp_path):
    points, six = cm.annulus(around=16)
    path = cm.save(tmp_path / "in.vtu", points, six, point_data={"u": points[:, 0] ** 2})
    tm.write(tmp_path / "out.vtu", tm.read(path), like=path)
    mesh = meshio.read(tmp_path / "out.vtu")
    assert (mesh.points == points).all()
    assert (six_of(mesh) == six).all()
    assert (mesh.point_data["u"] == points[:, 0] ** 2).all()


def test_a_clockwise_file_keeps_its_winding_and_the_order_of_its_nodes(tmp_path):
    points, six = cm.annulus(around=16)
    back = six[:, [0, 2, 1, 5, 4, 3]]
    path = cm.save(tmp_path / "in.vtu", points, back)
    with pytest.warns(tm.MeshWarning, match="clockwise"):
        mesh = tm.read(path)
    tm.write(tmp_path / "out.vtu", mesh, like=path)
    assert (six_of(meshio.read(tmp_path / "out.vtu")) == back).all()


def test_an_inner_node_that_alone_inverts_its_triangles_is_put_right(tmp_path):
    points, six = cm.annulus()
    inner = next(m for e, m in cm.edges(six).items() if e not in cm.boundary(six))
    points[inner, :2] += 0.5
    path = cm.save(tmp_path / "in.vtu", points, six)
    assert Source.open(path).curved.inverted >= 1
    done, mesh = improved(path, tmp_path / "out.vtu", topology="keep")
    assert done.curved.inverted == 0
    assert (cm.jacobians(mesh.points, six_of(mesh)).min(1) > 0).all()


def bulging_strip():
    """A row of flat triangles under a side that bulges in so far that straight sides above it would cut it."""
    x = np.linspace(0, 3, 4)
    points = np.array([[u, v] for v in (0.0, 0.35, 0.7, 1.4) for u in x])
    faces = np.array([f for j in range(3) for i in range(3) for f in (
        [4 * j + i, 4 * j + i + 1, 4 * j + i + 5], [4 * j + i, 4 * j + i + 5, 4 * j + i + 4])])  # fmt: skip
    points, six = cm.with_nodes(points, faces)
    nodes = cm.edges(six)
    points[nodes[1, 2], 1] = 0.3
    return points, six


@pytest.mark.parametrize("topology", ["keep", "flip"])
def test_sides_next_to_a_boundary_that_bulges_in_are_curved_inwards(tmp_path, topology):
    points, six = bulging_strip()
    path = cm.save(tmp_path / "in.vtu", points, six)
    assert Source.open(path).curved.inverted > 0
    done, mesh = improved(path, tmp_path / "out.vtu", topology=topology)
    assert done.curved.inverted == 0
    assert (cm.jacobians(mesh.points, six_of(mesh)).min(1) > 0).all()
    node = cm.edges(six)[1, 2]
    assert (mesh.points[node] == points[node]).all()


def test_interfaces_that_are_curved_keep_their_nodes_and_no_flip_crosses_them(tmp_path):
    points, six = cm.tangled_annulus(0.3, around=14, layers=3)
    region = (np.hypot(*cm.annulus(around=14, layers=3)[0][six[:, :3]].mean(1)[:, :2].T) > 0.8).astype(np.int32)
    interface = [e for e in cm.edges(six) if e not in cm.boundary(six) and len(
        {int(region[r]) for r in range(len(six)) if set(e) <= set(six[r, :3].tolist())}) == 2]  # fmt: skip
    nodes = cm.edges(six)
    for e in interface:
        points[nodes[e], :2] *= 1.02
    path = cm.save(tmp_path / "in.vtu", points, six, cell_data={"region": [region]})
    done, mesh = improved(path, tmp_path / "out.vtu")
    assert done.curved.inverted == 0
    after = cm.edges(six_of(mesh))
    for e in interface:
        assert (mesh.points[after[e]] == points[nodes[e]]).all()


def test_quadratic_fields_are_carried_exactly_where_sides_are_straight(tmp_path, rng):
    points, faces = np.meshgrid(np.linspace(0, 1, 5), np.linspace(0, 1, 5)), []
    points = np.stack([points[0].ravel(), points[1].ravel()], 1)
    for j in range(4):
        for i in range(4):
            a = 5 * j + i
            faces += [(a, a + 1, a + 6), (a, a + 6, a + 5)]
    inside = (points > 0).all(1) & (points < 1).all(1)
    points[inside] += rng.uniform(-0.09, 0.09, (inside.sum(), 2))
    points, six = cm.with_nodes(points, np.array(faces))

    def field(p):
        return 1 + 2 * p[:, 0] - p[:, 1] + 3 * p[:, 0] ** 2 - p[:, 0] * p[:, 1] + 0.5 * p[:, 1] ** 2

    number = np.arange(len(points))
    path = cm.save(tmp_path / "in.vtu", points, six, point_data={"f": field(points), "id": number})
    for topology in ("flip", "full"):
        _, mesh = improved(path, tmp_path / "out.vtu", topology=topology)
        # Newton's method ends at rounding.
        np.testing.assert_allclose(mesh.point_data["f"], field(mesh.points), rtol=0, atol=1e-11)
        if topology == "flip":
            assert (mesh.points != points).any()
            assert (mesh.point_data["id"] == number).all()


def test_lagrange_cells_of_vtk_stay_lagrange_cells(tmp_path):
    points, six = cm.tangled_annulus()
    cells = " ".join(map(str, six.ravel()))
    ends = " ".join(map(str, 6 * np.arange(1, len(six) + 1)))
    text = (
        '<?xml version="1.0"?><VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">'
        f'<UnstructuredGrid><Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(six)}">'
        '<Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">'
        f"{' '.join(map(repr, points.ravel().tolist()))}</DataArray></Points>"
        f'<Cells><DataArray type="Int64" Name="connectivity" format="ascii">{cells}</DataArray>'
        f'<DataArray type="Int64" Name="offsets" format="ascii">{ends}</DataArray>'
        f'<DataArray type="UInt8" Name="types" format="ascii">{" ".join(["69"] * len(six))}</DataArray></Cells>'
        "</Piece></UnstructuredGrid></VTKFile>"
    )
    (tmp_path / "in.vtu").write_text(text)
    done, _ = improved(tmp_path / "in.vtu", tmp_path / "out.vtu")
    assert {b.type for b in meshio.read(tmp_path / "out.vtu").cells} == {"VTK_LAGRANGE_TRIANGLE"}
    assert done.curved.inverted == 0
    improved(tmp_path / "in.vtu", tmp_path / "out.msh")
    assert {b.type for b in load(tmp_path / "out.msh").mesh.cells} == {"triangle6"}
    with pytest.warns(tm.MeshWarning, match="do not hold mid-side nodes of triangle6 cells"):
        tm.write(tmp_path / "out.stl", done.meshes[0], like=tmp_path / "in.vtu")


def test_straight_and_curved_triangles_of_one_file_keep_their_kinds(tmp_path):
    points, six = cm.tangled_annulus(0.3, around=14, layers=3)
    rest = cm.annulus(around=14, layers=3)[0]
    outside = np.hypot(*rest[six[:, :3]].mean(1)[:, :2].T) > 0.8
    used, rows = np.unique(np.concatenate([six[outside, :3].ravel(), six[~outside].ravel()]), return_inverse=True)
    linear, curved = rows[: 3 * outside.sum()].reshape(-1, 3), rows[3 * outside.sum() :].reshape(-1, 6)
    path = tmp_path / "in.vtu"
    meshio.Mesh(points[used], [("triangle", linear), ("triangle6", curved)]).write(path)
    done, mesh = improved(path, tmp_path / "out.vtu")
    assert [(b.type, len(b.data)) for b in mesh.cells] == [("triangle", outside.sum()), ("triangle6", (~outside).sum())]
    assert done.curved.all_inverted == 0
    assert (cm.jacobians(mesh.points, six_of(mesh)).min(1) > 0).all()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda six: six.__setitem__((0, 3), six[5, 4]), "mid-side node"),
        (lambda six: six.__setitem__((0, 3), six[7, 0]), "a corner of another|two mid-side nodes"),
    ],
)
def test_nodes_that_fit_no_edge_are_told(tmp_path, change, text):
    points, six = cm.annulus()
    change(six)
    path = cm.save(tmp_path / "in.vtu", points, six)
    with pytest.raises(InvalidMeshError, match=text) as caught:
        tm.read(path)
    assert str(path) in str(caught.value)


def test_triangles_of_other_orders_are_refused_by_name(tmp_path):
    path = tmp_path / "in.msh"
    meshio.Mesh(np.zeros((10, 3)), [("triangle10", np.arange(10)[None])]).write(path, file_format="gmsh")
    with pytest.raises(InvalidMeshError, match="triangle10 cells; of curved triangles those of six nodes"):
        tm.read(path)


def test_every_mesh_of_a_batch_has_the_result_that_it_has_alone(tmp_path):
    files = []
    for k, step in enumerate((0.3, 0.45)):
        files.append(cm.save(tmp_path / f"{k}.vtu", *cm.tangled_annulus(step)))
    together = improve_series([open_mesh(f) for f in files], tm.ImproveOptions())
    for file, one in zip(files, together, strict=True):
        (alone,) = improve_series([open_mesh(file)], tm.ImproveOptions())
        assert torch.equal(one.meshes[0].points, alone.meshes[0].points)
        assert torch.equal(one.meshes[0].triangles, alone.meshes[0].triangles)


def test_a_report_of_json_has_the_counts(tmp_path):
    path = cm.save(tmp_path / "in.vtu", *cm.tangled_annulus())
    record = Source.open(path).curved.to_dict()
    assert json.loads(json.dumps(record)) == record
    assert record["inverted_curved"] > 0
    assert record["minimum_scaled_jacobian"] < 0


def test_triangles_that_straight_sides_alone_mend_need_nothing_else(tmp_path):
    turn = np.pi / 4 * np.arange(8)
    points = np.concatenate([np.stack([np.cos(turn), np.sin(turn)], 1), [[0.05, 0.02], [0.3, -0.2]]])
    faces = np.array([(0, 1, 2), (2, 3, 4), (4, 5, 6), (6, 7, 0), (0, 2, 8), (2, 4, 8), (4, 6, 8), (6, 0, 9), (0, 8, 9),
                      (8, 6, 9)])  # fmt: skip
    points, six = cm.with_nodes(points, faces, circles=(1.0,))  # the sides from 0 to 2 and so on are arcs, too
    assert (cm.jacobians(points, six).min(1) < 0).sum() == 4
    done, mesh = improved(cm.save(tmp_path / "in.vtu", points, six), tmp_path / "out.vtu", topology="keep")
    assert done.curved.inverted == 0
    assert (cm.jacobians(mesh.points, six_of(mesh)).min(1) > 0).all()


def test_heights_of_terrain_with_six_nodes_are_read_by_quadratic_functions(tmp_path):
    points, six = cm.tangled_annulus()
    rest = cm.annulus()[0]
    points[:, 2] = 0.3 * rest[:, 0] ** 2
    path = cm.save(tmp_path / "in.vtu", points, six)
    done, mesh = improved(path, tmp_path / "out.vtu")
    assert done.curved.inverted == 0
    rim = np.isclose(np.hypot(*rest[:, :2].T), 1.0) | np.isclose(np.hypot(*rest[:, :2].T), 0.4)
    assert (mesh.points[rim] == points[rim]).all()
    assert np.ptp(mesh.points[:, 2]) <= np.ptp(points[:, 2]) + 0.05
