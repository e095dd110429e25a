import dataclasses
import math

import meshes
import numpy as np
import pytest
import torch
from exact import inverted, total_area
from hypothesis import given
from hypothesis import strategies as st

from torchmesh import MeshBatch, SmoothOptions, Status, join, quality, smooth
from torchmesh.mesh.interfaces import holding
from torchmesh.mesh.means import vertex_size
from torchmesh.mesh.measure import upright

# Valid, and far from their best shape.
ROUGH = {
    "grid": lambda: meshes.jittered(8, 7, 0.12, 3),
    "disc": lambda: meshes.disturbed(meshes.disc(), 0.04, 4),
    "ring": lambda: meshes.disturbed(meshes.ring(), 0.03, 5),
    "interface": lambda: meshes.disturbed(meshes.l_shape(4), 0.03, 6),
    "delaunay": lambda: meshes.delaunay(60, 7),
    "moved hole": lambda: meshes.moved_hole(1.0),
}


def energy(mesh, power=2):
    return float((quality(mesh).inverse_mean_ratio ** power).sum())


@pytest.mark.parametrize("name", list(ROUGH))
@pytest.mark.parametrize("power", [1, 2, 8])
def test_smoothing_lowers_its_energy_and_inverts_nothing(name, power):
    mesh = ROUGH[name]()
    before = mesh.points.clone()
    smoothed, info = smooth(mesh, SmoothOptions(power=power))
    assert inverted(mesh) == inverted(smoothed) == 0
    assert energy(smoothed, power) < energy(mesh, power)
    assert info.status.item() in (Status.CONVERGED, Status.SETTLED)
    assert torch.equal(smoothed.points[holding(mesh).fixed], mesh.points[holding(mesh).fixed])
    assert bool((smoothed.points[~holding(mesh).fixed] != mesh.points[~holding(mesh).fixed]).any())
    assert torch.equal(mesh.points, before)
    assert smoothed.triangles is mesh.triangles
    assert float(total_area(smoothed)) == pytest.approx(float(total_area(mesh)), rel=1e-13)


@pytest.mark.parametrize("name", list(ROUGH))
def test_the_energy_reported_is_that_of_the_triangles_that_can_change(name):
    mesh = ROUGH[name]()
    smoothed, info = smooth(mesh)
    moving = (~holding(mesh).fixed)[mesh.triangles].any(1)
    expected = quality(smoothed).inverse_mean_ratio[moving].square().sum().item()
    # Points were rounded on their way back; slivers of ratio ten feel it tenfold.
    assert info.energy.item() == pytest.approx(expected, rel=1e-11)
    assert info.evaluations.item() >= info.iterations.item() + 1


@pytest.mark.parametrize("name", list(ROUGH))
def test_smoothing_ends_at_a_stationary_point(name):
    mesh = ROUGH[name]()
    options = SmoothOptions(energy_tolerance=0.0, gradient_tolerance=1e-5, max_iterations=2000)
    smoothed, info = smooth(mesh, options)
    assert info.status.item() == Status.CONVERGED
    points = smoothed.points.clone().requires_grad_()
    a, b, c = points[mesh.triangles].unbind(1)
    cross = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    lengths = (b - a).square().sum(1) + (c - b).square().sum(1) + (a - c).square().sum(1)
    gradient = torch.autograd.grad((lengths / (2 * math.sqrt(3) * cross)).square().sum(), points)[0]
    scaled = (gradient * vertex_size(mesh)[:, None])[~holding(mesh).fixed]
    assert float(scaled.square().mean().sqrt()) == pytest.approx(info.gradient.item(), rel=1e-4)
    assert info.gradient.item() <= 1e-5


def test_a_hexagon_becomes_regular():
    angle = np.pi / 3 * np.arange(6)
    points = np.concatenate([np.stack([np.cos(angle), np.sin(angle)], 1), [[0.4, -0.3]]])
    mesh = MeshBatch.from_arrays(points, [[i, (i + 1) % 6, 6] for i in range(6)])
    smoothed, _ = smooth(mesh, SmoothOptions(energy_tolerance=0, gradient_tolerance=1e-9))
    # A gradient of 1e-9 over a curvature of about ten.
    assert smoothed.points[6].tolist() == pytest.approx([0, 0], abs=1e-8)
    assert quality(smoothed).max.item() == pytest.approx(1, abs=1e-12)


def test_a_mesh_at_its_best_stays():
    mesh = meshes.equilateral()
    smoothed, info = smooth(mesh)
    assert info.status.item() == Status.CONVERGED
    assert info.iterations.item() == 0
    assert torch.equal(smoothed.points, mesh.points)


@given(st.integers(0, 10_000), st.floats(0.01, 0.25), st.sampled_from([1, 2, 8]), st.integers(1, 60))
def test_smoothing_never_inverts_whenever_it_is_stopped(seed, size, power, iterations):
    start = [
        lambda: meshes.jittered(5, 5, size, seed),
        lambda: meshes.delaunay(30, seed),
        lambda: meshes.disturbed(meshes.disc(8, 3), size / 3, seed),
    ][seed % 3]()
    valid = inverted(start) == 0
    smoothed, info = smooth(start, SmoothOptions(power=power, max_iterations=iterations))
    if valid:
        assert inverted(smoothed) == 0
        assert energy(smoothed, power) <= energy(start, power) * (1 + 1e-12)
        assert info.iterations.item() <= iterations
    else:
        assert info.status.item() == Status.INVERTED
        assert torch.equal(smoothed.points, start.points)


@pytest.mark.parametrize("block", [1, 8, 1000])
def test_narrow_blocks_change_nothing_but_rounding(block):
    parts = [make() for make in ROUGH.values()]
    options = SmoothOptions(max_iterations=12)
    together, info = smooth(join(parts), options, block=block)
    usual, _ = smooth(join(parts), options)
    assert torch.allclose(together.points, usual.points, rtol=0, atol=1e-9)
    for part, joined, iterations in zip(parts, together.split(), info.iterations, strict=True):
        alone, own = smooth(part, options, block=block)
        assert torch.equal(alone.points, joined.points)
        assert int(own.iterations) == int(iterations)


@pytest.mark.parametrize("name", list(meshes.TANGLED))
def test_a_tangled_mesh_is_refused_and_unmoved(name):
    mesh = meshes.TANGLED[name]()
    smoothed, info = smooth(mesh)
    assert info.status.tolist() == [Status.INVERTED]
    assert info.iterations.tolist() == [0]
    assert torch.equal(smoothed.points, mesh.points)


def test_a_flat_triangle_is_refused_too():
    mesh = MeshBatch.from_arrays([[0, 0], [2, 0], [2, 2], [0, 2], [1, 0]], [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    assert smooth(mesh)[1].status.tolist() == [Status.INVERTED]


def test_iterations_are_limited():
    mesh = ROUGH["disc"]()
    still, info = smooth(mesh, SmoothOptions(max_iterations=0))
    assert torch.equal(still.points, mesh.points)
    assert info.status.tolist() == [Status.ITERATION_LIMIT]
    _, info = smooth(mesh, SmoothOptions(max_iterations=2))
    assert info.status.tolist() == [Status.ITERATION_LIMIT]
    assert 0 < info.iterations.item() <= 2


def test_free_restricts_what_moves():
    mesh = ROUGH["grid"]()
    free = torch.zeros(len(mesh.points), dtype=torch.bool)
    inner = (~mesh.fixed).nonzero().squeeze(1)
    free[inner[:5]] = True
    free[0] = True
    copy = free.clone()
    smoothed, _ = smooth(mesh, free=free)
    moved = (smoothed.points != mesh.points).any(1)
    assert set(moved.nonzero().squeeze(1).tolist()) == set(inner[:5].tolist())
    assert torch.equal(free, copy)
    assert energy(smoothed) < energy(mesh)


def test_nothing_free_is_converged():
    mesh = meshes.grid(1, 1)
    smoothed, info = smooth(mesh)
    assert torch.equal(smoothed.points, mesh.points)
    assert info.status.tolist() == [Status.CONVERGED]


def test_fixed_interior_vertices_stay_to_the_bit():
    rough = ROUGH["grid"]()
    held = torch.zeros(len(rough.points), dtype=torch.bool)
    held[[20, 21, 35]] = True
    mesh = MeshBatch.from_arrays(rough.points, rough.triangles, held)
    smoothed, _ = smooth(mesh)
    assert torch.equal(smoothed.points[held], mesh.points[held])
    assert not torch.equal(smooth(rough)[0].points[held], mesh.points[held])


# --- covariance ---


@pytest.mark.parametrize("exponent", [-300, -7, 1, 300])
@pytest.mark.parametrize("name", list(ROUGH))
def test_scaling_by_a_power_of_two_scales_the_result_to_the_bit(name, exponent):
    mesh = ROUGH[name]()
    scaled, its = smooth(mesh.with_points(mesh.points * 2.0**exponent))
    plain, info = smooth(mesh)
    assert torch.equal(scaled.points, plain.points * 2.0**exponent)
    assert torch.equal(its.iterations, info.iterations)
    assert torch.equal(its.energy, info.energy)


def test_a_shift_that_loses_no_digit_shifts_the_result():
    mesh = ROUGH["disc"]()
    mesh = mesh.with_points((mesh.points * 2**20).round() / 2**20)
    shift = torch.tensor([1024.0, -512.0], dtype=torch.float64)
    shifted, info = smooth(mesh.with_points(mesh.points + shift))
    plain, its = smooth(mesh)
    assert torch.equal(info.iterations, its.iterations)
    # The last step puts the points back at 1024, where a last bit is 2e-13.
    torch.testing.assert_close(shifted.points - shift, plain.points, rtol=0, atol=4e-13)


@pytest.mark.parametrize("name", list(ROUGH))
def test_a_turned_mesh_gives_the_turned_result_nearly(name):
    mesh = ROUGH[name]()
    turn = torch.tensor([[math.cos(1), math.sin(1)], [-math.sin(1), math.cos(1)]], dtype=torch.float64)
    options = SmoothOptions(energy_tolerance=0.0, gradient_tolerance=1e-7, max_iterations=2000)
    turned, plain = (smooth(m, options)[0] for m in (mesh.with_points(mesh.points @ turn), mesh))
    # Both are at the minimum to a gradient of 1e-7 in units of an edge; the soft modes of 150 vertices are
    # hundreds of times softer than one edge.
    torch.testing.assert_close(turned.points, plain.points @ turn, rtol=0, atol=1e-4)


def test_renumbering_renumbers_the_result_nearly(rng):
    mesh = ROUGH["ring"]()
    order = torch.from_numpy(rng.permutation(len(mesh.points)))
    new_row = order.argsort()
    other = MeshBatch.from_arrays(mesh.points[order], new_row[mesh.triangles].roll(1, 1).flip(0))
    options = SmoothOptions(energy_tolerance=0.0, gradient_tolerance=1e-7, max_iterations=2000)
    torch.testing.assert_close(
        smooth(other, options)[0].points, smooth(mesh, options)[0].points[order], rtol=0, atol=1e-5
    )


@pytest.mark.parametrize("name", list(ROUGH))
def test_single_precision_in_is_valid_single_precision_out(name):
    mesh = ROUGH[name]().to(torch.float32)
    smoothed, info = smooth(mesh)
    assert smoothed.points.dtype == torch.float32
    assert inverted(smoothed) == 0
    assert torch.equal(smoothed.points[holding(mesh).fixed], mesh.points[holding(mesh).fixed])
    assert info.energy.dtype == torch.float64
    assert energy(smoothed) < energy(mesh)


def test_rounding_to_single_precision_that_flattens_a_sliver_puts_the_mesh_back():
    # The free vertex lives in a slit of two last bits, between the lower side and a notch; its best position is a
    # third of a bit above the side, and single precision would put it onto the side.
    bit = 2.0**-20
    points = [[0, 8], [1, 8], [6, 9], [0.5, 8 + 2 * bit], [-5, 9], [0.5, 8 + bit]]
    double = MeshBatch.from_arrays(points, [[i, (i + 1) % 5, 5] for i in range(5)])
    height = (smooth(double)[0].points[5, 1].item() - 8) / bit
    assert 0.2 < height < 0.5
    mesh = double.to(torch.float32)
    assert inverted(mesh) == 0
    smoothed, info = smooth(mesh)
    assert inverted(smoothed) == 0
    assert torch.equal(smoothed.points, mesh.points)
    assert info.status.tolist() == [Status.STALLED]


def test_far_from_the_origin_nothing_is_lost():
    mesh = ROUGH["grid"]()
    far = mesh.with_points(mesh.points + 1e6)
    smoothed, _ = smooth(far)
    # Coordinates of 1e6 have 1e-10 to give, cells are a tenth wide.
    assert energy(smoothed) == pytest.approx(energy(smooth(mesh)[0]), rel=1e-6)


# --- batches and options ---


def test_joined_equals_alone_to_the_bit_and_tangled_neighbours_do_not_matter():
    parts = [make() for make in (*ROUGH.values(), *meshes.TANGLED.values())] + [meshes.grid(1, 1), meshes.equilateral()]
    single = SmoothOptions(ceiling=1.5, single=True)
    for options in (SmoothOptions(), SmoothOptions(power=8, energy_tolerance=1e-4), SmoothOptions(ceiling=1.5), single):
        batch, info = smooth(join(parts), options)
        for b, (mesh, together) in enumerate(zip(parts, batch.split(), strict=True)):
            alone, its = smooth(mesh, options)
            assert torch.equal(alone.points, together.points)
            assert info.curves is its.curves is None
            for field in dataclasses.fields(info):
                if field.name != "curves":
                    assert torch.equal(getattr(info, field.name)[b : b + 1], getattr(its, field.name)), field.name


def test_runs_repeat_to_the_bit():
    mesh = ROUGH["moved hole"]()
    assert torch.equal(smooth(mesh)[0].points, smooth(mesh)[0].points)


def test_a_higher_power_cares_more_for_the_worst():
    mesh = ROUGH["delaunay"]()
    mild, strict = (quality(smooth(mesh, SmoothOptions(power=p))[0]) for p in (1, 8))
    assert strict.max.item() < mild.max.item()
    assert strict.mean.item() > mild.mean.item()


def test_a_ceiling_presses_the_worst_down():
    mesh = ROUGH["delaunay"]()
    without, below = (quality(smooth(mesh, SmoothOptions(ceiling=c))[0]) for c in (None, 1.5))
    assert below.max.item() < without.max.item()


def test_the_monitor_sees_every_iteration_and_falling_energies():
    seen = []
    _, info = smooth(ROUGH["grid"](), monitor=lambda k, e: seen.append((k, e.item())))
    assert [k for k, _ in seen] == list(range(1, len(seen) + 1))
    values = [e for _, e in seen]
    assert values == sorted(values, reverse=True)
    assert values[-1] == info.energy.item()


@pytest.mark.parametrize(
    ("match", "arguments"),
    [
        ("SmoothOptions.power must be at least 1, not 0", {"power": 0}),
        ("SmoothOptions.ceiling must be above 1.* not 1.0", {"ceiling": 1.0}),
        ("SmoothOptions.max_iterations must not be negative, but is -1", {"max_iterations": -1}),
        ("SmoothOptions.energy_tolerance must not be negative, but is -1e-06", {"energy_tolerance": -1e-6}),
        ("SmoothOptions.energy_tolerance must not be negative, but is nan", {"energy_tolerance": math.nan}),
        ("SmoothOptions.gradient_tolerance must not be negative", {"gradient_tolerance": -1.0}),
        ("SmoothOptions.first_step must be positive, not 0", {"first_step": 0.0}),
        ("SmoothOptions.largest_step must be positive, not -0.5", {"largest_step": -0.5}),
    ],
)
def test_bad_options_are_named(match, arguments):
    with pytest.raises(ValueError, match=match):
        SmoothOptions(**arguments)


@pytest.mark.parametrize("name", list(ROUGH))
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_single_precision_comes_to_the_same_mesh(name, offset):
    mesh = ROUGH[name]()
    double, wide = smooth(mesh)
    single, info = smooth(mesh.with_points(mesh.points + offset), SmoothOptions(single=True))
    assert bool(upright(single).all())
    assert info.energy.item() == pytest.approx(wide.energy.item(), rel=1e-5)
    # Displacements keep their digits far from the origin; both stop where the energy is flat.
    assert float((single.points - offset - double.points).abs().max()) < 1e-2 * float(double.points.abs().max())


def test_in_single_precision_too_no_step_inverts_a_triangle():
    mesh = ROUGH["delaunay"]()
    for limit in range(12):
        moved, _ = smooth(mesh, SmoothOptions(max_iterations=limit, single=True))
        assert bool(upright(moved).all())


@pytest.mark.parametrize("power", [1, 2])
@pytest.mark.parametrize("height", [1e-9, 1e-16, 1e-18, 1e-300])
def test_a_sliver_of_any_height_is_opened(height, power):
    """Its curvature, or a height that rounding loses, stopped the minimiser at once."""
    points = [[0.0, 0], [1, 0], [1, 1], [0, 1], [0.5, height]]
    sliver = MeshBatch.from_arrays(points, [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    usual = meshes.grid(4, 4)
    both = join([sliver, usual])
    after, info = smooth(both, SmoothOptions(power=power))
    assert quality(after).max[0] < 1.1548
    assert info.status[0] in (Status.CONVERGED, Status.SETTLED)
    assert info.iterations[0] <= info.evaluations[0]
    alone, of_one = smooth(usual, SmoothOptions(power=power))
    assert torch.equal(after.split()[1].points, alone.points)
    assert int(of_one.evaluations) == int(info.evaluations[1])
    stay, _ = smooth(both, SmoothOptions(power=power, max_iterations=0))
    assert torch.equal(stay.points, both.points)
