"""A mesh that is stretched throughout keeps its shapes; one that is not is as if nobody had looked."""

import pytest
import torch
from meshes import delaunay, disc, disturbed, equilateral, jittered, moved_hole, ring

import torchmesh as tm
from torchmesh import ImproveOptions, MeshBatch, improve, join
from torchmesh.improving.state import State
from torchmesh.improving.stretched import StretchOptions, own_metric


def stretched(mesh: MeshBatch, by: float = 4.0, degrees: float = 30.0) -> MeshBatch:
    """`mesh` as long again `by` times in a direction."""
    angle = torch.deg2rad(torch.tensor(degrees, dtype=torch.float64))
    d = torch.stack([angle.cos(), angle.sin()])
    return mesh.with_points(mesh.points + (by - 1) * (mesh.points @ d)[:, None] * d)


def found(mesh: MeshBatch) -> bool:
    return own_metric(State.of(mesh, ImproveOptions()), StretchOptions()) is not None


@pytest.mark.parametrize(
    "mesh", [delaunay(200), equilateral(12, 9), jittered(cells=0.2)], ids=["delaunay", "regular", "jittered"]
)
def test_a_stretch_is_found_whatever_its_direction(mesh):
    assert not found(mesh)
    assert all(found(stretched(mesh, 4.0, degrees)) for degrees in (0.0, 30.0, 77.0))


def test_a_stretch_that_turns_is_found():
    """Round a ring, whose triangles are long along it."""
    assert found(ring(sectors=32, layers=24, inner=1.0, outer=1.9))


@pytest.mark.parametrize("mesh", [moved_hole(), disc(), tm.domains.generate(9, triangles=300, seed=2).deformed])
def test_what_is_poor_by_chance_is_not_meant(mesh):
    assert not found(mesh)


@pytest.mark.parametrize("topology", ["flip", "keep", "full"])
def test_a_stretched_mesh_becomes_what_the_mesh_unstretched_would(topology):
    base = disturbed(improve(jittered(9, 8, cells=0.2))[0], 0.01, 1)
    plain, report = improve(base, ImproveOptions(topology=topology))
    mesh = stretched(base, 4.0, 0.0)
    out, report = improve(mesh, ImproveOptions(topology=topology))
    assert bool(report.certified[0])
    assert "stretched throughout" in report.messages[0]
    assert mean_in_its_metric(out) < 1.03 * float(tm.quality(plain).mean)
    # Without the exception the stretch would be gone, where edges may flip.
    flat, _ = improve(mesh, ImproveOptions(topology=topology, shapes="equilateral"))
    assert topology == "keep" or mean_in_its_metric(flat) > 1.1 * mean_in_its_metric(out)


def mean_in_its_metric(mesh: MeshBatch) -> float:
    """The mean inverse mean ratio of a mesh that was stretched by four along x, measured as if it had not been."""
    back = mesh.points * torch.tensor([0.25, 1.0], dtype=torch.float64)
    return float(tm.quality(mesh.with_points(back)).mean)


def test_joined_equals_alone_to_the_bit():
    meshes = [jittered(), stretched(delaunay(60)), moved_hole(), stretched(equilateral(7, 6), 3.0)]
    options = ImproveOptions(workers=1)
    whole, report = improve(join(meshes), options)
    assert ["stretched" in message for message in report.messages] == [False, True, False, True]
    for mesh, joined in zip(meshes, whole.split(), strict=True):
        alone, _ = improve(mesh, options)
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)


def test_an_observer_sees_the_meshes_that_change_their_number_of_vertices():
    batch, seen = join([disc(), stretched(delaunay(60))]), []
    after, _ = improve(batch, ImproveOptions(topology="full"), observe=lambda stage, mesh: seen.append((stage, mesh)))
    assert {"initial", "smooth", "remesh"} <= {stage for stage, _ in seen}
    assert all(len(mesh) in (1, 2) for _, mesh in seen)
    assert len(after) == 2


def test_needles_too_thin_for_a_metric_have_no_shapes_to_keep():
    thin = stretched(jittered(6, 5, cells=0.1), 1e9, 90.0)
    assert bool((thin.points.isfinite()).all())
    _, report = improve(join([thin, ring()]), ImproveOptions(topology="full"))
    assert report.valid.all()
    assert not found(thin)
    assert found(stretched(jittered(6, 5, cells=0.1), 1e4, 90.0))
