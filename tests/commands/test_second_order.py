"""Six-node triangles on the command line: counts, exit statuses, motions of curved parts."""

import json
import re

import curved_meshes as cm
import meshio
import numpy as np
import pytest


def test_quality_counts_inverted_curved_triangles_and_decides_the_exit_status(call, folder):
    points, six = cm.annulus(around=16)
    cm.save(folder / "ring.vtu", points, six)
    done = call("quality", "ring.vtu", "--json")
    (record,) = json.loads(done.out)
    assert done.status == 0
    assert (record["curved"], record["inverted_curved"], record["inverted"]) == (len(six), 0, 0)
    assert record["minimum_scaled_jacobian"] > 0.3
    inner = next(m for e, m in cm.edges(six).items() if e not in cm.boundary(six))
    points[inner, :2] *= 1.4  # straight triangles know nothing of it
    cm.save(folder / "bad.vtu", points, six)
    wrong = (cm.jacobians(points, six).min(1) <= 0).nonzero()[0].tolist()
    assert wrong
    done = call("quality", "bad.vtu", "--json", "--worst", len(wrong))
    (record,) = json.loads(done.out)
    assert done.status == 1
    assert record["inverted"] == record["inverted_curved"] == len(wrong)
    assert record["rows_of_inverted_curved"] == wrong
    assert sorted(w["row"] for w in record["worst"]) == wrong
    assert record["minimum_scaled_jacobian"] < 0
    assert "minimum scaled Jacobian" in call("quality", "bad.vtu").out


def test_improve_mends_curved_triangles_and_its_report_says_so(call, folder):
    points, six = cm.tangled_annulus()
    cm.save(folder / "in.vtu", points, six)
    done = call("improve", "in.vtu", "out.vtu", "--report", "report.json")
    assert done.status == 0, done.err
    record = json.loads((folder / "report.json").read_text())
    assert record["before"]["inverted_curved"] > 0
    assert record["after"]["inverted_curved"] == 0
    assert record["valid"]
    assert "minimum scaled Jacobian" in done.out
    assert call("quality", "out.vtu").status == 0
    assert call("report", "in.vtu", "out.vtu", "page.html").status == 0


def test_what_cannot_be_mended_is_said_with_status_1(call, folder, inline):
    # One triangle, whose curved side reaches through the opposite corner: every node lies on the boundary.
    points = np.array([[0, 0, 0], [1, 0, 0], [0.5, 0.5, 0], [0.5, 0.9, 0], [0.75, 0.25, 0], [0.25, 0.25, 0.0]])
    cm.save(folder / "one.vtu", points, np.arange(6)[None])
    done = call("improve", "one.vtu", "out.vtu", "--report", "report.json")
    assert done.status == 1
    assert "1 inverted six-node triangle in out.vtu" in done.err
    assert not json.loads((folder / "report.json").read_text())["valid"]
    assert (meshio.read(folder / "out.vtu").points == points).all()
    (folder / "in" / "one.vtu").write_bytes((folder / "one.vtu").read_bytes())
    assert call("batch", "in", "--out", "done").status == 1


def test_warp_moves_the_nodes_of_a_hole_as_it_moves_the_hole(call, folder):
    points, six = cm.annulus(around=16)
    cm.save(folder / "ring.vtu", points, six)
    hole = np.isclose(np.hypot(*points[:, :2].T), 0.4)
    rim = np.isclose(np.hypot(*points[:, :2].T), 1.0)
    assert call("warp", "ring.vtu", "out.vtu", "--move", "hole:1:0.1,0.05").status == 0
    after = meshio.read(folder / "out.vtu").points
    np.testing.assert_allclose(after[hole], points[hole] + [0.1, 0.05, 0], rtol=0, atol=1e-14)
    assert (after[rim] == points[rim]).all()
    for steps in ([], ["--steps", "auto"]):
        assert call("warp", "ring.vtu", "out.vtu", "--rotate", "hole:1:25", *steps).status == 0
        mesh = meshio.read(folder / "out.vtu")
        turn = np.radians(25)
        x, y = points[hole, :2].T
        expected = np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y], 1)
        np.testing.assert_allclose(mesh.points[hole, :2], expected, rtol=0, atol=1e-13)
        assert (cm.jacobians(mesh.points, mesh.cells_dict["triangle6"]).min(1) > 0).all()
    assert call("warp", "ring.vtu", "out.vtu", "--move", "hole:1:0.45,0", "--improve").status == 0
    mesh = meshio.read(folder / "out.vtu")
    assert (cm.jacobians(mesh.points, mesh.cells_dict["triangle6"]).min(1) > 0).all()
    np.testing.assert_allclose(mesh.points[hole], points[hole] + [0.45, 0, 0], rtol=0, atol=1e-14)


def test_warp_by_a_field_moves_nodes_of_the_boundary_by_their_own_values(call, folder):
    points, six = cm.annulus(around=16)
    radius = np.hypot(*points[:, :2].T)
    field = np.where(np.isclose(radius, 0.4)[:, None], 0.1 * points, 0.0)
    cm.save(folder / "ring.vtu", points, six, point_data={"displacement": field})
    assert call("warp", "ring.vtu", "out.vtu", "--displacement", "displacement").status == 0
    mesh = meshio.read(folder / "out.vtu")
    on = np.isclose(radius, 0.4)
    np.testing.assert_allclose(mesh.points[on], 1.1 * points[on], rtol=0, atol=1e-15)


def test_a_file_of_quads_alone_is_measured_and_improved_in_plan(call, folder):
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(0, 1, 6), np.linspace(0, 1, 6)))
    points = np.stack([x, y, np.sin(3 * x)], 1)
    points[14, :2] += [0.25, 0.2]
    corner = (np.arange(5)[:, None] * 6 + np.arange(5)).ravel()
    quads = np.stack([corner, corner + 1, corner + 7, corner + 6], 1)
    meshio.Mesh(points, [("quad", quads)]).write(folder / "bed.vtu")
    assert call("quality", "bed.vtu").status == 1
    assert call("improve", "bed.vtu", "out.vtu").status == 0
    assert call("quality", "out.vtu").status == 0
    after = meshio.read(folder / "out.vtu").points
    rim = (x == 0) | (x == 1) | (y == 0) | (y == 1)
    assert (after[rim] == points[rim]).all()
    assert points[:, 2].min() <= after[14, 2] <= points[:, 2].max()
    assert (after[14, :2] != points[14, :2]).any()


def test_commands_draw_the_curves(call, folder):
    pytest.importorskip("matplotlib")
    points, six = cm.tangled_annulus(0.3, around=10)
    meshio.Mesh(points, [("triangle6", six)]).write(folder / "ring.vtu")
    done = call("report", "ring.vtu", "out.vtu", "page.html")
    assert (done.status, done.err) == (0, ""), "the file after is valid, whatever that before was"
    page = (folder / "page.html").read_text()
    stages = json.loads(re.search(r'<script[^>]*id="header"[^>]*>(.*?)</script>', page, re.S)[1])["stages"]
    assert stages[0]["curves"] == stages[-1]["curves"] == 20
    assert call("improve", "ring.vtu", "b.vtu", "--plot", "p.svg").status == 0
    assert (folder / "p.svg").stat().st_size > 10_000


def test_values_at_mid_side_nodes_ride_with_the_boundary_in_steps(call, folder):
    points, six = cm.annulus(around=16, layers=4)
    cm.save(folder / "ring.vtu", points, six, point_data={"x": points[:, 0].copy()})
    done = call("warp", "ring.vtu", "out.vtu", "--move", "outer:1:1,0", "--move", "hole:1:1,0", "--steps", "auto")
    assert (done.status, done.err) == (0, "")
    made = meshio.read(folder / "out.vtu")
    assert np.abs(made.points[:, :2] - points[:, :2] - [1, 0]).max() > 1e-3, "vertices were smoothed"
    assert np.abs(made.point_data["x"] - (made.points[:, 0] - 1)).max() < 1e-3
