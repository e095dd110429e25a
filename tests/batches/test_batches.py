"""Files through one process: packed by vertices, each result its own, whatever is wrong with another."""

import itertools
import json
import math
import sys
import warnings
from pathlib import Path

import fields
import meshes
import meshio
import numpy as np
import pytest
import torch

from torchmesh import ImproveOptions, MeshBatch, improve, read, write
from torchmesh.batches import file_improvement, manifest
from torchmesh.batches.batches import Job, fingerprint, improve_jobs
from torchmesh.batches.manifest import FileResult
from torchmesh.errors import MissingDependencyError


@pytest.fixture
def jobs(tmp_path) -> list[Job]:
    made = []
    for n, mesh in enumerate([meshes.jittered(8, 7), meshes.ring(), meshes.jittered(5, 4), meshes.moved_hole()]):
        name = f"m{n}.vtu"
        write(tmp_path / name, mesh)
        made.append(job(tmp_path, name))
    return made


def job(folder: Path, name: str) -> Job:
    return Job(name, str(folder / name), str(folder / "out" / name), str(folder / "out" / ".staging"))


def test_results_are_those_of_improve(jobs):
    results = list(improve_jobs(jobs, ImproveOptions(), 10**6, "as told"))
    assert [r.name for r in results] == [j.name for j in jobs]
    for result, given in zip(results, jobs, strict=True):
        before = read(given.file)
        after, report = improve(before)
        written = read(result.output)
        assert torch.equal(written.points, after.points)
        assert torch.equal(written.triangles, after.triangles)
        assert result.valid
        assert (result.error, result.options) == (None, "as told")
        assert (result.vertices, result.triangles) == (len(before.points), len(before.triangles))
        assert result.inverted_before == report.steps[0][0].inverted
        assert result.inverted_after == 0
        assert result.imr_average_after == float(report.quality.mean[0])
        assert result.imr_maximum_after == float(report.quality.max[0])
        assert result.imr_average_before == pytest.approx(report.steps[0][0].mean)
        assert result.output_bytes == Path(result.output).stat().st_size
        assert result.seconds > 0


@pytest.mark.parametrize("budget", [1, 100, 250, 10**6])
def test_batches_keep_to_the_budget(jobs, monkeypatch, budget):
    sizes = []

    def counting(batch, options, **more):
        sizes.append(torch.diff(batch.point_offsets).tolist())
        return improve(batch, options, **more)

    monkeypatch.setattr(file_improvement, "improve", counting)
    results = list(improve_jobs(jobs, ImproveOptions(), budget))
    assert all(r.valid for r in results)
    assert list(itertools.chain(*sizes)) == [r.vertices for r in results]
    for size in sizes:
        assert sum(size) <= budget or len(size) == 1
    for first, second in itertools.pairwise(sizes):  # none was closed before it was full
        assert sum(first) + second[0] > budget


def test_single_and_double_precision_do_not_share_a_batch(tmp_path):
    mesh = meshes.jittered()
    write(tmp_path / "double.vtu", mesh)
    write(tmp_path / "single.vtu", mesh.to(torch.float32))
    results = list(improve_jobs([job(tmp_path, n) for n in ("double.vtu", "single.vtu")], ImproveOptions(), 10**6))
    assert [r.valid for r in results] == [True, True]
    assert read(tmp_path / "out" / "single.vtu").points.dtype == torch.float32


def test_a_file_that_cannot_be_read_is_a_result(tmp_path, jobs):
    (tmp_path / "broken.vtu").write_text("no mesh")
    (tmp_path / "empty.vtu").touch()
    bad = [job(tmp_path, name) for name in ("broken.vtu", "empty.vtu", "missing.vtu", "odd.xyz")]
    (tmp_path / "odd.xyz").write_text("1 2 3")
    results = {r.name: r for r in improve_jobs([bad[0], jobs[0], *bad[1:], jobs[1]], ImproveOptions(), 10**6)}
    for name, text in (
        ("broken.vtu", "cannot be read as vtu"),
        ("empty.vtu", "the file is empty"),
        ("missing.vtu", "there is no such file"),
        ("odd.xyz", "'.xyz' is not known"),
    ):
        result = results[name]
        assert text in result.error
        assert str(tmp_path / name) in result.error
        assert (result.status, result.valid, result.output) == ("error", False, None)
        assert not (tmp_path / "out" / name).exists()
    assert results["m0.vtu"].valid
    assert results["m1.vtu"].valid


def test_a_mesh_that_cannot_be_mended_is_written_and_said(tmp_path):
    points, triangles = meshes.grid_arrays(6, 6)
    points[0] = 1.4
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        write(tmp_path / "crossed.vtu", MeshBatch.from_arrays(points, triangles))
    (result,) = improve_jobs([job(tmp_path, "crossed.vtu")], ImproveOptions(), 1000)
    assert (result.status, result.valid, result.error) == ("infeasible", False, None)
    assert "meet at about (1, 0.945946)" in result.message
    assert result.inverted_after > 0
    assert Path(result.output).exists()


def test_a_batch_that_fails_is_done_mesh_by_mesh(jobs, monkeypatch):
    """No mesh should make `improve` raise; if one does, the others do not pay for it."""

    def failing(batch, options, **more):
        if (torch.diff(batch.point_offsets) == len(meshes.ring().points)).any():
            raise ZeroDivisionError("a bug")
        return improve(batch, options, **more)

    monkeypatch.setattr(file_improvement, "improve", failing)
    results = list(improve_jobs(jobs, ImproveOptions(), 10**6))
    assert [r.valid for r in results] == [True, False, True, True]
    assert results[1].error == f"{jobs[1].file}: ZeroDivisionError: a bug"
    assert results[1].inverted_before is None


def test_a_failed_write_leaves_no_trace(jobs, tmp_path, monkeypatch):
    def full(path, *_):
        Path(path).write_text("half")
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(file_improvement, "write_series", full)
    results = list(improve_jobs(jobs[:1], ImproveOptions(), 1000))
    assert "No space left on device" in results[0].error
    assert (results[0].output, results[0].inverted_after) == (None, None)
    assert not [p for p in (tmp_path / "out").rglob("*") if p.is_file()]


def test_warnings_are_kept_with_the_real_names(tmp_path):
    mesh = meshes.moved_hole()
    pressure = np.arange(len(mesh.triangles)) / 7
    meshio.Mesh(mesh.points.numpy(), [("triangle", mesh.triangles.numpy())], cell_data={"pressure": [pressure]}).write(
        tmp_path / "loaded.vtu"
    )
    (result,) = improve_jobs([job(tmp_path, "loaded.vtu")], ImproveOptions(), 1000)
    (text,) = result.warnings
    assert text == f"{result.output}: not carried over from {tmp_path / 'loaded.vtu'}: cell data 'pressure'"


def test_point_data_survives_added_and_removed_vertices(tmp_path):
    """With topology "full" new vertices take their values from the old ones, as `write` with a vertex map does."""
    before = fields.write_coarse(tmp_path / "coarse.vtu")
    (result,) = improve_jobs([job(tmp_path, "coarse.vtu")], ImproveOptions(topology="full"), 1000)
    assert (result.valid, result.warnings) == (True, [])
    fields.assert_carried(before, meshio.read(result.output))


def test_point_data_of_a_series_survives_added_and_removed_vertices(tmp_path):
    """Each mesh of the file has a part of the batch's vertex map of its own, and so has each file of the batch."""
    before = [fields.coarse(), fields.coarse(3)]
    fields.write_steps(tmp_path / "steps.xdmf", before)
    fields.write_coarse(tmp_path / "first.vtu")
    jobs = [job(tmp_path, "first.vtu"), job(tmp_path, "steps.xdmf")]
    _, result = improve_jobs(jobs, ImproveOptions(topology="full"), 10**6)
    assert (result.valid, result.warnings, result.steps) == (True, [], 2)
    after = fields.read_steps(Path(result.output))
    assert len(after) == 2
    for one, other in zip(before, after, strict=True):
        fields.assert_carried(one, other)


def test_a_fingerprint_follows_the_content(tmp_path):
    (tmp_path / "a").write_bytes(b"one")
    (tmp_path / "b").write_bytes(b"one")
    (tmp_path / "c").write_bytes(b"two")
    digests = [fingerprint(tmp_path / name)["digest"] for name in "abc"]
    assert digests[0] == digests[1] != digests[2]
    assert fingerprint(tmp_path / "a")["bytes"] == 3


# --- the manifest ------------------------------------------------------------------------------------

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
