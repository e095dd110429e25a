"""Cavities are re-triangulated into valid meshes, whatever lies in them; what is impossible is said."""

import numpy as np
import pytest
import torch
from cavities import edge_set, grid, make, region_mesh, whole
from exact import edge_counts, inverted
from hypothesis import given, settings
from hypothesis import strategies as st
from judges import assert_every_row_stays
from polygons import CROSSED, edges_of
from scipy.spatial import Delaunay

from experiments.robustness.attack import cracks
from torchmesh.errors import InvalidMeshError
from torchmesh.mesh.batch import MeshBatch, join
from torchmesh.mesh.interfaces import holding
from torchmesh.triangulating.arrays import Obstacle
from torchmesh.untangling import cavity as cavity_module
from torchmesh.untangling.retriangulation import (
    _corners_in_regions,
    _with_ring,
    retriangulate,
    untangle_by_retriangulation,
)

HOW = ["kept", "shuffled", "outside", "one point", "on one boundary vertex", "on a line"]


def disc(boundary, rings=3):
    """Rings of vertices that shrink from the loop `boundary` (n, 2) to its mean: rightly joined, maybe tangled."""
    count, centre = len(boundary), boundary.mean(0)
    points = np.concatenate([centre + (boundary - centre) * (1 - k / rings) for k in range(rings)] + [centre[None]])
    k, i = np.meshgrid(np.arange(rings - 1), np.arange(count), indexing="ij")
    a, b = (k * count + i).ravel(), (k * count + (i + 1) % count).ravel()
    last = (rings - 1) * count + np.arange(count)
    hub = np.stack([last, (rings - 1) * count + (np.arange(count) + 1) % count, np.full(count, rings * count)], 1)
    return points, np.concatenate([np.stack([a, b, b + count], 1), np.stack([a, b + count, a + count], 1), hub])


def perforated(rng, count=300):
    """A Delaunay mesh of random points in a star-shaped domain with two holes, its ragged boundary as it comes."""
    points = rng.uniform(-1, 1, (count, 2))
    triangles = Delaunay(points).simplices.astype(np.int64)
    centre = points[triangles].mean(1)
    radius, angle = np.linalg.norm(centre, axis=1), np.arctan2(centre[:, 1], centre[:, 0])
    keep = radius < 0.75 + 0.2 * np.cos(5 * angle + rng.uniform(0, 6))
    for hole in ([-0.35, 0], [0.3, 0.1]):
        keep &= np.linalg.norm(centre - hole, axis=1) > 0.15
    triangles = triangles[keep]
    used, triangles = np.unique(triangles, return_inverse=True)
    return points[used], triangles.reshape(-1, 3)


def tangled(mesh, how, rng):
    """`mesh` with its free vertices put elsewhere."""
    points, free = mesh.points.numpy().copy(), ~holding(mesh).fixed.numpy()
    low, high = points.min(0), points.max(0)
    if how == "shuffled":
        points[free] = rng.permutation(points[free])
    elif how == "outside":
        points[free] = high + (high - low) * rng.uniform(1, 2, (free.sum(), 2))
    elif how == "one point":
        points[free] = low + (high - low) * rng.uniform(0.2, 0.8, 2)
    elif how == "on one boundary vertex":
        points[free] = points[holding(mesh).fixed.numpy()][0]
    elif how == "on a line":
        points[free] = low + (high - low) * np.stack([rng.uniform(size=free.sum()), np.full(free.sum(), 0.5)], 1)
    return mesh.with_points(torch.from_numpy(points))


def boundary_set(triangles):
    there = [e for t in triangles.tolist() for e in zip(t, t[1:] + t[:1], strict=True)]
    known = set(there)
    assert len(known) == len(there), "an edge is run along twice the same way"
    return {e for e in known if e[::-1] not in known}


def all_positive(points, triangles):
    """Signed areas in integers: every coordinate times the largest denominator of all."""
    ratios = [[x.as_integer_ratio() for x in row] for row in points.tolist()]
    unit = max(d for row in ratios for _, d in row)
    whole_points = [[n * (unit // d) for n, d in row] for row in ratios]
    corners = ([whole_points[v] for v in t] for t in triangles.tolist())
    return all((bx - ax) * (cy - ay) > (by - ay) * (cx - ax) for (ax, ay), (bx, by), (cx, cy) in corners)


def assert_repaired(before, result):
    """The facts, computed in another way than the package does: integer areas, sets of edges."""
    assert result.ok, result.reason
    assert result.reason == ""
    after = result.mesh
    assert after.points.shape == before.points.shape
    assert after.points.dtype == before.points.dtype
    assert after.triangles.shape == before.triangles.shape
    assert all_positive(after.points, after.triangles)
    assert boundary_set(after.triangles) == boundary_set(before.triangles)
    edges = edge_set(after.triangles)
    assert {frozenset(e) for e in before.constrained_edges.tolist()} <= edges
    assert len(edges) == len(edge_set(before.triangles))
    assert torch.equal(after.triangles.unique(), before.triangles.unique())
    assert torch.equal((after.points != before.points).any(1) & ~result.moved, torch.zeros_like(result.moved))
    assert not bool((result.moved & holding(before).fixed).any())
    assert torch.equal(after.triangles[~result.rewritten], before.triangles[~result.rewritten])


@pytest.mark.parametrize("how", HOW)
@pytest.mark.parametrize("seed", range(4))
def test_domain_with_holes(how, seed):
    rng = np.random.default_rng(seed)
    mesh = tangled(make(*perforated(rng)), how, rng)
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))
    assert_repaired(mesh, untangle_by_retriangulation(mesh))


@pytest.mark.parametrize("how", HOW)
def test_step_by_step_where_all_at_once_is_refused(how, monkeypatch):
    rng = np.random.default_rng(5)
    mesh = tangled(make(*perforated(rng)), how, rng)
    asked = []
    monkeypatch.setattr(cavity_module, "triangulate_with", lambda *_: asked.append(True))
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))
    assert asked


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(3, 40), st.sampled_from(HOW))
def test_any_star_shaped_polygon(seed, count, how):
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.arange(count) / count
    boundary = rng.uniform(0.02, 1, count)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    mesh = tangled(make(*disc(boundary, int(rng.integers(1, 4)))), how, rng)
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 30), st.sampled_from(HOW))
def test_any_simple_polygon(seed, count, how):
    """Random points joined to a simple polygon by undoing crossings (2-opt)."""
    rng = np.random.default_rng(seed)
    boundary = simple_polygon(rng, count)
    mesh = tangled(make(*disc(boundary, 2)), how, rng)
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))
    assert_repaired(mesh, untangle_by_retriangulation(mesh))


def simple_polygon(rng, count):
    points = rng.uniform(0, 1, (count, 2))
    changed = True
    while changed:
        changed = False
        for i in range(count - 1):
            for j in range(i + 2, count - (i == 0)):
                a, b, c, d = points[i], points[i + 1], points[j], points[(j + 1) % count]
                now = np.linalg.norm(a - b) + np.linalg.norm(c - d)
                if np.linalg.norm(a - c) + np.linalg.norm(b - d) < now - 1e-12:
                    points[i + 1 : j + 1] = points[i + 1 : j + 1][::-1]
                    changed = True
    x, y = points.T
    return points if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0 else points[::-1]


def spiral(turns=3, count=200, width=0.1):
    angle = np.linspace(0, 2 * np.pi * turns, count)
    outward = np.stack([np.cos(angle), np.sin(angle)], 1)
    middle = 1 + angle / (2 * np.pi)
    return np.concatenate([(middle + width)[:, None] * outward, ((middle - width)[:, None] * outward)[::-1]])


@pytest.mark.parametrize("how", HOW)
def test_spiral(how):
    mesh = tangled(make(*disc(spiral(), 4)), how, np.random.default_rng(0))
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))


@pytest.mark.parametrize("how", HOW)
def test_l_shape_of_many_collinear_boundary_vertices(how):
    points, triangles = grid(16, 16)
    centre = points[triangles].mean(1)
    triangles = triangles[(centre < 0.5).any(1)]
    used, triangles = np.unique(triangles, return_inverse=True)
    mesh = tangled(make(points[used], triangles.reshape(-1, 3)), how, np.random.default_rng(0))
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))


@pytest.mark.parametrize(
    ("scale", "offset"),
    [(1.0, 1e8), (1e-3, 1e8), (1e-100, 0.0), (1e100, 0.0), (1e-150, 0.0), (1e149, 0.0), (1e100, 1e103)],
)
@pytest.mark.parametrize("how", ["shuffled", "one point"])
def test_any_size_and_far_from_the_origin(scale, offset, how):
    rng = np.random.default_rng(1)
    points, triangles = perforated(rng, 150)
    mesh = tangled(make(points * scale + offset, triangles), how, rng)
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))
    assert_repaired(mesh, untangle_by_retriangulation(mesh))


def test_single_precision():
    rng = np.random.default_rng(2)
    points, triangles = perforated(rng)
    mesh = tangled(make(points.astype(np.float32), triangles), "one point", rng)
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))


@pytest.mark.parametrize("gap", [1e-6, 1e-12])
def test_thin_gap_between_a_hole_and_the_boundary(gap):
    points, triangles = grid(12, 12)
    triangles = triangles[~((points[triangles].mean(1) > 1 / 12) & (points[triangles].mean(1) < 0.5)).all(1)]
    used, triangles = np.unique(triangles, return_inverse=True)
    points = points[used]
    points[:, 1] = np.where((points[:, 1] > 0) & (points[:, 1] < 0.1), gap, points[:, 1])
    for how in ("kept", "shuffled", "one point"):
        mesh = tangled(make(points, triangles.reshape(-1, 3)), how, np.random.default_rng(0))
        assert_repaired(mesh, retriangulate(mesh, whole(mesh)))


@pytest.mark.parametrize("how", HOW)
def test_interface_is_a_wall(how):
    points, triangles, inner, interface = region_mesh()
    mesh = tangled(make(points, triangles, constrained_edges=interface), how, np.random.default_rng(3))
    for result in (retriangulate(mesh, whole(mesh)), untangle_by_retriangulation(mesh)):
        assert_repaired(mesh, result)
        assert set(result.mesh.triangles[inner].unique().tolist()) == set(np.unique(triangles[inner]).tolist())


def dangling_mesh():
    """A grid with a chain of constrained edges from the boundary inwards, and a separate one."""
    points, triangles = grid(10, 10)
    index = np.arange(121).reshape(11, 11)
    chains = [index[:6, 5], index[np.arange(6, 10), np.arange(6, 10) - 4]]
    return points, triangles, np.concatenate([np.stack([c[:-1], c[1:]], 1) for c in chains])


@pytest.mark.parametrize("how", HOW)
def test_dangling_constrained_edges_survive(how):
    points, triangles, edges = dangling_mesh()
    mesh = tangled(make(points, triangles, constrained_edges=edges), how, np.random.default_rng(4))
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))
    assert_repaired(mesh, untangle_by_retriangulation(mesh))


def test_long_constrained_edges_are_recovered_among_fixed_vertices():
    """One constrained edge moved so that it runs right across the domain, between fixed vertices."""
    points, triangles = grid(10, 10)
    index = np.arange(121).reshape(11, 11)
    edge = [[index[3, 3], index[4, 4]]]
    fixed = np.random.default_rng(5).random(121) < 0.3
    points[edge[0]] = [[0.06, 0.04], [0.93, 0.97]]
    mesh = make(points, triangles, fixed=fixed, constrained_edges=edge)
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))


def test_fixed_interior_vertices_stay_and_edges_between_them_cross_nothing():
    rng = np.random.default_rng(6)
    points, triangles = perforated(rng)
    mesh = make(points, triangles, fixed=rng.random(len(points)) < 0.3)
    mesh = tangled(mesh, "shuffled", rng)
    assert_repaired(mesh, untangle_by_retriangulation(mesh))


def test_what_cannot_be_done_is_said_and_nothing_changes():
    points, triangles = grid(6, 6)
    index = np.arange(49).reshape(7, 7)
    for position in ([2.0, 2.0], points[index[3, 4]], [0.5, 0.0], points[index[0, 3]]):
        moved = points.copy()
        moved[index[3, 3]] = position
        fixed = np.zeros(49, bool)
        fixed[[index[3, 3], index[3, 4]]] = True
        mesh = make(moved, triangles, fixed=fixed)
        for result in (retriangulate(mesh, whole(mesh)), untangle_by_retriangulation(mesh)):
            assert not result.ok
            assert f"vertex {index[3, 3]} lies" in result.reason or f"vertex {index[3, 4]} lies" in result.reason
            assert torch.equal(result.mesh.points, mesh.points)
            assert torch.equal(result.mesh.triangles, mesh.triangles)
    crossing = np.array([[index[2, 2], index[2, 3]], [index[4, 2], index[4, 3]]])
    moved = points.copy()
    moved[crossing] = [[[0.3, 0.3], [0.7, 0.7]], [[0.3, 0.7], [0.7, 0.3]]]
    result = retriangulate(make(moved, triangles, constrained_edges=crossing), whole(make(points, triangles)))
    assert not result.ok
    assert all(str(v) in result.reason for v in crossing.ravel())
    bent = points.copy()
    bent[index[3, 0]] = [0.5, 1.5]
    mesh = make(bent, triangles)
    result = untangle_by_retriangulation(mesh)
    assert not result.ok
    assert str(index[3, 0]) in result.reason


def test_a_hole_that_leaves_through_vertices_of_the_wall_is_named():
    # The hole has vertices of its own in the positions of two vertices of the wall.
    points = np.concatenate([CROSSED, CROSSED[[3, 2]]])
    boundary = edges_of([np.arange(6), np.array([6, 7, 10, 8, 9, 11])])
    fixed = np.ones(len(points), bool)
    cavity = cavity_module.Cavity(points, boundary, np.zeros((0, 2), np.int64), fixed, fixed, points.dtype)
    built = cavity.filled()
    assert isinstance(built, Obstacle)
    assert "of the boundary meet" in str(built)


def test_cavities_are_small_and_leave_the_rest_alone():
    points, triangles = grid(40, 40)
    index = np.arange(41 * 41).reshape(41, 41)
    swapped = points.copy()
    for i, j in ((8, 8), (30, 12), (20, 33)):
        pair = index[i, j], index[i + 1, j + 1]
        swapped[list(pair)] = points[list(pair[::-1])]
    mesh = make(swapped, triangles)
    result = untangle_by_retriangulation(mesh)
    assert_repaired(mesh, result)
    assert 0 < int(result.rewritten.sum()) < 250


def test_a_fold_of_a_whole_strip_is_repaired():
    """Free vertices pushed past the boundary over half of the domain, as a large boundary motion does."""
    points, triangles = grid(30, 30)
    mesh = make(points, triangles)
    moved = points + np.stack(
        [0.4 * np.sin(np.pi * points[:, 0]) * np.sin(3 * np.pi * points[:, 1]), points[:, 1] * 0], 1
    )
    mesh = mesh.with_points(
        torch.where(holding(mesh).fixed[:, None], mesh.points, torch.from_numpy(2 * moved - points))
    )
    assert_repaired(mesh, untangle_by_retriangulation(mesh))


def test_several_components_one_upon_the_other():
    points, triangles = grid(8, 8)
    both = np.concatenate([points, points + 0.3])
    mesh = make(both, np.concatenate([triangles, triangles + len(points)]))
    mesh = tangled(mesh, "shuffled", np.random.default_rng(7))
    assert_repaired(mesh, retriangulate(mesh, whole(mesh)))
    assert_repaired(mesh, untangle_by_retriangulation(mesh))


def test_a_valid_mesh_is_returned_as_it_is():
    mesh = make(*grid(5, 5))
    result = untangle_by_retriangulation(mesh)
    assert_repaired(mesh, result)
    assert not bool(result.rewritten.any())
    assert not bool(result.moved.any())


def test_positions_are_kept_where_they_can_be():
    rng = np.random.default_rng(8)
    mesh = make(*perforated(rng))
    assert not bool(retriangulate(mesh, whole(mesh)).moved.any())
    shuffled = tangled(mesh, "shuffled", rng)
    assert not bool(retriangulate(shuffled, whole(mesh)).moved.any())
    spread = retriangulate(mesh, whole(mesh), keep=torch.zeros(len(mesh.points), dtype=torch.bool))
    assert_repaired(mesh, spread)
    assert torch.equal(spread.moved, ~holding(mesh).fixed)


def test_spread_vertices_make_good_triangles():
    """All vertices in one point: Delaunay, evenly spread triangles, none worse than 4 (equilateral: 1)."""
    from torchmesh.mesh.triangle import corners, inverse_mean_ratio

    mesh = tangled(make(*grid(30, 30)), "one point", np.random.default_rng(9))
    after = retriangulate(mesh, whole(mesh)).mesh
    ratio = inverse_mean_ratio(corners(after.points, after.triangles))
    assert float(ratio.mean()) < 1.3
    assert float(ratio.max()) < 4


def test_retriangulating_part_of_a_mesh_changes_only_that():
    mesh = make(*grid(12, 12))
    cavity = torch.from_numpy((mesh.points[mesh.triangles].mean(1) < 0.4).all(1).numpy())
    mesh = tangled(mesh, "kept", np.random.default_rng(0))
    result = retriangulate(mesh, cavity)
    assert_repaired(mesh, result)
    assert torch.equal(result.rewritten, cavity)


def test_edges_that_exist_outside_the_cavity_are_not_made_twice():
    """A vertex of three triangles lies outside the triangle around it, whose edge [0, 2] the cavity would choose."""
    points = np.array([[0.0, -0.3], [2.0, 0.0], [0.0, 0.3], [-1.0, 0.0]])
    mesh = make(points, np.array([[3, 0, 1], [3, 1, 2], [3, 2, 0]]))
    result = retriangulate(mesh, torch.tensor([True, True, False]))
    assert not result.ok
    assert "exists outside" in result.reason
    assert_repaired(mesh, untangle_by_retriangulation(mesh))


def test_one_mesh_and_masks_of_its_size_are_asked_for():
    mesh = make(*grid(2, 2))
    with pytest.raises(InvalidMeshError, match="one mesh at a time"):
        untangle_by_retriangulation(join([mesh, mesh]))
    with pytest.raises(InvalidMeshError, match="cavity must be"):
        retriangulate(mesh, torch.ones(3, dtype=torch.bool))
    with pytest.raises(InvalidMeshError, match="keep must be"):
        retriangulate(mesh, whole(mesh), keep=torch.ones(3, dtype=torch.bool))


def test_input_is_not_changed():
    mesh = tangled(make(*grid(6, 6)), "one point", np.random.default_rng(0))
    points, triangles = mesh.points.clone(), mesh.triangles.clone()
    retriangulate(mesh, whole(mesh))
    untangle_by_retriangulation(mesh)
    assert torch.equal(mesh.points, points)
    assert torch.equal(mesh.triangles, triangles)


def test_same_answer_every_time():
    mesh = tangled(make(*perforated(np.random.default_rng(1))), "shuffled", np.random.default_rng(2))
    one, two = (untangle_by_retriangulation(mesh).mesh for _ in range(2))
    assert torch.equal(one.triangles, two.triangles)
    assert torch.equal(one.points, two.points)


@pytest.mark.parametrize("seed", range(8))
def test_boundaries_that_touch_themselves(seed):
    """Cracks with lips of their own division, joined across by edges, and snakes that touch themselves."""
    rng = np.random.default_rng(seed)
    made = [cracks.two_lips(rng), cracks.crack(rng), cracks.crack(rng, kinked=True), cracks.walk(rng)]
    for points, triangles in made:
        mesh = MeshBatch.from_arrays(points, triangles)
        result = untangle_by_retriangulation(mesh)
        assert result.ok, result.reason
        assert inverted(mesh) > 0
        assert_every_row_stays(mesh, result.mesh)


def test_a_cavity_grows_within_its_region_only():
    rng = np.random.default_rng(3)
    grown = 0
    for _ in range(50):
        triangles, region = rng.integers(0, 40, (60, 3)), rng.integers(0, rng.integers(1, 6), 60)
        wanted = rng.random(60) < 0.1
        keys = triangles * 10 + region[:, None]
        expected = np.isin(keys, keys[wanted]).any(1)
        assert np.array_equal(_with_ring(_corners_in_regions(triangles, region), wanted), expected)
        grown += int(expected.sum() - wanted.sum())
    assert grown > 100


def test_constrained_edges_beside_a_crack_survive():
    points, triangles = cracks.two_lips(np.random.default_rng(0), flips=0)
    points[9] = [1.8, 0.1]
    mesh = MeshBatch.from_arrays(points, triangles, constrained_edges=[[6, 0], [8, 2]])
    result = untangle_by_retriangulation(mesh)
    assert result.ok, result.reason
    assert inverted(result.mesh) == 0
    assert {frozenset((0, 6)), frozenset((2, 8))} <= set(edge_counts(result.mesh.triangles))
