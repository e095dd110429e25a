"""Vertices that have passed each other on a straight side go back in order; nothing else of the boundary moves."""

import math

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm
from torchmesh.mesh.batch import join
from torchmesh.mesh.means import local_widths
from torchmesh.smoothing.boundary_order import in_order


def low(mesh: tm.MeshBatch) -> torch.Tensor:
    """The vertices of the lower side of a grid, from left to right."""
    rows = (mesh.points[:, 1] == 0).nonzero().squeeze(1)
    return rows[mesh.points[rows, 0].argsort()]


def passed(shift: dict[int, float], degrees: float = 0.0) -> tuple[tm.MeshBatch, tm.MeshBatch]:
    """A grid, and the same with vertices of its lower side moved along it; both turned."""
    mesh = meshes.grid(8, 8)
    points, side = mesh.points.clone(), low(mesh)
    for k, to in shift.items():
        points[side[k], 0] = to
    turn = lambda p: meshes.turned(p, degrees)  # noqa: E731
    return mesh.with_points(turn(mesh.points)), mesh.with_points(turn(points))


@pytest.mark.parametrize("degrees", [0.0, 31.0])
@pytest.mark.parametrize(
    "shift", [{3: 0.52}, {3: 0.7}, {2: 0.5, 4: 0.25}, {3: 0.5}, {2: 0.5, 3: 0.5}, {5: 0.05, 6: 0.02, 1: 0.9}]
)
def test_the_side_is_in_order_again(shift, degrees):
    mesh, folded = passed(shift, degrees)
    after, moved = in_order(folded)
    side = low(meshes.grid(8, 8))
    along = meshes.turned(after.points[side], -degrees)
    assert bool((along[1:, 0] > along[:-1, 0]).all())
    assert along[:, 1].abs().max() < 1e-12
    others = torch.ones(len(mesh.points), dtype=torch.bool)
    others[side[1:-1]] = False
    assert torch.equal(after.points[others], folded.points[others])
    assert int(moved) == int((after.points != folded.points).any(1).sum()) > 0
    # Positions are exchanged, but for those that were there twice.
    before = {tuple(p) for p in folded.points.tolist()}
    if len(before) == len(mesh.points):
        assert {tuple(p) for p in after.points.tolist()} == before


def test_what_is_in_order_or_held_or_beyond_the_ends_keeps_its_bits():
    mesh, folded = passed({3: 0.7})
    _, beyond = passed({3: 1.2})
    for given, hold in ((mesh, None), (folded, torch.ones(len(mesh.points), dtype=torch.bool)), (beyond, None)):
        after, moved = in_order(given, hold)
        assert after is given
        assert moved.tolist() == [0]
    for name in meshes.VALID:
        valid = meshes.VALID[name]()
        assert in_order(valid)[0] is valid


def test_in_a_batch_as_alone():
    parts = [passed({3: 0.7})[1], meshes.ring(), passed({2: 0.5, 3: 0.5}, 20.0)[1]]
    both, moved = in_order(join(parts))
    for part, joined, count in zip(parts, both.split(), moved.tolist(), strict=True):
        alone, own = in_order(part)
        assert torch.equal(alone.points, joined.points)
        assert own.tolist() == [count]
    assert (moved > 0).tolist() == [True, False, True]


@pytest.mark.parametrize("shift", [{3: 0.52}, {3: 0.5}, {2: 0.5, 4: 0.25}])
def test_sliding_mends_what_fixed_boundaries_cannot(shift):
    # Turned, rounding may leave a boundary that does not cross itself.
    _, report = tm.improve(passed(shift)[1])
    assert report.status.item() in (tm.Status.PARTLY, tm.Status.INFEASIBLE)
    _, folded = passed(shift, 17.0)
    after, report = tm.improve(folded, tm.ImproveOptions(boundary="slide"))
    assert bool(report.valid)
    assert bool(report.certified)
    assert "back in order" in report.messages[0]
    assert math.isclose(float(tm.quality(after).area.sum()), 1.0)
    assert not np.allclose(after.points, folded.points)


def test_the_report_counts_the_vertices_that_were_put_back_in_order():
    _, folded = passed({3: 0.7})
    after, report = tm.improve(folded, tm.ImproveOptions(boundary="slide", workers=1))
    assert bool(report.certified[0])
    side = low(meshes.grid(8, 8))
    # Those that had been passed, and the one that passed them.
    moved = (after.points != folded.points).any(1)
    assert bool(moved[side[3:6]].all())
    assert int(report.moved) == int(moved.sum())
    way = (after.points - folded.points).norm(dim=1) / local_widths(folded)
    assert float(report.travel.max) == pytest.approx(float(way.max()))
