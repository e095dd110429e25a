"""Gathering: where a boundary is too coarse for the vertices inside, they crowd in few places."""

import math

import meshes
import pytest
import torch
from judges import assert_every_row_stays

import torchmesh as tm
from torchmesh.mesh import connectivity
from torchmesh.remeshing.condensation import Places, _held, gather, places_of
from torchmesh.remeshing.options import RemeshOptions
from torchmesh.remeshing.relocation import Relocation
from torchmesh.remeshing.sizing import boundary_sizes, continue_inwards


def strip(cells: int = 9, length: float = 20.0, width: float = 1.0) -> tm.MeshBatch:
    """A square's mesh with its boundary laid round a long strip at equal steps: few long edges, many vertices."""
    mesh = meshes.grid(cells, cells)
    rim = connectivity.boundary_edges(mesh.triangles, connectivity.twins(mesh.triangles))
    loop = connectivity.boundary_loops(rim)[0]
    at = torch.arange(len(loop), dtype=torch.float64) / len(loop) * 2 * (length + width)
    corner = torch.tensor([0.0, length, length + width, 2 * length + width], dtype=torch.float64)
    for c in corner:
        at[(at - c).abs().argmin()] = c
    x = torch.where(at < length, at, (2 * length + width - at).clamp(0, length))
    y = (at - length).clamp(0, width) - (at - 2 * length - width).clamp_min(0)
    points = mesh.points.clone()
    points[loop] = torch.stack([x, y], 1)
    after, report = tm.improve(
        tm.relax(mesh.with_points(points)), tm.ImproveOptions(smooth_rounds=3, remesh=RemeshOptions(max_rounds=0))
    )
    assert bool(report.valid)
    return after


@pytest.fixture(scope="module")
def relocated() -> tm.MeshBatch:
    work = Relocation(strip(), RemeshOptions())
    work.improve(torch.ones(1, dtype=torch.bool))
    return work.batch


def test_shapes_gain_what_even_sizes_cost(relocated):
    before = tm.quality(relocated)
    after, flips = gather(relocated, RemeshOptions())
    assert_every_row_stays(relocated, after)
    assert int(flips) > 0
    # Of what the mean is above the ideal, at least a fifth.
    assert float(tm.quality(after).mean) - 1 < 0.8 * (float(before.mean) - 1)


def test_good_meshes_and_those_with_sizes_asked_for_keep_their_bits(relocated):
    good = meshes.equilateral()
    after, flips = gather(tm.join([good, good]), RemeshOptions())
    assert torch.equal(after.points, tm.join([good, good]).points)
    assert flips.tolist() == [0, 0]
    asked, _ = gather(relocated, RemeshOptions(sizes="uniform"))
    assert torch.equal(asked.points, relocated.points)


def test_gathered_in_a_batch_is_gathered_alone(relocated):
    parts = [meshes.grid(5, 4), relocated]
    together, flips = gather(tm.join(parts), RemeshOptions())
    for part, joined, count in zip(parts, together.split(), flips, strict=True):
        alone, own = gather(part, RemeshOptions())
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)
        assert int(own) == int(count)


@pytest.mark.parametrize("scale", [1e-140])
def test_the_unit_of_length_does_not_matter(relocated, scale):
    after, _ = gather(relocated.with_points(relocated.points * scale), RemeshOptions())
    assert float(tm.quality(after).mean) < float(tm.quality(relocated).mean) - 0.05


def test_the_integral_counts_the_triangles_round_a_place():
    """`_held` against the sum over thin rings."""
    for part, reach in [(0.01, 1.0), (0.3, 2.0), (1.0, 0.5)]:
        edges = torch.linspace(0, reach, 20_001, dtype=torch.float64)
        middle = 0.5 * (edges[1:] + edges[:-1])
        area = math.pi * (edges[1:].square() - edges[:-1].square())
        size = part + 0.45 * middle
        rings = float((area / (math.sqrt(3) / 4 * size.square())).sum())
        held = _held(torch.tensor([part], dtype=torch.float64), torch.tensor([[reach]], dtype=torch.float64))
        assert float(held) == pytest.approx(rings, rel=1e-4)


def test_sizes_grow_from_the_places_and_stay_below_those_of_the_boundary(relocated):
    places = places_of(relocated)
    sizes = places.sizes(relocated)
    boundary = continue_inwards(relocated).logarithm.exp()
    assert bool((sizes <= boundary * (1 + 1e-12)).all())
    assert bool((sizes < 0.5 * boundary).any())
    nowhere = Places(*(torch.full_like(v, torch.inf) for v in (places.x, places.y, places.least)))
    torch.testing.assert_close(nowhere.sizes(relocated), boundary, rtol=1e-12, atol=0)


def test_the_bend_of_a_strip_is_half_the_square_of_its_half_width():
    mesh = meshes.grid(60, 12)
    length = 1 / 60
    stretched = mesh.with_points(mesh.points * torch.tensor([1.0, 0.2]))
    inward = continue_inwards(stretched)
    middle = (stretched.points - torch.tensor([0.5, 0.1])).norm(dim=1).argmin()
    assert float(inward.bend[middle]) == pytest.approx(0.5 * (0.1 / length) ** 2, rel=0.1)
    sizes = boundary_sizes(stretched, torch.tensor([len(mesh.triangles)]))
    assert torch.equal(sizes[inward.known], inward.length[inward.known])
