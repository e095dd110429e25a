"""Flips that are enough: they lead to the mesh that is told, edges that must stay are left out, and users read them."""

from dataclasses import replace

import meshes
import numpy as np
import pytest
import torch
from exact import inverted

import torchmesh as tm
from torchmesh import EnoughFlips, enough_flips
from torchmesh.errors import InvalidMeshError
from torchmesh.untangling.enough_flips import FlipSearch


def pushed_in() -> tm.MeshBatch:
    """A square with a corner pushed in beyond the diagonal of its cell: a triangle of fixed vertices is inverted."""
    mesh = meshes.grid(4, 4)
    points = mesh.points.clone()
    points[20] = torch.tensor([0.78125, 0.21875])
    return mesh.with_points(points)


def turned_ring(sides: int = 20, degrees: float = 120.0) -> tm.MeshBatch:
    """Two circles of fixed vertices and one of free ones between, the inner circle turned."""
    angle = 2 * np.pi * np.arange(sides) / sides
    loops = [
        radius * np.stack([np.cos(angle + turn), np.sin(angle + turn)], 1)
        for radius, turn in ((1.0, 0.0), (0.8, 0.0), (0.6, np.radians(degrees)))
    ]
    k = np.arange(sides)
    n = (k + 1) % sides
    faces = [
        np.stack([out * sides + k, out * sides + n, (out + 1) * sides + k], 1)
        for out in (0, 1)
    ] + [np.stack([out * sides + n, (out + 1) * sides + n, (out + 1) * sides + k], 1) for out in (0, 1)]  # fmt: skip
    return tm.relax(tm.MeshBatch.from_arrays(np.concatenate(loops), np.concatenate(faces)))


def edges(mesh: tm.MeshBatch) -> set[frozenset[int]]:
    return {frozenset((t[k - 1], t[k])) for t in mesh.triangles.tolist() for k in range(3)}


def test_a_single_flip_is_enough_for_a_corner_that_is_pushed_in():
    mesh = pushed_in()
    found = enough_flips(mesh)
    assert found is not None
    assert found.edges == ((15, 21),)
    assert found.replaced == 1
    assert edges(found.mesh) == edges(mesh) - {frozenset((15, 21))} | {frozenset((16, 20))}
    assert inverted(found.mesh) == 0
    assert torch.equal(found.mesh.points[mesh.fixed], mesh.points[mesh.fixed])
    _, report = tm.improve(mesh, tm.ImproveOptions(topology="keep"))
    assert "1 flip is enough to make it possible: 15-21" in report.messages[0]
    assert "1 flip is enough" in report.notes[0]


def test_the_flips_lead_from_the_mesh_given_to_the_one_told():
    """In their order, each of an edge that is there then."""
    mesh = pushed_in()
    points = mesh.points.clone()
    points[4] = torch.tensor([0.21875, 0.78125])
    mesh = mesh.with_points(points)
    found = enough_flips(mesh)
    assert found is not None
    assert found.edges is not None
    assert len(found.edges) == 2
    assert inverted(found.mesh) == 0
    faces = [tuple(t) for t in mesh.triangles.tolist()]
    for a, b in found.edges:
        pair = [t for t in faces if a in t and b in t]
        c, d = (next(v for v in t if v not in (a, b)) for t in pair)
        faces = [t for t in faces if t not in pair] + [(a, c, d), (b, c, d)]
    assert {frozenset(t) for t in faces} == {frozenset(t) for t in found.mesh.triangles.tolist()}


def test_edges_that_must_stay_are_not_flipped():
    mesh = replace(pushed_in(), constrained_edges=torch.tensor([[15, 21]]))
    assert enough_flips(mesh) is None
    _, report = tm.improve(mesh, tm.ImproveOptions(topology="keep"))
    assert "enough" not in report.messages[0]


def test_a_valid_mesh_takes_no_flips_and_what_is_no_single_mesh_is_refused():
    found = enough_flips(meshes.grid())
    assert found is not None
    assert found.edges == ()
    assert found.replaced == 0
    with pytest.raises(ValueError, match="takes one mesh of triangles, not 2"):
        enough_flips(tm.join([meshes.grid(), meshes.grid()]))


def test_a_flip_is_found_where_no_vertex_can_move():
    """A square whose one corner is pushed in beyond the diagonal."""
    square = tm.MeshBatch.from_arrays([[0.0, 0], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [0, 2, 3]])
    pushed = square.with_points(torch.tensor([[1.0, 0], [0.25, 0.25], [0, 1], [0, 0]]).double())
    found = enough_flips(pushed)
    assert found is not None
    assert found.edges == ((0, 2),)
    assert inverted(found.mesh) == 0
    _, report = tm.improve(pushed, tm.ImproveOptions(topology="keep"))
    assert report.status.tolist() == [tm.Status.INFEASIBLE]
    assert "1 flip is enough to make it possible: 0-2" in report.messages[0]


@pytest.mark.parametrize("value", [float("nan"), 1e200])
@pytest.mark.parametrize("vertex", [0, 12])
def test_positions_that_one_cannot_compute_with_are_refused(vertex, value):
    mesh = meshes.grid(4, 4)
    points = mesh.points.clone()
    points[vertex] = value
    with pytest.raises(InvalidMeshError, match=f"mesh 0: points row {vertex} is"):
        enough_flips(mesh.with_points(points))


def test_without_trials_cavities_are_told():
    found = enough_flips(pushed_in(), FlipSearch(descents=()))
    assert found is not None
    assert found.edges is None
    assert found.replaced > 0
    assert inverted(found.mesh) == 0
    assert found.text().startswith(f"with {found.replaced} other edges it is possible")


def test_where_many_are_tangled_few_flips_are_found_after_which_the_triangles_can_be_kept():
    """A ring whose inner circle is turned by 120 degrees, with one ring of vertices between: a third is inverted.

    New cavities alone replace nearly all edges that can be flipped.
    """
    mesh = turned_ring()
    anew = enough_flips(mesh, FlipSearch(descents=()))
    found = enough_flips(mesh)
    assert anew is not None
    assert found is not None
    assert found.edges is not None
    assert found.replaced <= len(found.edges) <= anew.replaced / 2
    flipped = mesh.with_triangles(found.mesh.triangles)
    assert inverted(flipped) > 10
    kept, report = tm.improve(flipped, tm.ImproveOptions(topology="keep"))
    assert inverted(kept) == 0
    assert report.status.tolist() != [int(tm.Status.STALLED)]
    again = enough_flips(mesh)
    assert again is not None
    assert again.edges == found.edges


def test_words():
    mesh = meshes.grid()
    assert EnoughFlips(mesh, ((1, 2),), 1).text() == (
        "1 flip is enough to make it possible: 1-2 (the fewest that were found, an upper bound)"
    )
    text = EnoughFlips(mesh, ((1, 2), (3, 4), (5, 6)), 3).text(most=2)
    assert text.startswith("3 flips are enough to make it possible: 1-2, 3-4 and 1 more")
