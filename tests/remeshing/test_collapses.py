"""Edge collapses against the plain way of doing each, and rounds of them."""

import meshes
import pytest
import torch
from editing import VALID, assert_twins, editing, finished, random_valid
from exact import directed_edges, double_area, triangle_set
from hypothesis import given
from hypothesis import strategies as st
from judges import assert_same_domain

import torchmesh as tm
from torchmesh import MeshBatch
from torchmesh.mesh.interfaces import holding
from torchmesh.mesh.triangle import corners, inverse_mean_ratio
from torchmesh.remeshing.collapses import collapse, collapse_rounds, evaluate, proposals, still_upright
from torchmesh.remeshing.splits import split_rounds

SEEDS = st.integers(0, 10_000)


def plain_collapse(mesh: MeshBatch, u: int, w: int) -> list[list[int]] | None:
    """The triangles after u has gone into w; None where that is not a valid mesh."""
    points = mesh.points.tolist()
    rows = [[w if v == u else v for v in row] for row in mesh.triangles.tolist()]
    rows = [row for row in rows if len(set(row)) == 3]
    if any(double_area(*(points[v] for v in row)) <= 0 for row in rows):
        return None
    if max(directed_edges(rows).values()) > 1:
        return None
    return rows


@pytest.mark.parametrize("name", ["jittered", "disc", "ring", "l_shape", "delaunay", "bowtie", "scrambled"])
def test_a_collapse_is_allowed_exactly_where_the_plain_one_gives_a_valid_mesh(name):
    mesh = meshes.scrambled(meshes.delaunay(25, 3), 3) if name == "scrambled" else VALID[name]()
    e = editing(mesh)
    h, owner = proposals(e, e.edges())
    outcome = evaluate(e, h)
    allowed = outcome.after.isfinite() & still_upright(e, h, outcome)
    assert len(h) == 0 or (name == "bowtie") or bool(allowed.any())
    for i in range(len(h)):
        u, w = int(e.vertex[h[i]]), int(e.head(h[i]))
        assert not mesh.fixed[u]
        assert {u, w} == {int(e.vertex[e.edges()[owner[i]]]), int(e.head(e.edges()[owner[i]]))}
        plain = plain_collapse(mesh, u, w)
        assert bool(allowed[i]) == (plain is not None), (u, w)
        if plain is not None and i % 5 == 0:
            other = editing(mesh)
            collapse(other, h[i : i + 1])
            assert triangle_set(other.triangles[other.triangles[:, 0] >= 0]) == triangle_set(plain)
            assert_twins(other)


def test_the_quality_foretold_is_the_quality_there_is():
    mesh = meshes.scrambled(meshes.delaunay(30, 5), 5, 60)
    e = editing(mesh, 0.3)
    h, _ = proposals(e, e.edges())
    outcome = evaluate(e, h)
    before = tm.quality(mesh).inverse_mean_ratio
    for i in outcome.after.isfinite().nonzero().squeeze(1).tolist()[::3]:
        u, w = int(e.vertex[h[i]]), int(e.head(h[i]))
        old = (mesh.triangles == u).any(1)
        assert float(outcome.before[i]) == pytest.approx(float(before[old].max()), rel=1e-12)
        kept = mesh.triangles[old & ~(mesh.triangles == w).any(1)]
        rows = torch.where(kept == u, w, kept)
        ratio = inverse_mean_ratio(corners(mesh.points, rows))
        assert float(outcome.after[i]) == pytest.approx(float(ratio.max()), rel=1e-12)
        ring = mesh.triangles[old].unique()
        reach = (mesh.points[ring[ring != u]] - mesh.points[w]).norm(dim=1).max()
        assert float(outcome.longest[i]) == pytest.approx(float(reach) / 0.3, rel=1e-12)
        assert set(outcome.claims[i].tolist()) - {-1} == set(ring.tolist())


def test_two_sheets_are_not_glued_together():
    # The vertices 0 and 1 share the neighbours 2 and 3 too: 0-1-2 is a loop of edges and no triangle.
    points = [[0, 0], [1, 0], [0.5, 2], [0.5, -2], [0.5, 0.4], [0.5, -0.4], [0.5, 5], [-4, -4], [5, -4]]
    rows = [[0, 1, 4], [0, 4, 2], [4, 1, 2], [1, 0, 5], [5, 0, 3], [1, 5, 3], [0, 2, 7], [2, 1, 8]]
    rows += [[2, 6, 7], [6, 2, 8], [0, 7, 3], [1, 3, 8], [3, 7, 8]]
    mesh = MeshBatch.from_arrays(points, rows)
    e = editing(mesh)
    edge = next(h for h in e.edges().tolist() if {int(e.vertex[h]), int(e.head(torch.tensor([h])))} == {0, 1})
    h, _ = proposals(e, torch.tensor([edge]))
    assert len(h) == 2
    assert evaluate(e, h).after.isinf().all()


@given(SEEDS, st.sampled_from([0.02, 0.1, 0.3, 1.0, 5.0]))
def test_rounds_keep_the_domain_and_leave_nothing_to_do(seed, size):
    mesh = holding(random_valid(seed))
    size = size * float((mesh.points.amax(0) - mesh.points.amin(0)).max()) * 0.4

    def long(e):
        def wish(h):
            ratio = e.relative_length(h)
            return ratio > 1.4, e.shuffled(h, -ratio)

        return wish

    def short(e):
        def wish(h):
            ratio = e.relative_length(h)
            return torch.where(ratio < 0.7, ratio, torch.inf)

        return wish

    e = editing(mesh, size)
    done = split_rounds(e, long(e), max_rounds=4)
    assert_twins(e)
    assert_same_domain(mesh, finished(mesh, e))
    assert len(finished(mesh, e).points) == len(mesh.points) + int(done)
    done = collapse_rounds(e, short(e), lambda o: o.after > 0)
    assert_twins(e)
    after = finished(mesh, e)
    assert_same_domain(mesh, after)
    h, _ = proposals(e, e.edges())
    h = h[e.relative_length(h) < 0.7]
    outcome = evaluate(e, h)
    assert not bool((outcome.after.isfinite() & still_upright(e, h, outcome)).any())
    if size > 1:
        assert int(done) > 0 or bool(mesh.fixed.all())


def test_a_crowd_is_thinned_in_few_rounds():
    mesh = meshes.grid(40, 40)
    e = editing(mesh, 0.1)
    rounds = 0

    def judge(o):
        nonlocal rounds
        rounds += 1
        return o.longest < 1.4

    def wish(h):
        ratio = e.relative_length(h)
        return torch.where(ratio < 0.7, ratio, torch.inf)

    done = collapse_rounds(e, wish, judge)
    assert int(done) > 1000
    # Their number grows with the logarithm of the crowd, not with the crowd.
    assert rounds < 20
    assert_same_domain(mesh, finished(mesh, e))


def test_what_a_mesh_collapses_does_not_depend_on_what_stands_after_it():
    def thinned(mesh):
        e = editing(mesh, 0.3)

        def wish(h):
            ratio = e.relative_length(h)
            return torch.where(ratio < 0.9, ratio, torch.inf)

        collapse_rounds(e, wish, lambda o: (o.after < 1.6) & (o.longest < 1.5))
        return finished(mesh, e)

    for seed in range(30, 40):
        mesh = holding(random_valid(seed))
        alone, joined = thinned(mesh), thinned(tm.join([mesh, holding(random_valid(seed + 1000))])).split()[0]
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)
