"""Vertices that have no room are taken out under topology "full", with all that hangs on their names."""

import dataclasses
import functools

import meshes
import numpy as np
import pytest
import torch
from exact import inverted
from scipy.spatial import Delaunay

from torchmesh import ImproveOptions, MeshBatch, RemeshOptions, Report, Status, improve, join
from torchmesh.mesh.connectivity import boundary_edges, euler_number, twins
from torchmesh.mesh.vertex_map import Names
from torchmesh.remeshing.sizing import size_field
from torchmesh.remeshing.state import RemeshState, editable, rebuilt
from torchmesh.remeshing.vertex_removal import collapse_round, remove_vertices
from torchmesh.remeshing.vertex_removal import inverted as inverted_triangles

# Where neighbouring float64 numbers are 1 apart.
FAR = 2.0**52
# Sizes of vertices keep `improve` from making the inside anew.
BY_REMOVAL = ImproveOptions(topology="full", remesh=RemeshOptions(sizes="keep"))
WALL = np.array([[0.5, 0.25], [0.5, 0.5], [0.5, 0.75]])
BOUNDARY = np.array([[0, 0], [0.5, 0], [1, 0], [1, 0.5], [1, 1], [0.5, 1], [0, 1], [0, 0.5]])


def crowded(side, free, seed=0, wall=False):
    """A square of side + 1 times side + 1 floating-point positions, with `free` vertices more, all at one of them.

    wall: constrained edges join the middles of two opposite sides.
    """
    rng = np.random.default_rng(seed)
    inner = rng.uniform(0.1, 0.9, (free, 2))
    held = np.concatenate([BOUNDARY, WALL]) if wall else BOUNDARY
    if wall:  # so that the wall's edges are Delaunay
        inner[:, 0] = np.where(inner[:, 0] < 0.5, 0.5, 0.8) * inner[:, 0] + np.where(inner[:, 0] < 0.5, 0.05, 0.2)
    points = np.concatenate([held, inner])
    triangles = Delaunay(points).simplices
    a, b, c = points[triangles].transpose(1, 0, 2)
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles = np.where((twice < 0)[:, None], triangles[:, ::-1], triangles)[np.abs(twice) > 1e-12]
    edges = [[1, 8], [8, 9], [9, 10], [10, 5]] if wall else None
    mesh = MeshBatch.from_arrays(points, triangles, constrained_edges=edges)
    positions = np.concatenate([held, np.full((free, 2), 0.25)])
    return mesh.with_points(torch.from_numpy(positions * side + FAR))


@functools.cache
def improved_alone(side: int, free: int) -> tuple[MeshBatch, MeshBatch, Report]:
    """A crowded mesh before and after under topology "full": made once for all tests, which change nothing of it."""
    mesh = crowded(side, free)
    return mesh, *improve(mesh, BY_REMOVAL)


@pytest.mark.parametrize(("side", "free"), [(2, 5), (4, 12), (8, 70)])
def test_where_floats_have_no_room_full_takes_vertices_out(side, free):
    mesh = crowded(side, free)
    _, report = improve(mesh)
    assert report.status.tolist() == [Status.STALLED]
    assert "no room between floating-point numbers" in report.messages[0]
    assert "inverted triangles are left after average" in report.messages[0]
    mesh, after, report = improved_alone(side, free)
    assert inverted(after) == 0
    assert report.certified.tolist() == [True]
    assert report.status.tolist() == [Status.SETTLED]
    assert "vertex-removal" in report.to_dict()[0]["tried"]
    assert report.worked == ["vertex-removal"]
    new = report.vertex_map.old_to_new
    assert torch.equal(after.points[new[:8]], mesh.points[:8])
    assert int((new < 0).sum()) > 0
    assert report.remeshed.collapses.item() >= int((new < 0).sum())
    names = torch.arange(len(mesh.points))
    carried = report.vertex_map.carry(names)
    old = report.vertex_map.new_to_old
    assert torch.equal(carried[old >= 0], old[old >= 0])


def test_walls_and_fixed_vertices_stay():
    mesh = crowded(8, 60, wall=True)
    after, report = improve(mesh, ImproveOptions(topology="full"))
    assert inverted(after) == 0
    assert report.certified.tolist() == [True]
    new = report.vertex_map.old_to_new
    assert torch.equal(after.points[new[:11]], mesh.points[:11])
    kept = {frozenset(e) for e in after.constrained_edges.tolist()}
    assert {frozenset(new[list(e)].tolist()) for e in mesh.constrained_edges.tolist()} == kept


def test_joined_equals_alone_to_the_bit():
    options = BY_REMOVAL
    parts = [(mesh, *improve(mesh, options)) for mesh in (meshes.jittered(6, 5, 0.5, 0), meshes.grid(3, 3))]
    parts += [improved_alone(4, 12), improved_alone(8, 70)]
    batch = join([mesh for mesh, _, _ in parts])
    together, report = improve(batch, options)
    assert bool(report.certified.all())
    maps = report.vertex_map.split(batch, together)
    for (_, alone, by_itself), after, vertex_map in zip(parts, together.split(), maps, strict=True):
        assert torch.equal(after.points, alone.points)
        assert torch.equal(after.triangles, alone.triangles)
        assert torch.equal(vertex_map.old_to_new, by_itself.vertex_map.old_to_new)


def test_sizes_of_the_user_go_with_their_vertices():
    mesh = crowded(8, 70)
    sizes = torch.full((len(mesh.points),), 3.0, dtype=torch.float64)
    options = ImproveOptions(topology="full", remesh=RemeshOptions(sizes=sizes))
    after, report = improve(join([meshes.grid(3, 3), mesh]), dataclasses.replace(
        options, remesh=RemeshOptions(sizes=torch.cat([torch.full((16,), 0.3, dtype=torch.float64), sizes]))
    ))  # fmt: skip
    assert bool(report.certified.all())
    assert len(report.remeshed.size) == len(after.points)


@pytest.mark.parametrize("name", list(meshes.TANGLED))
def test_a_round_of_collapses_leaves_a_mesh_of_the_same_frame(name):
    mesh = meshes.TANGLED[name]()
    state = RemeshState.begin(mesh, size_field(mesh, "keep"))
    e = editable(state)
    before = int(inverted_triangles(e).sum())
    assert before == inverted(mesh)
    taken = collapse_round(e)
    state = rebuilt(state, e)
    after, old = state.batch, state.names.of
    assert taken.item() > 0
    assert len(after.points) == len(mesh.points) - taken.item()
    assert len(after.triangles) == len(mesh.triangles) - 2 * taken.item()
    assert torch.equal(after.points, mesh.points[old])
    twin, given = twins(after.triangles), twins(mesh.triangles)
    assert torch.equal(twin[twin[twin >= 0]], (twin >= 0).nonzero().squeeze(1))
    assert euler_number(after.triangles, twin) == euler_number(mesh.triangles, given)
    boundaries = [old[boundary_edges(after.triangles, twin)], boundary_edges(mesh.triangles, given)]
    boundaries = [{tuple(edge) for edge in boundary.tolist()} for boundary in boundaries]
    assert boundaries[0] == boundaries[1]
    gone = torch.ones(len(mesh.points), dtype=torch.bool)
    gone[old] = False
    assert not bool((gone & mesh.fixed).any())


def test_a_mesh_of_fixed_vertices_only_ends():
    mesh = meshes.grid(1, 1)
    points = mesh.points.clone()
    points[2] = torch.tensor([-0.5, 0.2])
    mesh = mesh.with_points(points)
    after, removed = remove_vertices(mesh, RemeshOptions())
    assert (removed.cavities.tolist(), removed.collapses.tolist()) == ([0], [0])
    assert removed.kept.tolist() == list(range(len(points)))
    assert torch.equal(after.points, mesh.points)


def test_what_is_left_keeps_its_names_and_its_sizes():
    mesh = crowded(4, 12)
    names = Names.of_rows(2 * len(mesh.points), mesh.points.device).select(torch.arange(len(mesh.points)) * 2)
    after, removed = remove_vertices(mesh, RemeshOptions(), names)
    assert inverted(after) == 0
    assert int(removed.collapses) == len(mesh.points) - len(after.points) > 0
    assert removed.names.of.tolist() == (2 * removed.kept).tolist()
    assert torch.equal(removed.size, size_field(mesh, "keep")[removed.kept])
    assert bool(torch.isin(mesh.fixed.nonzero().squeeze(1), removed.kept).all())
