"""The run of the README's numbers: what it writes, and how it is seen that they are stale."""

import json
from argparse import Namespace

import pytest

from experiments.robustness import compiled_peers
from experiments.speed import readme

PAGE = """before
<!-- written by experiments/speed/readme.py: run -->
old
<!-- end -->
between
<!-- written by experiments/speed/readme.py: comparison -->
| old |
<!-- end -->
"""


def test_parts_of_the_page_are_replaced_and_nothing_else():
    text = readme.written(PAGE, "comparison", "| new |\n| rows |")
    assert text == PAGE.replace("| old |", "| new |\n| rows |")
    assert readme.written(text, "run", "new") == text.replace("\nold\n", "\nnew\n")
    with pytest.raises(ValueError, match="no part 'table'"):
        readme.written(PAGE, "table", "")


def test_the_readme_has_the_parts_that_a_run_writes():
    text = readme.README.read_text(encoding="utf-8")
    for part in ("run", "reproduction", "comparison"):
        assert readme.written(text, part, "x") != text
    assert readme.written(text, "peers", "x", compiled_peers.WRITER) != text


def test_the_table_of_compiled_peers_says_what_it_ran_on_and_counts_each_method_by_size():
    rows = [
        {"case": f"{n}-{k}", "triangles": n, "method": method, "valid": valid, "seconds": seconds}
        for n in (20, 40)
        for k in range(3)
        for method, valid, seconds in (
            ("torchmesh, untangle", True, 0.25),
            ("foldover-free maps (C++)", k > 0, 1.0 * k),
        )
    ]
    given = Namespace(foldover="untangle2d", lifted=None, limit=30.0, triangles=[20, 40])
    text = compiled_peers.for_the_readme(rows, given)
    assert "compiled_peers --foldover PROGRAM --limit 30`" in text
    assert "3 maps and turned rings of each size" in text
    assert readme.about_this_run()["processor"] in text
    assert "| foldover-free maps (C++) | 2 of 3 | 1.00 | 2.0 | 2 of 3 | 1.00 | 2.0 |" in text


def test_numbers_are_stale_when_the_code_has_changed_or_no_run_is_noted(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(readme, "README", tmp_path / "README.md")
    monkeypatch.setattr(readme, "NOTE", tmp_path / "readme.json")
    assert readme.main(["--check"]) == 1
    assert "no run" in capsys.readouterr().out
    note = readme.about_this_run()
    assert {"commit", "processor", "versions", "day", "code"} <= set(note)
    readme.NOTE.write_text(json.dumps(note))
    readme.README.write_text(PAGE)
    assert "does not speak of the run" in readme.stale()
    readme.README.write_text(readme.written(PAGE, "run", readme.in_words(note)))
    assert readme.main(["--check"]) == 0
    readme.NOTE.write_text(json.dumps(note | {"code": "other"}))
    assert "the code has changed since the run of" in readme.stale()


def test_a_run_writes_all_parts_and_its_note(tmp_path, monkeypatch):
    """With tables that are at hand in place of those that take minutes."""
    monkeypatch.setattr(readme, "README", tmp_path / "README.md")
    monkeypatch.setattr(readme, "NOTE", tmp_path / "readme.json")
    readme.README.write_text(PAGE)
    monkeypatch.setattr(readme, "reproduction", lambda folder: {})
    monkeypatch.setattr(readme, "comparison", lambda folder: {"comparison": "| new |"})
    assert readme.main([]) == 0
    text = readme.README.read_text()
    assert "| new |" in text
    assert readme.in_words(json.loads(readme.NOTE.read_text())) in text
    assert readme.stale() == ""
