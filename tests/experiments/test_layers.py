"""The ways of the experiment on layers do what their names say, on a small airfoil."""

import numpy as np
import pytest
import torch

import torchmesh as tm
from experiments.quality import layers


@pytest.fixture
def small(monkeypatch) -> tm.MeshBatch:
    for name, value in (("SIDES", 32), ("ROWS", 6), ("OUTER", 8)):
        monkeypatch.setattr(layers, name, value)
    return layers.airfoil(1e-3)


def test_the_mesh_is_valid_and_has_the_heights_asked_for(small):
    assert int(tm.quality(small).inverted[0]) == 0
    assert np.median(layers.first_heights(small)) == pytest.approx(1e-3, rel=0.1)


@pytest.mark.parametrize(
    ("way", "matrix"), [("elasticity", [[1.0, 0.2], [-0.2, 1.0]]), ("rbf", [[1.1, 0.2], [-0.1, 0.9]])]
)
def test_other_ways_carry_the_motions_that_they_reproduce(small, way, matrix):
    """Splines any linear motion; elasticity, whose stiffness varies, those without strain."""
    goal = small.points @ torch.tensor(matrix, dtype=torch.float64).T + 0.3
    moved = small.with_points(torch.where(small.fixed[:, None], goal, small.points))
    assert torch.allclose(layers.WAYS[way](small, moved).points, goal, atol=1e-8)


def test_the_table_says_that_ours_keeps_the_layers(small, monkeypatch, capsys):
    monkeypatch.setattr(layers, "WAYS", {name: layers.WAYS[name] for name in ("deform", "femwarp")})
    assert layers.main(["--first", "1e-3", "--degrees", "10"]) == 0
    lines = [line.split(" | ") for line in capsys.readouterr().out.splitlines()]
    assert lines[2][2:6] == ["deform", "0", "100 %", "1 - 1"]
    assert lines[3][2] == "femwarp"
