"""Vertices without a place: the proof holds step by step, says nothing of meshes that can be valid, and is told."""

from dataclasses import replace

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm
from experiments.shared import feasible
from torchmesh.bench import boundary
from torchmesh.diagnosing.no_place import PlaceOptions, no_place, vertex_without_place
from torchmesh.diagnosing.no_place_check import check_no_place
from torchmesh.diagnosing.no_place_steps import NoPlace
from torchmesh.learning.outlines import bent_band, laid_along
from torchmesh.mesh.connectivity import boundary_edges


def laid(sectors: int = 26, layers: int = 2, bends: int = 6) -> tm.MeshBatch:
    """A disc whose boundary is laid onto a band that bends so often."""
    mesh = meshes.disc(sectors, layers)
    loop = boundary.loops(mesh.triangles)[0]
    points = mesh.points.clone()
    points[loop] = torch.from_numpy(laid_along(bent_band(bends), len(loop)))
    return tm.relax(mesh.with_points(points))


@pytest.fixture(scope="module")
def impossible():
    """A mesh that can have no valid positions, and the proof."""
    mesh = laid()
    return mesh, vertex_without_place(mesh)


def arrays(mesh):
    return mesh.points.numpy(), mesh.triangles.numpy(), mesh.fixed.numpy()


def test_a_disc_of_few_layers_does_not_reach_round_the_bends_of_a_band(impossible):
    mesh, proof = impossible
    assert proof is not None
    assert check_no_place(*arrays(mesh), proof) == []
    assert not bool(mesh.fixed[proof.vertex])
    after, report = tm.improve(mesh, tm.ImproveOptions(topology="keep"))
    assert report.status.tolist() == [tm.Status.PARTLY]  # fewer are inverted than before
    assert f"vertex {proof.vertex} has no place" in report.messages[0]
    assert bool(report.quality.inverted > 0)
    assert torch.equal(after.triangles, mesh.triangles)
    # Edges that flip reach it.
    assert tm.improve(mesh)[1].valid.tolist() == [True]
    assert tm.diagnose(mesh, "keep") == []
    (problem,) = tm.diagnose(mesh, "keep", thorough=True)
    assert problem.kind is tm.ProblemKind.NO_PLACE
    assert problem.kind.proves
    assert isinstance(problem.proof, NoPlace)


def test_lines_from_fixed_vertices_prove_it_where_those_between_cells_are_too_many():
    """A thin ring that turned: a vertex with neighbours on both circles has no place that sees all of them."""
    mesh = meshes.ring(sectors=48, layers=2, inner=0.8, outer=1.0)
    points = mesh.points.clone()
    turn, inner = torch.tensor(2.3, dtype=torch.float64), torch.arange(len(points)) < 48
    turned = points @ torch.stack([turn.cos(), turn.sin(), -turn.sin(), turn.cos()]).view(2, 2)
    mesh = tm.relax(mesh.with_points(torch.where(inner[:, None], turned, points)))
    few = PlaceOptions(most_lines=3_000)
    proof = vertex_without_place(mesh, few)
    assert proof is not None
    assert check_no_place(*arrays(mesh), proof) == []
    assert all(bool(mesh.fixed[step.neighbour]) for step in proof.steps)
    # Too few lines even for these: nothing is proved.
    assert vertex_without_place(mesh, PlaceOptions(most_lines=100)) is None


def test_steps_that_do_not_hold_are_found(impossible):
    mesh, proof = impossible
    first = proof.steps[0]
    assert check_no_place(*arrays(mesh), replace(proof, steps=proof.steps[1:]))
    assert check_no_place(*arrays(mesh), replace(proof, steps=proof.steps[::-1]))
    fixed = int(mesh.fixed.nonzero()[0])
    for wrong in (replace(first, vertex=fixed), replace(first, neighbour=first.vertex), first):
        assert check_no_place(*arrays(mesh), replace(proof, steps=(wrong, *proof.steps)))
    assert check_no_place(*arrays(mesh), replace(proof, cells=proof.cells[1:]))


@pytest.mark.parametrize("seed", range(2))
def test_of_a_mesh_that_can_be_valid_nothing_is_proved(seed):
    """However its free vertices lie: the search does not look at them."""
    rng = np.random.default_rng(seed)
    valid = tm.domains.generate(1, [["gate", "letter"][seed]], triangles=100, seed=seed).undeformed
    throw = torch.from_numpy(rng.uniform(-1, 1, valid.points.shape))
    mesh = valid.with_points(torch.where(valid.fixed[:, None], valid.points, throw))
    assert vertex_without_place(mesh) is None
    assert tm.diagnose(mesh, "keep", thorough=True) == []


@pytest.mark.parametrize("name", ["turned-100-0-laplace", "holes-150-1-laplace", "spiral-100-2-point"])
def test_of_domains_with_holes_nothing_is_proved_either(name):
    assert vertex_without_place(feasible.case(name).tangled) is None


def test_a_thin_ring_whose_inner_circle_has_turned_is_impossible():
    mesh = feasible.meshed(feasible.ring(0.7), np.random.default_rng(0), 200)
    points = torch.from_numpy(feasible.twisted(mesh.points.numpy(), 0.7, np.pi))
    proof = vertex_without_place(mesh.with_points(points))
    assert proof is not None
    assert check_no_place(mesh.with_points(points).points.numpy(), *arrays(mesh)[1:], proof) == []


def test_holes_crossings_and_fixed_vertices_inside_prove_nothing_wrongly():
    ring = meshes.ring(16, 4)
    assert vertex_without_place(ring) is None
    mesh = meshes.grid(6, 6)
    held = replace(mesh, fixed=mesh.fixed | (torch.arange(len(mesh.points)) == 24))
    assert vertex_without_place(held) is None
    crossed = mesh.points.clone()
    crossed[0] = torch.tensor([2.0, 0.5])
    edges = boundary_edges(mesh.triangles, mesh.twin).numpy()
    assert no_place(crossed.numpy(), *arrays(mesh)[1:], edges) is None
