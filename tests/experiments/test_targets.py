"""The speed targets are measured, on meshes so small that their numbers mean nothing."""

import json
import math

import pytest

from experiments.speed import targets
from experiments.speed.target_rows import ratio_row
from torchmesh.bench.stopwatch import Seconds

TINY = ["--small", "150", "--medium", "200", "--large", "300", "--meshes", "2", "--repeats", "1"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("target", "needs"), [(1, ["gmsh"]), (4, ["gmsh", "numba"]), (5, ["gmsh", "igl"]), (6, ["gmsh"]), (7, ["gmsh"])]
)
def test_a_target_is_measured(cache, tmp_path, capsys, target, needs):
    for module in needs:
        pytest.importorskip(module)
    out = tmp_path / "rows.json"
    assert targets.main(["--cache", str(cache), "--only", str(target), *TINY, "--out", str(out)]) == 0
    assert f"| T{target} |" in capsys.readouterr().out
    rows = json.loads(out.read_text())["rows"]
    # The time of an iteration is a difference, which may be negative on meshes so small.
    assert all(row["target"] == target and math.isfinite(row["ratio"]) for row in rows)
    assert all(row["goal"] is None or row["goal"] > 0 for row in rows)
    assert any(row["goal"] for row in rows)


def test_a_target_is_met_by_the_wall_ratio_and_good_meshes():
    ratio = Seconds(2.0, 9.0).over(Seconds(4.0, 3.0))
    assert ratio == Seconds(0.5, 3.0)
    assert ratio_row(1, "", ratio, 0.5, []).met
    assert not ratio_row(1, "", ratio, 0.4, []).met
    assert not ratio_row(1, "", ratio, 0.5, [], good=False).met
    assert "**no**" in targets.table([ratio_row(1, "", ratio, 0.4, [])])


def test_a_missing_peer_is_a_row(monkeypatch):
    def missing(setting):
        raise targets.peers.Missing("not installed")

    monkeypatch.setitem(targets.TARGETS, 3, missing)
    (row,) = targets.measured(3, None)
    assert row.ratio is None
    assert row.what == "not installed"
