"""The experiments on hard tangles run, resume, and their random domains all come out valid."""

import json
import subprocess
import sys
from pathlib import Path

import meshes
import pytest
import torch
from exact import inverted

import torchmesh as tm
from torchmesh.untangling.retriangulation import untangle_by_retriangulation

FOLDER = Path(__file__).parents[2] / "experiments"


@pytest.fixture
def fuzz(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    import fuzz

    return fuzz


@pytest.fixture
def validity(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    import validity

    return validity


def test_the_independent_check_finds_every_fault(validity):
    mesh = meshes.grid(4, 4)
    free = int((~mesh.fixed).nonzero()[0])
    assert validity.faults(mesh, mesh) == []

    def with_point(row, x, y):
        points = mesh.points.clone()
        points[row] = torch.tensor([x, y])
        return mesh.with_points(points)

    assert "inverted or flat" in validity.faults(mesh, with_point(free, 2.0, 2.0))[0]
    assert "fixed vertices have moved" in validity.faults(mesh, with_point(0, -0.1, 0.0))
    flat = mesh.points.clone()
    flat[mesh.triangles[0, 2]] = 0.5 * (flat[mesh.triangles[0, 0]] + flat[mesh.triangles[0, 1]])
    assert validity.inverted(flat.numpy(), mesh.triangles.numpy()[:1]) == 1
    fewer = tm.MeshBatch.from_arrays(mesh.points, mesh.triangles[1:], mesh.fixed)
    assert validity.faults(mesh, fewer) == ["another boundary", "another Euler number"]
    twice = torch.cat([mesh.triangles, mesh.triangles[:1]]).numpy()
    assert max(validity.directed(twice).values()) == 2


def test_the_exact_check_sees_what_floating_point_does_not(validity):
    # The determinant is 2^-60 relative to its products: exactly positive one way round, negative the other.
    points = torch.tensor([[0.0, 0.0], [1.0, 1.0], [1 + 2**-30, 1 + 2**-30 + 2**-52]], dtype=torch.float64).numpy()
    assert validity.inverted(points, torch.tensor([[0, 1, 2]]).numpy()) == 0
    assert validity.inverted(points, torch.tensor([[0, 2, 1]]).numpy()) == 1


@pytest.mark.parametrize("family", ["moved", "turned", "jittered", "scrambled", "mapped", "wound"])
def test_every_family_tangles_and_keeps_its_boundary_simple(family, monkeypatch, tmp_path):
    pytest.importorskip("gmsh")
    monkeypatch.syspath_prepend(FOLDER)
    import tangles

    kind = tangles.FAMILIES[family]
    value = kind.values[len(kind.values) // 2]
    case = tangles.tangle(family, value, 300, 0.3, 0, tmp_path, angle=90.0 if kind.turns else 0.0)
    assert int(tm.quality(case.undeformed).inverted) == 0
    assert int(tm.quality(case.tangled).inverted) > 0
    assert tangles.simple(case.tangled)
    crossed = case.tangled.points.clone()
    rim = case.tangled.fixed.nonzero().squeeze(1)
    crossed[rim[0]], crossed[rim[len(rim) // 2]] = case.tangled.points[rim[len(rim) // 2]], case.tangled.points[rim[0]]
    assert not tangles.simple(case.tangled.with_points(crossed))


def test_random_domains_with_their_vertices_anywhere_come_out_valid_or_are_refused_rightly(fuzz):
    made = [case for case in map(fuzz.case, range(60)) if case is not None]
    assert len(made) > 40
    holes = [m for _, m in made if len(m.constrained_edges)]
    assert len(holes) > 10
    after, report = tm.improve(tm.join([tangled for _, tangled in made]))
    for b, mesh in enumerate(after.split()):
        if report.status[b] == tm.Status.INFEASIBLE:
            assert tm.diagnose(made[b][1])
        else:
            assert inverted(mesh) == 0, b
            assert bool(report.certified[b]), b


def test_pockets_alone_repair_random_domains(fuzz):
    for seed in range(100, 130):
        made = fuzz.case(seed)
        if made is None or tm.diagnose(made[1]):
            continue
        keep = torch.rand(len(made[1].points), generator=torch.Generator().manual_seed(seed)) < 0.5
        for kept in (None, keep):
            result = untangle_by_retriangulation(made[1], kept)
            assert result.ok, (seed, result.reason)
            assert inverted(result.mesh) == 0


def test_the_experiment_goes_on_where_it_was(tmp_path):
    pytest.importorskip("gmsh")
    command = [sys.executable, str(FOLDER / "never_give_up.py"), "--triangles", "80", "--seeds", "1", "--ways", "ours",
               "--families", "scrambled",
               "--cache", str(tmp_path / "cache"), "--out", str(tmp_path)]  # fmt: skip
    record = tmp_path / "never_give_up.jsonl"
    first = subprocess.run(command, capture_output=True, text=True)
    assert first.returncode == 0, first.stderr
    lines = record.read_text().splitlines()
    assert all(json.loads(line)["valid"] for line in lines)
    assert (tmp_path / "never_give_up.png").read_bytes().startswith(b"\x89PNG")
    # As a run that was stopped leaves it.
    record.write_text("\n".join(lines[:-3]) + "\n")
    again = subprocess.run(command, capture_output=True, text=True)
    assert again.returncode == 0, again.stderr
    assert record.read_text().splitlines()[: len(lines) - 3] == lines[:-3]
    assert len(record.read_text().splitlines()) == len(lines)
