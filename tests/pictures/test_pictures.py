"""Pictures: they show what they should, in full or not at all."""

import subprocess
import sys
from pathlib import Path

import meshes
import numpy as np
import pytest
import torch

from torchmesh import MeshBatch, improve, quality
from torchmesh.errors import MeshIOError, MissingDependencyError
from torchmesh.files.atomic import check_target, replacing
from torchmesh.pictures.pictures import before_after, plot_mesh, short, with_close_up, worst_place

matplotlib = pytest.importorskip("matplotlib")
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402
from matplotlib.image import imread  # noqa: E402


def pixels(path: Path) -> np.ndarray:
    return imread(path)[..., :3]


def vermilion(image: np.ndarray) -> int:
    """How many pixels have the colour of inverted triangles, or that colour over a pale one."""
    r, g, b = np.moveaxis(image, 2, 0)
    # Reddish, but neither the red of the frame (no green in it) nor that red where it fades into a pale mesh.
    return int(((r > 0.7) & (r - g > 0.25) & (g > 0.36) & (b < 0.28)).sum())


def drawn(mesh: MeshBatch, region=None) -> tuple[np.ndarray, object, object]:
    """The pixels, what `plot_mesh` returned, and the axes."""
    figure = Figure(figsize=(4, 3), dpi=100)
    canvas = FigureCanvasAgg(figure)
    ax = figure.add_axes((0, 0, 1, 1))
    fill = plot_mesh(ax, mesh, quality(mesh), region)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3] / 255, fill, ax


def test_inverted_triangles_and_only_they_are_vermilion():
    tangled, valid = meshes.moved_hole(), meshes.grid()
    assert int(quality(tangled).inverted[0]) > 5
    assert vermilion(drawn(tangled)[0]) > 100
    assert vermilion(drawn(valid)[0]) == 0


def test_an_inverted_triangle_too_small_to_see_has_a_mark():
    mesh = meshes.grid(160, 120)
    points = mesh.points.clone()
    row = 40 * 121 + 40
    # Thrown over its neighbours: within a cell of two or three pixels.
    points[row] += torch.tensor([1.2 / 160, 1.4 / 120])
    tangled = mesh.with_points(points)
    bad = ~quality(tangled).upright
    assert 0 < int(bad.sum()) < 10
    image, _, ax = drawn(tangled)
    (marks,) = ax.lines
    centre = tangled.points[tangled.triangles[bad]].mean(1)
    assert marks.get_xydata() == pytest.approx(centre.numpy())
    assert vermilion(image) >= 5


def test_the_marks_of_very_many_inverted_triangles_leave_the_mesh_visible():
    mesh = meshes.jittered(160, 160, 0.6)
    assert int(quality(mesh).inverted[0]) > 10_000
    image, _, _ = drawn(mesh)
    assert 0.1 < vermilion(image) / image[..., 0].size < 0.7


def test_a_region_draws_only_its_triangles():
    mesh = meshes.grid(40, 40)
    _, everything, _ = drawn(mesh)
    _, corner, _ = drawn(mesh, (0.0, 0.0, 0.1, 0.1))
    assert len(everything.get_array()) == 3200
    # 4 x 4 cells of two triangles, and those that touch the rectangle's sides.
    assert 32 <= len(corner.get_array()) <= 50


@pytest.mark.parametrize("aspect", [0.5, 1.0, 1.7])
def test_the_worst_place_holds_inverted_triangles_in_the_shape_asked_for(aspect):
    mesh = meshes.moved_hole()
    q = quality(mesh)
    x0, y0, x1, y1 = worst_place(mesh, q, aspect)
    centre = mesh.points[mesh.triangles[~q.upright]].mean(1)
    inside = (centre >= torch.tensor([x0, y0])) & (centre <= torch.tensor([x1, y1]))
    assert bool(inside.all(1).any())
    assert (y1 - y0) / (x1 - x0) == pytest.approx(aspect)


def test_the_worst_place_of_a_valid_mesh_holds_its_worst_triangle():
    mesh = meshes.delaunay(80, seed=3)
    q = quality(mesh)
    x0, y0, x1, y1 = worst_place(mesh, q)
    x, y = mesh.points[mesh.triangles[q.inverse_mean_ratio.argmax()]].mean(0).tolist()
    assert x0 < x < x1
    assert y0 < y < y1


def test_before_after(tmp_path):
    before = meshes.moved_hole()
    after, _ = improve(before)
    before_after(tmp_path / "picture.png", before, after, title="a hole that moved")
    image = pixels(tmp_path / "picture.png")
    assert image.shape[0] > 800
    assert image.shape[1] > 1000
    assert image.var() > 0.01
    # Left is before; right, short of the key at the far right, is after.
    half = image.shape[1] // 2
    above_histograms = image[: image.shape[0] * 2 // 3]
    assert vermilion(above_histograms[:, :half]) > 200
    assert vermilion(above_histograms[:, half : int(0.88 * image.shape[1])]) == 0
    assert [p.name for p in tmp_path.iterdir()] == ["picture.png"]


@pytest.mark.parametrize("suffix", [".pdf", ".svg", ".PNG"])
def test_other_formats(tmp_path, suffix):
    mesh = meshes.grid()
    before_after(tmp_path / f"picture{suffix}", mesh, mesh)
    head = (tmp_path / f"picture{suffix}").read_bytes()[:200]
    assert {".pdf": b"%PDF", ".svg": b"<?xml", ".PNG": b"\x89PNG"}[suffix] in head


@pytest.mark.parametrize(
    "points",
    [
        [[0, 0], [1e-9, 0], [0, 1e-9]],
        [[0, 0], [1e6, 0], [0, 1.0]],
        [[5, 5], [5.001, 5], [5, 9.0]],
        [[0, 0], [1, 0], [2, 0.0]],
        [[3, 4], [3, 4], [3, 4.0]],
    ],
    ids=["tiny", "wide", "tall", "flat", "point"],
)
def test_a_single_triangle_of_any_size_and_shape(tmp_path, points):
    mesh = MeshBatch.from_arrays(points, [[0, 1, 2]])
    before_after(tmp_path / "picture.png", mesh, mesh)
    assert pixels(tmp_path / "picture.png").var() > 0.001


def test_fifty_thousand_triangles(tmp_path):
    mesh = meshes.jittered(160, 160, 0.3)
    assert len(mesh.triangles) > 50_000
    before_after(tmp_path / "picture.png", mesh, meshes.grid(160, 160))
    assert vermilion(pixels(tmp_path / "picture.png")) > 1000


def test_with_close_up(tmp_path):
    mesh = meshes.moved_hole()
    with_close_up(tmp_path / "figure.png", mesh, (8.0, 4.0, 10.0, 6.0), "Figure 5")
    image = pixels(tmp_path / "figure.png")
    frame = np.array([0xCC, 0, 0]) / 255
    red = (np.abs(image - frame).max(2) < 0.02).any(0)
    assert red[: len(red) // 2].any(), "the whole view has the close-up's rectangle"
    assert not red[len(red) // 2 :].any(), "the close-up has none"


@pytest.mark.parametrize("name", ["picture.bmp", "picture", "picture.jpeg.txt"])
def test_an_unknown_extension_is_one_clear_error(tmp_path, name):
    mesh = meshes.grid()
    with pytest.raises(MeshIOError, match=r"use one of \.png \.pdf \.svg"):
        before_after(tmp_path / name, mesh, mesh)
    assert not list(tmp_path.iterdir())


def test_places_that_cannot_be_written_to(tmp_path, monkeypatch):
    with pytest.raises(MeshIOError, match="does not exist"):
        check_target(tmp_path / "nowhere" / "picture.png")
    with pytest.raises(MeshIOError, match="is a directory"):
        check_target(tmp_path)

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tempfile.mkdtemp", refuse)
    with pytest.raises(MeshIOError, match="cannot be written: Permission denied"):
        check_target(tmp_path / "picture.png")


def test_replacing_leaves_the_old_file_when_the_new_one_fails(tmp_path):
    target = tmp_path / "file.txt"
    target.write_text("old")

    def half(error: Exception) -> None:
        with replacing(target) as path:
            path.write_text("half")
            raise error

    with pytest.raises(ZeroDivisionError):
        half(ZeroDivisionError())
    with pytest.raises(MeshIOError, match=r"file\.txt: cannot be written: No space left on device"):
        half(OSError(28, "No space left on device"))
    with pytest.raises(KeyboardInterrupt):
        half(KeyboardInterrupt())
    assert target.read_text() == "old"
    with replacing(target) as path:
        path.write_text("new")
    assert target.read_text() == "new"
    assert [p.name for p in tmp_path.iterdir()] == ["file.txt"]


def test_without_matplotlib_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    mesh = meshes.grid()
    with pytest.raises(MissingDependencyError, match=r"pip install 'torchmesh-untangle\[plot\]'"):
        before_after(tmp_path / "picture.png", mesh, mesh)
    assert not list(tmp_path.iterdir())


def test_pictures_leave_pyplot_alone(tmp_path):
    code = (
        "import sys, torch; from torchmesh import MeshBatch; from torchmesh.pictures.pictures import before_after\n"
        "assert 'matplotlib' not in sys.modules\n"
        "mesh = MeshBatch.from_arrays([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])\n"
        f"before_after({str(tmp_path / 'p.png')!r}, mesh, mesh)\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0, "1.000"), (999.9, "999.900"), (4943.76, "4,944"), (1e6, "1.0e+06"), (float("inf"), "inf")],
)
def test_short(value, text):
    assert short(value) == text
