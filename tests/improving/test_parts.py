"""Parts are cut out and put back: rows, held vertices, and edges that clash."""

from dataclasses import replace

import meshes
import torch

import torchmesh as tm
from torchmesh.improving.options import ImproveOptions
from torchmesh.improving.parts import Parts, paste
from torchmesh.improving.state import State
from torchmesh.mesh.vertex_map import Names


def chosen(mesh: tm.MeshBatch, rows: list[int]) -> torch.Tensor:
    return torch.zeros(len(mesh.points), dtype=torch.bool).index_fill_(0, torch.tensor(rows), True)


def slow_parts(triangles: list[list[int]], free: set[int]) -> list[tuple[list[int], set[int]]]:
    """The rows of triangles and the vertices of each part, by sets: joined by free vertices, in the order of rows."""
    left = [t for t, row in enumerate(triangles) if free & set(row)]
    parts = []
    while left:
        rows, grown = {left[0]}, True
        while grown:
            mine = {v for t in rows for v in triangles[t]} & free
            more = {t for t in left if mine & set(triangles[t])}
            grown, rows = more > rows, rows | more
        left = [t for t in left if t not in rows]
        parts.append((sorted(rows), {v for t in rows for v in triangles[t]}))
    return parts


def test_parts_are_those_that_free_vertices_join():
    batch = tm.join([meshes.delaunay(60, 3), meshes.l_shape(4), meshes.ring()])
    for seed in range(5):
        free = torch.rand(len(batch.points), generator=torch.Generator().manual_seed(seed)) < 0.12
        parts = Parts.cut_out(batch, free)
        expected = slow_parts(batch.triangles.tolist(), set(free.nonzero().squeeze(1).tolist()))
        assert len(parts) == len(expected) > 3
        owner = torch.bucketize(parts.triangles, batch.triangle_offsets[1:], right=True)
        edges = 0
        for p, (rows, vertices) in enumerate(expected):
            v, t = (slice(*o[p : p + 2].tolist()) for o in (parts.mesh.point_offsets, parts.mesh.triangle_offsets))
            assert parts.triangles[t].tolist() == rows
            assert set(parts.vertices[v].tolist()) == vertices
            assert (owner[t] == parts.owner[p]).all()
            inner = [
                e for e in batch.constrained_edges.tolist() if _inner(e, [batch.triangles[r].tolist() for r in rows])
            ]
            edges += len(inner)
        assert torch.equal(parts.vertices[parts.mesh.triangles], batch.triangles[parts.triangles])
        assert torch.equal(parts.mesh.fixed, batch.fixed[parts.vertices] | ~free[parts.vertices])
        assert len(parts.mesh.constrained_edges) == edges
        assert not parts.whole.any()
    assert Parts.cut_out(batch, torch.ones_like(free)).whole.tolist() == [True] * 3


def _inner(edge: list[int], triangles: list[list[int]]) -> bool:
    return sum(set(edge) <= set(row) for row in triangles) == 2


def test_what_is_put_back_is_free_vertices_and_triangles_alone():
    batch = tm.join([meshes.grid(8, 7), meshes.grid(5, 5)])
    parts = Parts.cut_out(batch, chosen(batch, [20, 21, 44, 85]))
    assert len(parts) == 3
    state = State.of(parts.mesh.with_points(parts.mesh.points + 0.01), ImproveOptions())
    names = Names.of_rows(len(batch.points), batch.points.device)
    made = paste(parts, state, torch.tensor([True, False, True]), names)
    moved = (made.mesh.points != batch.points).any(1).nonzero().squeeze(1)
    assert moved.tolist() == [20, 21, 85]
    assert torch.equal(made.mesh.triangles, batch.triangles)
    marks = made.by_triangle(torch.zeros(len(batch.triangles)), torch.tensor([1.0, 2.0]))
    assert set(marks[parts.triangles[: int(parts.mesh.triangle_offsets[1])]].tolist()) == {1.0}
    assert marks.sum() == 10 + 2 * 6
    assert torch.equal(made.by_vertex(batch.fixed, torch.zeros(0, dtype=torch.bool)), batch.fixed)


def test_an_edge_that_exists_outside_is_a_clash():
    batch = meshes.delaunay(60, 3)
    triangles, free = batch.triangles.tolist(), chosen(batch, [1, 8, 15, 22, 29, 36, 43, 50])
    parts = Parts.cut_out(batch, free)
    state = State.of(parts.mesh, ImproveOptions())
    assert not parts.clash(state).any()
    tried = []
    for p in range(len(parts)):
        v, t = (slice(*o[p : p + 2].tolist()) for o in (parts.mesh.point_offsets, parts.mesh.triangle_offsets))
        vertices = parts.vertices[v].tolist()
        held = {v for v in vertices if not free[v]}
        own = {q for row in parts.triangles[t].tolist() for q in _pairs(triangles[row]) if q <= held}
        others = {q for row in triangles for q in _pairs(row) if q <= held} - own
        apex = next(v for v in vertices if free[v])
        for pair, clashes in ((next(iter(own)), False), *((q, True) for q in others)):
            faces = parts.mesh.triangles.clone()
            corners = [vertices.index(w) for w in (*sorted(pair), apex)]
            faces[t.start] = torch.tensor(corners) + v.start
            after = replace(state, mesh=replace(parts.mesh, triangles=faces))
            assert parts.clash(after).tolist() == [clashes and q == p for q in range(len(parts))]
            tried.append(clashes)
    assert True in tried
    assert False in tried


def _pairs(row: list[int]) -> list[frozenset]:
    return [frozenset(p) for p in ((row[0], row[1]), (row[1], row[2]), (row[2], row[0]))]
