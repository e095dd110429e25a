"""The experiments on hard tangles run, resume, and their random domains all come out valid."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from exact import inverted

import torchmesh as tm
from torchmesh.pockets import untangle_by_pockets

FOLDER = Path(__file__).parent.parent / "experiments"


@pytest.fixture
def fuzz(monkeypatch):
    monkeypatch.syspath_prepend(FOLDER)
    import fuzz

    return fuzz


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
            result = untangle_by_pockets(made[1], kept)
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
