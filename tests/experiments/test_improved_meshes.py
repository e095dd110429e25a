"""A small run of the experiment on quality prints its table, and its numbers are within the limits beside them."""

import pytest

from experiments.quality import improved_meshes


def test_a_run_prints_its_table(tmp_path, capsys):
    pytest.importorskip("gmsh")
    out = tmp_path / "table.md"
    assert improved_meshes.main(["--only", "gate, 0.3", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert out.read_text() == printed
    head, _, *rows = (line.strip("| ").split(" | ") for line in printed.strip().splitlines())
    assert [row[1] for row in rows] == ["flip", "full"]
    for row in (dict(zip(head, row, strict=True)) for row in rows):
        assert row["certified"] == "yes"
        ratio, least = (float(v.strip("()")) for v in row["maximum (limit)"].split())
        angle, most = (float(v.strip("()")) for v in row["minimum angle (limit)"].split())
        assert ratio >= least
        assert angle <= most
        assert 1 < float(row["IMR average"]) < ratio


def test_a_name_that_no_variant_has_is_refused(capsys):
    with pytest.raises(SystemExit) as stopped:
        improved_meshes.main(["--only", "square"])
    assert stopped.value.code == 2
    assert "square" in capsys.readouterr().err
