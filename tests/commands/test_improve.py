"""`torchmesh improve`: its files, its words and its exit status, as a process or called in this process."""

import contextlib
import io
import json
import os
import re
import signal
from pathlib import Path

import meshes
import meshio
import numpy as np
import pytest
import torch
from children import interrupted_at, started
from command_line import Outcome, inverted, is_one_clear_line, names
from layered import round_body
from rich.console import Console

from experiments.robustness import check_certificates
from torchmesh import quality, read, write
from torchmesh.commands import console
from torchmesh.errors import MeshIOError
from torchmesh.improving.report import Progress


def test_improve_writes_a_valid_mesh_a_report_and_a_picture(call, folder):
    before = names(folder)
    done = call("improve", "tangled.vtk", "out.vtu", "--report", "r.json", "--plot", "p.png")
    assert (done.status, done.err) == (0, "")
    assert names(folder) - before == {"out.vtu", "r.json", "p.png"}
    assert inverted(folder / "tangled.vtk") > 5
    assert inverted(folder / "out.vtu") == 0
    for word in ("before", "after", "triangles", "inverted", "IMR average", "IMR maximum", "minimum angle"):
        assert word in done.out
    assert (folder / "p.png").stat().st_size > 50_000
    report = json.loads((folder / "r.json").read_text(), parse_constant=pytest.fail)
    assert set(report) >= {
        "torchmesh", "input", "output", "method", "topology", "boundary", "beta", "seconds", "before", "after",
        "status", "message", "valid", "steps",
    }  # fmt: skip
    assert (report["input"], report["output"]) == ("tangled.vtk", "out.vtu")
    assert (report["method"], report["topology"], report["beta"]) == ("default", "flip", None)
    assert report["valid"] is True
    kinds = {
        "triangles": int, "vertices": int, "inverted": int, "imr_average": float, "imr_maximum": float,
        "minimum_angle": float,
    }  # fmt: skip
    for state in ("before", "after"):
        assert {key: type(value) for key, value in report[state].items()} == kinds
    assert report["before"]["inverted"] == inverted(folder / "tangled.vtk")
    assert report["after"]["inverted"] == 0
    assert report["before"]["triangles"] == report["after"]["triangles"]
    assert report["steps"][0]["inverted"] == report["before"]["inverted"]
    assert report["steps"][-1]["mean"] == pytest.approx(report["after"]["imr_average"])
    for step in report["steps"]:
        assert set(step) >= {"stage", "mean", "max", "inverted", "flips", "iterations", "seconds"}


def test_improve_says_so_when_a_mesh_cannot_be_made_valid(call, folder):
    done = call("improve", "crossed.vtu", "out.vtu", "--report", "r.json")
    left = inverted(folder / "out.vtu")
    assert done.status == 1
    assert left > 0
    last = done.err.splitlines()[-1]
    assert last.startswith("not valid: ")
    assert f" {left} inverted triangle" in last
    assert "out.vtu" in last
    assert "Traceback" not in done.err
    report = json.loads((folder / "r.json").read_text())
    assert report["valid"] is False
    assert report["after"]["inverted"] == left


def test_what_is_impossible_is_told_with_its_reason_its_flips_and_a_proof_that_another_program_checks(
    call, folder, capsys
):
    mesh = meshes.grid(4, 4)
    mesh.points[20] = torch.tensor([0.78125, 0.21875])
    write(folder / "dented.vtk", mesh)
    done = call("improve", "dented.vtk", "out.vtk", "--topology", "keep", "--report", "r.json")
    assert done.status == 1
    assert "has three fixed vertices, and is not upright" in done.err
    assert "1 flip is enough to make it possible: 15-21 (the fewest that were found, an upper bound)" in done.err
    capsys.readouterr()
    assert check_certificates.main([str(folder / "r.json")]) == 0
    assert capsys.readouterr().out == "dented.vtk: proved: fixed triangle\n"
    # With edges that flip the corner is no fault, and nothing is proved.
    assert call("improve", "dented.vtk", "out.vtk", "--report", "r.json").status == 0
    assert "proofs" not in json.loads((folder / "r.json").read_text())
    assert check_certificates.main([str(folder / "r.json")]) == 1
    assert "there is no certificate" in capsys.readouterr().out


def test_improve_keeps_triangles_when_told(call, folder):
    assert call("improve", "tangled.vtu", "out.vtu", "--topology", "keep").status == 0
    assert (read(folder / "out.vtu").triangles == read(folder / "tangled.vtu").triangles).all()


def test_the_fast_method_polishes_nothing(call, folder):
    assert call("improve", "tangled.vtu", "out.vtu", "--method", "fast", "--report", "r.json").status == 0
    assert "polish" not in (folder / "r.json").read_text()


def test_paper_method_with_an_absolute_beta(call, folder):
    done = call("improve", "tangled.vtu", "out.vtu", "--method", "paper", "--beta", "0.01", "--report", "r.json")
    assert done.status == 0
    report = json.loads((folder / "r.json").read_text())
    assert (report["method"], report["beta"]) == ("paper", 0.01)
    assert "untangle-beta" in {step["stage"] for step in report["steps"]}


def test_improve_can_write_over_its_input(call, folder):
    assert call("improve", "tangled.vtu", "tangled.vtu", "--in-place").status == 0
    assert inverted(folder / "tangled.vtu") == 0


def test_quiet_says_nothing(call):
    assert call("improve", "tangled.vtu", "out.vtu", "--quiet") == Outcome(0, "", "")
    with console.progress(quiet=True) as show:
        assert show is None


def test_a_warning_is_one_line_on_standard_error(call, folder):
    mesh = meshio.read(folder / "tangled.vtu")
    points = np.concatenate([mesh.points, [[99.0, 99.0, 0.0]]])
    meshio.Mesh(points, [("triangle", mesh.cells_dict["triangle"][:, ::-1])]).write(folder / "odd.vtu")
    done = call("improve", "odd.vtu", "out.vtu")
    assert done.status == 0
    lines = done.err.splitlines()
    assert len(lines) == 2
    assert all(line.startswith("warning: odd.vtu: ") for line in lines)
    assert any("clockwise" in line for line in lines)
    assert any("belong to no" in line for line in lines)
    assert call("quality", "odd.vtu", "odd.vtu").err == done.err, "each is said once"


@pytest.mark.parametrize(
    "failing", ["torchmesh.files.time_series.SeriesDraft.save", "torchmesh.pictures.pictures.before_after"]
)
def test_all_files_appear_or_none(call, folder, monkeypatch, failing):
    def fail(*_, **__):
        raise MeshIOError("out.vtu: cannot be written: No space left on device")

    before = names(folder)
    monkeypatch.setattr(failing, fail)
    done = call("improve", "tangled.vtu", "out.vtu", "--report", "r.json", "--plot", "p.png")
    assert (done.status, done.err) == (2, "error: out.vtu: cannot be written: No space left on device\n")
    assert names(folder) == before


def test_the_live_line_tells_stage_iteration_and_energy(monkeypatch):
    """Painted ten times a second and at the end: a stage of the real work may be over before its line is painted."""
    screen = io.StringIO()
    monkeypatch.setattr(console, "_stderr", lambda: Console(file=screen, force_terminal=True, width=120))
    with console.progress(quiet=False) as show:
        show(Progress("untangle", meshes=2, inverted=1234, iteration=7, energy=1.5))
    assert " s  untangle: 2 meshes, 1,234 inverted, iteration 7, energy 1.5" in screen.getvalue()


def terminal(
    arguments: list[str], folder: Path, interrupt_at: bytes | None = None, sigint_ignored: bool = False
) -> tuple[int, bytes, str]:
    """Run with standard error on a terminal of its own: exit status, what the terminal got, standard output.

    interrupt_at    send SIGINT when the terminal has got this text
    sigint_ignored  start the process with SIGINT ignored
    """
    import pty

    ours, theirs = pty.openpty()
    with started("-m", "torchmesh", *arguments, cwd=folder, stderr=theirs, sigint_ignored=sigint_ignored) as child:
        os.close(theirs)
        shown = b""
        with contextlib.suppress(OSError):  # raised where the terminal's other end is closed
            while chunk := os.read(ours, 4096):
                shown += chunk
                if interrupt_at and interrupt_at in shown:
                    child.send_signal(signal.SIGINT)
                    interrupt_at = None
        os.close(ours)
        out, _ = child.communicate(timeout=60)
    assert interrupt_at is None, "the text never came, so that nothing was interrupted"
    return child.returncode, shown, out


needs_terminal = pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals here")


@needs_terminal
def test_live_progress_on_a_terminal_that_ignored_interrupts_do_not_end(folder, tmp_path, monkeypatch):
    """Jobs in the background of a script are started to ignore interrupts, which are meant for another program.

    One comes while torch is imported, and one in the midst of the work.
    """
    monkeypatch.setenv("PYTHONPATH", interrupted_at("torch", tmp_path))
    write(folder / "large.vtu", meshes.disturbed(meshes.delaunay(600), 0.05, seed=1))
    status, shown, out = terminal(["improve", "large.vtu", "out.vtu"], folder, b" inverted", sigint_ignored=True)
    assert status == 0
    assert "inverted" not in shown.decode().rsplit("\r\x1b[1A\x1b[2K", 1)[-1], "it is cleared at the end"
    assert "\x1b" not in out, "the table in a pipe is plain text"
    assert b"interrupted" not in shown
    assert inverted(folder / "out.vtu") == 0


@needs_terminal
def test_an_interrupt_leaves_nothing_behind(folder):
    """The work is left in its midst: no table is printed, and no file is new or changed."""
    write(folder / "large.vtu", meshes.disturbed(meshes.delaunay(8000), 0.05, seed=1))
    (folder / "out.vtu").write_text("what was there before")
    before = names(folder)
    arguments = ["improve", "large.vtu", "out.vtu", "--report", "r.json", "--plot", "p.png"]
    status, shown, out = terminal(arguments, folder, interrupt_at=b" inverted")
    assert (status, out) == (130, "")
    assert b"interrupted" in shown
    assert b"Traceback" not in shown
    assert names(folder) == before
    assert (folder / "out.vtu").read_text() == "what was there before"


def test_boundaries_slide_on_request(call, folder):
    done = call("improve", "tangled.vtk", "out.vtk", "--boundary", "slide", "--report", "r.json")
    assert (done.status, done.err) == (0, "")
    before, after = read(folder / "tangled.vtk"), read(folder / "out.vtk")
    assert not np.array_equal(before.points[before.fixed], after.points[before.fixed])
    assert json.loads((folder / "r.json").read_text())["boundary"] == "slide"
    assert call("improve", "tangled.vtk", "kept.vtk").status == 0
    kept = read(folder / "kept.vtk")
    assert np.array_equal(before.points[before.fixed], kept.points[before.fixed])
    assert quality(after).mean.item() < quality(kept).mean.item()


def test_strict_writes_nothing_and_names_what_would_be_lost(call, folder, inline):
    points = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [1.4, 0.5]], float)
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    sides = np.array([[0, 1], [1, 2]])
    meshio.Mesh(points, [("triangle", faces), ("line", sides)], point_data={"t": np.arange(5) / 3}).write(
        folder / "given.vtu"
    )
    before = names(folder)
    done = call("improve", "given.vtu", "out.off", "--strict")
    assert done.status == 2
    assert "out.off: not written, because it would not hold line cells, point data 't'" in done.err
    assert names(folder) == before
    loose = call("improve", "given.vtu", "out.off", "--report", "r.json")
    assert loose.status == 0
    assert "line cells, point data 't'" in loose.err
    assert json.loads((folder / "r.json").read_text())["lost"] == ["line cells", "point data 't'"]
    kept = call("improve", "given.vtu", "out.vtu", "--strict", "--report", "r.json")
    assert (kept.status, kept.err) == (0, "")
    assert json.loads((folder / "r.json").read_text())["lost"] == []
    moved = call("warp", "given.vtu", "moved.off", "--move", "outer:1:1,0", "--strict")
    assert moved.status == 2
    assert not (folder / "moved.off").exists()
    many = call("batch", "given.vtu", "--out", "done", "--format", "off", "--strict", "--workers", "1", "-q")
    assert many.status == 2
    assert not (folder / "done" / "given.off").exists()


def test_interfaces_may_move_and_the_areas_are_told(call, folder):
    mesh = meshes.l_shape(4)
    inner = mesh.constrained_edges[0, 1], mesh.constrained_edges[1, 1]
    points = np.pad(mesh.points.numpy(), ((0, 0), (0, 1)))
    points[list(inner)] = points[list(inner)[::-1]]
    tags = (meshes.l_shape(4).points[mesh.triangles, 0].mean(1) > 1).int().numpy() + 1
    given = meshio.Mesh(points, [("triangle", mesh.triangles.numpy())], cell_data={"region": [tags]})
    given.write(folder / "in.vtu")
    done = call("improve", "in.vtu", "out.vtu")
    assert done.status == 1
    assert "--interfaces free" in done.err
    done = call("improve", "in.vtu", "out.vtu", "--interfaces", "free", "--report", "r.json")
    assert (done.status, done.err) == (0, "")
    assert "interfaces: 2 regions, areas changed by" in done.out
    report = json.loads((folder / "r.json").read_text())
    assert report["interfaces"] == "free"
    assert sum(region["after"] for region in report["regions"]) == pytest.approx(3)
    after = meshio.read(folder / "out.vtu")
    assert inverted(folder / "out.vtu") == 0
    # Vertices may travel from one region to the other, with their triangles; the tags follow the interface.
    a, b, c = (after.points[after.cells_dict["triangle"][:, k], :2].T for k in range(3))
    areas = ((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0]) / 2
    by_tag = [areas[after.cell_data["region"][0] == tag].sum() for tag in (1, 2)]
    assert sorted(by_tag) == pytest.approx(sorted(region["after"] for region in report["regions"]))


def test_scope_damage_leaves_the_rest_to_the_bit(call, folder):
    base = meshes.disturbed(meshes.equilateral(30, 25), 0.08, 0)
    thrown = meshes.disturbed(base, 1.0, 1).points
    near = (base.points - 10.0).norm(dim=1) < 1.8
    points = np.pad(np.where(near.numpy()[:, None], thrown, base.points) * [4.0, 1.0], ((0, 0), (0, 1)))
    meshio.Mesh(points, [("triangle", base.triangles.numpy())]).write(folder / "in.vtu")
    assert inverted(folder / "in.vtu") > 3
    done = call("improve", "in.vtu", "out.vtu", "--scope", "damage", "--report", "r.json")
    assert (done.status, done.err) == (0, "")
    moved = (meshio.read(folder / "out.vtu").points != points).any(1)
    assert 0 < moved.sum() <= len(points) / 8
    assert json.loads((folder / "r.json").read_text())["scope"] == "damage"


def test_a_folded_quad_is_told_and_nothing_is_certified(call, folder):
    done = call("improve", "folded.vtk", "out.vtk", "--report", "report.json")
    assert done.status == 1
    assert "not valid: 1 inverted quad in out.vtk (" in done.err
    assert "1 quad (row 0) is inverted still: with quads='split' (--quads split)" in done.err
    report = json.loads((folder / "report.json").read_text())
    assert (report["valid"], report["certified"]) == (False, False)
    assert (report["before"]["inverted_quads"], report["after"]["inverted_quads"]) == (1, 1)


def test_the_shapes_of_a_reference_are_kept(call, folder):
    from layered import first_heights, round_body, turned_body

    body = round_body(sides=16, rows=5, growth=2.0, around=3)
    write(folder / "body.vtu", body)
    write(folder / "turned.vtu", turned_body(body, 16, 20.0))
    done = call("improve", "turned.vtu", "out.vtu", "--reference", "body.vtu")
    assert done.status == 0, done
    assert torch.allclose(first_heights(read(folder / "out.vtu"), 16), first_heights(body, 16), rtol=1e-6)
    write(folder / "other.vtu", round_body(sides=17))
    done = call("improve", "turned.vtu", "out.vtu", "--reference", "other.vtu")
    assert done.status == 2
    assert "the reference has" in done.err


def layered(named: bool) -> meshio.Mesh:
    """A disc with layers round the unit circle, turned to meshio; the wall is the physical group `airfoil` if named."""
    body = round_body()
    wall = np.stack([np.arange(24), (np.arange(24) + 1) % 24], 1)
    mesh = meshio.Mesh(np.pad(body.points.numpy(), ((0, 0), (0, 1))), [("triangle", body.triangles.numpy())])
    if named:
        mesh.cells.append(meshio.CellBlock("line", wall))
        tags = [np.full(len(b.data), n) for n, b in enumerate(mesh.cells, 1)]
        mesh.cell_data = {"gmsh:physical": tags, "gmsh:geometrical": tags}
        mesh.field_data = {"fluid": np.array([1, 2]), "airfoil": np.array([2, 1])}
    return mesh


@pytest.mark.parametrize("named", [True, False], ids=["a group", "a position"])
def test_found_layers_are_told_with_the_name_of_their_wall_or_its_position(call, folder, named):
    layered(named).write(folder / "layers.msh", file_format="gmsh22", binary=False)
    done = call("improve", "layers.msh", "out.msh", "--report", "r.json")
    assert (done.status, done.err) == (0, "")
    told = re.search(r"found: (layer of 8 at (.*), first height 0.0001: kept)", done.out)
    assert told[1] in json.loads((folder / "r.json").read_text())["message"]
    if named:
        assert told[2] == "wall 'airfoil'"
    else:
        x, y = map(float, re.fullmatch(r"the wall near \((.*), (.*)\)", told[2]).groups())
        assert abs(x * x + y * y - 1) < 1e-5


def test_the_place_of_a_fault_that_is_left_is_printed(call, folder):
    """Two neighbours of the lower side are in one position, so that the triangle on their edge is flat."""
    mesh = meshes.grid(12, 12)
    points = mesh.points.clone()
    points[(points - points.new_tensor([0.75, 0.75])).norm(dim=1).argmin()] += 0.2
    one, other = ((mesh.points - mesh.points.new_tensor([x, 0.0])).norm(dim=1).argmin() for x in (3 / 12, 4 / 12))
    points[one] = points[other]
    write(folder / "fault.vtu", mesh.with_points(points))
    done = call("improve", "fault.vtu", "out.vtu", "--report", "r.json")
    report = json.loads((folder / "r.json").read_text())
    assert (done.status, report["status"]) == (1, "partly")
    said = [line for line in done.err.splitlines() if line.startswith("not valid: 1 inverted triangle in out.vtu")]
    assert len(said) == 1
    assert f"vertices {min(int(one), int(other))} and {max(int(one), int(other))} are both at (0.333333, 0)" in said[0]
    assert call("improve", "fault.vtu", "out.vtu", "--boundary", "slide").status == 0


def split_by(folder, name: str) -> None:
    """A tangle whose left and right half have two numbers in cell data of that name."""
    mesh = meshes.moved_hole()
    points = np.pad(mesh.points.numpy(), ((0, 0), (0, 1)))
    sides = (points[mesh.triangles.numpy(), 0].mean(1) > 0.5).astype(np.int64)
    meshio.Mesh(points, [("triangle", mesh.triangles.numpy())], cell_data={name: [sides]}).write(folder / "parts.vtu")


def test_ranks_are_no_regions_and_it_is_said_which_data_is(call, folder):
    split_by(folder, "mpi_rank")
    done = call("improve", "parts.vtu", "out.vtu", "--report", "report.json")
    assert done.status == 0
    assert "regions: no regions by cell data 'mpi_rank' (--regions NAME takes it)" in done.out
    assert json.loads((folder / "report.json").read_text())["regions_by"]["passed_over"] == ["mpi_rank"]
    split_by(folder, "material")
    done = call("improve", "parts.vtu", "out.vtu", "--interfaces", "free")
    assert "regions: 2 regions by cell data 'material'" in done.out
    assert "regions: " not in call("improve", "tangled.vtu", "out.vtu").out


def test_messages_on_constrained_edges_name_the_array(call, folder):
    points, triangles = meshes.grid_arrays(6, 6)
    sides = (points[triangles, 0].mean(1) > 0.5).astype(np.int64)
    points[(points == [0.5, 0.5]).all(1)] = [0.5, 1.3]  # a vertex of the interface, beyond the boundary
    meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("triangle", triangles)], cell_data={"mpi_rank": [sides]}).write(
        folder / "parts.vtu"
    )
    done = call("improve", "parts.vtu", "out.vtu", "--regions", "mpi_rank", "-q")
    assert done.status == 1
    assert "constrained edges are interfaces between regions by cell data 'mpi_rank'; --regions NAME|none" in done.err
    assert call("improve", "parts.vtu", "out.vtu", "--regions", "none").status == 0
    assert is_one_clear_line(call("improve", "parts.vtu", "out.vtu", "--regions", "rank"), "it has 'mpi_rank'")
