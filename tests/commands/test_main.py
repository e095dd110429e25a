"""The command line, as processes and, where only the message matters, called in this process."""

import contextlib
import json
import math
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import meshes
import meshio
import numpy as np
import pytest
from exact import double_area

from torchmesh import MeshBatch, metrics, quality
from torchmesh.commands import console
from torchmesh.commands import main as cli
from torchmesh.commands import motion_options as motions
from torchmesh.errors import MeshIOError
from torchmesh.files.mesh_files import read, write


@dataclass(frozen=True)
class Outcome:
    status: int
    out: str
    err: str


def process(*arguments: object, folder: Path) -> Outcome:
    """`python -m torchmesh` with the arguments, run in `folder`."""
    command = [sys.executable, "-m", "torchmesh", *map(str, arguments)]
    environment = os.environ | {"PYTHONWARNINGS": "error::DeprecationWarning"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
    return Outcome(done.returncode, done.stdout, done.stderr)


Call = Callable[..., Outcome]


@pytest.fixture
def call(capsys, monkeypatch, folder) -> Call:
    """The same in this process, without the cost of a start."""

    def run(*arguments: object) -> Outcome:
        monkeypatch.chdir(folder)
        capsys.readouterr()
        status = cli.main([*map(str, arguments)])
        said = capsys.readouterr()
        return Outcome(status, said.out, said.err)

    return run


@pytest.fixture(scope="module")
def originals(tmp_path_factory) -> Path:
    """The files of the examples in the help texts, and some that are bad."""
    folder = tmp_path_factory.mktemp("files")
    for name in ("tangled.vtu", "tangled.vtk", "tangled.msh"):
        write(folder / name, meshes.moved_hole())
    for part in ("a", "b"):
        (folder / "in" / part).mkdir(parents=True)
        write(folder / "in" / part / "mesh.vtu", meshes.jittered())
    write(folder / "better.vtu", meshes.equilateral())
    points, triangles = plate()
    write(folder / "plate.msh", MeshBatch.from_arrays(points, triangles))
    on_hole = (np.abs(points - 0.5).max(1) < 0.21)[:, None]
    displacement = on_hole * np.array([[0.1, 0.05, 0.0]])
    meshio.Mesh(points, [("triangle", triangles)], point_data={"displacement": displacement, "u": points[:, 0]}).write(
        folder / "plate.vtu"
    )
    crossed().write(folder / "crossed.vtu")
    (folder / "empty.vtu").touch()
    (folder / "folder.vtu").mkdir()
    (folder / "unknown.foo").write_text("hello\n")
    (folder / "broken.vtu").write_bytes((folder / "tangled.vtu").read_bytes()[:700])
    points, triangles = meshes.grid_arrays(3, 3)
    points = np.pad(points, ((0, 0), (0, 1)))
    points[5, 1] = math.nan
    meshio.Mesh(points, [("triangle", triangles)]).write(folder / "nan.vtk", file_format="vtk42", binary=False)
    meshio.Mesh(points[:4], [("quad", np.array([[0, 1, 2, 3]]))]).write(folder / "quads.vtu")
    return folder


@pytest.fixture
def folder(originals, tmp_path) -> Path:
    shutil.copytree(originals, tmp_path / "work")
    return tmp_path / "work"


def plate() -> tuple[np.ndarray, np.ndarray]:
    """The unit square of 10 x 10 cells, the middle 4 x 4 of them cut out."""
    points, triangles = meshes.grid_arrays(10, 10)
    inside = (np.abs(points[triangles].mean(1) - 0.5) < 0.2).all(1)
    used, triangles = np.unique(triangles[~inside], return_inverse=True)
    return points[used], triangles.reshape(-1, 3)


def crossed() -> meshio.Mesh:
    """A square one of whose corners was pulled through the opposite side: nothing can untangle it."""
    points, triangles = meshes.grid_arrays(6, 6)
    points[0] = 1.4
    return meshio.Mesh(points, [("triangle", triangles)])


def inverted(path: Path) -> int:
    """By numpy and exact rational arithmetic, not by torchmesh."""
    mesh = meshio.read(path)
    return sum(double_area(*mesh.points[row, :2]) <= 0 for row in mesh.cells_dict["triangle"])


def names(folder: Path) -> set[str]:
    return {p.name for p in folder.rglob("*")}


# --- improve -----------------------------------------------------------------------------------------


def test_improve_writes_a_valid_mesh_a_report_and_a_picture(folder):
    before = names(folder)
    done = process("improve", "tangled.vtk", "out.vtu", "--report", "r.json", "--plot", "p.png", folder=folder)
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


def test_improve_says_so_when_a_mesh_cannot_be_made_valid(folder):
    done = process("improve", "crossed.vtu", "out.vtu", "--report", "r.json", folder=folder)
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
    assert call("improve", "tangled.vtu", "tangled.vtu").status == 0
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


@pytest.mark.parametrize("failing", ["torchmesh.files.mesh_files.write", "torchmesh.pictures.pictures.before_after"])
def test_all_files_appear_or_none(call, folder, monkeypatch, failing):
    def fail(*_, **__):
        raise MeshIOError("out.vtu: cannot be written: No space left on device")

    before = names(folder)
    monkeypatch.setattr(failing, fail)
    done = call("improve", "tangled.vtu", "out.vtu", "--report", "r.json", "--plot", "p.png")
    assert (done.status, done.err) == (2, "error: out.vtu: cannot be written: No space left on device\n")
    assert names(folder) == before


def terminal(arguments: list[str], folder: Path, interrupt_at: bytes | None = None) -> tuple[int, bytes, str]:
    """Run with standard error on a terminal of its own; status, what the terminal got, standard output."""
    import pty

    ours, theirs = pty.openpty()
    run = subprocess.Popen(
        [sys.executable, "-m", "torchmesh", *arguments], cwd=folder, stderr=theirs, stdout=subprocess.PIPE, text=True
    )
    os.close(theirs)
    shown = b""
    with contextlib.suppress(OSError):  # raised where the terminal's other end is closed
        while chunk := os.read(ours, 4096):
            shown += chunk
            if interrupt_at and interrupt_at in shown:
                run.send_signal(signal.SIGINT)
                interrupt_at = None
    os.close(ours)
    out, _ = run.communicate(timeout=60)
    return run.returncode, shown, out


needs_terminal = pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals here")


@needs_terminal
def test_live_progress_on_a_terminal(folder):
    write(folder / "large.vtu", meshes.disturbed(meshes.delaunay(3000), 0.05, seed=1))
    status, shown, out = terminal(["improve", "large.vtu", "out.vtu"], folder)
    assert status == 0
    assert b"inverted, iteration" in shown
    assert b"energy" in shown
    assert "inverted" not in shown.decode().rsplit("\r\x1b[1A\x1b[2K", 1)[-1], "it is cleared at the end"
    assert "\x1b" not in out, "the table in a pipe is plain text"


@needs_terminal
def test_an_interrupt_leaves_nothing_behind(folder):
    write(folder / "large.vtu", meshes.disturbed(meshes.delaunay(20_000), 0.05, seed=1))
    (folder / "out.vtu").write_text("what was there before")
    before = names(folder)
    arguments = ["improve", "large.vtu", "out.vtu", "--report", "r.json", "--plot", "p.png"]
    started = time.perf_counter()
    status, shown, out = terminal(arguments, folder, interrupt_at=b" inverted")
    assert (status, out) == (130, "")
    assert b"interrupted" in shown
    assert b"Traceback" not in shown
    assert time.perf_counter() - started < 30
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


# --- quality -----------------------------------------------------------------------------------------


def test_quality_tables(folder):
    done = process("quality", "tangled.vtu", "better.vtu", folder=folder)
    assert (done.status, done.err) == (1, "")
    lines = [line.split() for line in done.out.splitlines()]
    mesh = read(folder / "tangled.vtu")
    row = next(line for line in lines if line[:1] == ["tangled.vtu"])
    assert row[1:3] == [str(len(mesh.triangles)), str(inverted(folder / "tangled.vtu"))]
    row = next(line for line in lines if line[:1] == ["better.vtu"])
    assert row[1:] == ["40", "0", "1.000", "1.000", "60.000"]
    assert "worst triangles of tangled.vtu" in done.out
    worst = [line for line in lines if line[-1:] == ["inverted"]]
    assert len(worst) == 10
    area = quality(mesh).area
    place = mesh.points[mesh.triangles[int(worst[0][0])]].mean(0).tolist()
    assert int(worst[0][0]) == int(area.argmin()), "the largest inverted triangle leads"
    assert [float(x) for x in worst[0][3:5]] == pytest.approx(place, rel=1e-5)


def test_quality_json(call, folder):
    done = call("quality", "tangled.vtu", "better.vtu", "--json", "--worst", 3)
    assert (done.status, done.err) == (1, "")
    tangled, better = json.loads(done.out, parse_constant=pytest.fail)
    keys = {"file", "triangles", "vertices", "inverted", "imr_average", "imr_maximum", "minimum_angle", "worst"}
    assert set(tangled) == set(better) == keys
    assert (tangled["file"], tangled["inverted"]) == ("tangled.vtu", inverted(folder / "tangled.vtu"))
    assert better["minimum_angle"] == pytest.approx(60)
    assert [len(r["worst"]) for r in (tangled, better)] == [3, 3]
    for worst in tangled["worst"]:
        assert set(worst) == {"row", "inverted", "imr", "area", "centroid"}
        assert worst["inverted"] is True
        assert worst["area"] < 0


def test_quality_metrics(call, folder):
    done = call("quality", "tangled.vtu", "better.vtu", "--metrics", "minimum_angle,edge_ratio", "--worst", 0)
    lines = [line.split() for line in done.out.splitlines()]
    assert ["metric", "min", "p5", "median", "p95", "max", "mean"] in lines
    assert ["minimum_angle", *["60.000"] * 6] in lines
    assert ["edge_ratio", *["1.000"] * 6] in lines
    done = call("quality", "tangled.vtu", "--metrics", "all", "--json")
    (record,) = json.loads(done.out, parse_constant=pytest.fail)
    assert list(record["metrics"]) == list(metrics.METRICS)
    assert record["metrics"]["inverse_mean_ratio"]["max"] == record["imr_maximum"]
    assert record["metrics"]["minimum_angle"]["min"] == pytest.approx(record["minimum_angle"], rel=1e-14)
    assert set(record["metrics"]["area"]) == {"min", "mean", "max", "p5", "p50", "p95"}


def test_quality_says_how_edges_follow_sizes(call, folder):
    lengths = {"boundary": 1.0, "uniform": 1.0, "0.5": 2.0}
    for sizes, mean in lengths.items():
        done = call("quality", "better.vtu", "--sizes", sizes, "--json")
        (record,) = json.loads(done.out)
        found = record["edge_length_over_size"]
        # Equilateral triangles of side 1; "uniform" knows the area only.
        assert found == {name: pytest.approx(mean, rel=1e-6) for name in ("mean", "p5", "p95")}
    done = call("quality", "better.vtu", "--sizes", 2, "--worst", 0)
    assert "edge length / size" in done.out
    assert "0.50 (0.50 - 0.50)" in done.out
    file = meshio.read(folder / "better.vtu")
    file.point_data["length"] = np.full(len(file.points), 4.0)
    file.write(folder / "sized.vtu")
    (record,) = json.loads(call("quality", "sized.vtu", "--sizes", "length", "--json").out)
    assert record["edge_length_over_size"]["mean"] == pytest.approx(0.25)
    for wrong, text in (("0", "must be a positive length"), ("nan", "positive length"), ("width", "nor a point field")):
        done = call("quality", "sized.vtu", "--sizes", wrong)
        assert done.status == 2
        assert text in done.err


def test_a_metric_that_does_not_exist_is_refused(call):
    done = call("quality", "better.vtu", "--metrics", "area,skew")
    assert (done.status, done.out) == (2, "")
    assert "error: --metrics: there is no 'skew'; there are all, area," in done.err


def test_worst_upright_triangles_follow_by_shape(call, folder):
    write(folder / "random.vtu", meshes.delaunay(60, seed=1))
    (record,) = json.loads(call("quality", "random.vtu", "--json").out)
    shapes = [w["imr"] for w in record["worst"]]
    assert shapes == sorted(shapes, reverse=True)
    assert shapes[0] == record["imr_maximum"]
    assert len(shapes) == 10


def test_a_flat_triangle_is_null_in_json(call, folder):
    mesh = meshio.Mesh([[0, 0], [1, 0], [2, 0], [1, 1.0]], [("triangle", [[0, 1, 2], [0, 2, 3]])])
    mesh.write(folder / "flat.vtu")
    done = call("quality", "flat.vtu", "--json")
    (record,) = json.loads(done.out, parse_constant=pytest.fail)
    assert record["imr_maximum"] is None
    assert record["inverted"] == 1
    assert done.status == 1
    assert "inf" in call("quality", "flat.vtu").out


def test_quality_of_a_plane_in_space_gives_places_in_space(call, folder):
    points, triangles = meshes.grid_arrays(3, 3)
    upright = np.pad(points, ((0, 0), (1, 0)), constant_values=7.0)
    meshio.Mesh(upright, [("triangle", triangles)]).write(folder / "wall.vtu")
    (record,) = json.loads(call("quality", "wall.vtu", "--json", "--worst", 1).out)
    worst = record["worst"][0]
    assert worst["centroid"] == pytest.approx(upright[triangles[worst["row"]]].mean(0).tolist())


def test_quality_goes_on_after_a_bad_file(call):
    done = call("quality", "missing.vtu", "better.vtu", "empty.vtu")
    assert done.status == 2
    assert [line.split(":")[:2] for line in done.err.splitlines()] == [
        ["error", " missing.vtu"],
        ["error", " empty.vtu"],
    ]
    assert "better.vtu" in done.out


# --- warp --------------------------------------------------------------------------------------------


def test_warp_lists_the_parts_of_the_boundary(call):
    done = call("warp", "plate.msh", "--list")
    assert (done.status, done.err) == (0, "")
    rows = [line.split() for line in done.out.splitlines()]
    assert ["outer:1", "40", "0", "1", "0", "1"] in rows
    assert ["hole:1", "16", "0.3", "0.7", "0.3", "0.7"] in rows


def moved(folder: Path) -> np.ndarray:
    """(V, 2) how far each vertex of plate.msh went on its way to out.vtu."""
    return (read(folder / "out.vtu").points - read(folder / "plate.msh").points).numpy()


def parts() -> tuple[np.ndarray, np.ndarray]:
    points, _ = plate()
    return np.abs(points - 0.5).max(1) < 0.21, np.abs(points - 0.5).max(1) > 0.49


def test_warp_moves_a_hole_and_carries_the_interior_along(folder):
    done = process("warp", "plate.msh", "out.vtu", "--move", "hole:1:0.1,0.05", folder=folder)
    assert (done.status, done.err) == (0, "")
    by, (hole, rim) = moved(folder), parts()
    assert by[hole] == pytest.approx(np.tile([0.1, 0.05], (16, 1)))
    assert (by[rim] == 0).all()
    between = by[~hole & ~rim]
    assert (between[:, 0] > 0).all()
    assert (between[:, 0] < 0.1).all()
    assert (read(folder / "out.vtu").triangles == read(folder / "plate.msh").triangles).all()


def test_warp_turns_about_the_middle_or_a_point(call, folder):
    points, (hole, _) = plate()[0], parts()
    assert call("warp", "plate.msh", "out.vtu", "--rotate", "hole:1:90").status == 0
    x, y = points[hole].T - 0.5
    assert points[hole] + moved(folder)[hole] == pytest.approx(np.stack([0.5 - y, 0.5 + x], 1))
    assert call("warp", "plate.msh", "out.vtu", "--rotate", "hole:1:90:0.5,0.4").status == 0
    x, y = (points[hole] - [0.5, 0.4]).T
    assert points[hole] + moved(folder)[hole] == pytest.approx(np.stack([0.5 - y, 0.4 + x], 1))


def test_warp_moves_what_lies_in_a_box_and_moves_add_up(call, folder):
    box = ["--move", "-1,-1,0.001,2:-0.1,0", "--move", "outer:1:0,0.2"]
    assert call("warp", "plate.msh", "out.vtu", *box).status == 0
    points, (hole, rim) = plate()[0], parts()
    left = points[:, 0] == 0
    by = moved(folder)
    assert by[left] == pytest.approx(np.tile([-0.1, 0.2], (11, 1)))
    assert by[rim & ~left] == pytest.approx(np.tile([0.0, 0.2], (29, 1)))
    assert (by[hole] == 0).all()


def test_warp_by_a_point_field(call, folder):
    assert call("warp", "plate.vtu", "out.vtu", "--displacement", "displacement").status == 0
    hole, rim = parts()
    assert moved(folder)[hole] == pytest.approx(np.tile([0.1, 0.05], (16, 1)))
    assert (moved(folder)[rim] == 0).all()


def test_a_warp_that_tangles_says_how_much_and_improve_mends_it(call, folder):
    far = ["--move", "hole:1:0.2,0", "--rotate", "hole:1:45"]
    done = call("warp", "plate.msh", "out.vtu", *far)
    count = inverted(folder / "out.vtu")
    assert count > 0
    assert done.status == 0, "warp does not promise a valid mesh"
    assert done.err == f"{count} inverted triangles in out.vtu; to mend: torchmesh improve out.vtu OUT\n"
    done = call("warp", "plate.msh", "out.vtu", *far, "--improve")
    assert (done.status, done.err) == (0, "")
    assert inverted(folder / "out.vtu") == 0
    assert [word in done.out for word in ("undeformed", "warped", "improved")] == [True] * 3


@pytest.mark.parametrize("steps", ["auto", "3"])
def test_a_warp_in_steps_never_tangles(call, folder, steps):
    done = call("warp", "plate.msh", "out.vtu", "--rotate", "hole:1:180", "--move", "hole:1:0.1,0", "--steps", steps)
    assert (done.status, done.err) == (0, "")
    assert inverted(folder / "out.vtu") == 0
    assert "arrived in" in done.out
    assert [word in done.out for word in ("undeformed", "deformed")] == [True] * 2
    hole, rim = parts()
    points = plate()[0]
    assert points[hole] + moved(folder)[hole] == pytest.approx(1 - points[hole] + [0.1, 0.0])
    assert (moved(folder)[rim] == 0).all()


def test_a_warp_in_steps_stops_at_the_wall(call, folder):
    done = call("warp", "plate.msh", "out.vtu", "--move", "hole:1:2,0", "--steps", "auto", "-q")
    assert done.status == 1
    assert done.out == ""
    assert done.err.startswith("not at the goal: out.vtu is valid, but stuck after ")
    assert "outside the outer loop" in done.err
    assert inverted(folder / "out.vtu") == 0


def test_bad_steps_are_usage_errors(call):
    for steps in ("0", "-1", "many", "1.5", ""):
        done = call("warp", "plate.msh", "out.vtu", "--move", "hole:1:0.1,0", f"--steps={steps}")
        assert done.status == 2
        assert "expected auto or a number of steps" in done.err
    done = call("warp", "plate.msh", "out.vtu", "--move", "hole:1:0.1,0", "--steps", "2", "--improve")
    assert done.status == 2
    assert "--improve" in done.err


def test_holes_are_numbered_from_left_to_right():
    points, triangles = meshes.grid_arrays(9, 3)
    cell = np.floor(points[triangles].mean(1) * [9, 3]).astype(int)
    holes = (cell == [1, 1]).all(1) | (cell == [4, 1]).all(1) | (cell == [7, 1]).all(1)
    for order in (slice(None), slice(None, None, -1)):
        loops = motions.loops(MeshBatch.from_arrays(points, triangles[~holes][order]))
        assert list(loops) == ["outer:1", "hole:1", "hole:2", "hole:3"]
        middle = [float(points[loop.numpy(), 0].mean()) for loop in loops.values()]
        assert middle == pytest.approx([0.5, 1.5 / 9, 4.5 / 9, 7.5 / 9])


def test_warp_by_a_point_field_in_a_plane_of_space(call, folder):
    points, triangles = plate()
    wall = np.pad(points, ((0, 0), (1, 0)), constant_values=7.0)
    hole, rim = parts()
    fields = {"along": hole[:, None] * [0.0, 0.1, 0.05], "out": hole[:, None] * [0.1, 0.0, 0.05]}
    meshio.Mesh(wall, [("triangle", triangles)], point_data=fields).write(folder / "wall.vtu")
    assert call("warp", "wall.vtu", "out.vtu", "--displacement", "along").status == 0
    by = meshio.read(folder / "out.vtu").points - wall
    assert by[hole] == pytest.approx(np.tile([0.0, 0.1, 0.05], (16, 1)), abs=1e-12)
    assert by[rim] == pytest.approx(0)
    done = call("warp", "wall.vtu", "out.vtu", "--displacement", "out")
    assert is_one_clear_line(done, "it leaves the plane")


# --- bad input and usage -----------------------------------------------------------------------------

TO = ["improve", "tangled.vtu"]
WARP = ["warp", "plate.vtu", "out.vtu"]
BAD = {
    "missing file": (["improve", "missing.vtu", "out.vtu"], "missing.vtu: there is no such file"),
    "a directory": (["improve", "folder.vtu", "out.vtu"], "folder.vtu: is a directory"),
    "empty file": (["improve", "empty.vtu", "out.vtu"], "empty.vtu: the file is empty"),
    "unknown extension": (["improve", "unknown.foo", "out.vtu"], "'.foo' is not known"),
    "truncated": (["improve", "broken.vtu", "out.vtu"], "broken.vtu: cannot be read"),
    "not a number": (["improve", "nan.vtk", "out.vtu"], "points row 5 is"),
    "no triangles": (["improve", "quads.vtu", "out.vtu"], "quads.vtu: no triangles"),
    "no output directory": ([*TO, "nowhere/out.vtu"], "does not exist"),
    "unknown output extension": ([*TO, "out.foo"], "'.foo' is not known"),
    "output is a directory": ([*TO, "folder.vtu"], "folder.vtu: is a directory"),
    "unknown picture": ([*TO, "out.vtu", "--plot", "p.bmp"], "p.bmp: the extension '.bmp' is no picture's"),
    "no picture directory": ([*TO, "out.vtu", "--plot", "nowhere/p.png"], "does not exist"),
    "no report directory": ([*TO, "out.vtu", "--report", "nowhere/r.json"], "does not exist"),
    "report is a directory": ([*TO, "out.vtu", "--report", "folder.vtu"], "is a directory"),
    "one file for two": ([*TO, "out.vtu", "--report", "./out.vtu"], "named twice"),
    "report over input": ([*TO, "out.vtu", "--report", "tangled.vtu"], "named twice"),
    "beta of the default": ([*TO, "out.vtu", "--beta", "1"], "--beta needs --method paper"),
    "negative beta": ([*TO, "out.vtu", "--method", "paper", "--beta", "-1"], "must not be negative"),
    "infinite beta": ([*TO, "out.vtu", "--method", "paper", "--beta", "inf"], "finite"),
    "beta a word": ([*TO, "out.vtu", "--method", "paper", "--beta", "small"], "--beta"),
    "unknown method": ([*TO, "out.vtu", "--method", "best"], "--method"),
    "no threads": ([*TO, "out.vtu", "--threads", "0"], "--threads"),
    "no output": (TO, "OUT"),
    "no file": (["quality"], "FILE"),
    "quality of a missing file": (["quality", "missing.vtu"], "missing.vtu: there is no such file"),
    "unknown command": (["untangle"], "untangle"),
    "unknown option": ([*TO, "out.vtu", "--fast"], "--fast"),
    "nothing to move": (WARP, "nothing to move"),
    "nowhere to write": (["warp", "plate.vtu", "--move", "hole:1:1,0"], "Missing argument 'OUT'"),
    "list and more": ([*WARP, "--list"], "--list goes with IN alone"),
    "no such hole": ([*WARP, "--move", "hole:2:1,0"], "there is no hole:2, only outer:1, hole:1"),
    "no such part": ([*WARP, "--move", "slot:1,0"], "'slot' is not 4 numbers"),
    "hole without number": ([*WARP, "--move", "hole:1,0"], "expected hole:N:DX,DY"),
    "one number": ([*WARP, "--move", "hole:1:1"], "'1' is not 2 numbers"),
    "infinitely far": ([*WARP, "--move", "hole:1:inf,0"], "'inf,0' is not 2 numbers"),
    "empty box": ([*WARP, "--move", "5,5,6,6:1,0"], "no boundary vertex"),
    "box inside the mesh": ([*WARP, "--move", "0.05,0.05,0.15,0.15:1,0"], "no boundary vertex"),
    "no angle": ([*WARP, "--rotate", "hole:1"], "expected hole:N:DEG"),
    "angle a word": ([*WARP, "--rotate", "hole:1:left"], "'left' is not a number"),
    "no such field": ([*WARP, "--displacement", "w"], "it has 'displacement', 'u'"),
    "a field of numbers": ([*WARP, "--displacement", "u"], "not a vector"),
    "warp of a tangled mesh": (["warp", "tangled.vtu", "out.vtu", "--move", "hole:1:1,0"], "tangled.vtu: mesh 0"),
    "reproduce into a file": (["reproduce", "--out", "unknown.foo"], "unknown.foo: cannot be made a directory"),
}


def is_one_clear_line(done: Outcome, text: str) -> bool:
    return done.status == 2 and done.err.startswith("error: ") and done.err.count("\n") == 1 and text in done.err


@pytest.mark.parametrize(("arguments", "text"), BAD.values(), ids=BAD)
def test_bad_input_is_one_clear_line_and_no_file(call, folder, arguments, text):
    before = names(folder)
    done = call(*arguments)
    assert is_one_clear_line(done, text), done
    assert names(folder) == before


@pytest.mark.parametrize("case", [case for case in BAD if "output" in case or "picture" in case or "report" in case])
def test_places_to_write_to_are_checked_before_the_work(call, monkeypatch, case):
    monkeypatch.setattr("torchmesh.files.mesh_files.read", lambda *_: pytest.fail("the work began"))
    arguments, text = BAD[case]
    assert is_one_clear_line(call(*arguments), text)


@pytest.mark.parametrize("case", ["not a number", "unknown method"])
def test_bad_input_as_a_process(folder, case):
    arguments, text = BAD[case]
    before = names(folder)
    done = process(*arguments, folder=folder)
    assert is_one_clear_line(done, text), done
    assert done.out == ""
    assert names(folder) == before


def test_a_place_that_refuses_writing(call, folder, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    before = names(folder)
    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    done = call("improve", "tangled.vtu", "out.vtu")
    assert is_one_clear_line(done, "out.vtu: cannot be written: Permission denied")
    assert names(folder) == before


def test_an_unforeseen_error_is_not_hidden(call, monkeypatch):
    def fail(*_, **__):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("torchmesh.files.mesh_files.read", fail)
    with pytest.raises(ZeroDivisionError):
        call("quality", "better.vtu")


# --- help --------------------------------------------------------------------------------------------


def test_version_and_help_as_a_process(folder):
    from importlib.metadata import version

    assert process("--version", folder=folder) == Outcome(0, f"torchmesh {version('torchmesh-untangle')}\n", "")
    done = process("--help", folder=folder)
    assert (done.status, done.err) == (0, "")
    for command in ("improve", "quality", "warp", "reproduce"):
        assert command in done.out


def test_no_arguments_is_a_request_for_help(call):
    done = call()
    assert done.status == 2
    assert "Usage: torchmesh" in done.out


EXAMPLES = [
    example
    for command in cli.app.registered_commands
    for example in (command.epilog or "").split("\n\n")[1:]
    if not example.startswith("torchmesh reproduce")  # test_reproduction runs them
]


def test_every_command_has_examples_in_its_help(call):
    assert len(EXAMPLES) >= 12
    for command in cli.app.registered_commands:
        name = command.callback.__name__
        done = call(name, "--help")
        assert done.status == 0
        assert "Examples:" in done.out
        assert f"torchmesh {name}" in done.out


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_examples_of_the_help_run(call, example):
    program, *arguments = shlex.split(example)
    assert program == "torchmesh"
    if "--count" in arguments:  # a few are as good a test
        arguments[arguments.index("--count") + 1] = "3"
    done = call(*arguments)
    tangled = arguments[0] == "quality" and "tangled.vtu" in arguments
    assert done.status == (1 if tangled else 0), done


def test_nothing_heavy_is_imported_by_the_command_line_itself():
    """So that --help does not wait for torch."""
    heavy = ("torch", "numpy", "scipy", "meshio", "matplotlib")
    code = f"import sys, torchmesh.commands.main; print(*(m for m in {heavy!r} if m in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout.split(), done.stderr) == (0, [], "")
