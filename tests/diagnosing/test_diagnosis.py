import dataclasses

import numpy as np
import pytest
import torch

from experiments.robustness.attack import cracks
from torchmesh.diagnosing import diagnosis
from torchmesh.diagnosing.diagnosis import ProblemKind, diagnose
from torchmesh.improving.pipeline import improve
from torchmesh.kernels import library
from torchmesh.mesh.batch import MeshBatch, join
from torchmesh.mesh.measure import quality
from torchmesh.status import Status
from torchmesh.triangulating import crossings


def grid(n, hole=()):
    """An n x n grid without the cells (i, j) of `hole`: points, triangles, index (n+1, n+1) with -1 for unused."""
    x, y = np.meshgrid(np.arange(n + 1) / n, np.arange(n + 1) / n, indexing="ij")
    index = np.arange(x.size).reshape(x.shape)
    cells = [(i, j) for i in range(n) for j in range(n) if (i, j) not in hole]
    triangles = []
    for i, j in cells:
        a, b, c, d = index[i, j], index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]
        triangles += [[a, b, c], [a, c, d]]
    used, triangles = np.unique(triangles, return_inverse=True)
    number = np.full(x.size, -1)
    number[used] = np.arange(len(used))
    return np.stack([x.ravel(), y.ravel()], 1)[used], triangles.reshape(-1, 3), number[index]


HOLE = [(3, 3), (3, 4), (4, 3), (4, 4)]


def kinds(problems):
    return {p.kind for p in problems}


def moved(points, index, rows, shift):
    points = points.copy()
    points[np.setdiff1d(index[rows], -1)] += shift
    return points


@pytest.mark.parametrize(("n", "hole"), [(1, ()), (4, ()), (8, HOLE), (8, [(0, 3)]), (8, [(2, 2), (3, 3)])])
def test_sound_boundaries_are_left_in_peace(n, hole):
    """With holes, a notch, and two holes that share a vertex; the interior vertices may be anywhere."""
    points, triangles, _ = grid(n, hole)
    mesh = MeshBatch.from_arrays(points, triangles)
    assert diagnose(mesh) == []
    points[~mesh.fixed.numpy()] = 17.0
    assert diagnose(mesh.with_points(torch.from_numpy(points))) == []


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1.0, 1e8), (1e-100, 0.0), (1e100, 0.0)])
def test_boundary_that_crosses_itself_is_named_with_its_place(scale, offset):
    points, triangles, index = grid(4)
    points[index[4, 2]] = [-0.25, 0.5]
    mesh = MeshBatch.from_arrays(points * scale + offset, triangles)
    problems = diagnose(mesh)
    assert kinds(problems) == {ProblemKind.BOUNDARY_CROSSING}
    pairs = {frozenset([frozenset(p.vertices[:2]), frozenset(p.vertices[2:])]) for p in problems}
    low, high = (frozenset([int(index[4, 2]), int(index[4, j])]) for j in (1, 3))
    left = [frozenset([int(index[0, j]), int(index[0, j + 1])]) for j in (1, 2)]
    assert pairs == {frozenset([low, left[0]]), frozenset([high, left[1]])}
    for p in problems:
        place = (np.array(p.place) - offset) / scale
        assert place == pytest.approx(
            [0.0, 0.45 if low in (set(p.vertices[:2]), set(p.vertices[2:])) else 0.55], abs=1e-6
        )
        assert all(str(v) in p.message for v in p.vertices)
        assert p.mesh == 0


def test_hole_across_the_boundary_and_touching_it():
    points, triangles, index = grid(8, HOLE)
    hole = np.ix_([3, 4, 5], [3, 4, 5])
    across = MeshBatch.from_arrays(moved(points, index, hole, [0.45, 0.03]), triangles)
    assert kinds(diagnose(across)) == {ProblemKind.BOUNDARY_CROSSING}
    corner = points.copy()
    corner[index[5, 4]] = [1.0, 0.55]
    touching = diagnose(MeshBatch.from_arrays(corner, triangles))
    assert kinds(touching) == {ProblemKind.BOUNDARY_CROSSING}
    assert all(index[5, 4] in p.vertices for p in touching)
    assert all(p.place == pytest.approx((1.0, 0.55)) for p in touching)


def test_hole_outside_in_another_hole_and_inside_out():
    points, triangles, index = grid(12, [(2, 2), (8, 8)])
    one, two = np.ix_([2, 3], [2, 3]), np.ix_([8, 9], [8, 9])
    outside = diagnose(MeshBatch.from_arrays(moved(points, index, one, [3.0, 0.0]), triangles))
    assert kinds(outside) == {ProblemKind.HOLE_OUTSIDE}
    assert outside[0].vertices[0] in index[one]
    points[index[two]] = 0.5 + 4 * (points[index[two]] - points[index[two]].mean((0, 1)))
    points[index[one]] += 0.5 - points[index[one]].mean((0, 1))
    nested = diagnose(MeshBatch.from_arrays(points, triangles))
    assert kinds(nested) == {ProblemKind.HOLE_OUTSIDE}
    assert set(nested[0].vertices) <= set(index[one].ravel()) | set(index[two].ravel())
    points, triangles, index = grid(12, [(5, 5)])
    ring = np.ix_([5, 6], [5, 6])
    points[index[ring]] = points[index[ring]][::-1]
    mirrored = diagnose(MeshBatch.from_arrays(points, triangles))
    assert kinds(mirrored) == {ProblemKind.HOLE_INSIDE_OUT}
    assert mirrored[0].vertices[0] in index[ring]


def test_negative_area():
    points, triangles, _ = grid(4)
    mesh = MeshBatch.from_arrays(points, triangles)
    mirrored = mesh.with_points(mesh.points * torch.tensor([-1.0, 1.0], dtype=torch.float64))
    assert kinds(diagnose(mirrored)) == {ProblemKind.NO_AREA}
    flat = mesh.with_points(mesh.points * torch.tensor([1.0, 0.0], dtype=torch.float64))
    assert {ProblemKind.BOUNDARY_CROSSING, ProblemKind.DUPLICATE_VERTICES} >= kinds(diagnose(flat)) > set()


def test_closed_surface():
    triangles = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]])
    problems = diagnose(MeshBatch.from_arrays(np.array([[0, 0], [1, 0], [0, 1], [0.25, 0.25]], float), triangles))
    assert kinds(problems) == {ProblemKind.NO_AREA}


def test_duplicate_boundary_vertices():
    points, triangles, index = grid(4)
    points[index[4, 2]] = points[index[4, 3]]
    problems = diagnose(MeshBatch.from_arrays(points, triangles))
    assert kinds(problems) == {ProblemKind.DUPLICATE_VERTICES}
    assert problems[0].vertices == tuple(sorted((index[4, 2], index[4, 3])))
    assert problems[0].place == (1.0, 0.75)


def test_constrained_edges_that_cross_each_other_or_the_boundary():
    points, triangles, index = grid(6)
    edges = np.array([[index[2, 2], index[2, 3]], [index[4, 2], index[4, 3]]])
    crossed = points.copy()
    crossed[edges] = [[[0.3, 0.3], [0.7, 0.7]], [[0.3, 0.7], [0.7, 0.3]]]
    problems = diagnose(MeshBatch.from_arrays(crossed, triangles, constrained_edges=edges))
    assert kinds(problems) == {ProblemKind.CONSTRAINT_CROSSING}
    assert set(problems[0].vertices) == set(edges.ravel())
    assert problems[0].place == pytest.approx((0.5, 0.5))
    points[edges[0, 1]] = [0.4, 1.2]
    problems = diagnose(MeshBatch.from_arrays(points, triangles, constrained_edges=edges))
    assert kinds(problems) == {ProblemKind.CONSTRAINT_CROSSING}


def test_fixed_vertices_outside_and_on_edges_and_region_turned_inside_out():
    points, triangles, index = grid(8)
    fixed = np.zeros(81, bool)
    fixed[[index[2, 2], index[5, 5]]] = True
    points[index[2, 2]] = [1.5, 0.5]
    points[index[5, 5]] = [0.3, 0.0]
    problems = diagnose(MeshBatch.from_arrays(points, triangles, fixed=fixed))
    assert kinds(problems) == {ProblemKind.VERTEX_OUTSIDE}
    assert [p.vertices[0] for p in problems] == [index[5, 5]]
    points[index[5, 5]] = [0.3, 0.1]
    problems = diagnose(MeshBatch.from_arrays(points, triangles, fixed=fixed))
    assert [p.vertices for p in problems] == [(index[2, 2],)]
    assert problems[0].place == (1.5, 0.5)
    points, triangles, index = grid(8)
    ring = [index[3, 3], index[4, 3], index[5, 3], index[5, 4], index[5, 5], index[4, 5], index[3, 5], index[3, 4]]
    loop = np.stack([ring, np.roll(ring, -1)], 1)
    points[ring] = points[ring[::-1]]
    problems = diagnose(MeshBatch.from_arrays(points, triangles, constrained_edges=loop))
    assert kinds(problems) == {ProblemKind.NO_AREA, ProblemKind.HOLE_INSIDE_OUT}


def test_pieces_may_lie_over_each_other():
    points, triangles, _ = grid(4)
    both = np.concatenate([points, points + 0.4])
    assert diagnose(MeshBatch.from_arrays(both, np.concatenate([triangles, triangles + len(points)]))) == []


def test_batch_names_the_mesh():
    points, triangles, index = grid(4)
    good = MeshBatch.from_arrays(points, triangles)
    points[index[4, 2]] = [-0.25, 0.5]
    problems = diagnose(join([good, MeshBatch.from_arrays(points, triangles), good]))
    assert {p.mesh for p in problems} == {1}
    assert max(max(p.vertices) for p in problems) < len(points)


@pytest.mark.parametrize("topology", ["keep", "flip"])
def test_a_batch_is_told_what_its_meshes_are_told_alone_and_sound_ones_are_not_looked_at_alone(topology, monkeypatch):
    """A crossing hides what lies wrongly in the same look; every fault is told all the same."""
    points, triangles, index = grid(6)
    tangled = points.copy()
    tangled[index[3, 3]] += 0.3
    crossed = tangled.copy()
    crossed[[index[0, 1], index[0, 4]]] = crossed[[index[0, 4], index[0, 1]]]
    inside_out = tangled * [-1.0, 1.0]
    sound = MeshBatch.from_arrays(points, triangles)
    meshes = [sound.with_points(torch.from_numpy(p)) for p in [tangled, inside_out, *[tangled] * 6, crossed, points]]
    batch = join(meshes)
    alone = [dataclasses.replace(p, mesh=b) for b, mesh in enumerate(meshes) for p in diagnose(mesh, topology)]
    assert {p.mesh for p in alone} == {1, 8}
    looks = []
    one = diagnosis._of_one
    monkeypatch.setattr(diagnosis, "_of_one", lambda mesh, keep, most: looks.append(len(mesh)) or one(mesh, keep, most))
    assert diagnose(batch, topology) == alone
    assert looks.count(1) == 2


def test_twins_that_are_known_change_nothing(monkeypatch):
    points, triangles, index = grid(6)
    tangled = points.copy()
    tangled[index[3, 3]] += 0.3
    crossed = tangled.copy()
    crossed[[index[0, 1], index[0, 4]]] = crossed[[index[0, 4], index[0, 1]]]
    parts = [MeshBatch.from_arrays(points, triangles).with_points(torch.from_numpy(p)) for p in (tangled, crossed)]
    batch = join([*parts, parts[0]])
    anew = dataclasses.replace(batch, _twin=None)
    assert batch.known_twin is not None
    assert anew.known_twin is None
    found = diagnose(batch)
    assert {problem.mesh for problem in found} == {1}
    assert diagnose(anew) == found
    sound = join([parts[0], parts[0]])
    monkeypatch.setattr("torchmesh.mesh.connectivity.twins", lambda *_: pytest.fail("the twins were known"))
    assert diagnose(sound) == []


def test_the_search_for_crossings_looks_at_few_pairs_however_long_the_boundary(monkeypatch):
    looked_at = []

    def judged(points, one, two):
        looked_at.append(len(one))
        return judge(points, one, two)

    judge = crossings._meet
    monkeypatch.setattr(crossings, "_meet", judged)
    for n in (20, 80):
        points, triangles, index = grid(n)
        points[index[n // 2, n // 2]] += 1.5 / n  # one tangle, so that the boundary is looked at
        looked_at.clear()
        with library.using("torch"):
            assert diagnose(MeshBatch.from_arrays(points, triangles)) == []
        # Each of the 4 n boundary edges and its two neighbours have boxes that touch.
        assert 4 * n <= sum(looked_at) <= 8 * n


# --- with the triangles kept ---


def keep_kinds(mesh):
    return kinds(diagnose(mesh, topology="keep"))


@pytest.mark.parametrize("hole", [(), HOLE, [(0, 3)], [(2, 2), (3, 3)]])
def test_sound_meshes_are_left_in_peace_with_their_triangles_kept(hole):
    points, triangles, _ = grid(8, hole)
    mesh = MeshBatch.from_arrays(points, triangles)
    assert diagnose(mesh, topology="keep") == []
    points[~mesh.fixed.numpy()] = 17.0
    assert diagnose(mesh.with_points(torch.from_numpy(points)), topology="keep") == []


@pytest.mark.parametrize(("scale", "offset"), [(1.0, 0.0), (1.0, 1e8), (1e-140, 0.0), (1e140, 0.0)])
def test_an_inverted_triangle_of_fixed_vertices(scale, offset):
    # The corner (1, 0) of the square pushed in beyond the diagonal of its cell: the square stays simple.
    points, triangles, index = grid(4)
    points[index[4, 0]] = [0.78125, 0.21875]
    mesh = MeshBatch.from_arrays(points * scale + offset, triangles)
    assert diagnose(mesh) == []
    found = diagnose(mesh, topology="keep")
    corner = {int(index[4, 0]), int(index[3, 0]), int(index[4, 1])}
    assert keep_kinds(mesh) <= {ProblemKind.FIXED_TRIANGLE, ProblemKind.FIXED_EDGE}
    assert [set(p.vertices) for p in found if p.kind is ProblemKind.FIXED_TRIANGLE] == [corner]
    if scale == 1.0:
        assert found[0].place == pytest.approx(np.mean([[0.78125, 0.21875], [0.75, 0], [1, 0.25]], 0) + offset)
    assert "three fixed vertices" in found[0].message


def test_edges_between_fixed_vertices_that_leave_the_domain_or_cross():
    points, triangles, index = grid(4)
    fixed = np.zeros(len(points), bool)
    fixed[[index[1, 1], index[2, 2], index[1, 2], index[2, 1]]] = True
    swapped = points.copy()
    # The cell's diagonal and a side of it, between vertices that a user fixed, now cross.
    swapped[index[1, 1]], swapped[index[1, 2]] = [0.45, 0.3], [0.3, 0.2]
    mesh = MeshBatch.from_arrays(swapped, triangles, fixed)
    assert diagnose(mesh) == []
    assert keep_kinds(mesh) > set()
    # A straight edge across a bay: three cells of boundary pulled in below the edge over them.
    bay = MeshBatch.from_arrays(
        [[0, 0], [2, 1.9], [4, 0], [4, 3], [0, 3], [2, 2.5]],
        [[0, 1, 5], [1, 2, 5], [2, 3, 5], [3, 4, 5], [4, 0, 5]],
    )
    assert diagnose(bay, topology="keep") == []
    across = MeshBatch.from_arrays(
        [[0, 0], [2, 1.9], [4, 0], [4, 3], [0, 3], [2, 2.5]],
        [[0, 1, 2], [0, 2, 5], [2, 3, 5], [3, 4, 5], [4, 0, 5]],
    )
    assert diagnose(across) == []
    assert ProblemKind.FIXED_TRIANGLE in keep_kinds(across)


def star(radii, turn=0.1):
    """A free vertex in the middle of a ring at these radii."""
    count = len(radii)
    angle = 2 * np.pi * np.arange(count) / count + turn
    ring = np.stack([np.cos(angle), np.sin(angle)], 1) * np.asarray(radii)[:, None]
    points = np.concatenate([ring, [[0.0, 0.0]]])
    return points, np.array([[i, (i + 1) % count, count] for i in range(count)])


@pytest.mark.parametrize("count", [8, 30])
def test_a_ring_without_a_kernel(count):
    # A band that winds three quarters round: no place sees all of it.
    half = count // 2
    angle = np.linspace(0, 1.5 * np.pi, half)
    band = np.concatenate([np.stack([r * np.cos(a), r * np.sin(a)], 1) for r, a in ((1.0, angle), (0.8, angle[::-1]))])
    triangles = [[i, (i + 1) % (2 * half), 2 * half] for i in range(2 * half)]
    mesh = MeshBatch.from_arrays(np.concatenate([band, [[0.9, 0.0]]]), triangles)
    found = diagnose(mesh, topology="keep")
    assert [(p.kind, p.vertices) for p in found] == [(ProblemKind.NO_KERNEL, (2 * half,))]
    assert diagnose(mesh) == []


@pytest.mark.parametrize("count", [3, 4, 7, 14, 15, 40])
def test_star_shaped_rings_have_a_kernel_wherever_their_vertex_is(count):
    rng = np.random.default_rng(count)
    for _ in range(5):
        points, triangles = star(rng.uniform(0.5, 1.5, count))
        points[-1] = rng.normal(size=2) * 5
        assert ProblemKind.NO_KERNEL not in keep_kinds(MeshBatch.from_arrays(points, triangles))


def test_a_kernel_without_area_is_none_and_a_small_one_is_one():
    # The half-planes of the notch's sides meet in one point at gap 0, in nothing below, in a little above.
    def notched(gap):
        points = np.array(
            [[0, 0], [4, 0], [4, 2], [2 + gap, 2], [3 + gap, 4], [1 - gap, 4], [2 - gap, 2], [0, 2], [2, 1.0]]
        )
        return MeshBatch.from_arrays(points, [[i, (i + 1) % 8, 8] for i in range(8)])

    assert keep_kinds(notched(0.25)) == set()
    assert ProblemKind.NO_KERNEL in keep_kinds(notched(-0.6))


def test_problems_of_a_kind_are_told_up_to_a_number():
    points, triangles, _ = grid(20)
    mesh = MeshBatch.from_arrays(points, triangles)
    zigzag = mesh.points.clone()
    rim = mesh.fixed.nonzero().squeeze(1)
    zigzag[rim] = zigzag[rim][torch.randperm(len(rim), generator=torch.Generator().manual_seed(0))]
    for most in (1, 7, 20):
        found = diagnose(mesh.with_points(zigzag), most=most)
        assert len(found) == most
        assert kinds(found) == {ProblemKind.BOUNDARY_CROSSING}


def test_a_topology_that_is_none_is_refused():
    with pytest.raises(ValueError, match="topology must be 'keep' or 'flip', not 'full'"):
        diagnose(MeshBatch.from_arrays(*grid(2)[:2]), topology="full")


def test_a_valid_mesh_is_never_accused():
    """Sheets that lie over each other, a slit of no width: all triangles upright, so nothing is impossible."""
    spiral = np.array([[r * np.cos(a), r * np.sin(a)] for a in np.linspace(0, 9, 60) for r in (1.0, 2.0)])
    k = 2 * np.arange(59)
    strip = np.concatenate([np.stack([k, k + 1, k + 3], 1), np.stack([k, k + 3, k + 2], 1)])
    assert diagnose(MeshBatch.from_arrays(spiral, strip)) == []
    assert diagnose(slit(8)) == []
    assert diagnose(slit(8), "keep") == []
    points, triangles, index = grid(4)
    points[index[4, 2]] = [-0.25, 0.5]
    crossed = MeshBatch.from_arrays(points, triangles)
    assert len(diagnose(join([slit(8), crossed]))) == len(diagnose(crossed))


def slit(n):
    """A grid cut open along its middle from 1/4 to 3/4: the two sides of the cut lie on each other."""
    points, triangles, index = grid(n)
    cut = index[n // 4 + 1 : 3 * n // 4, n // 2]
    twin_of = np.arange(len(points))
    twin_of[cut] = len(points) + np.arange(len(cut))
    above = points[triangles].mean(1)[:, 1] > 0.5
    return MeshBatch.from_arrays(
        np.concatenate([points, points[cut]]), np.where(above[:, None], twin_of[triangles], triangles)
    )


def test_as_many_problems_of_a_kind_as_asked_for_however_many_there_are():
    points, triangles, index = grid(24)
    rng = np.random.default_rng(0)
    held = np.ones(len(points), bool)
    held[index[2:-2:2, 2:-2:2]] = False
    mesh = MeshBatch.from_arrays(rng.uniform(size=points.shape), triangles, held)
    problems = diagnose(mesh, "keep", most=3)
    told = {kind: sum(p.kind == kind for p in problems) for kind in kinds(problems)}
    assert told[ProblemKind.FIXED_TRIANGLE] == told[ProblemKind.NO_KERNEL] == told[ProblemKind.BOUNDARY_CROSSING] == 3
    assert max(told.values()) == 3


@pytest.mark.parametrize("keep", ["keep", "flip"])
def test_slits_are_no_problem_and_other_problems_told_all_the_same(keep):
    mesh = slit(8)
    points = mesh.points.clone()
    points[(~mesh.fixed).nonzero().squeeze(1)[::3]] += 0.4
    tangled = mesh.with_points(points)
    assert diagnose(tangled, keep) == []
    points[0] = torch.tensor([0.5, 0.55])  # a corner, across the slit's middle
    problems = diagnose(mesh.with_points(points), keep)
    assert ProblemKind.BOUNDARY_CROSSING in kinds(problems)
    assert kinds(problems) <= {ProblemKind.BOUNDARY_CROSSING, ProblemKind.FIXED_TRIANGLE}


def test_a_hole_with_its_side_on_the_boundary_is_no_slit():
    points, triangles, index = grid(16, [(i, j) for i in range(6, 10) for j in range(6, 10)])
    block = np.ix_(range(6, 11), range(6, 11))
    mesh = MeshBatch.from_arrays(moved(points, index, block, [6 / 16, 0.0]), triangles)
    problems = diagnose(mesh)
    assert kinds(problems) <= {ProblemKind.DUPLICATE_VERTICES, ProblemKind.BOUNDARY_CROSSING}
    assert all(p.place[0] == 1.0 for p in problems)
    assert len(problems) >= 3


def test_a_slit_that_crosses_another_boundary_is_named():
    mesh = slit(8)
    points = mesh.points.clone()
    below, above = ((points[:, 1] == 0.5) & (points[:, 0] == 0.5)).nonzero().squeeze(1).tolist()
    points[below, 1], points[above, 1] = 0.4, 0.6
    assert diagnose(mesh.with_points(points)) == []
    # Overlapping sheets of upright triangles are valid; with one inverted, the overlap is told, and they are mended.
    points[below, 1], points[above, 1] = 0.7, 0.3
    assert diagnose(mesh.with_points(points)) == []
    points[(~mesh.fixed).nonzero()[0]] += 0.4
    problems = diagnose(mesh.with_points(points))
    assert kinds(problems) == {ProblemKind.BOUNDARY_CROSSING}
    assert problems[0].vertices[0] in {below, above}
    assert bool(improve(mesh.with_points(points))[1].valid)


@pytest.mark.parametrize("seed", range(4))
def test_tangles_beside_a_slit_are_untangled(seed):
    mesh = slit(12)
    free = (~mesh.fixed)[:, None]
    throw = 0.05 * torch.randn(mesh.points.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    after, report = improve(mesh.with_points(torch.where(free, mesh.points + throw, mesh.points)))
    assert report.certified.tolist() == [True]
    assert torch.equal(after.points[mesh.fixed], mesh.points[mesh.fixed])


@pytest.mark.parametrize("handles", [1, 2])
def test_a_surface_with_handles_is_named_at_once(handles):
    """Tori of 6 x 6 cells, each but the first sewn into a hole of the one before, with one hole left."""
    count = 6
    triangles = []
    for k in range(handles):
        for i, j in np.ndindex(count, count):
            a, b, c, d = (
                36 * k + (i + p) % count * count + (j + q) % count for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))
            )
            triangles += [(a, b, c), (a, c, d)]
    # Two cells that are far apart go: one is left open, the other is where the next torus is sewn in.
    gone = {(0, 6, 7), (0, 7, 1)}
    if handles == 2:
        gone |= {(21, 27, 28), (21, 28, 22), (36 + 21, 36 + 27, 36 + 28), (36 + 21, 36 + 28, 36 + 22)}
    triangles = [t for t in triangles if t not in gone]
    sewn = {36 + 21: 21, 36 + 27: 22, 36 + 28: 28, 36 + 22: 27} if handles == 2 else {}
    triangles = np.array([[sewn.get(v, v) for v in t] for t in triangles])
    used, triangles = np.unique(triangles, return_inverse=True)
    triangles = triangles.reshape(-1, 3)
    points = np.random.default_rng(0).random((len(used), 2)) + 1
    points[np.searchsorted(used, [0, 6, 7, 1])] = [[0, 0], [0, 3], [3, 3], [3, 0]]
    mesh = MeshBatch.from_arrays(points, triangles)
    for topology in ("flip", "keep"):
        problems = diagnose(mesh, topology)
        assert kinds(problems) == {ProblemKind.NOT_PLANE}
        assert f"{handles} handle" in problems[0].message
    _, report = improve(mesh)
    assert report.status.tolist() == [Status.INFEASIBLE]
    assert "handle" in report.messages[0]


def test_a_disc_joined_to_itself_in_a_vertex_is_named():
    points, triangles, index = grid(6)
    inner, corner = int(index[3, 3]), int(index[0, 0])
    triangles = np.where(triangles == inner, corner, triangles)
    triangles -= triangles > inner
    problems = diagnose(MeshBatch.from_arrays(np.delete(points, inner, 0), triangles))
    assert kinds(problems) == {ProblemKind.NOT_PLANE}
    assert problems[0].vertices == (corner,)


@pytest.mark.parametrize("seed", range(6))
def test_boundaries_that_touch_themselves_are_no_problem(seed):
    rng = np.random.default_rng(seed)
    meshes = [cracks.two_lips(rng), cracks.crack(rng), cracks.crack(rng, kinked=True), cracks.walk(rng)]
    for points, triangles in meshes:
        mesh = MeshBatch.from_arrays(points, triangles)
        assert int(quality(mesh).inverted[0]) > 0, "a valid mesh is never looked at"
        assert diagnose(mesh) == []


def test_a_boundary_edge_of_no_length_is_impossible():
    points, triangles, index = grid(4)
    points[index[4, 2]] = points[index[4, 3]]
    points[index[2, 2]] += 0.4
    problems = diagnose(MeshBatch.from_arrays(points, triangles))
    assert kinds(problems) == {ProblemKind.DUPLICATE_VERTICES}
    assert "torchmesh clean" in problems[0].message


def test_vertices_of_a_crack_in_place_of_a_fixed_inner_one_are_told():
    points, triangles = cracks.two_lips(np.random.default_rng(0), flips=0)
    points[9] = points[8]
    fixed = np.zeros(10, bool)
    fixed[9] = True
    problems = diagnose(MeshBatch.from_arrays(points, triangles, fixed))
    assert kinds(problems) == {ProblemKind.DUPLICATE_VERTICES}
    assert problems[0].vertices == (8, 9)
