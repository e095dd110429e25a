"""The compiled walk that finds layers against its twin in torch: the same quadrilaterals, heights to the last bit."""

from dataclasses import fields

import pytest
import torch
from layered import flat_layer, round_body
from meshes import delaunay, moved_hole

from torchmesh import join
from torchmesh.layering.layers import LayerOptions, Layers, find_layers
from torchmesh.mesh.detached import without_autograd

OPTIONS = [LayerOptions(), LayerOptions(first=2.0, height=3.0, lean=4.0, alike=8.0, rows=1), LayerOptions(turn=0.99)]


def meshes(generator):
    flat, body = flat_layer(columns=10, rows=9, growth=1.4), round_body(sides=24, rows=6, first=1e-3, growth=1.5)
    for mesh in (flat, body, delaunay(80, seed=3), moved_hole(), join([flat, body])):
        for noise in (0.0, 1e-4, 1e-3, 1e-2):
            shift = torch.randn(mesh.points.shape, generator=generator, dtype=torch.float64)
            yield mesh.with_points(mesh.points + noise * shift)


@pytest.mark.parametrize("options", OPTIONS, ids=["usual", "loose", "straight"])
def test_the_walk_finds_the_same(options, generator):
    found = 0
    for mesh in meshes(generator):
        expected, got = find_layers(mesh, options), without_autograd(find_layers)(mesh, options)
        for f in fields(Layers):
            one, other = getattr(expected, f.name), getattr(got, f.name)
            if f.name == "height":
                torch.testing.assert_close(other, one, rtol=1e-15, atol=0)
            else:
                assert torch.equal(one, other), f.name
        found += len(got)
    assert found > 400


def test_of_two_strips_that_meet_neither_takes_the_triangle_of_the_other():
    # Between two walls that are near, the strips of both claim the triangles in the middle.
    thin = flat_layer(columns=8, rows=3, first=0.02, growth=1.0)
    points = thin.points.clone()
    points[:, 1] = points[:, 1].clamp_max(0.06)
    options = LayerOptions(first=2.0, height=2.0, rows=1, turn=0.1)
    for mesh in (thin, thin.with_points(points)):
        expected, got = find_layers(mesh, options), without_autograd(find_layers)(mesh, options)
        assert torch.equal(expected.triangles, got.triangles)
        assert int(torch.bincount(got.triangles.reshape(-1)).max()) == 1
