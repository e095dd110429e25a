"""The comparison with other tools runs, on meshes so small that its numbers mean nothing."""

import json

import pytest

from experiments.shared import clocks
from experiments.speed import compare


@pytest.mark.slow
def test_it_writes_table_record_and_plot(cache, tmp_path, capsys):
    pytest.importorskip("gmsh")
    arguments = ["--cache", cache, "--triangles", 300, 500, "--batch", 3, "--repeats", 1, "--out", tmp_path]
    assert compare.main(list(map(str, arguments))) == 0
    assert (tmp_path / "compare.md").read_text().strip() == capsys.readouterr().out.strip()
    rows = json.loads((tmp_path / "compare.json").read_text())["rows"]
    ours = [row for row in rows if row["tool"] == "torchmesh"]
    assert len(ours) == 7
    assert all(row["inverted"] > 0 and row["inverted_left"] == 0 for row in ours)
    assert {row["tool"] for row in rows} > {"torchmesh", "gmsh", "MFEM TMOP", "mouette"}
    assert all(row["seconds"] or row["note"] for row in rows)
    assert (tmp_path / "compare.png").read_bytes().startswith(b"\x89PNG")


def test_a_peer_that_is_slow_is_not_asked_again(cache):
    pytest.importorskip("gmsh")
    case, tired = compare.domains.case("bar", 300, 0, cache), set()
    assert {row.tool: row.seconds is not None for row in compare.compare(case, 1, 0.0, tired)}["gmsh"]
    assert "gmsh" in tired
    assert "torchmesh" not in tired
    again = {row.tool: row for row in compare.compare(case, 1, 0.0, tired)}
    assert again["gmsh"].seconds is None
    assert "too slow" in compare.table(list(again.values()))


def test_a_fresh_process_measures_import_and_first_call(cache):
    pytest.importorskip("gmsh")
    row = compare.first_call_row(compare.domains.case("bar", 300, 0, cache), 1)
    assert row.inverted_left == 0
    assert row.seconds > 0
    with pytest.raises(RuntimeError, match="no such thing"):
        clocks.in_fresh_process("raise SystemExit('no such thing')")
