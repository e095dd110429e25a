"""Patches are where they should be, do not touch, and every legal flip of them is tried: against plain loops."""

import meshes
import pytest
import torch
from exact import boundary, directed_edges, inverted

import torchmesh as tm
from torchmesh.mesh.connectivity import edges, twins
from torchmesh.smoothing.patches import Patches, every_flip, seeds_of


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
