"""Films: every stage is in them, motions glide, flips are cuts."""

import sys

import meshes
import numpy as np
import pytest
import torch

from torchmesh import InvalidMeshError, MeshBatch, MeshIOError, MissingDependencyError, animate, join, quality
from torchmesh.pictures import films

pytest.importorskip("matplotlib")
Image = pytest.importorskip("PIL.Image")


def stages() -> list[tuple[str, MeshBatch]]:
    """Tangled; moved to where it belongs; one edge flipped."""
    valid = meshes.grid(4, 4)
    flipped = valid.triangles.clone()
    a, b, c = valid.triangles[9].tolist()
    row = next(i for i, t in enumerate(valid.triangles.tolist()) if i != 9 and len({a, b, c} & set(t)) == 2)
    other = next(v for v in valid.triangles[row].tolist() if v not in (a, b, c))
    u, v = [w for w in (a, b, c) if w in valid.triangles[row].tolist()]
    apex = next(w for w in (a, b, c) if w not in (u, v))
    flipped[9], flipped[row] = torch.tensor([apex, u, other]), torch.tensor([apex, other, v])
    return [("initial", meshes.disturbed(valid, 0.2, 3)), ("smooth", valid), ("flip", valid.with_triangles(flipped))]


def durations(path) -> list[int]:
    with Image.open(path) as film:
        return [(film.seek(i), film.info["duration"])[1] for i in range(film.n_frames)]


def test_a_gif_holds_the_stages_and_glides_between(tmp_path):
    animate(tmp_path / "film.gif", stages(), title="three stages")
    times = durations(tmp_path / "film.gif")
    assert times[0] == 1500
    assert times[-1] == 3000
    assert times[-2] == 500
    assert set(times[1:-2]) == {60}, "the motion"
    with Image.open(tmp_path / "film.gif") as film:
        film.seek(0)
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(film.n_frames - 1)
        last = np.asarray(film.convert("RGB")).astype(int)
        assert film.info["loop"] == 0
    assert first.shape == last.shape

    def vermilion(image):
        image = image[:, : int(0.85 * image.shape[1])]  # without the key
        r, g, b = np.moveaxis(image, 2, 0)
        return ((r > 180) & (r - g > 60) & (g > 80) & (b < 70)).sum()

    assert int(quality(stages()[0][1]).inverted[0]) > 0
    assert vermilion(first) > 50
    assert vermilion(last) == 0


def test_vertices_glide_in_straight_lines_and_flips_are_cuts():
    (_, first), (_, second), (_, third) = stages()
    ways = films._glide(first, second, pixels_per_unit=1e6)
    assert len(ways) == films._GLIDE - 1
    for k, points in enumerate(ways, 1):
        part = k / films._GLIDE
        assert points == pytest.approx(((1 - part) * first.points + part * second.points).numpy())
    assert films._glide(first, second, pixels_per_unit=1e-6) == [], "nobody would see it move"
    assert films._glide(second, third, pixels_per_unit=1e6) == []
    assert films._glide(second, meshes.grid(5, 5), pixels_per_unit=1e6) == []


def test_an_mp4(tmp_path):
    import imageio_ffmpeg

    animate(tmp_path / "film.mp4", stages()[:2])
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "film.mp4"))
    assert seconds == pytest.approx(1.5 + 3.0 + 5 * 0.06, abs=0.1)
    assert frames == pytest.approx(50 * seconds, abs=2)
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]


def test_bad_films(tmp_path, monkeypatch):
    mesh = meshes.grid()
    with pytest.raises(MeshIOError, match=r"use one of \.gif \.mp4"):
        animate(tmp_path / "film.avi", [("mesh", mesh)])
    with pytest.raises(MeshIOError, match="does not exist"):
        animate(tmp_path / "nowhere" / "film.gif", [("mesh", mesh)])
    with pytest.raises(InvalidMeshError, match="at least one stage"):
        animate(tmp_path / "film.gif", [])
    with pytest.raises(InvalidMeshError, match="'two' is a batch of 2"):
        animate(tmp_path / "film.gif", [("two", join([mesh, mesh]))])
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingDependencyError, match="pip install imageio-ffmpeg"):
        animate(tmp_path / "film.mp4", [("mesh", mesh)])
    assert not list(tmp_path.iterdir())
