"""The compiled second-order steps against their twins in torch, and against themselves in pauses."""

import meshes
import pytest
import torch

from torchmesh.kernels import library, projected
from torchmesh.mesh.triangle import corners
from torchmesh.optimising.energies import Regularised, TotalLiftedContent
from torchmesh.optimising.jacobian import target_of
from torchmesh.optimising.levenberg import LevenbergOptions, push_areas
from torchmesh.optimising.projected_newton import NewtonSystem, ProjectedOptions, minimise_by_projection

ENERGIES = {"regularised": Regularised(0.3), "lifted": TotalLiftedContent(0.1)}


def scrambled(amount=0.4):
    """The system of a square grid towards its own triangles, with weights, one vertex alone, points thrown about."""
    mesh = meshes.grid(5, 5)
    throw = torch.randn(mesh.points.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    points = torch.where(mesh.fixed[:, None], mesh.points, mesh.points + amount * throw)
    points = torch.cat([points, torch.tensor([[0.3, 0.4]], dtype=torch.float64)])
    free = torch.cat([~mesh.fixed, torch.tensor([True])])
    weight = torch.linspace(0.5, 2.0, len(mesh.triangles), dtype=torch.float64)
    target = target_of(corners(mesh.points, mesh.triangles))
    return points, NewtonSystem(points, mesh.triangles, free, target, weight)


def both(work):
    """What comes of `work` of a new system with torch, and with the compiled loops."""
    found = []
    for choice in ("torch", "compiled"):
        points, system = scrambled()
        with library.using(choice):
            assert (system.compiled is None) == (choice == "torch")
            found.append(work(points, system))
        assert torch.equal(found[-1].points[~system.free], points[~system.free])
    return found


def assert_alike(one, two, tolerance):
    assert one.iterations == two.iterations > 2
    for name in ("points", "det"):
        torch.testing.assert_close(getattr(two, name), getattr(one, name), rtol=0, atol=tolerance)
    assert two.start == pytest.approx(one.start, rel=1e-12)
    assert two.energy == pytest.approx(one.energy, rel=tolerance)


@pytest.mark.parametrize("floors", [(1e-9, 0.0), (0.0, 1e-4)], ids=["of each triangle", "of the mesh"])
@pytest.mark.parametrize("name", ENERGIES)
def test_newton_steps_are_those_of_torch(name, floors):
    options = ProjectedOptions(3, floor=floors[0], common_floor=floors[1])
    assert_alike(*both(lambda points, system: minimise_by_projection(system, points, ENERGIES[name], options)), 1e-8)


def test_steps_of_levenberg_and_marquardt_are_those_of_torch():
    # So much is asked for that no triangle is large enough in the end.
    options = LevenbergOptions(max_iterations=6)
    assert_alike(*both(lambda points, system: push_areas(system, points, 0.9, options)), 1e-7)


def test_pauses_change_no_bit(monkeypatch):
    """Calls of one step, so that Python sees interrupts, come to what one call comes to, failed steps among them."""
    found = []
    for work in (10**9, 1):
        monkeypatch.setattr(projected, "_WORK", work)
        points, system = scrambled(0.6)
        with library.using("compiled"):
            pushed = push_areas(system, points, 0.9, LevenbergOptions(max_iterations=12, damping=1e-9))
            found.append((pushed, minimise_by_projection(system, points, ENERGIES["regularised"])))
    for one, two in zip(*found, strict=True):
        assert one.iterations == two.iterations > 1
        assert torch.equal(one.points, two.points)
        assert torch.equal(one.det, two.det)
        assert (one.start, one.energy) == (two.start, two.energy)


def test_a_system_that_is_singular_ends_the_work_where_it_is():
    points, system = scrambled()
    nothing = torch.zeros_like(system.weight)
    system.weight = nothing
    with library.using("compiled"):
        found = push_areas(system, points, 0.9, LevenbergOptions(damping=0.0))
    assert torch.equal(found.points, points)
