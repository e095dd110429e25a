"""The form in which meshes are split and collapsed: rings, conflict-free choices, compaction."""

import meshes
import pytest
import torch
from editing import VALID, editing
from hypothesis import given
from hypothesis import strategies as st

import torchmesh as tm
from torchmesh.mesh import connectivity
from torchmesh.remeshing.mutable import compact, independent, neighbours


@pytest.mark.parametrize("name", list(VALID))
def test_neighbours_are_those_that_share_an_edge_in_order(name):
    mesh = VALID[name]()
    twin = connectivity.twins(mesh.triangles)
    vertex = mesh.triangles.reshape(-1)
    ring, closed = neighbours(vertex, twin, torch.arange(len(vertex)))
    boundary = connectivity.boundary_vertices(mesh.triangles, twin, len(mesh.points))
    around: dict[int, dict[int, int]] = {}
    for a, b, c in mesh.triangles.tolist():
        for u, v, w in ((a, b, c), (b, c, a), (c, a, b)):
            around.setdefault(u, {})[v] = w
    for h, (row, whole) in enumerate(zip(ring.tolist(), closed.tolist(), strict=True)):
        u = int(vertex[h])
        assert whole == (not boundary[u])
        row = [v for v in row if v >= 0]
        assert row[0] == int(vertex[connectivity.next_in_triangle(torch.tensor(h))])
        if name != "bowtie":
            assert set(row) == set(around[u]) | set(around[u].values())
        assert len(set(row)) == len(row)
        if whole:
            assert all(around[u][v] == w for v, w in zip(row, [*row[1:], row[0]], strict=True))


@given(st.integers(0, 10_000))
def test_independent_rows_are_a_maximal_choice_by_rank(seed):
    generator = torch.Generator().manual_seed(seed)
    centres = torch.randint(-1, 12, (20, 2), generator=generator)
    claims = torch.cat([centres, torch.randint(-1, 12, (20, 3), generator=generator)], 1)
    rank = torch.randint(0, 5, (20,), generator=generator).double()
    chosen = independent(centres, claims, rank, 12)
    order = sorted(range(20), key=lambda i: (float(rank[i]), i))
    position = {row: k for k, row in enumerate(order)}
    for i in range(20):
        rivals = [j for j in range(20) if j != i and set(centres[j].tolist()) & set(claims[i].tolist()) - {-1}]
        assert bool(chosen[i]) == all(position[i] < position[j] for j in rivals)


def test_compaction_changes_nothing_where_nothing_died():
    batch = tm.join([meshes.l_shape(2), meshes.ring(), meshes.grid(2, 2)])
    e = editing(batch)
    kept, faces, locked, vertices, triangles = compact(e)
    assert torch.equal(kept, torch.arange(len(batch.points)))
    assert torch.equal(faces, batch.triangles)
    assert {frozenset(x) for x in locked.tolist()} == {frozenset(x) for x in batch.constrained_edges.tolist()}
    assert vertices.tolist() == [len(m.points) for m in batch.split()]
    assert triangles.tolist() == [len(m.triangles) for m in batch.split()]
