"""A run: foreign methods, whatever they do, get their rows; a run that was stopped goes on; the files say the same."""

import csv
import json
import os
import time

import pytest
import torch

import torchmesh as tm
from torchmesh import bench
from torchmesh.bench import registry, results, running
from torchmesh.bench.running import RunOptions


@pytest.fixture
def own():
    """Registers methods of a test, and forgets them after it."""
    registry.builtin_methods()
    known = dict(registry.METHODS)

    def register(name, function, **how):
        bench.method(name, **how)(function)
        return name

    yield register
    registry.METHODS.clear()
    registry.METHODS.update(known)


def raises(mesh):
    raise ZeroDivisionError("no\nluck")


def refuses(mesh):
    raise bench.Refused("too round")


def sleeps(mesh):
    if len(mesh.points) > 40:  # not on the small mesh that warms it up
        time.sleep(60)
    return mesh


def crashes(mesh):
    os._exit(3)


def gives_numbers(mesh):
    return 7


@pytest.mark.skipif(not hasattr(os, "fork"), reason="methods are stopped in forked processes")
def test_whatever_a_method_does_becomes_a_row(own, tmp_path):
    names = [own(f.__name__, f) for f in (raises, refuses, sleeps, crashes, gives_numbers)]
    names.append(own("known", lambda mesh, rest: bench.Result(rest, 0.5, note="as it was"), undeformed=True))
    names.append(own("no-number", lambda mesh: bench.Result(mesh, "soon")))
    rows = bench.run(tmp_path, RunOptions(names, ["jitter"], limit=1, seconds=1.5))
    told = {row["method"]: (row["outcome"], row["fault"]) for row in rows}
    assert told == {
        "raises": ("error", "ZeroDivisionError: no luck"),
        "refuses": ("refused", "too round"),
        "sleeps": ("error", "stopped after 1.5 seconds"),
        "crashes": ("error", "the process ended with status 3"),
        "gives_numbers": ("invalid", "no MeshBatch but int"),
        "known": ("valid", ""),
        "no-number": ("error", "ValueError: could not convert string to float: 'soon'"),
    }
    (known,) = (row for row in rows if row["method"] == "known")
    assert (known["note"], known["seconds"], known["wall_seconds"]) == ("as it was", 0.5, 0.5)
    assert all(row["digest"] == rows[0]["digest"] and json.loads(row["versions"])["torch"] for row in rows)


def test_the_tables_hold_the_rows_and_a_second_run_adds_only_what_is_new(own, tmp_path):
    own("mine", lambda mesh: tm.untangle(mesh)[0])
    first = bench.run(tmp_path, RunOptions(["mine"], ["jitter"], limit=2))
    made = []
    # A line that was cut short by a kill.
    with open(tmp_path / results.LINES, "a") as stream:
        stream.write('{"method": "mine", "fam')
    rows = bench.run(
        tmp_path, RunOptions(["mine", "ours"], ["jitter"], limit=3), progress=lambda done, total, row: made.append(row)
    )
    assert len(rows) == 6
    assert [(r["method"], r["case"]) for r in made] == [("ours", 0), ("ours", 1), ("mine", 2), ("ours", 2)]
    assert all(row in rows for row in first)
    with open(tmp_path / results.CSV, newline="") as stream:
        table = list(csv.DictReader(stream))
    assert [(r["method"], int(r["case"])) for r in table] == [(m, n) for m in ("mine", "ours") for n in range(3)]
    assert list(table[0]) == list(results.COLUMNS)
    assert all(r["valid"] == "True" for r in table if r["method"] == "ours")
    pq = pytest.importorskip("pyarrow.parquet")
    read = pq.read_table(tmp_path / results.PARQUET).to_pylist()
    assert [(r["method"], r["case"]) for r in read] == [(r["method"], int(r["case"])) for r in table]
    assert read[0]["seconds"] == pytest.approx(float(table[0]["seconds"]))
    page = (tmp_path / "index.html").read_text()
    assert "mine" in page
    assert page.count("<svg viewBox='0 0 480") == 2
    assert "100 %" in (tmp_path / "table.md").read_text()


def test_a_sequence_follows_the_methods_own_meshes_and_any_rows(own):
    from torchmesh.bench.catalogue import families
    from torchmesh.bench.solving import solve

    case = families()["sequence"].case(0)
    seen = []

    def watches(mesh):
        seen.append(mesh)
        better, _ = tm.improve(mesh, tm.ImproveOptions.fast(workers=1))
        order = torch.randperm(len(mesh.points), generator=torch.Generator().manual_seed(1))
        return tm.MeshBatch.from_arrays(better.points[order], order.argsort()[better.triangles])

    own("watches", watches)
    row = solve(case, registry.METHODS["watches"])
    assert (row["outcome"], row["steps"], row["steps_valid"]) == ("valid", 8, 8)
    seen = seen[-8:]
    for mesh, goal in zip(seen, (case.mesh.points, *case.path), strict=True):
        there = {tuple(p) for p in mesh.points[mesh.fixed].tolist()}
        assert {tuple(p) for p in goal[case.mesh.fixed].tolist()} <= there


@pytest.mark.parametrize("name", ["ours", "", "a b", "a,b"])
def test_names_that_cannot_be_are_refused(name):
    with pytest.raises(ValueError, match=r"built-in|letters"):
        bench.method(name)(lambda mesh: mesh)


def test_what_is_not_installed_is_left_out_by_name(own, tmp_path):
    own("lacking", lambda mesh: mesh, libraries=("no_such_module",))
    said = []
    rows = bench.run(tmp_path, RunOptions(["lacking", "ours-fast"], ["jitter"], limit=1), say=said.append)
    assert [row["method"] for row in rows] == ["ours-fast"]
    assert "lacking needs no_such_module" in said[0]
    with pytest.raises(ValueError, match="no method is left"):
        bench.run(tmp_path, RunOptions(["lacking"], ["jitter"], limit=1))


def test_families_without_weights_are_left_out_by_name(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCHMESH_BENCH_WEIGHTS", str(tmp_path / "nowhere.pt"))
    said = []
    with pytest.raises(ValueError, match="no family is left"):
        bench.run(tmp_path, RunOptions(["ours"], ["trained"], limit=1), say=said.append)
    assert "nowhere.pt" in said[0]
    assert "network needs" in registry.why_not(registry.METHODS["network"]) or "nowhere.pt" in registry.why_not(
        registry.METHODS["network"]
    )


@pytest.mark.parametrize("wrong", [{"limit": 0}, {"seconds": 0}])
def test_options_that_cannot_be_are_refused(wrong):
    with pytest.raises(ValueError, match=f"RunOptions.{next(iter(wrong))}"):
        running.RunOptions(**wrong)


@pytest.mark.parametrize(
    ("text", "fault"), [("1 / 0", "ZeroDivisionError"), ("x = 1", "no function in it"), (None, "FileNotFound")]
)
def test_a_file_without_methods_is_told(tmp_path, text, fault):
    path = tmp_path / "mine.py"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ValueError, match=f"mine.py: .*{fault}"):
        registry.methods_of(str(path))


def test_a_methods_mesh_is_its_own(own):
    """A method that writes into its mesh spoils the case for no other."""
    from torchmesh.bench.catalogue import families
    from torchmesh.bench.solving import solve

    case = families()["jitter"].case(2)
    before = case.digest

    def spoils(mesh):
        mesh.points.zero_()
        return mesh

    own("spoils", spoils)
    assert solve(case, registry.METHODS["spoils"])["outcome"] == "invalid"
    again = families()["jitter"].case(2)
    assert torch.equal(case.mesh.points, again.mesh.points)
    assert before == again.digest
