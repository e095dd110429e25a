"""Files through one process: packed by vertices, each result its own, whatever is wrong with another."""

import itertools
import warnings
from dataclasses import replace
from pathlib import Path

import meshes
import meshio
import numpy as np
import pytest
import torch
from file_runs import POSIX, job

from torchmesh import ImproveOptions, MeshBatch, improve, read, write
from torchmesh.batches import file_improvement
from torchmesh.batches.batches import Job, fingerprint, improve_jobs
from torchmesh.files.time_series import SeriesDraft


@pytest.fixture
def jobs(tmp_path) -> list[Job]:
    made = []
    for n, mesh in enumerate([meshes.jittered(8, 7), meshes.ring(), meshes.jittered(5, 4), meshes.moved_hole()]):
        name = f"m{n}.vtu"
        write(tmp_path / name, mesh)
        made.append(job(tmp_path, name))
    return made


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
    # Edges that cross are a fault of the boundary; nothing proves that no valid mesh lies over itself there.
    assert (result.status, result.valid, result.error) == ("stalled", False, None)
    assert "meet at about (1, 0.945946)" in result.message
    assert result.inverted_after > 0
    assert Path(result.output).exists()


def test_a_folded_quad_makes_a_mesh_invalid(tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [0.2, -0.5, 0], [2, 1, 0.0]])
    cells = [("quad", np.array([[0, 1, 4, 3]])), ("triangle", np.array([[1, 2, 5], [1, 5, 4]]))]
    meshio.Mesh(points, cells).write(tmp_path / "folded.vtk", file_format="vtk42", binary=False)
    (result,) = improve_jobs([job(tmp_path, "folded.vtk")], ImproveOptions(), 1000)
    assert (result.valid, result.inverted_after) == (False, 1)
    assert "1 quad (row 0) is inverted still" in result.message


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
    def full(self):
        Path(self.path).write_text("half")
        raise OSError(28, "No space left on device", str(self.path))

    monkeypatch.setattr(SeriesDraft, "save", full)
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
    (result,) = improve_jobs([job(tmp_path, "loaded.vtu")], ImproveOptions(), 1000, fields="carry")
    (text,) = result.warnings
    assert text == f"{result.output}: not carried over from {tmp_path / 'loaded.vtu'}: cell data 'pressure'"


def test_a_result_says_what_became_of_the_fields(tmp_path):
    mesh = meshes.moved_hole()
    heat = {"heat": mesh.points[:, 0].numpy(), "displacement": 0 * mesh.points.numpy()}
    meshio.Mesh(mesh.points.numpy(), [("triangle", mesh.triangles.numpy())], point_data=heat).write(
        tmp_path / "hot.vtu"
    )
    (result,) = improve_jobs([job(tmp_path, "hot.vtu")], ImproveOptions(), 1000)
    assert result.fields == "1 point field interpolated, carried with its vertices: displacement"
    after = meshio.read(result.output)
    np.testing.assert_allclose(after.point_data["heat"], after.points[:, 0], atol=1e-12)


def test_a_fingerprint_follows_the_content(tmp_path):
    (tmp_path / "a").write_bytes(b"one")
    (tmp_path / "b").write_bytes(b"one")
    (tmp_path / "c").write_bytes(b"two")
    digests = [fingerprint(tmp_path / name)["digest"] for name in "abc"]
    assert digests[0] == digests[1] != digests[2]
    assert fingerprint(tmp_path / "a")["bytes"] == 3


@POSIX
def test_a_planted_link_to_a_folder_is_an_error_and_nothing_is_written_through_it(jobs, tmp_path):
    given = jobs[0]
    away = tmp_path / "away"
    away.mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "sub").symlink_to(away)
    planted = replace(given, output=str(tmp_path / "out" / "sub" / "m0.vtu"))
    (result,) = improve_jobs([planted], ImproveOptions(), 10**6)
    assert "out/sub: is a symbolic link in the folder of results" in result.error
    assert not list(away.iterdir())


@POSIX
def test_a_planted_link_at_the_result_is_replaced(jobs, tmp_path):
    precious = tmp_path / "precious"
    precious.write_text("mine")
    target = Path(jobs[0].output)
    target.parent.mkdir()
    target.symlink_to(precious)
    (result,) = improve_jobs(jobs[:1], ImproveOptions(), 10**6)
    assert result.error is None
    assert not target.is_symlink()
    assert precious.read_text() == "mine"


def test_heights_ride_where_a_job_says_so_and_meshes_of_quads_alone_are_done(tmp_path):
    bed = meshes.jittered(5, 4)
    space = np.column_stack([bed.points.numpy(), np.sin(3 * bed.points[:, 0].numpy())])
    meshio.Mesh(space, [("triangle", bed.triangles.numpy())]).write(tmp_path / "bed.vtu")
    points, _ = meshes.grid_arrays(2, 2)
    quads = np.array([[3 * i + j, 3 * i + j + 3, 3 * i + j + 4, 3 * i + j + 1] for i in (0, 1) for j in (0, 1)])
    points[4] += 0.1
    meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("quad", quads)]).write(tmp_path / "quads.vtu")
    jobs = [replace(job(tmp_path, name), height="keep") for name in ("bed.vtu", "quads.vtu")]
    results = list(improve_jobs(jobs, ImproveOptions(), 10**6))
    assert [(r.error, r.valid) for r in results] == [(None, True)] * 2
    after = meshio.read(results[0].output).points
    assert (after[:, :2] != space[:, :2]).any()
    assert np.array_equal(after[:, 2], space[:, 2])
