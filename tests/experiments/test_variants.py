"""The variants that a seed draws."""

import itertools

from experiments.quality.variants import drawn


def test_a_seed_draws_the_same_variants_each_time():
    assert list(drawn(3)) == list(drawn(3))
    kinds = [{name.split(",")[0].split(" of ")[0].split(" at ")[0] for name in drawn(s)} for s in range(3)]
    for names in kinds:
        for kind in ("holes", "bar", "gate", "airfoil", "cylinder"):
            assert any(kind in name for name in names), (kind, names)
    assert all(drawn(a).keys() != drawn(b).keys() for a, b in itertools.combinations(range(3), 2))
