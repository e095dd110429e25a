"""Polishing: the worst triangles get better, nothing else gets worse, every row stays."""

import math

import meshes
import pytest
import torch
from exact import boundary, directed_edges, inverted, total_area
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import torchmesh as tm
from torchmesh.mesh.certificate import same_frame
from torchmesh.mesh.connectivity import twins
from torchmesh.smoothing.polishing import PolishLevel, PolishOptions, bad_triangles, polish


def slanted() -> tm.MeshBatch:
    """Equilateral triangles, of which one edge was flipped: two obtuse triangles that no single move betters."""
    mesh = meshes.equilateral(8, 7)
    triangles = mesh.triangles.clone()
    twin = twins(triangles)
    middle = mesh.points.mean(0)
    h = int(((mesh.points[triangles].mean(1) - middle).square().sum(1).argmin()) * 3)
    g = int(twin[h])
    u, w = int(triangles.reshape(-1)[h]), int(triangles.reshape(-1)[g])
    s, r = (int(triangles[k // 3][(k + 2) % 3]) for k in (h, g))
    triangles[h // 3], triangles[g // 3] = torch.tensor([u, r, s]), torch.tensor([r, w, s])
    return tm.MeshBatch.from_arrays(mesh.points, triangles)


def assert_nothing_is_worse(before, after, options):
    for name in ("fixed", "constrained_edges", "point_offsets", "triangle_offsets"):
        assert torch.equal(getattr(after, name), getattr(before, name)), name
    assert torch.equal(after.points[before.fixed], before.points[before.fixed])
    assert inverted(after) == 0
    assert max(directed_edges(after.triangles).values()) == 1
    assert boundary(after.triangles) == boundary(before.triangles)
    assert total_area(after) == total_area(before)
    assert same_frame(before, after, before.fixed).all()
    assert (tm.minimum_angle(after) >= tm.minimum_angle(before)).all()
    assert (tm.quality(after).max <= tm.quality(before).max.clamp_min(options.ratio)).all()
    left, given_ = (int(bad_triangles(m, tm.quality(m), options).sum()) for m in (after, before))
    assert left <= given_


def test_a_wrong_flip_is_taken_back():
    mesh = slanted()
    options = PolishOptions(angle=35)
    assert float(tm.minimum_angle(mesh)) == pytest.approx(30, abs=0.5)
    after, info = polish(mesh, options)
    assert_nothing_is_worse(mesh, after, options)
    assert info.patches.tolist() == [1]
    assert info.flips.tolist() == [1]
    assert float(tm.minimum_angle(after)) > 55


def test_what_is_good_enough_comes_back_as_it_was():
    tangled = meshes.jittered(8, 7, 1.0, 0)
    batch = tm.join([meshes.equilateral(), tangled, meshes.grid()])
    after, info = polish(batch)
    assert after is batch
    assert info.patches.tolist() == info.flips.tolist() == [0, 0, 0]
    mixed, info = polish(tm.join([batch, slanted()]), PolishOptions(angle=35))
    assert info.patches.tolist() == [0, 0, 0, 1]
    assert torch.equal(mixed.points[: len(batch.points)], batch.points)
    assert torch.equal(mixed.triangles[: len(batch.triangles)], batch.triangles)


def rough(seed: int) -> tm.MeshBatch:
    """A patch of nearly equilateral triangles or an L of two regions, with a few small angles."""
    if seed % 2:
        return meshes.disturbed(meshes.equilateral(12, 10), 0.12, seed)
    return meshes.disturbed(meshes.l_shape(5), 0.02, seed)


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.sampled_from([25.0, 30.0]), st.booleans())
def test_nothing_gets_worse_and_every_row_stays(seed, angle, random):
    mesh = meshes.delaunay(60, seed) if random else rough(seed)
    assume(not inverted(mesh))
    options = PolishOptions(angle=angle, max_rounds=4)
    after, info = polish(mesh, options)
    assert_nothing_is_worse(mesh, after, options)
    assert (int(info.patches) > 0) == (not torch.equal(after.points, mesh.points) or int(info.flips) > 0)


def test_small_angles_go():
    options = PolishOptions(angle=30)
    batch = tm.join([rough(seed) for seed in range(8)])
    after, info = polish(batch, options)
    assert_nothing_is_worse(batch, after, options)
    wanted = tm.minimum_angle(batch) < 30
    assert int(wanted.sum()) > 4
    assert torch.equal(info.patches > 0, wanted)
    assert (tm.minimum_angle(after) >= 30).all()


def test_a_mesh_with_many_bad_triangles_comes_back_unchanged():
    mesh = meshes.delaunay(200, 1)
    bad = bad_triangles(mesh, tm.quality(mesh), PolishOptions())
    assert int(bad.sum()) > 0.1 * len(bad)
    after, info = polish(mesh)
    assert info.patches.tolist() == [0]
    assert torch.equal(after.points, mesh.points)
    assert torch.equal(after.triangles, mesh.triangles)


def test_a_mesh_alone_and_the_same_in_a_batch_get_the_same_bits():
    parts = [rough(0), slanted(), rough(1), meshes.equilateral(), rough(2), rough(3), meshes.delaunay(60, 3)]
    options = PolishOptions(angle=30, max_rounds=5)
    together, info = polish(tm.join(parts), options)
    assert int((info.patches > 0).sum()) == 3
    for b, (part, joined) in enumerate(zip(parts, together.split(), strict=True)):
        alone, its = polish(part, options)
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)
        assert int(its.patches) == int(info.patches[b])
        assert int(its.flips) == int(info.flips[b])


def test_single_precision_stays_valid():
    mesh = rough(0).to(torch.float32)
    after, info = polish(mesh, PolishOptions(angle=30))
    assert after.points.dtype == torch.float32
    assert int(info.patches) > 0
    assert tm.quality(after).inverted.tolist() == [0]
    assert float(tm.minimum_angle(after)) >= float(tm.minimum_angle(mesh))


def test_no_angle_is_missed_by_looking_at_ratios_first():
    mesh = meshes.delaunay(300, 9)
    options = PolishOptions(angle=30, ratio=3.0)
    expected = (tm.metrics.measure(mesh, "minimum_angle") < 30) | (tm.quality(mesh).inverse_mean_ratio > 3)
    assert torch.equal(bad_triangles(mesh, tm.quality(mesh), options), expected)
    assert bad_triangles(mesh, tm.quality(mesh), PolishOptions(angle=0, ratio=math.inf)).sum() == 0


@pytest.mark.parametrize("topology", ["flip", "full"])
def test_improve_polishes_and_says_so(topology):
    # Walls whose edges are three times as long as those of the floor.
    points, triangles = meshes.grid_arrays(9, 3)
    mesh = tm.MeshBatch.from_arrays(points, triangles)
    plain, _ = tm.improve(mesh, tm.ImproveOptions(topology=topology, shapes="equilateral", polish=None))
    after, report = tm.improve(mesh, tm.ImproveOptions(topology=topology, shapes="equilateral"))
    assert report.certified.all()
    assert float(tm.minimum_angle(after)) >= float(tm.minimum_angle(plain))
    stages = [step.stage for step in report.steps[0]]
    bad = bad_triangles(plain, tm.quality(plain), PolishOptions())
    assert ("polish" in stages) == bool(bad.any())


@pytest.mark.parametrize(
    "wrong",
    [
        {"angle": 60},
        {"angle": -1},
        {"ratio": 1},
        {"max_rounds": -1},
        {"groups": 0},
        {"finalists": 0},
        {"angle_gain": -0.1},
        {"ratio_gain": math.nan},
        {"limit_share": 0},
        {"angle_margin": -1},
        {"levels": ()},
        {"levels": (PolishLevel(rings=0, flips=1, at_worst=True, most=1, share=0.0),)},
    ],
)
def test_options_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=f"PolishOptions.{next(iter(wrong))}"):
        PolishOptions(**wrong)
