"""The example of a graph network runs, and the layer's outputs are valid."""

import csv

import pytest

from experiments.learning import gnn_example


@pytest.mark.slow
def test_it_trains_validates_and_counts(tmp_path, capsys):
    pytest.importorskip("torch_geometric")
    pytest.importorskip("matplotlib")
    arguments = ["--epochs", "1", "--meshes", "6", "--triangles", "120", "--batch", "3", "--out", str(tmp_path)]
    assert gnn_example.main(arguments) == 0
    with open(tmp_path / "gnn.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(r["way"], r["epoch"]) for r in rows] == [(way, str(e)) for way in gnn_example.WAYS for e in (0, 1)]
    assert all(float(r["tangled"]) == 0 for r in rows if r["way"] == "the layer")
    assert {"gnn.png", "gnn.md", "gnn.run.json"} <= {p.name for p in tmp_path.iterdir()}
    assert "| no guard |" in capsys.readouterr().out
