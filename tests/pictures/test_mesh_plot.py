"""One mesh on axes: inverted triangles, and only they, are marked; only what is asked for is drawn."""

import meshes
import numpy as np
import pytest
import torch
from pictured import vermilion

from torchmesh import MeshBatch, quality
from torchmesh.pictures.mesh_plot import plot_mesh

matplotlib = pytest.importorskip("matplotlib")
from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402


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
    assert vermilion(drawn(tangled)[0]) > 60  # the dark hatching covers a part of them
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
