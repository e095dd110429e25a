"""The experiment on quality: its limits of the boundary hold, and a small run prints its table."""

import itertools
import math
from pathlib import Path

import meshes
import pytest
import torch
from typer.testing import CliRunner

import torchmesh as tm

FOLDER = Path(__file__).parents[2] / "experiments"


@pytest.fixture
def experiment(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    import quality

    return quality


def test_limits_of_known_boundaries(experiment):
    square = experiment.boundary_limits(meshes.grid(4, 4))
    # Two triangles in each corner, of 45 degrees between equal sides.
    assert square.angle == pytest.approx(45, abs=1e-9)
    t = math.pi / 4
    assert square.ratio == pytest.approx((2 - math.cos(t)) / (math.sqrt(3) * math.sin(t)), rel=1e-12)
    hexagon = experiment.boundary_limits(meshes.disc(6, 1))
    assert hexagon.angle == pytest.approx(60, abs=1e-6)
    assert hexagon.ratio == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_no_mesh_passes_the_limit_of_its_boundary(experiment, seed):
    mesh = meshes.delaunay(40, seed) if seed % 2 else meshes.disturbed(meshes.l_shape(4), 0.02, seed)
    limits = experiment.boundary_limits(mesh)
    assert float(tm.quality(mesh).max) >= limits.ratio * (1 - 1e-12)
    assert float(tm.minimum_angle(mesh)) <= limits.angle + 1e-9


def test_a_fan_of_equal_triangles_reaches_the_limit(experiment):
    # Three triangles of one shape in a corner between sides of lengths 1 and 6.
    turn, length = math.pi / 2 * torch.arange(4) / 3, 6 ** (torch.arange(4) / 3)
    rim = torch.stack([length * turn.cos(), length * turn.sin()], 1)
    fan = tm.MeshBatch.from_arrays(torch.cat([torch.zeros(1, 2), rim]).double(), [[0, 1, 2], [0, 2, 3], [0, 3, 4]])
    angle = math.degrees(math.atan2(math.sin(math.pi / 6), 6 ** (1 / 3) - math.cos(math.pi / 6)))
    # Rounding of single precision, in which the corners were made.
    assert float(tm.minimum_angle(fan)) == pytest.approx(angle, rel=1e-5)
    assert experiment.boundary_limits(fan).angle <= angle + 1e-4


def test_a_seed_draws_the_same_variants_each_time(experiment):
    assert list(experiment.drawn(3)) == list(experiment.drawn(3))
    kinds = [{name.split(",")[0].split(" of ")[0].split(" at ")[0] for name in experiment.drawn(s)} for s in range(3)]
    for names in kinds:
        for kind in ("holes", "bar", "gate", "airfoil", "cylinder"):
            assert any(kind in name for name in names), (kind, names)
    assert all(experiment.drawn(a).keys() != experiment.drawn(b).keys() for a, b in itertools.combinations(range(3), 2))


def test_a_run_prints_its_table(experiment, tmp_path):
    pytest.importorskip("gmsh")
    out = tmp_path / "table.md"
    done = CliRunner().invoke(experiment.app, ["--only", "gate, 0.3", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert out.read_text().strip() == done.stdout.strip()
    head, _, *rows = (line.strip("| ").split(" | ") for line in done.stdout.strip().splitlines())
    assert [row[1] for row in rows] == ["flip", "full"]
    for row in (dict(zip(head, row, strict=True)) for row in rows):
        assert row["certified"] == "yes"
        ratio, least = (float(v.strip("()")) for v in row["maximum (limit)"].split())
        angle, most = (float(v.strip("()")) for v in row["minimum angle (limit)"].split())
        assert ratio >= least
        assert angle <= most
        assert 1 < float(row["IMR average"]) < ratio


def test_a_name_that_no_variant_has_is_refused(experiment):
    done = CliRunner().invoke(experiment.app, ["--only", "square"])
    assert done.exit_code == 2
    assert "square" in done.output
