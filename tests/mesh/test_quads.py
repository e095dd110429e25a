"""Quads as elements of a mesh: exact signs of their corners, winding, and the forms that algorithms see."""

import itertools
import pickle
import warnings
from fractions import Fraction

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import torchmesh as tm
import torchmesh.mesh.boundary_parts
from tests.meshes import mixed
from torchmesh import MeshBatch
from torchmesh.mesh.measure import upright
from torchmesh.mesh.quads import halved, inverted_quads, sampled, split_quads, whole

SQUARE = torch.tensor([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], dtype=torch.float64)
ROW = torch.tensor([[0, 1, 2, 3]])


@pytest.mark.parametrize(
    ("where", "inverted"),
    [([1.0, 1.0], False), ([0.6, 0.6], False), ([0.5, 0.5], True), ([0.2, 0.2], True), ([-1.0, 0.5], True)],
    ids=["square", "kite", "corner of 180 degrees", "dart", "folded"],
)
def test_one_corner_decides(where, inverted):
    points = SQUARE.clone()
    points[2] = torch.tensor(where)
    for k in range(4):
        assert inverted_quads(points, ROW.roll(k, 1)).tolist() == [inverted]
    assert inverted_quads(points, ROW.flip(1)).tolist() == [True]


@given(st.lists(st.tuples(st.integers(-3, 3), st.integers(-3, 3)), min_size=4, max_size=4))
def test_corners_agree_with_fractions(positions):
    scale = 1 / 3
    points = torch.tensor(positions, dtype=torch.float64) * scale
    exact = [(Fraction(x * scale), Fraction(y * scale)) for x, y in positions]

    def area(a, b, c):
        (ax, ay), (bx, by), (cx, cy) = (exact[i] for i in (a, b, c))
        return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)

    want = any(area((k - 1) % 4, k, (k + 1) % 4) <= 0 for k in range(4))
    assert inverted_quads(points, ROW).tolist() == [want]


@pytest.mark.parametrize("flips", list(itertools.product([False, True], repeat=3)))
def test_elements_are_turned_to_agree_whichever_way_round_they_are_listed(flips):
    """A triangle, and two quads beside it: the first corner of each stays the first."""
    points = [[0.0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1], [3, 0]]
    upright = [[4, 6, 5], [0, 1, 2, 3], [1, 4, 5, 2]]
    listed = [np.roll(rows[::-1], 1).tolist() if flip else rows for rows, flip in zip(upright, flips, strict=True)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if any(flips) else "error", tm.MeshWarning)
        mesh = MeshBatch.from_arrays(points, listed[:1], quads=listed[1:])
    assert sorted(mesh.triangles[0].tolist()) == sorted(upright[0])
    assert mesh.quads.tolist() == upright[1:]
    assert int(tm.quality(mesh).inverted) == 0
    moved = mesh.points.clone()
    moved[2] = torch.tensor([1.9, 0.05], dtype=torch.float64)
    q = tm.quality(mesh.with_points(moved))
    assert q.quad_upright.tolist() == [True, False]
    assert int(q.inverted) == 1


@pytest.mark.parametrize(
    ("triangles", "quads", "text"),
    [
        ([], [[0, 1, 2]], r"quads must have shape \(Q, 4\)"),
        ([], [[0, 1, 2, 9]], "quads row 0 is .*rows of points run from 0 to 4"),
        ([[0, 1, 4]], [[0, 1, 2, 2]], "quads row 0 .* four different vertices"),
        ([[0, 1, 4]], [[0, 1, 2, 3], [0, 1, 4, 3]], "triangles row 0, quads row 0 and quads row 1 share the edge"),
    ],
)
def test_what_is_no_mesh_is_refused_by_its_row(triangles, quads, text):
    points = [[0.0, 0], [1, 0], [1, 1], [0, 1], [0.5, -1]]
    with pytest.raises(tm.InvalidMeshError, match=text):
        MeshBatch.from_arrays(points, triangles, quads=quads)


def test_a_diagonal_is_no_edge_to_constrain():
    with pytest.raises(tm.InvalidMeshError, match="diagonal of a quad"):
        MeshBatch.from_arrays(SQUARE, [], quads=ROW, constrained_edges=[[0, 2]])


def test_boundary_and_fixed_vertices_know_quads():
    mesh = mixed(4, 4, 2)
    inside = ((mesh.points > 0) & (mesh.points < 1)).all(1)
    assert torch.equal(mesh.fixed, ~inside)
    assert list(tm.mesh.boundary_parts.boundary_parts(mesh)) == ["outer:1"]


def batch_of_all() -> MeshBatch:
    return tm.join([mixed(4, 3, 2), mixed(3, 3, 3), mixed(2, 2, 0)])


def test_join_split_select_and_pickle_keep_quads():
    batch = batch_of_all()
    assert batch.quad_offsets.tolist() == [0, 6, 15, 15]
    for again in (tm.join(batch.split()), batch[[0, 1, 2]], pickle.loads(pickle.dumps(batch)), batch.to("cpu")):
        assert torch.equal(again.quads, batch.quads)
        assert torch.equal(again.quad_offsets, batch.quad_offsets)
    part = batch[[1, 0]]
    assert torch.equal(
        part.points[part.quads], torch.cat([batch.points[batch.quads[6:]], batch.points[batch.quads[:6]]])
    )


def test_forms_lead_back_and_rows_stand_behind_the_triangles_of_their_mesh():
    batch = batch_of_all()
    for form, rows in ((halved(batch), 2), (sampled(batch), 4), (sampled(halved(batch)), 4)):
        assert form.rows_per_quad == rows
        assert int(form.of_quads.sum()) == rows * len(batch.quads)
        assert not form.of_quads[: len(batch.split()[0].triangles)].any()
        back = whole(form)
        assert torch.equal(back.triangles, batch.triangles)
        assert torch.equal(back.triangle_offsets, batch.triangle_offsets)
    plain = mixed(2, 2, 0)
    assert halved(plain) is plain
    assert sampled(plain) is plain


def test_a_quad_counts_once_and_halves_are_upright_only_together():
    batch = batch_of_all()
    points = batch.points.clone()
    points[batch.quads[0, 2]] = points[batch.quads[0]].mean(0)
    folded = batch.with_points(points)
    q, h = tm.quality(folded), tm.quality(halved(folded))
    for name in ("mean", "max", "inverted", "quad_upright"):
        assert torch.equal(getattr(q, name), getattr(h, name)), name
    rows = halved(folded).of_quads
    assert torch.equal(h.upright[rows], q.quad_upright.repeat_interleave(2))
    assert torch.equal(upright(halved(folded)), h.upright)


def test_split_quads_become_two_triangles_behind_those_of_their_mesh():
    batch = batch_of_all()
    chosen = torch.zeros(15, dtype=torch.bool)
    chosen[[1, 6, 14]] = True
    after = split_quads(batch, chosen)
    assert after.quad_offsets.tolist() == [0, 5, 12, 12]
    assert int(tm.quality(after).inverted.sum()) == 0
    first = after.split()[0]
    assert torch.equal(first.triangles[-2:].unique(), batch.split()[0].quads[1].sort().values)
    assert torch.equal(first.triangles[:-2], batch.split()[0].triangles)
