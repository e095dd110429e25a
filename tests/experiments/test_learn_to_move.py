"""The experiment trains its network all three ways and writes what it found."""

import json

import pytest

from experiments.learning import learn_to_move


@pytest.mark.slow
def test_it_learns_three_ways(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    options = ["--steps", "3", "--meshes", "8", "--triangles", "100", "--batch", "2", "--out", str(tmp_path)]
    assert learn_to_move.main(options) == 0
    record = json.loads((tmp_path / "learn.json").read_text())
    assert [row["way"] for row in record["last"]] == ["no guard", "untangle loss", "layer"]
    assert record["last"][2]["tangled"] == 0
    assert (tmp_path / "learn.md").read_text() == capsys.readouterr().out
    assert (tmp_path / "learn.png").read_bytes().startswith(b"\x89PNG")
