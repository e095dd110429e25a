"""Pictures in files: they show what they should, in full or not at all."""

import subprocess
import sys

import meshes
import numpy as np
import pytest
from pictured import pixels, vermilion

from torchmesh import MeshBatch, improve
from torchmesh.errors import MeshIOError, MissingDependencyError
from torchmesh.pictures.pictures import before_after, with_close_up

pytest.importorskip("matplotlib")


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


def test_without_matplotlib_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    mesh = meshes.grid()
    with pytest.raises(MissingDependencyError, match=r"pip install 'torchmesh-untangle\[plot\]'"):
        before_after(tmp_path / "picture.png", mesh, mesh)
    assert not list(tmp_path.iterdir())


def test_pictures_and_films_leave_pyplot_alone(tmp_path):
    code = (
        "import sys, torch; from torchmesh import MeshBatch, animate\n"
        "from torchmesh.pictures.pictures import before_after\n"
        "assert 'matplotlib' not in sys.modules\n"
        "mesh = MeshBatch.from_arrays([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]])\n"
        f"before_after({str(tmp_path / 'p.png')!r}, mesh, mesh)\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
        f"animate({str(tmp_path / 'film.gif')!r}, [('mesh', mesh)])\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
