"""The manifest: what is written comes back, whatever was cut off, and the table holds the same."""

import json
import math
import os
import sys

import pytest

from torchmesh.batches import manifest
from torchmesh.batches.manifest import FileResult
from torchmesh.errors import MissingDependencyError

GOOD = FileResult("a/x.vtu", "in/a/x.vtu", "out/a/x.vtu", "settled", True, imr_maximum_before=math.inf, warnings=["w"])
BAD = FileResult("b/ü.vtu", "in/b/ü.vtu", error='it says "no"\n')


def test_a_record_comes_back(tmp_path):
    with manifest.Journal(tmp_path) as journal:
        journal.add(GOOD)
        journal.add(BAD)
    lines = (tmp_path / manifest.LINES).read_text().splitlines()
    assert [json.loads(line)["name"] for line in lines] == ["a/x.vtu", "b/ü.vtu"]
    assert json.loads(lines[0])["imr_maximum_before"] is None
    loaded = manifest.load(tmp_path)
    assert loaded["b/ü.vtu"].error == BAD.error
    assert loaded["a/x.vtu"].resumed
    assert loaded["a/x.vtu"].record() == GOOD.record()


@pytest.mark.parametrize("cut", [1, 20, 200])
def test_a_torn_last_line_is_passed_over_and_the_next_begins_anew(tmp_path, cut):
    with manifest.Journal(tmp_path) as journal:
        journal.add(GOOD)
        journal.add(BAD)
    path = tmp_path / manifest.LINES
    path.write_bytes(path.read_bytes()[:-cut])
    assert set(manifest.load(tmp_path)) == ({"a/x.vtu", "b/ü.vtu"} if cut == 1 else {"a/x.vtu"})
    with manifest.Journal(tmp_path) as journal:
        journal.add(BAD)
    assert set(manifest.load(tmp_path)) == {"a/x.vtu", "b/ü.vtu"}
    manifest.tidy(tmp_path)
    assert len(path.read_text().splitlines()) == 2


def test_the_last_line_for_a_mesh_counts(tmp_path):
    with manifest.Journal(tmp_path) as journal:
        journal.add(BAD)
        journal.add(FileResult(BAD.name, BAD.file, status="settled", valid=True))
    assert manifest.load(tmp_path)[BAD.name].valid
    manifest.tidy(tmp_path)
    assert len((tmp_path / manifest.LINES).read_text().splitlines()) == 1
    assert manifest.load(tmp_path)[BAD.name].valid


def test_foreign_lines_and_columns_do_no_harm(tmp_path):
    record = json.dumps(GOOD.record() | {"colour": "red"})
    (tmp_path / manifest.LINES).write_text(f'[1, 2]\n\n{{"file": 3}}\n"text"\n{record}\n')
    assert set(manifest.load(tmp_path)) == {"a/x.vtu"}


def test_the_table_holds_the_same(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    with manifest.Journal(tmp_path) as journal:
        journal.add(GOOD)
        journal.add(BAD)
    rows = parquet.read_table(manifest.write_table(tmp_path)).to_pylist()
    assert rows == [GOOD.record(), BAD.record()]


def test_without_pyarrow_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(MissingDependencyError, match=r"torchmesh-untangle\[parquet\]"):
        manifest.write_table(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_name_that_is_not_utf8_comes_back_and_has_escapes_in_the_table(tmp_path):
    pyarrow = pytest.importorskip("pyarrow.parquet")
    name = os.fsdecode(b"x\xff.vtu")
    with manifest.Journal(tmp_path) as journal:
        journal.add(FileResult(name, f"in/{name}", error=f"in/{name}: bad", warnings=[name]))
    assert list(manifest.load(tmp_path)) == [name]
    (row,) = pyarrow.read_table(manifest.write_table(tmp_path)).to_pylist()
    assert row["file"] == r"in/x\xff.vtu"
    assert row["warnings"] == [r"x\xff.vtu"]
