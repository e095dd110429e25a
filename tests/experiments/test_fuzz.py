"""The random domains of the fuzz test all come out valid, or are refused because no valid mesh exists."""

import pytest
import torch
from exact import inverted

import torchmesh as tm
from experiments.robustness import fuzz
from torchmesh.untangling.retriangulation import untangle_by_retriangulation


@pytest.fixture(scope="module")
def made():
    return [case for case in map(fuzz.case, range(60)) if case is not None]


@pytest.mark.slow
def test_random_domains_with_their_vertices_anywhere_come_out_valid_or_are_refused_rightly(made):
    assert len(made) > 40
    assert len([mesh for _, mesh in made if len(mesh.constrained_edges)]) > 10
    after, report = tm.improve(tm.join([tangled for _, tangled in made]))
    valid = 0
    for b, mesh in enumerate(after.split()):
        if report.status[b] in (tm.Status.INFEASIBLE, tm.Status.PARTLY):
            assert tm.diagnose(made[b][1])
        else:
            assert inverted(mesh) == 0, b
            assert bool(report.certified[b]), b
            valid += 1
    assert valid > 35


def test_retriangulation_alone_repairs_random_domains():
    repaired = 0
    for seed in range(100, 130):
        made = fuzz.case(seed)
        if made is None or tm.diagnose(made[1]):
            continue
        keep = torch.rand(len(made[1].points), generator=torch.Generator().manual_seed(seed)) < 0.5
        for kept in (None, keep):
            result = untangle_by_retriangulation(made[1], kept)
            assert result.ok, (seed, result.reason)
            assert inverted(result.mesh) == 0
        repaired += 1
    assert repaired > 15


def test_a_run_counts_its_meshes_and_judges_them(capsys, monkeypatch):
    assert fuzz.main(["--count", "2", "--seed", "3"]) == 0
    assert "meshes, 0 failed" in capsys.readouterr().out
    monkeypatch.setattr(fuzz, "judge", lambda *_: "wrong")
    assert fuzz.main(["--count", "2", "--seed", "3"]) == 1
    assert "seed 3: wrong" in capsys.readouterr().out


def test_the_judge_sees_a_moved_vertex_and_a_false_report():
    _, tangled = next(case for case in map(fuzz.case, range(60)) if case is not None and not tm.diagnose(case[1]))
    options = tm.ImproveOptions()
    after, report = tm.improve(tangled, options)
    assert fuzz.judge(tangled, after, report, options) == ""
    assert "said to be valid" in fuzz.judge(tangled, tangled, report, options)
    held = int(tangled.fixed.nonzero()[0])
    elsewhere = tangled.points.clone()
    elsewhere[held] += 1e-3 * (tangled.points.amax() - tangled.points.amin())
    assert fuzz.judge(tangled.with_points(elsewhere), after, report, options) == "a fixed vertex moved or is gone"
