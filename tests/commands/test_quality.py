"""`torchmesh quality`: tables, JSON, and what it says of files that it cannot read."""

import json

import meshes
import meshio
import numpy as np
import pytest
from command_line import inverted

from torchmesh import metrics, quality, read, write


def test_quality_tables(call, folder):
    done = call("quality", "tangled.vtu", "better.vtu")
    assert (done.status, done.err) == (1, "")
    lines = [line.split() for line in done.out.splitlines()]
    mesh = read(folder / "tangled.vtu")
    row = next(line for line in lines if line[:1] == ["tangled.vtu"])
    assert row[1:3] == [str(len(mesh.triangles)), str(inverted(folder / "tangled.vtu"))]
    row = next(line for line in lines if line[:1] == ["better.vtu"])
    assert row[1:] == ["40", "0", "1.000", "1.000", "60.000"]
    assert "worst triangles of tangled.vtu" in done.out
    worst = [line for line in lines if line[-1:] == ["inverted"]]
    assert len(worst) == 10
    area = quality(mesh).area
    centroid = mesh.points[mesh.triangles[int(worst[0][0])]].mean(0).tolist()
    assert int(worst[0][0]) == int(area.argmin()), "the largest inverted triangle leads"
    assert [float(x) for x in worst[0][3:5]] == pytest.approx(centroid, rel=1e-5)


def test_quality_json(call, folder):
    done = call("quality", "tangled.vtu", "better.vtu", "--json", "--worst", 3)
    assert (done.status, done.err) == (1, "")
    tangled, better = json.loads(done.out, parse_constant=pytest.fail)
    keys = {"file", "triangles", "vertices", "inverted", "imr_average", "imr_maximum", "minimum_angle", "worst"}
    assert set(tangled) == set(better) == keys
    assert (tangled["file"], tangled["inverted"]) == ("tangled.vtu", inverted(folder / "tangled.vtu"))
    assert better["minimum_angle"] == pytest.approx(60)
    assert [len(r["worst"]) for r in (tangled, better)] == [3, 3]
    for worst in tangled["worst"]:
        assert set(worst) == {"row", "inverted", "imr", "area", "centroid"}
        assert worst["inverted"] is True
        assert worst["area"] < 0


def test_quality_metrics(call, folder):
    done = call("quality", "tangled.vtu", "better.vtu", "--metrics", "minimum_angle,edge_ratio", "--worst", 0)
    lines = [line.split() for line in done.out.splitlines()]
    assert ["metric", "min", "p5", "median", "p95", "max", "mean"] in lines
    assert ["minimum_angle", *["60.000"] * 6] in lines
    assert ["edge_ratio", *["1.000"] * 6] in lines
    done = call("quality", "tangled.vtu", "--metrics", "all", "--json")
    (record,) = json.loads(done.out, parse_constant=pytest.fail)
    assert list(record["metrics"]) == list(metrics.METRICS)
    assert record["metrics"]["inverse_mean_ratio"]["max"] == record["imr_maximum"]
    assert record["metrics"]["minimum_angle"]["min"] == pytest.approx(record["minimum_angle"], rel=1e-14)
    assert set(record["metrics"]["area"]) == {"min", "mean", "max", "p5", "p50", "p95"}


def test_quality_says_how_edges_follow_sizes(call, folder):
    lengths = {"boundary": 1.0, "uniform": 1.0, "0.5": 2.0}
    for sizes, mean in lengths.items():
        done = call("quality", "better.vtu", "--sizes", sizes, "--json")
        (record,) = json.loads(done.out)
        found = record["edge_length_over_size"]
        # Equilateral triangles of side 1; "uniform" knows the area only.
        assert found == {name: pytest.approx(mean, rel=1e-6) for name in ("mean", "p5", "p95")}
    done = call("quality", "better.vtu", "--sizes", 2, "--worst", 0)
    assert "edge length / size" in done.out
    assert "0.50 (0.50 - 0.50)" in done.out
    file = meshio.read(folder / "better.vtu")
    file.point_data["length"] = np.full(len(file.points), 4.0)
    file.write(folder / "sized.vtu")
    (record,) = json.loads(call("quality", "sized.vtu", "--sizes", "length", "--json").out)
    assert record["edge_length_over_size"]["mean"] == pytest.approx(0.25)
    for wrong, text in (("0", "must be a positive length"), ("nan", "positive length"), ("width", "nor a point field")):
        done = call("quality", "sized.vtu", "--sizes", wrong)
        assert done.status == 2
        assert text in done.err


def test_a_metric_that_does_not_exist_is_refused(call):
    done = call("quality", "better.vtu", "--metrics", "area,skew")
    assert (done.status, done.out) == (2, "")
    assert "error: --metrics: there is no 'skew'; there are all, area," in done.err


def test_worst_upright_triangles_follow_by_shape(call, folder):
    write(folder / "random.vtu", meshes.delaunay(60, seed=1))
    (record,) = json.loads(call("quality", "random.vtu", "--json").out)
    shapes = [w["imr"] for w in record["worst"]]
    assert shapes == sorted(shapes, reverse=True)
    assert shapes[0] == record["imr_maximum"]
    assert len(shapes) == 10


def test_a_flat_triangle_is_null_in_json(call, folder):
    mesh = meshio.Mesh([[0, 0], [1, 0], [2, 0], [1, 1.0]], [("triangle", [[0, 1, 2], [0, 2, 3]])])
    mesh.write(folder / "flat.vtu")
    done = call("quality", "flat.vtu", "--json")
    (record,) = json.loads(done.out, parse_constant=pytest.fail)
    assert record["imr_maximum"] is None
    assert record["inverted"] == 1
    assert done.status == 1
    assert "inf" in call("quality", "flat.vtu").out


def test_quality_of_a_plane_in_space_gives_places_in_space(call, folder):
    points, triangles = meshes.grid_arrays(3, 3)
    upright = np.pad(points, ((0, 0), (1, 0)), constant_values=7.0)
    meshio.Mesh(upright, [("triangle", triangles)]).write(folder / "wall.vtu")
    (record,) = json.loads(call("quality", "wall.vtu", "--json", "--worst", 1).out)
    worst = record["worst"][0]
    assert worst["centroid"] == pytest.approx(upright[triangles[worst["row"]]].mean(0).tolist())


def test_quality_goes_on_after_a_bad_file(call):
    done = call("quality", "missing.vtu", "better.vtu", "empty.vtu")
    assert done.status == 2
    assert [line.split(":")[:2] for line in done.err.splitlines()] == [
        ["error", " missing.vtu"],
        ["error", " empty.vtu"],
    ]
    assert "better.vtu" in done.out


def test_a_folded_quad_is_inverted_and_decides_the_exit_status(call):
    done = call("quality", "folded.vtk", "--json")
    (record,) = json.loads(done.out)
    assert done.status == 1
    assert (record["inverted"], record["quads"], record["inverted_quads"]) == (0, 1, 1)
    assert record["rows_of_inverted_quads"] == [0]
    done = call("quality", "folded.vtk")
    assert done.status == 1
    assert "inverted quads of folded.vtk: rows 0" in done.out
