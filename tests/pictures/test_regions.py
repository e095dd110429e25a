"""Where the close-up is taken: there the triangles are inverted, or else worst."""

import meshes
import pytest
import torch

from torchmesh import quality
from torchmesh.pictures.regions import within, worst_region


@pytest.mark.parametrize("aspect", [0.5, 1.0, 1.7])
def test_the_worst_region_holds_inverted_triangles_in_the_shape_asked_for(aspect):
    mesh = meshes.moved_hole()
    q = quality(mesh)
    x0, y0, x1, y1 = worst_region(mesh, q, aspect)
    centre = mesh.points[mesh.triangles[~q.upright]].mean(1)
    inside = (centre >= torch.tensor([x0, y0])) & (centre <= torch.tensor([x1, y1]))
    assert bool(inside.all(1).any())
    assert (y1 - y0) / (x1 - x0) == pytest.approx(aspect)


def test_the_worst_region_of_a_valid_mesh_holds_its_worst_triangle():
    mesh = meshes.delaunay(80, seed=3)
    q = quality(mesh)
    x0, y0, x1, y1 = worst_region(mesh, q)
    x, y = mesh.points[mesh.triangles[q.inverse_mean_ratio.argmax()]].mean(0).tolist()
    assert x0 < x < x1
    assert y0 < y < y1


def test_a_rectangle_moves_into_the_view_only_as_far_as_it_must():
    view = (0.0, 0.0, 10.0, 10.0)
    assert within((2.0, 3.0, 4.0, 5.0), view) == (2.0, 3.0, 4.0, 5.0)
    assert within((-1.0, 9.0, 1.0, 11.0), view) == (0.0, 8.0, 2.0, 10.0)
