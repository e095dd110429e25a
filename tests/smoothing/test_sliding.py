import dataclasses
import functools
import math

import meshes
import numpy as np
import pytest
import together
import torch
from exact import inverted, total_area

import torchmesh as tm
from torchmesh import ImproveOptions, MeshBatch, SmoothOptions, Status, diagnose, improve, join, quality, smooth
from torchmesh.mesh import connectivity
from torchmesh.mesh.interfaces import holding
from torchmesh.mesh.triangle import corners, signed_area
from torchmesh.optimising.energies import InverseMeanRatio
from torchmesh.optimising.jacobian import equilateral
from torchmesh.optimising.objective import MeshObjective, pack
from torchmesh.smoothing import sliding
from torchmesh.smoothing.sliding import Slide, curves_of
from torchmesh.triangulating.polygon import crossing_pairs

SLIDE = SmoothOptions(boundary="slide")


def rectangle() -> MeshBatch:
    """0.1 to 3.1 by 0.3 to 2.3, its vertices crowded to the left and below."""
    points, triangles = meshes.grid_arrays(8, 8)
    return MeshBatch.from_arrays(
        np.stack([points[:, 0] ** 1.7, points[:, 1] ** 1.4], 1) * [3, 2] + [0.1, 0.3], triangles
    )


def polar(sectors: int = 24, layers: int = 5, inner: float = 0.2, split: int | None = None) -> MeshBatch:
    """An annulus to radius 1 with sectors up to 2.3 times as wide as others; `split`: an interface after that layer."""
    points, triangles = meshes.ring_arrays(sectors, layers, inner, 1.0)
    angle = 2 * np.pi * np.arange(sectors) / sectors
    angle = angle + np.sin(3 * angle) * 3.2 / sectors
    radius = np.linspace(inner, 1.0, layers + 1)
    points = np.stack([np.outer(radius, np.cos(angle)).ravel(), np.outer(radius, np.sin(angle)).ravel()], 1)
    if split is None:
        return MeshBatch.from_arrays(points, triangles)
    row = split * sectors + np.arange(sectors)
    return MeshBatch.from_arrays(points, triangles, constrained_edges=np.stack([row, np.roll(row, -1)], 1))


def halves() -> MeshBatch:
    """The rectangle again, with an interface up its middle column."""
    mesh = rectangle()
    column = torch.arange(9) + 4 * 9
    return MeshBatch.from_arrays(
        mesh.points, mesh.triangles, constrained_edges=torch.stack([column[:-1], column[1:]], 1)
    )


UNEVEN = {
    "rectangle": rectangle,
    "circle": polar,
    "round interface": lambda: polar(split=2),
    "straight interface": halves,
    "ring": lambda: meshes.disturbed(meshes.ring(), 0.03, 5),
    "l_shape": lambda: meshes.disturbed(meshes.l_shape(4), 0.03, 6),
    "moved hole": lambda: meshes.moved_hole(1.0),
}


def region_areas(mesh: MeshBatch) -> list[float]:
    """The area on each side of the constrained edges."""
    twin = connectivity.twins(mesh.triangles)
    count = len(mesh.points)
    ends = connectivity.edge_keys(connectivity.tails(mesh.triangles), connectivity.heads(mesh.triangles), count)
    walls = connectivity.edge_keys(mesh.constrained_edges[:, 0], mesh.constrained_edges[:, 1], count)
    region = connectivity.triangle_components(mesh.triangles, twin, torch.isin(ends, walls))
    area = signed_area(corners(mesh.points, mesh.triangles))
    return sorted(torch.zeros(int(region.max()) + 1, dtype=torch.float64).index_add_(0, region, area).tolist())


def network(mesh: MeshBatch) -> torch.Tensor:
    boundary = connectivity.boundary_edges(mesh.triangles, connectivity.twins(mesh.triangles))
    return torch.cat([boundary, mesh.constrained_edges])


def crossings(mesh: MeshBatch) -> int:
    return len(crossing_pairs(mesh.points.numpy(), network(mesh).numpy()))


@functools.cache
def slid_along(name: str) -> tuple[MeshBatch, MeshBatch, tm.MoveInfo]:
    """A mesh of UNEVEN before and after sliding: made once for all tests, which change nothing of it."""
    mesh = UNEVEN[name]()
    slid, info = smooth(mesh, SLIDE)
    assert torch.equal(mesh.points, UNEVEN[name]().points), "what was given has been changed"
    return mesh, slid, info


@pytest.mark.parametrize("name", list(UNEVEN))
def test_sliding_improves_what_a_fixed_boundary_holds_back(name):
    mesh, slid, info = slid_along(name)
    held, _ = smooth(mesh)
    assert inverted(slid) == 0
    assert info.status.item() in (Status.CONVERGED, Status.SETTLED)
    assert quality(slid).mean.item() < quality(held).mean.item()
    assert crossings(slid) == 0
    # Exact up to the rounding of the vertices' positions.
    assert float(total_area(slid)) == pytest.approx(float(total_area(mesh)), rel=1e-14)
    assert region_areas(slid) == pytest.approx(region_areas(mesh), rel=1e-13)


def test_sides_stay_straight_to_the_bit_and_corners_stay():
    mesh = rectangle()
    slid, _ = smooth(mesh, SLIDE)
    for axis, value in ((0, 0.1), (0, 3.1), (1, 0.3), (1, 2.3)):
        on_side = mesh.points[:, axis] == value
        assert int(on_side.sum()) == 9
        assert bool((slid.points[on_side, axis] == value).all())
    corner = torch.isin(mesh.points[:, 0], mesh.points[[0, -1], 0]) & torch.isin(
        mesh.points[:, 1], mesh.points[[0, -1], 1]
    )
    assert int(corner.sum()) == 4
    assert torch.equal(slid.points[corner], mesh.points[corner])
    # Evenly spread: the quality of a plain grid, whose mean is 2 / sqrt(3).
    assert quality(slid).mean.item() < 1.1
    assert quality(smooth(mesh)[0]).mean.item() > 1.3


def test_oblique_sides_stay_straight_to_rounding():
    turn = torch.tensor([[math.cos(0.7), math.sin(0.7)], [-math.sin(0.7), math.cos(0.7)]], dtype=torch.float64)
    mesh = rectangle()
    turned = mesh.with_points(mesh.points @ turn)
    back = smooth(turned, SLIDE)[0].points @ turn.T
    for axis, value in ((0, 0.1), (0, 3.1), (1, 0.3), (1, 2.3)):
        on_side = mesh.points[:, axis] == value
        assert float((back[on_side, axis] - value).abs().max()) < 2e-15


def test_on_a_circle_vertices_stay_close_to_it_and_spread():
    mesh = polar()
    slid, _ = smooth(mesh, SLIDE)
    edge = mesh.points.norm(dim=1) > 0.999
    angle = torch.atan2(slid.points[edge, 1], slid.points[edge, 0])
    old = torch.atan2(mesh.points[edge, 1], mesh.points[edge, 0])
    # Evenly spread vertices enclose more: the circle shrinks by what keeps the polygon's area.
    gap, even = old.sort().values.diff(), 2 * math.pi / 24
    assert gap.max().item() > 2 * gap.min().item()
    spread = angle.sort().values.diff()
    assert spread.max().item() < 1.2 * spread.min().item()
    shift = 1 - slid.points[edge].norm(dim=1)
    assert 0 < shift.max().item() < even**2 / 8


@pytest.mark.parametrize("name", list(UNEVEN))
def test_order_along_the_curves_is_kept_and_corners_are_where_they_were(name):
    mesh, slid, info = slid_along(name)
    curves = curves_of(mesh)
    step = info.curves.parameter[curves.after] - info.curves.parameter
    assert bool((step > 0)[torch.arange(len(step)) != curves.last].all())
    may = curves.may_slide(mesh.point_offsets)
    stays = holding(mesh).fixed & ~may
    assert torch.equal(slid.points[stays], mesh.points[stays])
    assert bool((slid.points != mesh.points).any(1)[may].any())


@pytest.mark.parametrize("name", ["rectangle", "round interface", "ring"])
def test_gradients_are_those_of_finite_differences(name):
    mesh = UNEVEN[name]()
    curves = curves_of(mesh)
    free = ~holding(mesh).fixed | curves.may_slide(mesh.point_offsets)
    packing = pack(mesh.points, mesh.triangles, free, mesh.point_offsets, mesh.triangle_offsets)
    inner = MeshObjective(
        InverseMeanRatio(), equilateral(), packing.rows, packing.anchored, packing.block_offsets,
        packing.triangle_offsets, packing.spread_vertices(torch.ones(len(mesh.points))),
    )  # fmt: skip
    objective, start = Slide(mesh, curves, packing).start(inner)
    start[objective.x_rows] += 1e-3  # off the knots, where the second derivative jumps
    gradient = objective(start)[1]
    step = 1e-6
    for row in torch.cat([objective.x_rows[::3], packing.x_rows[::7], packing.y_rows[::7]]).tolist():
        values = [objective(start + d * (torch.arange(len(start)) == row))[0].item() for d in (step, -step)]
        assert gradient[row].item() == pytest.approx((values[0] - values[1]) / (2 * step), rel=1e-5, abs=1e-5)
    assert bool((gradient[objective.y_rows] == 0).all())
    assert bool((objective.scale[objective.y_rows] == 0).all())


def test_only_what_is_free_slides():
    mesh = rectangle()
    free = torch.zeros(len(mesh.points), dtype=torch.bool)
    free[[1, 4]] = True
    slid, _ = smooth(mesh, SLIDE, free=free)
    assert (slid.points != mesh.points).any(1).nonzero().squeeze(1).tolist() == [1, 4]


def test_a_second_smoothing_goes_on_along_the_same_curves():
    mesh = polar()
    few = dataclasses.replace(SLIDE, max_iterations=8)
    first, info = smooth(mesh, few)
    for _ in range(20):
        first, info = smooth(first, few, curves=info.curves)
    whole, _ = smooth(mesh, dataclasses.replace(SLIDE, energy_tolerance=0, max_iterations=500))
    assert quality(first).mean.item() == pytest.approx(quality(whole).mean.item(), rel=1e-4)
    # Twenty-one times back to the area: the circle is where one run leaves it.
    radii = [m.points[mesh.fixed].norm(dim=1).sort().values for m in (first, whole)]
    torch.testing.assert_close(radii[0], radii[1], rtol=0, atol=1e-5)


def test_nothing_slides_where_nothing_moves():
    mesh = meshes.equilateral()
    slid, info = smooth(mesh, SLIDE)
    assert torch.equal(slid.points, mesh.points)
    still, info = smooth(rectangle(), dataclasses.replace(SLIDE, max_iterations=0))
    assert torch.equal(still.points, rectangle().points)
    assert torch.equal(info.curves.parameter, curves_of(rectangle()).parameter)


@pytest.mark.parametrize("name", list(meshes.TANGLED))
def test_a_tangled_mesh_is_refused_and_unmoved(name):
    mesh = meshes.TANGLED[name]()
    slid, info = smooth(mesh, SLIDE)
    assert info.status.tolist() == [Status.INVERTED]
    assert torch.equal(slid.points, mesh.points)


def slit() -> MeshBatch:
    """An annulus cut along an arc, whose two sides are a thousandth apart: chords out of step would cross."""
    sectors, layers = 24, 6
    points, triangles = meshes.ring_arrays(sectors, layers, 0.4, 1.6)
    angle = 2 * np.pi * np.arange(sectors) / sectors
    radius = np.linspace(0.4, 1.6, layers + 1)
    # The layers are twisted: each side of the cut wants to slide its own way.
    angle = angle + np.array([0.15, 0.1, 0.05, 0, -0.05, -0.1, -0.15])[:, None]
    middle = 3 * sectors + np.arange(3, 21)
    points = np.stack([radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)], 2).reshape(-1, 2)
    outer = points[middle] * 1.0005
    points[middle] *= 0.9995
    centre = np.linalg.norm(points[triangles].mean(1), axis=1)
    other = np.arange(len(points))
    other[middle[1:-1]] = len(points) + np.arange(len(middle))[1:-1]
    triangles = np.where((centre > 1)[:, None], other[triangles], triangles)
    points = np.concatenate([points, outer])
    points[[middle[0], middle[-1]]] = (points[[middle[0], middle[-1]]] + outer[[0, -1]]) / 2
    used, triangles = np.unique(triangles, return_inverse=True)
    return MeshBatch.from_arrays(points[used], triangles.reshape(-1, 3))


def test_chords_of_narrow_slits_do_not_cross(monkeypatch):
    mesh = slit()
    assert inverted(mesh) == 0
    assert crossings(mesh) == 0
    radius = mesh.points.norm(dim=1)
    free = (radius > 0.5) & (radius < 1.5)
    slid, _ = smooth(mesh, SLIDE, free=free)
    assert crossings(slid) == 0
    assert not torch.equal(slid.points, mesh.points)
    monkeypatch.setattr(sliding, "_crosses", lambda batch, at: torch.zeros_like(at))
    assert crossings(smooth(mesh, SLIDE, free=free)[0]) > 0


# --- covariance and batches ---


@pytest.mark.parametrize("exponent", [-300, -7, 1, 300])
def test_scaling_by_a_power_of_two_scales_the_result_to_the_bit(exponent):
    given = [slid_along(name) for name in UNEVEN]
    scaled, its = smooth(join([mesh.with_points(mesh.points * 2.0**exponent) for mesh, _, _ in given]), SLIDE)
    for (_, plain, info), part, iterations in zip(given, scaled.split(), its.iterations, strict=True):
        assert torch.equal(part.points, plain.points * 2.0**exponent)
        assert info.iterations.tolist() == [iterations]


def test_far_from_the_origin_nothing_is_lost():
    mesh = polar()
    slid, _ = smooth(mesh.with_points(mesh.points + 1e6), SLIDE)
    assert quality(slid).mean.item() == pytest.approx(quality(smooth(mesh, SLIDE)[0]).mean.item(), rel=1e-5)


@pytest.mark.parametrize("name", list(UNEVEN))
def test_single_precision_in_is_valid_single_precision_out(name):
    mesh = UNEVEN[name]().to(torch.float32)
    slid, _ = smooth(mesh, SLIDE)
    assert slid.points.dtype == torch.float32
    assert inverted(slid) == 0
    assert quality(slid).mean.item() < quality(smooth(mesh)[0]).mean.item()
    # Each vertex is rounded to 2^-24 of its coordinate.
    assert float(total_area(slid)) == pytest.approx(float(total_area(mesh)), rel=1e-6)


def test_joined_equals_alone_to_the_bit():
    others = [*(make() for make in meshes.TANGLED.values()), meshes.grid(1, 1), slit()]
    parts = [slid_along(name) for name in UNEVEN] + [(mesh, *smooth(mesh, SLIDE)) for mesh in others]
    batch, info = smooth(join([mesh for mesh, _, _ in parts]), SLIDE)
    for b, ((_, alone, its), joined) in enumerate(zip(parts, batch.split(), strict=True)):
        assert torch.equal(alone.points, joined.points)
        for name in ("energy", "gradient", "iterations", "evaluations", "status"):
            assert torch.equal(getattr(info, name)[b : b + 1], getattr(its, name)), name


# --- improve ---

TANGLED = {
    "moved hole": meshes.moved_hole,
    "interface": meshes.dragged_interface,
    "jittered": lambda: meshes.disturbed(polar(split=2), 0.1, 3),
    "rectangle": lambda: meshes.disturbed(rectangle(), 0.3, 4),
}


@functools.cache
def improved_together(boundary: str, topology: str) -> dict[str, tuple[MeshBatch, MeshBatch, tm.Report]]:
    """The meshes of TANGLED before and after: made once for all tests, which change nothing of them."""
    before = [make() for make in TANGLED.values()]
    results = together.improved(before, ImproveOptions(boundary=boundary, topology=topology))
    return {name: (mesh, *result) for name, mesh, result in zip(TANGLED, before, results, strict=True)}


def refined(report: tm.Report) -> float:
    """The mean after flips and smoothing; what relocation adds to that differs from mesh to mesh."""
    stages = [step.stage for step in report.steps[0]]
    return report.steps[0][stages.index("relocate") - 1 if "relocate" in stages else -1].mean


@pytest.mark.parametrize("name", list(TANGLED))
@pytest.mark.parametrize("topology", ["flip", "keep"])
def test_improve_slides_flips_and_certifies(name, topology):
    mesh, better, report = improved_together("slide", topology)[name]
    _, held, of_held = improved_together("fixed", topology)[name]
    assert inverted(mesh) > 0
    assert report.certified.tolist() == [True]
    assert inverted(better) == 0
    assert diagnose(better) == []
    assert refined(report) < refined(of_held)
    assert float(total_area(better)) == pytest.approx(float(total_area(mesh)), rel=1e-14)
    assert {frozenset(e) for e in network(better).tolist()} == {frozenset(e) for e in network(mesh).tolist()}
    if topology == "flip":
        assert (sum(step.flips for step in report.steps[0]) > 0) or name == "interface"
        assert region_areas(better) == pytest.approx([abs(a) for a in region_areas(held)], rel=1e-13)
    stays = holding(mesh).fixed & ~curves_of(mesh).may_slide(mesh.point_offsets)
    assert torch.equal(better.points[stays], mesh.points[stays])


@pytest.mark.parametrize("name", list(TANGLED))
def test_vertices_slide_on_after_remeshing(name):
    mesh, better, report = improved_together("slide", "full")[name]
    of_held = improved_together("fixed", "full")[name][2]
    assert report.certified.tolist() == [True]
    assert inverted(better) == 0
    assert float(report.quality.mean) < 1.02 * float(of_held.quality.mean)
    assert float(total_area(better)) == pytest.approx(float(total_area(mesh)), rel=1e-14)
    new_row = report.vertex_map.old_to_new
    # Boundary and interface edges are the given ones, by their new rows.
    assert (new_row[mesh.fixed] >= 0).all()
    moved = {frozenset(new_row[torch.tensor(e)].tolist()) for e in network(mesh).tolist()}
    assert {frozenset(e) for e in network(better).tolist()} == moved
    # Corners stay; sliding vertices are where the same curve has them, or as near as its area allows.
    stays = holding(mesh).fixed & ~curves_of(mesh).may_slide(mesh.point_offsets)
    assert torch.equal(better.points[new_row[stays]], mesh.points[stays])
    slid = (better.points[new_row[holding(mesh).fixed]] != mesh.points[holding(mesh).fixed]).any()
    assert bool(slid) == bool(curves_of(mesh).slides.any())


def test_curves_follow_their_vertices_to_other_rows():
    batch = join([rectangle(), polar()])
    curves = curves_of(batch)
    # A vertex more in front of each mesh.
    owner = torch.bucketize(torch.arange(len(batch.points)), batch.point_offsets[1:], right=True)
    new_row = torch.arange(len(batch.points)) + owner + 1
    after = batch.point_offsets + torch.arange(3)
    moved = curves.renumbered(new_row, batch.point_offsets, after)
    assert torch.equal(moved.rows(after), new_row[curves.rows(batch.point_offsets)])
    assert torch.equal(moved.vertex, curves.vertex + 1)
    assert torch.equal(moved.parameter, curves.parameter)


def test_full_with_sliding_in_a_batch_is_full_alone():
    options = ImproveOptions(boundary="slide", topology="full")
    parts = improved_together("slide", "full")
    for name in ("jittered", "rectangle"):
        mesh, joined, _ = parts[name]
        alone, _ = improve(mesh, options)
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)


def test_improve_holds_what_it_is_told():
    mesh = TANGLED["moved hole"]()
    hold = mesh.points[:, 0] < 3
    better, report = improve(mesh, ImproveOptions(boundary="slide"), hold=hold)
    held = hold & mesh.fixed
    assert int(held.sum()) > 5
    assert torch.equal(better.points[held], mesh.points[held])
    assert not torch.equal(better.points[mesh.fixed], mesh.points[mesh.fixed])
    assert report.certified.tolist() == [True]
    with pytest.raises(tm.InvalidMeshError, match=r"hold must be \(\d+,\) bool, not \(3,\) torch.bool"):
        improve(mesh, ImproveOptions(boundary="slide"), hold=hold[:3])


def test_improving_a_batch_with_sliding_boundaries_is_improving_each_alone():
    options = ImproveOptions(boundary="slide")
    parts = [make() for make in (*TANGLED.values(), *UNEVEN.values())]
    for mesh, joined in zip(parts, improve(join(parts), options)[0].split(), strict=True):
        alone, _ = improve(mesh, options)
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)


def test_without_the_option_nothing_slides():
    mesh = TANGLED["moved hole"]()
    better, _ = improve(mesh)
    assert torch.equal(better.points[mesh.fixed], mesh.points[mesh.fixed])


def test_the_smoothing_options_slide_in_improve_too_and_set_the_corners():
    mesh = polar()
    for angle, slides in ((5.0, False), (40.0, True)):
        options = ImproveOptions(smooth=SmoothOptions(boundary="slide", corner_angle=angle))
        better, _ = improve(mesh, options)
        assert torch.equal(better.points[mesh.fixed], mesh.points[mesh.fixed]) is not slides


@pytest.mark.parametrize(
    ("match", "make"),
    [
        ("SmoothOptions.boundary must be 'fixed' or 'slide', not 'free'", lambda: SmoothOptions(boundary="free")),
        (
            "SmoothOptions.corner_angle must lie between 0 and 180 degrees, not 200",
            lambda: SmoothOptions(corner_angle=200),
        ),
        ("ImproveOptions.boundary must be 'fixed' or 'slide', not 'move'", lambda: ImproveOptions(boundary="move")),
        (
            "exclude each other: a boundary edge is halved on its chord",
            lambda: ImproveOptions(boundary="slide", topology="full", remesh=tm.RemeshOptions(split_boundary=True)),
        ),
    ],
)
def test_bad_options_are_named(match, make):
    with pytest.raises(ValueError, match=match):
        make()
