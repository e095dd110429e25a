"""Sizes that grow from a few points."""

import math

import meshes
import pytest
import torch
from coarse import strip

from torchmesh.remeshing.point_sources import PointSources, place_sources, triangles_round
from torchmesh.remeshing.sizing import boundary_sizes, continue_inwards


def test_the_integral_counts_the_triangles_round_a_source():
    """`triangles_round` against the sum over thin rings."""
    for part, reach in [(0.01, 1.0), (0.3, 2.0), (1.0, 0.5)]:
        edges = torch.linspace(0, reach, 20_001, dtype=torch.float64)
        middle = 0.5 * (edges[1:] + edges[:-1])
        area = math.pi * (edges[1:].square() - edges[:-1].square())
        size = part + 0.45 * middle
        rings = float((area / (math.sqrt(3) / 4 * size.square())).sum())
        parts, reaches = (torch.tensor(v, dtype=torch.float64) for v in ([part], [[reach]]))
        held = triangles_round(parts, reaches, 0.45)
        assert float(held) == pytest.approx(rings, rel=1e-4)


def test_sizes_grow_from_the_sources_and_stay_below_those_of_the_boundary():
    mesh = strip()
    sources = place_sources(mesh)
    sizes = sources.sizes(mesh)
    boundary = continue_inwards(mesh).logarithm.exp()
    assert bool((sizes <= boundary * (1 + 1e-12)).all())
    assert bool((sizes < 0.5 * boundary).any())
    nowhere = PointSources(*(torch.full_like(v, torch.inf) for v in (sources.x, sources.y, sources.size)), 0.45)
    torch.testing.assert_close(nowhere.sizes(mesh), boundary, rtol=1e-12, atol=0)


def test_the_bend_of_a_strip_is_half_the_square_of_its_half_width():
    mesh = meshes.grid(60, 12)
    length = 1 / 60
    stretched = mesh.with_points(mesh.points * torch.tensor([1.0, 0.2]))
    inward = continue_inwards(stretched)
    middle = (stretched.points - torch.tensor([0.5, 0.1])).norm(dim=1).argmin()
    assert float(inward.bend[middle]) == pytest.approx(0.5 * (0.1 / length) ** 2, rel=0.1)
    sizes = boundary_sizes(stretched, torch.tensor([len(mesh.triangles)]))
    assert torch.equal(sizes[inward.known], inward.length[inward.known])
