"""The benchmark scripts run, on meshes so small that their numbers mean nothing, and their yardsticks are right."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from meshes import delaunay, disturbed, grid

from torchmesh.mesh.triangle import corners, inverse_mean_ratio

SCRIPTS = Path(__file__).parents[2] / "experiments" / "benchmarks"
TINY = ["--small", "300", "--medium", "500", "--large", "800", "--meshes", "3", "--repeats", "1"]


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def references(monkeypatch):
    monkeypatch.syspath_prepend(SCRIPTS)
    import references

    return references


def run(script: str, *arguments: object) -> str:
    command = [sys.executable, str(SCRIPTS / script), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_compare_writes_table_record_and_plot(cache, tmp_path):
    pytest.importorskip("gmsh")
    printed = run("compare.py", "--cache", cache, "--triangles", 300, "--triangles", 500, "--batch", 3,
                  "--repeats", 1, "--out", tmp_path)  # fmt: skip
    assert (tmp_path / "compare.md").read_text().strip() == printed.strip()
    rows = json.loads((tmp_path / "compare.json").read_text())["rows"]
    ours = [row for row in rows if row["tool"] == "torchmesh"]
    assert len(ours) == 7
    assert all(row["inverted"] > 0 and row["inverted_left"] == 0 for row in ours)
    assert {row["tool"] for row in rows} > {"torchmesh", "gmsh", "MFEM TMOP", "mouette"}
    assert (tmp_path / "compare.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("target", "needs"), [(1, ["gmsh"]), (4, ["gmsh", "numba"]), (5, ["gmsh", "igl"]), (7, ["gmsh"])]
)
def test_a_target_is_measured(cache, tmp_path, target, needs):
    for module in needs:
        pytest.importorskip(module)
    printed = run("targets.py", "--cache", cache, "--only", target, *TINY, "--out", tmp_path / "rows.json")
    assert f"| T{target} |" in printed
    rows = json.loads((tmp_path / "rows.json").read_text())["rows"]
    assert all(row["target"] == target and row["ratio"] > 0 for row in rows)
    assert all(row["goal"] is None or row["goal"] > 0 for row in rows)
    assert any(row["goal"] for row in rows)


def test_the_serial_loop_is_the_smoothers_energy(references):
    pytest.importorskip("numba")
    mesh = disturbed(grid(), 0.01, 1)
    points = mesh.points.clone().requires_grad_()
    expected = inverse_mean_ratio(corners(points, mesh.triangles)).square().sum()
    expected.backward()
    gradient = np.empty((len(points), 2))
    energy = references.serial_energy()(mesh.points.numpy(), mesh.triangles.numpy(), gradient)
    # Sums of some sixty terms of order one, in another order.
    assert energy == pytest.approx(float(expected.detach()), rel=1e-13)
    torch.testing.assert_close(torch.from_numpy(gradient), points.grad, rtol=1e-11, atol=1e-11)


def test_the_delaunay_check_counts_the_wrong_edges(references):
    mesh = delaunay(60)
    points, triangles = mesh.points.numpy(), mesh.triangles.numpy()
    assert references.not_delaunay(points, triangles) == 0
    thin = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 0.5], [1.0, -0.5]])
    assert references.not_delaunay(thin, np.array([[0, 1, 2], [1, 0, 3]])) == 1
    assert references.not_delaunay(thin, np.array([[0, 3, 2], [3, 1, 2]])) == 0


def test_the_delaunay_check_is_exact_on_a_circle(references):
    # The corners of a square are on one circle: neither diagonal is wrong, until one corner moves in by one bit.
    square = 1e6 + np.array([[0.0, 0.0], [0.125, 0.0], [0.125, 0.125], [0.0, 0.125]])
    across = np.array([[0, 1, 3], [1, 2, 3]])
    assert references.not_delaunay(square, across) == 0
    square[2, 0] -= 2**-33
    assert references.not_delaunay(square, across) == 1


def test_the_delaunay_check_refuses_what_is_no_mesh(references):
    with pytest.raises(ValueError, match="the same way"):
        references.interior_edges(np.array([[0, 1, 2], [0, 1, 3]]))
    with pytest.raises(ValueError, match="three triangles"):
        references.interior_edges(np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]]))
