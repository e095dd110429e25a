import dataclasses
import math

import meshes
import pytest
import torch
from exact import inverted
from hypothesis import given
from hypothesis import strategies as st

from torchmesh import InvalidMeshError, MeshBatch, Status, UntangleOptions, join, quality, smooth, untangle
from torchmesh.mesh.triangle import corners, signed_area
from torchmesh.untangling.continuation import _PATIENCE, _Hope
from torchmesh.untangling.local_size import local_size
from torchmesh.untangling.untangling import usual_area

METHODS = {
    "regularised": UntangleOptions(),
    "beta": UntangleOptions("beta", max_iterations=1000),
    "beta, single": UntangleOptions("beta", max_iterations=1000, single=True),
}

# Tangled by their interior vertices only, so that these triangles can be made valid.
MENDABLE = {
    "lightly jittered": lambda: meshes.jittered(8, 7, 0.35, 0),
    "jittered": lambda: meshes.jittered(8, 7, 0.5, 0),
    "disc": lambda: meshes.disturbed(meshes.disc(), 0.1, 2),
    "ring": lambda: meshes.disturbed(meshes.ring(), 0.08, 3),
    "interface": lambda: meshes.disturbed(meshes.l_shape(4), 0.12, 5),
}


def assert_moved_only_what_is_free(before, after):
    assert after.triangles is before.triangles
    assert torch.equal(after.points[before.fixed], before.points[before.fixed])
    assert bool(after.points.isfinite().all())


@pytest.mark.parametrize("method", list(METHODS))
@pytest.mark.parametrize("name", list(MENDABLE))
def test_untangles_what_thrown_vertices_have_tangled(name, method):
    mesh = MENDABLE[name]()
    copy = mesh.points.clone()
    assert inverted(mesh) > 0
    moved, info = untangle(mesh, METHODS[method])
    assert_moved_only_what_is_free(mesh, moved)
    assert torch.equal(mesh.points, copy)
    assert inverted(moved) == 0
    assert info.status.tolist() == [Status.VALID]
    assert info.iterations.item() > 0
    assert info.evaluations.item() > info.iterations.item()


def test_untangles_a_moved_hole_with_the_triangles_kept():
    mesh = meshes.moved_hole()
    moved, info = untangle(mesh)
    assert_moved_only_what_is_free(mesh, moved)
    assert inverted(moved) == 0
    assert info.status.tolist() == [Status.VALID]


@pytest.mark.parametrize("method", list(METHODS))
@pytest.mark.parametrize("name", list(meshes.VALID))
def test_a_valid_mesh_is_unmoved(name, method):
    mesh = meshes.VALID[name]()
    mesh = mesh.with_points(mesh.points / 3 + 0.1)
    # Even where untangle-beta would want more area for some of its triangles.
    moved, info = untangle(mesh, dataclasses.replace(METHODS[method], beta=2.0))
    assert torch.equal(moved.points, mesh.points)
    assert info.status.tolist() == [Status.VALID]
    assert info.iterations.tolist() == [0]


@pytest.mark.parametrize("method", list(METHODS))
@given(st.sampled_from([0.3, 0.6, 1.2]), st.integers(0, 10_000))
def test_the_status_tells_whether_the_mesh_is_valid(method, cells, seed):
    mesh = meshes.jittered(5, 4, cells, seed)
    moved, info = untangle(mesh, METHODS[method])
    assert_moved_only_what_is_free(mesh, moved)
    assert (info.status.item() == Status.VALID) == (inverted(moved) == 0)
    if method == "regularised":
        assert inverted(moved) == 0


@pytest.mark.parametrize("method", list(METHODS))
def test_what_cannot_be_untangled_ends_and_says_so(method):
    # One boundary vertex of the grid is pulled across the square: its triangles cannot all be upright.
    mesh = meshes.grid(4, 4)
    points = mesh.points.clone()
    points[10] = torch.tensor([0.5, 1.5])
    folded = mesh.with_points(points)
    moved, info = untangle(folded, METHODS[method])
    assert inverted(moved) > 0
    assert info.status.item() in (Status.STALLED, Status.SETTLED, Status.ITERATION_LIMIT, Status.CONVERGED)
    assert_moved_only_what_is_free(folded, moved)


@pytest.mark.parametrize("method", list(METHODS))
@pytest.mark.parametrize("points", ["one point", "a line", "mirror image", "no area"])
def test_degenerate_meshes_end_without_harm(method, points):
    mesh = meshes.grid(4, 4)
    x, y = mesh.points.unbind(1)
    # The last one is a bow tie: as much of it is turned over as is not.
    where = {
        "one point": (0 * x + 0.5, 0 * y),
        "a line": (x, 0 * y),
        "mirror image": (-x, y),
        "no area": (x, (x - 0.5) * (y - 0.5)),
    }[points]
    bad = mesh.with_points(torch.stack(where, 1))
    good = MENDABLE["jittered"]()
    moved, info = untangle(join([bad, good]), METHODS[method])
    assert info.status[0] != Status.VALID
    assert bool(moved.points.isfinite().all())
    assert torch.equal(moved.split()[1].points, untangle(good, METHODS[method])[0].points)


@pytest.mark.parametrize("method", list(METHODS))
def test_nothing_free_is_not_valid(method):
    mesh = meshes.grid(1, 1).with_points(meshes.grid(1, 1).points * torch.tensor([-1.0, 1.0]))
    moved, info = untangle(mesh, METHODS[method])
    assert torch.equal(moved.points, mesh.points)
    assert info.status.item() != Status.VALID


@pytest.mark.parametrize("method", list(METHODS))
def test_free_restricts_what_moves(method):
    mesh = MENDABLE["lightly jittered"]()
    area = signed_area(corners(mesh.points, mesh.triangles))
    free = torch.zeros(len(mesh.points), dtype=torch.bool)
    free[mesh.triangles[area <= 0].reshape(-1)] = True
    moved, _ = untangle(mesh, METHODS[method], free=free)
    changed = (moved.points != mesh.points).any(1)
    assert bool(changed.any())
    assert not bool((changed & ~(free & ~mesh.fixed)).any())


# --- untangle-beta ---


def smallest_share(mesh):
    """The smallest area in units of the mean of |area|."""
    area = quality(mesh).area
    return (area.min() / area.abs().mean()).item()


def test_beta_is_the_area_that_triangles_are_pushed_to():
    mesh = MENDABLE["lightly jittered"]()
    mean = quality(mesh).area.abs().mean().item()
    for beta in (0.01, 0.1, 0.3):
        moved, info = untangle(mesh, UntangleOptions("beta", beta=beta, max_iterations=3000))
        lack = (beta * mean - quality(moved).area).clamp_min(0) / mean
        moving = (~mesh.fixed)[mesh.triangles].any(1)
        assert info.energy.item() == pytest.approx(lack[moving].square().sum().item(), abs=1e-12)
        # The minimum is zero: every triangle gets its beta, up to the root of what the stopping test leaves.
        assert quality(moved).area.min().item() / mean > 0.9 * beta


def test_beta_is_relative_to_the_mesh_and_absolute_on_request():
    mesh = MENDABLE["jittered"]()
    doubled = mesh.with_points(2 * mesh.points)
    mean = quality(mesh).area.abs().mean().item()
    relative = UntangleOptions("beta", beta=0.2)
    assert torch.equal(untangle(doubled, relative)[0].points, 2 * untangle(mesh, relative)[0].points)
    same, four_times = (UntangleOptions("beta", absolute_beta=f * 0.2 * mean, max_iterations=3000) for f in (1, 4))
    assert torch.equal(untangle(doubled, four_times)[0].points, 2 * untangle(mesh, same)[0].points)
    # On the doubled mesh the same number asks for a quarter.
    little, much = (quality(untangle(doubled, o)[0]).area.min().item() / (4 * mean) for o in (same, four_times))
    assert little == pytest.approx(0.05, rel=0.15)
    assert much == pytest.approx(0.2, rel=0.15)


def test_beta_leaves_alone_what_is_larger_already():
    # One vertex is thrown; the far triangles have all their area.
    mesh = meshes.grid(10, 10)
    points = mesh.points.clone()
    points[60] = torch.tensor([0.72, 0.55])
    tangled = mesh.with_points(points)
    assert inverted(tangled) > 0
    moved, _ = untangle(tangled, UntangleOptions("beta", beta=0.1))
    assert inverted(moved) == 0
    near = set(mesh.triangles[quality(tangled).area < 0.1 * 0.005].reshape(-1).tolist())
    changed = set((moved.points != tangled.points).any(1).nonzero().squeeze(1).tolist())
    # Who is pushed pushes its neighbours; two rings round the tangle are all that can have moved.
    for _ in range(2):
        near |= {v for row in mesh.triangles.tolist() if near & set(row) for v in row}
    assert changed
    assert changed <= near


# --- the regularised functional ---


def test_local_size_of_equilateral_triangles_is_their_side():
    sizes = local_size(meshes.equilateral(side=0.25))
    assert sizes.tolist() == pytest.approx([0.25] * len(sizes), rel=1e-13)


@pytest.mark.parametrize("name", [*meshes.VALID, *meshes.TANGLED])
def test_target_areas_sum_to_the_enclosed_area(name):
    mesh = (meshes.VALID | meshes.TANGLED)[name]()
    side = local_size(mesh)[mesh.triangles].mean(1)
    target = (math.sqrt(3) / 4 * side.square()).sum().item()
    assert target == pytest.approx(quality(mesh).area.sum().item(), rel=1e-12)


def test_local_size_grows_where_the_mesh_is_coarse():
    sizes = local_size(meshes.ring(16, 12, 0.1, 3.0), 20)
    # As many edges on a circle thirty times as long; the field is smoothed, so that it grows less.
    assert float(sizes[-16:].min()) > 1.5 * float(sizes[:16].max())


def test_continuations_are_limited():
    mesh = meshes.jittered(8, 7, 0.9, 1)
    options = UntangleOptions(max_continuations=1, max_iterations=2, size_sweeps=(20,))
    moved, info = untangle(mesh, options)
    assert info.iterations.item() <= 2
    assert inverted(moved) > 0
    assert info.status.tolist() == [Status.ITERATION_LIMIT]


# --- both ---


@pytest.mark.parametrize("method", list(METHODS))
@pytest.mark.parametrize("exponent", [-200, 3, 200])
def test_scaling_by_a_power_of_two_scales_the_result_to_the_bit(method, exponent):
    for name in ("jittered", "ring"):
        mesh = MENDABLE[name]()
        scaled, its = untangle(mesh.with_points(mesh.points * 2.0**exponent), METHODS[method])
        plain, info = untangle(mesh, METHODS[method])
        assert torch.equal(scaled.points, plain.points * 2.0**exponent)
        assert torch.equal(its.iterations, info.iterations)


@pytest.mark.parametrize("method", list(METHODS))
def test_far_from_the_origin_works_too(method):
    mesh = MENDABLE["jittered"]()
    moved, _ = untangle(mesh.with_points(mesh.points + 1e6), METHODS[method])
    assert inverted(moved) == 0


@pytest.mark.parametrize("method", list(METHODS))
def test_single_precision(method):
    mesh = MENDABLE["disc"]().to(torch.float32)
    moved, info = untangle(mesh, METHODS[method])
    assert moved.points.dtype == torch.float32
    assert inverted(moved) == 0
    assert info.status.tolist() == [Status.VALID]


@pytest.mark.parametrize("method", list(METHODS))
def test_joined_equals_alone_to_the_bit(method):
    hopeless = meshes.grid(4, 4).with_points(-meshes.grid(4, 4).points.flip(1))
    parts = [make() for make in (*MENDABLE.values(), *meshes.VALID.values())] + [
        hopeless,
        meshes.jittered(4, 4, 1.5, 9),
    ]
    batch, info = untangle(join(parts), METHODS[method])
    for b, (mesh, together) in enumerate(zip(parts, batch.split(), strict=True)):
        alone, its = untangle(mesh, METHODS[method])
        assert torch.equal(alone.points, together.points)
        for field in dataclasses.fields(info):
            if field.name == "curves":  # for sliding, which untangling does not
                continue
            assert torch.equal(getattr(info, field.name)[b : b + 1], getattr(its, field.name)), field.name


def test_an_untangled_mesh_can_be_smoothed():
    moved, _ = untangle(MENDABLE["ring"]())
    smoothed, info = smooth(moved)
    assert info.status.item() in (Status.CONVERGED, Status.SETTLED)
    assert quality(smoothed).max.item() < quality(moved).max.item()


def test_the_monitor_is_called():
    seen = []
    untangle(MENDABLE["ring"](), monitor=lambda k, e: seen.append(k))
    assert seen[0] == 1
    assert len(seen) > 5


@pytest.mark.parametrize(
    ("match", "arguments"),
    [
        ("UntangleOptions.method must be .*'magic'", {"method": "magic"}),
        ("UntangleOptions.max_iterations must be at least 1, not 0", {"max_iterations": 0}),
        ("UntangleOptions.max_continuations must be at least 1, not -2", {"max_continuations": -2}),
        ("UntangleOptions.beta must not be negative, but is -0.1", {"beta": -0.1}),
        ("UntangleOptions.beta must not be negative, but is nan", {"beta": math.nan}),
        ("UntangleOptions.absolute_beta must not be negative, but is -1", {"absolute_beta": -1}),
    ],
)
def test_bad_options_are_named(match, arguments):
    with pytest.raises(ValueError, match=match):
        UntangleOptions(**arguments)


def test_meshes_of_a_batch_keep_their_own_beta():
    mesh = MENDABLE["jittered"]()
    batch = join([mesh, MeshBatch.from_arrays(1000 * mesh.points, mesh.triangles)])
    moved, _ = untangle(batch, METHODS["beta"])
    assert [inverted(m) for m in moved.split()] == [0, 0]


# --- with the undeformed mesh at hand ---


def test_a_reference_brings_back_its_own_shapes_and_sizes():
    # A strongly graded disc: equilateral targets of local size would even it out.
    mesh = meshes.disc(12, 5)
    graded = mesh.with_points(mesh.points * mesh.points.norm(dim=1, keepdim=True) ** 1.5)
    tangled = meshes.disturbed(graded, 0.08, 3)
    assert inverted(tangled) > 0
    moved, info = untangle(tangled, reference=graded)
    assert info.status.tolist() == [Status.VALID]
    assert inverted(moved) == 0
    own, plain = (
        (quality(m).area / quality(graded).area).log().abs().mean().item() for m in (moved, untangle(tangled)[0])
    )
    assert own < 0.5 * plain


def test_a_reference_that_does_not_fit_is_refused():
    mesh = meshes.jittered()
    with pytest.raises(
        InvalidMeshError, match="the reference has 1 meshes, 81 points and 128 triangles, not the batch"
    ):
        untangle(mesh, reference=meshes.grid(8, 8))
    valid = meshes.grid(8, 7)
    flipped = valid.triangles.clone()
    flipped[5] = flipped[5].roll(1)
    batch = join([mesh, mesh])
    with pytest.raises(InvalidMeshError, match="mesh 1: triangles row 5 is another triangle"):
        untangle(batch, reference=join([valid, valid.with_triangles(flipped)]))
    with pytest.raises(InvalidMeshError, match=r"mesh 0: triangles row \d+ is inverted in the reference"):
        untangle(mesh, reference=mesh)


def test_size_fields_are_tried_in_turn_until_a_mesh_is_valid():
    mesh = meshes.jittered(8, 7, 0.5, 0)
    once, first = untangle(mesh, UntangleOptions(size_sweeps=(100,)))
    again, its = untangle(mesh, UntangleOptions(size_sweeps=(100, 20, 1000)))
    assert torch.equal(once.points, again.points)
    assert first.iterations.tolist() == its.iterations.tolist()
    # No try can mend a square turned inside out: each adds its work.
    lost = meshes.grid(4, 4).with_points(-meshes.grid(4, 4).points.flip(1))
    lost = meshes.disturbed(lost, 0.1, 0)
    counts = [untangle(lost, UntangleOptions(size_sweeps=s, max_iterations=20))[1] for s in ((100,), (100, 20))]
    assert counts[1].iterations.item() > counts[0].iterations.item()
    for bad in ((), (-1,)):
        with pytest.raises(ValueError, match=r"UntangleOptions.size_sweeps must be numbers"):
            UntangleOptions(size_sweeps=bad)


def graded_tangle():
    """A grid whose columns grow twentyfold from left to right, with a vertex of the wide part pulled across."""
    mesh = meshes.grid(120, 6)
    t = mesh.points / mesh.points.amax(0)
    points = torch.stack([t[:, 0] + 20 * t[:, 0] ** 4, t[:, 1]], 1)
    inner = ((~mesh.fixed) & (t[:, 0] > 0.9)).nonzero().squeeze(1)
    points[inner[5], 0] += 3
    return mesh.with_points(points)


def test_local_beta_counts_in_what_is_usual_nearby():
    mesh = graded_tangle()
    mean = float(signed_area(corners(mesh.points, mesh.triangles)).abs().mean())
    usual = usual_area(mesh, UntangleOptions("beta", local=True))
    x = mesh.points[:, 0][mesh.triangles].mean(1)
    assert torch.allclose(usual_area(mesh, UntangleOptions("beta")), torch.tensor(mean, dtype=torch.float64))
    assert bool((usual <= mean * (1 + 1e-12)).all())
    assert float(usual[x < 0.2].max()) < 0.3 * mean
    assert float(usual[x > 15].min()) == pytest.approx(mean)


def test_reach_bounds_what_moves():
    mesh = meshes.grid(12, 12)
    points = mesh.points.clone()
    vertex = int((~mesh.fixed).nonzero()[30])
    points[vertex] += torch.tensor([1.6, 0.3])
    mesh = mesh.with_points(points)
    counts = []
    for reach in (1, 2, None):
        moved, _ = untangle(mesh, UntangleOptions("beta", beta=0.3, reach=reach, max_iterations=30))
        counts.append(int((moved.points != mesh.points).any(1).sum()))
    assert 0 < counts[0] < counts[1] <= counts[2]


@pytest.mark.parametrize("options", [{"reach": 0}, {"local": True, "absolute_beta": 0.1}])
def test_options_that_make_no_sense(options):
    with pytest.raises(ValueError, match=r"reach|local"):
        UntangleOptions("beta", **options)


# --- stalls ---


def hopeless() -> MeshBatch:
    """A grid with four held vertices in its middle, two of which have changed places: their triangles stay inverted."""
    mesh = meshes.grid(10, 10)
    points, fixed = mesh.points.clone(), mesh.fixed.clone()
    one, two, *rest = 49, 60, 48, 61
    points[[one, two]] = points[[two, one]]
    fixed[[one, two, *rest]] = True
    return dataclasses.replace(mesh, points=points, fixed=fixed)


def test_what_no_longer_gets_better_ends_before_the_limit():
    mesh = hopeless()
    options = UntangleOptions(size_sweeps=(100,), max_continuations=100_000)
    moved, info = untangle(mesh, options)
    assert inverted(moved) > 0
    assert info.status.tolist() == [Status.STALLED]


def test_a_stalled_mesh_leaves_the_others_of_its_batch_alone():
    batch = [meshes.jittered(8, 7, 0.5, 0), hopeless(), meshes.jittered(8, 7, 0.9, 1)]
    moved, info = untangle(join(batch))
    assert info.status[1] == Status.STALLED
    for b, mesh in enumerate(batch):
        alone, by_itself = untangle(mesh)
        assert torch.equal(moved.split()[b].points, alone.points)
        for name in ("status", "iterations", "evaluations"):
            assert getattr(info, name)[b] == getattr(by_itself, name)


@pytest.mark.parametrize(
    ("before", "now", "lost"),
    [
        ((-1.0, 10), (-0.95, 10), True),
        ((-1.0, 10), (-0.85, 10), False),  # the lowest determinant rises
        ((-1.0, 10), (-0.95, 8), False),  # fewer are inverted
        ((-1e-3, 10), (-1e-3, 10), False),  # within reach of epsilon
        ((-1.0, 10), (0.5, 0), False),
    ],
)
def test_hope_is_lost_when_nothing_gained_in_ten_rounds(before, now, lost):
    hope = _Hope(torch.ones(3, dtype=torch.float64))
    row, eps = torch.tensor([1]), torch.tensor([1e-2], dtype=torch.float64)

    def ask(turn, lowest, count):
        return hope.lost(turn, row, eps, torch.tensor([lowest], dtype=torch.float64), torch.tensor([count])).item()

    assert not any(ask(turn, *before) for turn in range(_PATIENCE))
    assert ask(_PATIENCE, *now) is lost
