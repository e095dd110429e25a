"""The run over ever harder tangles goes on where it was, and its tables count what is in the record."""

import json

import pytest

from experiments.robustness import never_give_up
from experiments.robustness.success import tables_of


@pytest.mark.slow
def test_the_run_goes_on_where_it_was(cache, tmp_path, monkeypatch):
    pytest.importorskip("gmsh")
    arguments = ["--triangles", "80", "--seeds", "1", "--ways", "ours", "--families", "scrambled",
                 "--cache", str(cache), "--out", str(tmp_path)]  # fmt: skip
    record = tmp_path / "never_give_up.jsonl"
    assert never_give_up.main(arguments) == 0
    lines = record.read_text().splitlines()
    assert len(lines) == 4
    assert all(json.loads(line)["valid"] for line in lines)
    assert (tmp_path / "never_give_up.png").read_bytes().startswith(b"\x89PNG")
    assert "| ours | 4 | 4 |" in (tmp_path / "never_give_up.md").read_text()
    monkeypatch.setattr(never_give_up, "draw", lambda *_: None)
    # As a run that was stopped leaves it.
    record.write_text("\n".join(lines[:-3]) + "\n")
    assert never_give_up.main(arguments) == 0
    assert record.read_text().splitlines()[: len(lines) - 3] == lines[:-3]
    assert len(record.read_text().splitlines()) == len(lines)
    # A result of ours that is not valid makes the run fail.
    bad = json.loads(lines[0]) | {"valid": False, "note": "1 triangles inverted or flat"}
    record.write_text("\n".join([json.dumps(bad), *lines[1:]]) + "\n")
    assert never_give_up.main(arguments) == 1


def test_a_way_that_fails_is_a_row(monkeypatch, cache):
    pytest.importorskip("gmsh")
    case = never_give_up.tangle("scrambled", 0, 80, 0.3, 0, cache)
    monkeypatch.setitem(never_give_up.WAYS, "gmsh", lambda mesh: 1 / 0)
    monkeypatch.setitem(never_give_up.WAYS, "Kim 2017", lambda mesh: mesh)
    assert never_give_up.measure(case, "gmsh")["note"].startswith("ZeroDivisionError")
    row = never_give_up.measure(case, "Kim 2017")
    assert not row["valid"]
    assert "inverted or flat" in row["note"]


def test_the_tables_count_each_family_and_size():
    row = {"way": "ours", "value": 1, "angle": 0.0, "grading": 0.3, "seed": 0, "seconds": 1.0, "max": 2.0}
    rows = [row | {"family": "moved", "triangles": 300, "valid": True, "mean": 1.1},
            row | {"family": "moved", "triangles": 1000, "valid": False, "mean": None},
            row | {"family": "wound", "triangles": 1000, "valid": True, "mean": 1.3}]  # fmt: skip
    first, second = (block.splitlines() for block in tables_of(rows).strip().split("\n\n"))
    assert first[2:] == ["| ours | 3 | 2 | 1.200 | 1.30 | 1.00 | 1.0 |"]
    found = dict(
        zip(*([c.strip() for c in line.strip("|").split("|")] for line in (second[0], second[2])), strict=True)
    )
    assert {k: v for k, v in found.items() if v} == {
        "valid": "ours", "moved": "1 of 2", "wound": "1 of 1", "300 triangles": "1 of 1", "1,000 triangles": "1 of 2"
    }  # fmt: skip
