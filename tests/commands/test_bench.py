"""`torchmesh bench`."""

import csv
import sys


def test_a_foreign_method_beside_ours(call, folder):
    done = call("bench", "run", "--with", "my_method.py", "--families", "jitter", "--limit", "2", "--out", "results")
    assert done.status == 0, done
    assert "mine" in done.out
    with open(folder / "results" / "results.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [(r["method"], r["family"], r["case"]) for r in rows] == [
        (m, "jitter", n) for m in ("mine", "ours") for n in "01"
    ]
    assert {"results.csv", "results.parquet", "index.html"} <= {p.name for p in (folder / "results").iterdir()}


def test_errors_of_a_foreign_method_are_told(call, folder):
    """A table of 0 percent alone would leave its author in the dark."""
    wrong = "from torchmesh import bench\n@bench.method('wrong')\ndef wrong(mesh):\n    return mesh.case\n"
    (folder / "wrong.py").write_text(wrong)
    done = call("bench", "run", "--with", "wrong.py", "--methods", "wrong", "--families", "jitter", "--limit", "1",
                "--out", "wrong")  # fmt: skip
    assert done.status == 0, done
    assert "wrong raised 1 error; the first, in jitter 0: AttributeError" in done.err, done


def test_what_is_unknown_is_one_line(call):
    for arguments in (
        ["--methods", "nothing"], ["--families", "nothing"], ["--with", "nothing.py"], ["--weights", "nothing.pt"],
        ["--limit", "0"],
    ):  # fmt: skip
        done = call("bench", "run", *arguments)
        assert done.status == 2
        assert done.err.startswith("error: ")
        assert done.err.count("\n") == 1
        assert arguments[0 if arguments[1] == "0" else 1] in done.err


def test_families_and_methods_are_listed_with_what_is_missing(call, monkeypatch):
    monkeypatch.setitem(sys.modules, "gmsh", None)
    done = call("bench", "list")
    assert done.status == 0
    for word in ("moved", "lengths moved", "ours-keep", "kim2017"):
        assert word in done.out
    assert "gmsh-anew needs gmsh" in done.out
    assert "[bench,peers]'" in done.out
