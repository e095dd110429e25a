"""Polishing: the worst triangles get better, nothing else gets worse, every row stays."""

import math

import meshes
import pytest
import torch
from exact import boundary, directed_edges, inverted, total_area
from hypothesis import given, settings
from hypothesis import strategies as st

import torchmesh as tm
from torchmesh.mesh.certificate import same_frame
from torchmesh.mesh.connectivity import edges, twins
from torchmesh.smoothing.patches import Patches, every_flip, seeds_of
from torchmesh.smoothing.polishing import PolishOptions, _fan_limits, bad_triangles, polish


def hops(mesh, start):
    """For every vertex how many edges it is from the vertices `start`, by walking."""
    near = [[] for _ in range(len(mesh.points))]
    for u, w in edges(mesh.triangles, twins(mesh.triangles)).tolist():
        near[u].append(w)
        near[w].append(u)
    distance, front = dict.fromkeys(start, 0), list(start)
    while front:
        front = [w for u in front for w in near[u] if distance.setdefault(w, distance[u] + 1) == distance[u] + 1]
        front = list(dict.fromkeys(front))
    return distance


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
    if inverted(mesh):
        return
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


def test_a_mesh_with_many_bad_triangles_wants_other_means():
    mesh = meshes.delaunay(200, 1)
    bad = bad_triangles(mesh, tm.quality(mesh), PolishOptions())
    assert int(bad.sum()) > 0.1 * len(bad)
    after, info = polish(mesh)
    assert info.patches.tolist() == [0]
    assert torch.equal(after.points, mesh.points)
    assert torch.equal(after.triangles, mesh.triangles)


@pytest.mark.parametrize("degrees", [20, 60, 90, 200, 300])
@pytest.mark.parametrize("ratio", [1.0, 1.7, 6.0])
def test_no_fan_of_boundary_triangles_passes_its_limit(degrees, ratio):
    alpha, generator = math.radians(degrees), torch.Generator().manual_seed(degrees)
    best, roundest = 0.0, math.inf
    for k in range(1, 7):
        for trial in range(40):
            # Between sides of lengths 1 and `ratio`: equal shares at first, then any.
            part = torch.rand(k, generator=generator, dtype=torch.float64) if trial else torch.ones(k).double()
            step = torch.rand(k, generator=generator, dtype=torch.float64) if trial else torch.ones(k).double()
            turn = torch.nn.functional.pad((alpha * part / part.sum()).cumsum(0), (1, 0))
            length = torch.nn.functional.pad((math.log(ratio) * step / step.sum()).cumsum(0), (1, 0)).exp()
            if float((turn[1:] - turn[:-1]).max()) > 3.1:
                continue
            rim = torch.stack([length * turn.cos(), length * turn.sin()], 1)
            points = torch.cat([torch.zeros(1, 2, dtype=torch.float64), rim])
            fan = torch.tensor([[0, i + 1, i + 2] for i in range(k)])
            mesh = tm.MeshBatch.from_arrays(points, fan)
            angle = math.radians(float(tm.minimum_angle(mesh)))
            limit, least = (float(v[0]) for v in _fan_limits(mesh, torch.ones(k + 2, dtype=torch.bool)))
            # Sums of k angles and ratios, rounded.
            assert angle <= limit + 1e-12
            shape = float(tm.quality(mesh).max)
            assert shape >= least * (1 - 1e-12)
            best, roundest = max(best, angle), min(roundest, shape)
    assert best == pytest.approx(limit, rel=1e-9)
    assert roundest == pytest.approx(least, rel=1e-9)


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


@pytest.mark.parametrize("reach", [1, 2, 4])
def test_seeds_are_the_worst_for_as_far_as_they_reach(reach):
    mesh = meshes.delaunay(150, 5)
    angle = tm.metrics.measure(mesh, "minimum_angle")
    bad = angle < 30
    chosen = seeds_of(mesh, bad, angle, reach).tolist()
    assert chosen
    expected = []
    for row in bad.nonzero().squeeze(1).tolist():
        distance = hops(mesh, mesh.triangles[row].tolist())
        # A triangle is as near as the corner nearest to it, and the rank travels by triangles.
        rivals = [
            other
            for other in bad.nonzero().squeeze(1).tolist()
            if other != row and min(distance[v] for v in mesh.triangles[other].tolist()) <= reach - 1
        ]
        if all((float(angle[row]), row) < (float(angle[other]), other) for other in rivals):
            expected.append(row)
    assert chosen == expected


@pytest.mark.parametrize("rings", [1, 2, 3])
def test_patches_are_so_many_rings_and_do_not_touch(rings):
    mesh = meshes.disturbed(meshes.grid(20, 18), 0.005, 6)
    angle = tm.metrics.measure(mesh, "minimum_angle")
    seeds = seeds_of(mesh, torch.ones_like(angle, dtype=torch.bool), angle, 2 * rings)
    assert len(seeds) > 2
    patches = Patches.cut_out(mesh, seeds, rings, torch.ones_like(mesh.fixed))
    owner = {}
    for p, part in enumerate(patches.mesh.split()):
        rows = slice(int(patches.mesh.point_offsets[p]), int(patches.mesh.point_offsets[p + 1]))
        vertices = patches.vertices[rows]
        assert torch.equal(part.points, mesh.points[vertices])
        distance = hops(mesh, mesh.triangles[seeds[p]].tolist())
        free = {v for v, d in distance.items() if d < rings and not mesh.fixed[v]}
        assert set(vertices[~part.fixed].tolist()) == free
        touched = {t for t, row in enumerate(mesh.triangles.tolist()) if any(distance[v] < rings for v in row)}
        faces = patches.faces[patches.mesh.triangle_offsets[p] : patches.mesh.triangle_offsets[p + 1]]
        assert set(faces.tolist()) == touched
        assert torch.equal(vertices[part.triangles], mesh.triangles[faces])
        assert not touched & owner.keys()
        owner.update(dict.fromkeys(touched, p))


def test_every_legal_flip_of_every_mesh_is_a_member():
    batch = tm.join([meshes.delaunay(12, 7), meshes.l_shape(1), meshes.delaunay(9, 8)])
    members, owner, flipped = every_flip(batch, torch.ones_like(batch.fixed), None)
    assert len(members) == len(owner) == len(flipped)
    parts, kept = batch.split(), {b: set() for b in range(len(batch))}
    for member, b, changed in zip(members.split(), owner.tolist(), flipped.tolist(), strict=True):
        assert torch.equal(member.points, parts[b].points)
        was, now = (set(map(frozenset, edges(m.triangles, twins(m.triangles)).tolist())) for m in (parts[b], member))
        assert len(was - now) == len(now - was) == int(changed)
        assert inverted(member) == 0
        assert max(directed_edges(member.triangles).values()) == 1
        assert boundary(member.triangles) == boundary(parts[b].triangles)
        kept[b] |= was - now
    locked = set(map(frozenset, parts[1].constrained_edges.tolist()))
    assert locked
    assert not locked & kept[1]
    for b, part in enumerate(parts):
        convex = 0
        twin = twins(part.triangles)
        for h in (twin > torch.arange(len(twin))).nonzero().squeeze(1).tolist():
            u, w = part.triangles[h // 3][h % 3], part.triangles[h // 3][(h + 1) % 3]
            s, g = part.triangles[h // 3][(h + 2) % 3], int(twin[h])
            r = part.triangles[g // 3][(g + 2) % 3]
            new = part.with_triangles(part.triangles.clone())
            new.triangles[h // 3], new.triangles[g // 3] = torch.stack([u, r, s]), torch.stack([r, w, s])
            convex += inverted(new) == 0 and frozenset([int(u), int(w)]) not in (locked if b == 1 else ())
        assert len(kept[b]) == convex > 0


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
    plain, _ = tm.improve(mesh, tm.ImproveOptions(topology=topology, polish=None))
    after, report = tm.improve(mesh, tm.ImproveOptions(topology=topology))
    assert report.certified.all()
    assert float(tm.minimum_angle(after)) >= float(tm.minimum_angle(plain))
    stages = [step.stage for step in report.steps[0]]
    bad = bad_triangles(plain, tm.quality(plain), PolishOptions())
    assert ("polish" in stages) == bool(bad.any())


@pytest.mark.parametrize("wrong", [{"angle": 60}, {"angle": -1}, {"ratio": 1}, {"max_rounds": -1}])
def test_options_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=f"PolishOptions.{next(iter(wrong))}"):
        PolishOptions(**wrong)
