"""The PDE experiment solves what it says, and writes its table and plot."""

import csv
import itertools
import math

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm

K = 2 * math.pi


@pytest.fixture
def poisson():
    pytest.importorskip("skfem")
    from experiments.quality import poisson

    return poisson


def test_errors_fall_with_the_orders_of_linear_elements(poisson):
    found = [poisson.solve(*meshes.grid_arrays(n, n), K) for n in (8, 16, 32)]
    for coarse, fine in itertools.pairwise(found):
        # Asymptotically 4, 2, 4 and 2 (any finite element text; Strang & Fix 1973).
        assert coarse.l2_error / fine.l2_error == pytest.approx(4, rel=0.15)
        assert coarse.h1_error / fine.h1_error == pytest.approx(2, rel=0.1)
        assert fine.condition / coarse.condition == pytest.approx(4, rel=0.1)
        assert fine.cg / coarse.cg > 1.5


def test_the_condition_number_is_that_of_the_five_point_stencil(poisson):
    # Right triangles of a square grid assemble to it: eigenvalues 4 - 2 cos(i pi / n) - 2 cos(j pi / n).
    expected = 1 / math.tan(math.pi / 20) ** 2
    assert poisson.solve(*meshes.grid_arrays(10, 10), K).condition == pytest.approx(expected, rel=1e-10)


def test_a_worse_mesh_is_worse_to_solve_on(poisson):
    good, bad = meshes.grid(12, 12), meshes.jittered(12, 12, 0.22, 5)
    assert int(tm.quality(bad).inverted) == 0
    one, two = (poisson.solve(m.points.numpy(), m.triangles.numpy(), K) for m in (good, bad))
    assert two.condition > 1.2 * one.condition
    assert two.h1_error > one.h1_error


@pytest.mark.slow
def test_table_and_plot_are_written(poisson, monkeypatch, tmp_path, capsys):
    mesh = tm.MeshBatch.from_arrays(*meshes.holed_arrays())
    on_hole = (mesh.points - torch.tensor([4.0, 5.0])).norm(dim=1) < 1.1
    step = on_hole[:, None] * torch.tensor([5.0, 0.0], dtype=torch.float64)
    pair = mesh, tm.femwarp(mesh, mesh.points + step)
    monkeypatch.setattr(poisson, "domains", lambda: {"hole": pair, "other": pair})
    assert poisson.main(["--out", str(tmp_path / "out"), "--only", "hole"]) == 0
    rows = list(csv.DictReader((tmp_path / "out" / "poisson.csv").read_text().splitlines()))
    assert [r["mesh"] for r in rows] == ["undeformed", *poisson.METHODS]
    for row in rows:
        solved = int(row["inverted"]) == 0
        assert np.isfinite([float(row[name]) for name in ("condition", "cg", "l2_error", "h1_error")]).all() == solved
    assert next(r for r in rows if r["mesh"] == "default")["inverted"] == "0"
    table = (tmp_path / "out" / "poisson.md").read_text()
    assert table == capsys.readouterr().out
    assert table.count("| hole |") == len(rows)
    assert (tmp_path / "out" / "poisson.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(SystemExit):
        poisson.main(["--out", str(tmp_path), "--only", "nothing"])
    assert "there are hole, other" in capsys.readouterr().err
