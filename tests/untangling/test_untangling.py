"""`untangle` by both methods: what can be made valid becomes valid, and the status tells the truth."""

import dataclasses

import meshes
import pytest
import torch
from exact import inverted
from hypothesis import given
from hypothesis import strategies as st
from tangles import MENDABLE, METHODS

from torchmesh import InvalidMeshError, Status, UntangleOptions, join, quality, smooth, untangle
from torchmesh.mesh.triangle import corners, signed_area
from torchmesh.untangling.options import NewtonWays

# All second-order ways, of which each gives up soon.
FEW = NewtonWays(
    (100,), pushes=8, alphas=(0.1,), steps_per_alpha=5, max_continuations=12, weightings=((100, 1.0, 2.0),)
)


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
    moved, info = untangle(folded, dataclasses.replace(METHODS[method], newton=FEW))
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
