"""Cases are what their names say: the same each time, tangled, with a simple boundary, harder level by level."""

import numpy as np
import pytest
import torch
from exact import inverted

from torchmesh import bench
from torchmesh.bench.case import COUNT
from torchmesh.bench.catalogue import families
from torchmesh.bench.exact_check import boundary_is_simple
from torchmesh.bench.network import Mover
from torchmesh.mesh.interfaces import holding

NAMES = ["moved", "turned", "sequence", "jitter", "letters", "spirals", "layers", "quads", "untrained", "trained"]


@pytest.fixture(autouse=True)
def weights(tmp_path_factory, monkeypatch):
    """Weights of a network that was never trained, in place of those of the checkout."""
    path = tmp_path_factory.mktemp("weights") / "mover.pt"
    torch.manual_seed(0)
    state = Mover().state_dict()
    torch.save({"untrained": state, "trained": state}, path)
    monkeypatch.setenv("TORCHMESH_BENCH_WEIGHTS", str(path))


def test_there_are_ten_thousand_cases_in_these_families():
    assert list(families()) == NAMES
    assert sum(map(len, families().values())) >= 10_000
    for family in families().values():
        assert list(family.levels) == sorted(family.levels)
        assert {family.level(n) for n in range(len(family.levels))} == set(family.levels)


@pytest.mark.parametrize("name", NAMES)
def test_cases_are_tangled_and_can_be_solved(name):
    family = families()[name]
    for number in (1, len(family.levels) - 1):
        case = family.case(number)
        assert inverted(case.undeformed) == 0
        assert bench.judge(case.undeformed, case.undeformed).valid
        if not len(case.mesh.quads):
            assert case.path or inverted(case.mesh) == case.inverted > 0
            assert boundary_is_simple(case.mesh)
        assert case.path or not bench.judge(case, case.mesh).valid
        assert torch.equal(case.mesh.triangles, case.undeformed.triangles)
        assert case.level == family.level(number)


@pytest.mark.parametrize("name", ["jitter", "turned", "untrained"])
def test_a_case_depends_on_its_name_alone(name):
    once = families()[name].case(3)
    torch.manual_seed(7)
    np.random.seed(7)
    again = list(bench.cases([name], limit=4))[3]
    assert once.digest == again.digest
    assert once.digest != families()[name].case(4).digest


def test_numbers_beyond_the_benchmark_are_other_cases():
    family = families()["jitter"]
    assert family.case(COUNT).digest != family.case(0).digest


def test_some_meshes_have_two_regions_whose_interface_stays():
    some = [case for case in bench.cases(["jitter"], limit=9) if case.details["regions"] == 2]
    assert some
    for case in some:
        assert len(case.mesh.constrained_edges) > 3
        held = holding(case.mesh).fixed
        assert torch.equal(case.mesh.points[held], case.undeformed.points[held])


def test_an_unknown_family_is_told():
    with pytest.raises(ValueError, match="no family square; there are moved"):
        next(bench.cases(["square"]))
