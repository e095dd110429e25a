"""Time series in every command: XDMF and collections of ParaView."""

import json

import fields
import meshes
import meshio
import numpy as np
import pytest
from command_line import inverted, is_one_clear_line

from torchmesh import read, read_series, write
from torchmesh.commands.batch import Tally


@pytest.fixture(params=["run.xdmf", "run.pvd"])
def run(request, folder) -> str:
    """A hole that moves through its mesh: valid, tangled, and more tangled."""
    steps = []
    for step, distance in enumerate((0.0, 3.0, 5.0)):
        mesh = meshes.moved_hole(distance)
        points = np.pad(mesh.points.numpy(), ((0, 0), (0, 1)))
        motion = np.zeros_like(points)
        motion[:, 1] = 0.01 * step
        data = {"u": points[:, 0] + step, "displacement": motion}
        steps.append(meshio.Mesh(points, [("triangle", mesh.triangles.numpy())], point_data=data))
    if request.param.endswith("pvd"):
        sets = []
        for step, mesh in enumerate(steps):
            mesh.write(folder / f"s{step}.vtu")
            sets.append(f'<DataSet timestep="{step}" file="s{step}.vtu"/>')
        text = f'<VTKFile type="Collection"><Collection>{"".join(sets)}</Collection></VTKFile>'
        (folder / "run.pvd").write_text(text)
    else:
        fields.write_steps(folder / "run.xdmf", steps)
    return request.param


def test_quality_has_a_row_for_each_step(call, run):
    done = call("quality", run, "--json", "--worst", "1")
    assert done.status == 1
    records = json.loads(done.out)
    assert [record["steps"] for record in records] == ["step 0 (time 0)", "step 1 (time 1)", "step 2 (time 2)"]
    assert [record["inverted"] > 0 for record in records] == [False, True, True]


def test_improve_mends_every_step(call, folder, run):
    out = f"better{run[3:]}"
    done = call("improve", run, out, "--report", "r.json", "--plot", "p.png")
    assert (done.status, done.err) == (0, "")
    assert "step 2 (time 2)" in done.out
    report = json.loads((folder / "r.json").read_text())
    assert report["valid"]
    assert [one["time_steps"] for one in report["meshes"]] == [[0], [1], [2]]
    after = read_series(folder / out)
    assert after.times == [0.0, 1.0, 2.0]
    assert call("quality", out, "--worst", "0").status == 0
    assert "step 2" not in call("improve", "tangled.vtu", "out.vtu").out


def test_a_target_of_one_step_is_refused_before_the_work(call, run, monkeypatch):
    monkeypatch.setattr("torchmesh.batches.file_improvement.improve", lambda *_, **__: pytest.fail("it improved"))
    assert is_one_clear_line(call("improve", run, "out.vtu"), "write .xdmf or .pvd")


def test_report_shows_the_worst_step(call, folder, run):
    done = call("report", run, f"better{run[3:]}", "page.html")
    assert (done.status, done.err) == (0, "")
    assert "stages of step 2" in done.out
    page = (folder / "page.html").read_text()
    assert "Time series" in page
    assert "step 2, time 2, shown" in page


@pytest.mark.parametrize("run", ["run.xdmf"], indirect=True)
def test_report_and_animate_show_the_step_asked_for(call, run):
    out = f"better{run[3:]}"
    assert "stages of step 1" in call("report", run, out, "page.html", "--step", "1").out
    assert is_one_clear_line(call("report", run, out, "page.html", "--step", "3"), "has steps from 0 to 2")
    assert "a.gif: 3 steps" in call("animate", run, "a.gif").out
    assert " stages" in call("animate", run, "a.gif", "--step", "1").out


def test_every_step_is_warped_by_its_own_displacement(call, folder):
    rest = meshes.moved_hole(0.0)
    points = np.pad(rest.points.numpy(), ((0, 0), (0, 1)))
    steps = []
    for step in range(3):
        motion = np.zeros_like(points)
        motion[:, 1] = 0.01 * step
        steps.append(meshio.Mesh(points, [("triangle", rest.triangles.numpy())], point_data={"d": motion}))
    fields.write_steps(folder / "rest.xdmf", steps)
    assert len(read_series(folder / "rest.xdmf").batch) == 1
    assert call("warp", "rest.xdmf", "out.xdmf", "--displacement", "d", "--move", "hole:1:0.001,0").status == 0
    moved = read_series(folder / "out.xdmf")
    assert len(moved.batch) == 3
    for step, mesh in enumerate(moved.batch.split()):
        by = (mesh.points - rest.points)[mesh.fixed]
        assert by[:, 1].tolist() == pytest.approx([0.01 * step] * len(by))
    assert call("warp", "rest.xdmf", "out.xdmf", "--move", "hole:1:0.001,0", "--steps", "auto").status == 0
    assert len(read_series(folder / "out.xdmf").batch) == 1


def test_batch_says_how_many_are_errors(call, folder, inline):
    (folder / "some").mkdir()
    (folder / "some" / "b.vtu").write_text("no mesh")
    assert "\nerrors: 1 of 1 file: results/manifest.jsonl\n" in call("batch", "some", "--out", "results").err
    write(folder / "some" / "a.vtu", meshes.moved_hole())
    assert "\nerrors: 1 of 2 files: results/manifest.jsonl\n" in call("batch", "some", "--out", "results").err
    tally = Tally(3, 0, 3)
    tally.tangled, tally.errors = 1, 1
    assert tally.verdict() == "not valid: 1 of 3 meshes still has inverted elements, 1 is an error"
    tally.tangled, tally.errors = 2, 0
    assert tally.verdict() == "not valid: 2 of 3 meshes still have inverted elements"


def test_batch_names_what_it_skipped(call, folder, inline):
    (folder / "some").mkdir()
    write(folder / "some" / "a.vtu", meshes.moved_hole())
    for name in ("notes.txt", "table.csv", ".hidden"):
        (folder / "some" / name).write_text("no mesh")
    done = call("batch", "some", "--out", "results")
    assert done.status == 0
    assert done.err == "skipped: 2 files of no mesh format: some/notes.txt, some/table.csv\n"
    assert inverted(folder / "results" / "a.vtu") == 0
    assert call("batch", "some", "--out", "results", "--quiet").err == ""
    assert read(folder / "results" / "a.vtu").triangles.shape == read(folder / "some" / "a.vtu").triangles.shape
