import time

import numpy as np
import pytest
import torch

from torchmesh.diagnosis import ProblemKind, diagnose
from torchmesh.mesh import MeshBatch, join


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


def test_a_hundred_thousand_triangles_take_less_than_a_second():
    points, triangles, _ = grid(224)
    mesh = MeshBatch.from_arrays(points, triangles)
    start = time.perf_counter()
    assert diagnose(mesh) == []
    assert time.perf_counter() - start < 1.0
