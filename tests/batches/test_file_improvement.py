"""Reading, improving and writing: what a file holds comes along, alone and in a batch with others."""

from pathlib import Path

import fields
import meshes
import meshio
import pytest
import torch
from file_runs import job

from torchmesh import ImproveOptions, improve, read, read_series, write
from torchmesh.batches import file_improvement
from torchmesh.batches.batches import improve_jobs
from torchmesh.batches.file_improvement import improve_series, open_mesh
from torchmesh.errors import InvalidMeshError, MeshIOError
from torchmesh.files.time_series import write_series


def test_point_data_survives_added_and_removed_vertices(tmp_path):
    """With topology "full" new vertices take their values from the old ones, as `write` with a vertex map does."""
    before = fields.write_coarse(tmp_path / "coarse.vtu")
    (result,) = improve_jobs([job(tmp_path, "coarse.vtu")], ImproveOptions(topology="full"), 1000)
    assert (result.valid, result.warnings) == (True, [])
    fields.assert_carried(before, meshio.read(result.output))


def test_point_data_of_a_series_survives_added_and_removed_vertices(tmp_path):
    """Each mesh of the file has a part of the batch's vertex map of its own, and so has each file of the batch."""
    before = [fields.coarse(), fields.coarse(5)]
    fields.write_steps(tmp_path / "steps.xdmf", before)
    fields.write_coarse(tmp_path / "first.vtu")
    jobs = [job(tmp_path, "first.vtu"), job(tmp_path, "steps.xdmf")]
    _, result = improve_jobs(jobs, ImproveOptions(topology="full"), 10**6)
    assert (result.valid, result.warnings, result.steps) == (True, [], 2)
    after = fields.read_steps(Path(result.output))
    assert len(after) == 2
    for one, other in zip(before, after, strict=True):
        fields.assert_carried(one, other)


def test_files_are_improved_together_and_written_apart(tmp_path):
    given = [meshes.jittered(8, 7), meshes.ring()]
    for name, mesh in zip("ab", given, strict=True):
        write(tmp_path / f"{name}.vtu", mesh)
    files = improve_series([open_mesh(tmp_path / f"{name}.vtu") for name in "ab"], ImproveOptions())
    assert [file.rows for file in files] == [slice(0, 1), slice(1, 2)]
    for file, mesh in zip(files, given, strict=True):
        file.write(tmp_path / "out.vtu")
        after, report = improve(mesh)
        assert torch.equal(read(tmp_path / "out.vtu").points, after.points)
        assert file.report.quality.mean[file.rows].tolist() == report.quality.mean.tolist()


def test_vertices_that_the_file_holds_do_not_slide(tmp_path, monkeypatch):
    """What `held` says of each file reaches `improve`; without sliding there is nothing to hold."""
    write(tmp_path / "a.vtu", meshes.jittered())
    count, seen = len(meshes.jittered().points), []

    def watching(batch, options, **more):
        seen.append(more["hold"])
        return improve(batch, options, **more)

    monkeypatch.setattr(file_improvement, "improve", watching)
    monkeypatch.setattr(file_improvement, "held", lambda source: torch.arange(count) == 3)
    files = [open_mesh(tmp_path / "a.vtu"), open_mesh(tmp_path / "a.vtu")]
    improve_series(files, ImproveOptions(boundary="slide"))
    improve_series(files, ImproveOptions())
    assert seen[0].nonzero().squeeze(1).tolist() == [3, 3 + count]
    assert seen[1] is None


def test_a_time_series_is_no_single_mesh(tmp_path):
    fields.write_steps(tmp_path / "steps.xdmf", [fields.coarse(), fields.coarse(3)])
    with pytest.raises(MeshIOError, match="it is a time series"):
        read(tmp_path / "steps.xdmf")
    assert len(open_mesh(tmp_path / "steps.xdmf")) == 2


def test_a_series_needs_a_vertex_map_for_each_mesh(tmp_path):
    fields.write_steps(tmp_path / "steps.xdmf", [fields.coarse(), fields.coarse(3)])
    series = read_series(tmp_path / "steps.xdmf")
    with pytest.raises(InvalidMeshError, match="there are 0 vertex maps for 2 meshes"):
        write_series(tmp_path / "out.xdmf", series.batch, series, [])
