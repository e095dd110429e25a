"""Each built-in method whose library is installed mends what it can, and says what it cannot take."""

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm
from torchmesh import bench
from torchmesh.bench import registry
from torchmesh.bench.catalogue import families

NAMES = registry.builtin_methods()


def test_these_methods_are_built_in():
    assert {"ours", "ours-keep", "ours-full", "ours-fast", "kim2017", "gmsh-untangle", "gmsh-anew", "mfem-tmop",
            "mouette", "regularised", "harmonic", "biharmonic", "elastic", "rbf", "network", "network-layer"} == set(
        NAMES
    )  # fmt: skip
    assert all(registry.words(registry.METHODS[name]).endswith(".") for name in NAMES)


def called(name: str, mesh: tm.MeshBatch, undeformed: tm.MeshBatch) -> tm.MeshBatch:
    known = registry.METHODS[name]
    if registry.why_not(known):
        pytest.skip(registry.why_not(known))
    answer = known.function(mesh, undeformed) if known.undeformed else known.function(mesh)
    return answer.mesh if isinstance(answer, bench.Result) else answer


@pytest.mark.parametrize("name", [n for n in NAMES if n not in ("mouette", "network", "network-layer")])
def test_a_method_mends_a_light_tangle(name):
    rest = meshes.grid(6, 6)
    points = rest.points.clone()
    points[24] += 0.25
    tangled = rest.with_points(points)
    assert int(tm.quality(tangled).inverted) > 0
    verdict = bench.judge(tangled, called(name, tangled, rest))
    assert (verdict.valid, verdict.fault) == (True, "")


@pytest.mark.parametrize("name", ["harmonic", "elastic", "rbf", "biharmonic"])
def test_extensions_reproduce_a_motion_of_the_plane(name):
    """An affine one, or a shift where a turn has strains of its own, or a normal derivative, which must be zero."""
    rest = meshes.ring()
    turn = torch.tensor([[0.8, 0.6], [-0.6, 0.8]], dtype=torch.float64)
    goal = rest.points @ turn + 0.3 if name in ("harmonic", "rbf") else rest.points + 0.3
    moved = rest.with_points(torch.where(rest.fixed[:, None], goal, rest.points))
    assert torch.allclose(called(name, moved, rest).points, goal, atol=1e-8)


def test_harmonic_is_femwarp():
    case = families()["turned"].case(0)
    made = called("harmonic", case.mesh, case.undeformed)
    assert torch.allclose(made.points, case.mesh.points, atol=1e-9)


def test_a_method_that_cannot_hold_an_interface_refuses():
    case = next(c for c in bench.cases(["jitter"], limit=9) if c.details["regions"] == 2)
    for name in ("gmsh-untangle", "gmsh-anew"):
        if not registry.why_not(registry.METHODS[name]):
            with pytest.raises(bench.Refused):
                registry.METHODS[name].function(case.mesh)


def test_the_network_moves_nothing_that_is_fixed(tmp_path, monkeypatch):
    from torchmesh.bench.network import Mover

    torch.manual_seed(0)
    state = Mover().state_dict()
    torch.save({"untrained": state, "trained": state}, tmp_path / "w.pt")
    monkeypatch.setenv("TORCHMESH_BENCH_WEIGHTS", str(tmp_path / "w.pt"))
    case = families()["jitter"].case(0)
    for name in ("network", "network-layer"):
        made = called(name, case.mesh, case.undeformed)
        assert torch.equal(made.points[case.mesh.fixed], case.mesh.points[case.mesh.fixed])
    # Turning the plane turns what the network gives only roughly; moving it does not matter.
    from torchmesh.bench.network import load

    network = load("trained")
    shift = torch.tensor([3.0, -2.0], dtype=torch.float64)
    with torch.no_grad():
        here = network(case.undeformed, case.mesh.points)
        there = network(case.undeformed.with_points(case.undeformed.points + shift), case.mesh.points + shift)
    assert np.allclose(here + shift, there, atol=1e-4)
