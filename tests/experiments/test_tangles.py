"""Every family of tangles starts from a valid mesh, tangles it, and keeps its boundary simple."""

import pytest

import torchmesh as tm
from experiments.shared.tangles import FAMILIES, tangle
from torchmesh.bench.exact_check import boundary_is_simple


@pytest.mark.parametrize("family", ["moved", "turned", "jittered", "scrambled", "mapped", "wound"])
def test_every_family_tangles_and_keeps_its_boundary_simple(family, cache):
    pytest.importorskip("gmsh")
    kind = FAMILIES[family]
    value = kind.values[len(kind.values) // 2]
    case = tangle(family, value, 300, 0.3, 0, cache, angle=90.0 if kind.turns else 0.0)
    assert int(tm.quality(case.undeformed).inverted) == 0
    assert int(tm.quality(case.tangled).inverted) > 0
    assert boundary_is_simple(case.tangled)
    crossed = case.tangled.points.clone()
    on = case.tangled.fixed.nonzero().squeeze(1)
    two = on[[0, len(on) // 2]]
    crossed[two] = case.tangled.points[two.flip(0)]
    assert not boundary_is_simple(case.tangled.with_points(crossed))


def test_no_family_is_left_out():
    assert set(FAMILIES) == {"moved", "turned", "jittered", "scrambled", "mapped", "wound"}
