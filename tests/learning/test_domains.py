"""Generated domains: as good as promised, tangled as wished, the same whoever asks for them."""

import dataclasses
import itertools

import pytest
import torch

import torchmesh as tm
from torchmesh import domains
from torchmesh.mesh.batch import MeshBatch


def same(a: MeshBatch, b: MeshBatch) -> bool:
    return all(torch.equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a) if f.name[0] != "_")


@pytest.mark.parametrize("family", sorted(domains.FAMILIES))
def test_a_family_keeps_its_promises(family):
    # With fewer, narrow parts of these families are coarse.
    enough = 400 if family in ("gate", "letter", "onto", "bar") else 1000
    made = domains.generate(8, [family], seed=5, triangles=enough, motions=2)
    assert made.families == (family,) * 8
    before, after = tm.quality(made.undeformed), tm.quality(made.deformed)
    assert int(before.inverted.sum()) == 0
    assert float(before.mean.max()) <= domains.MAX_MEAN
    assert float(before.max.max()) <= domains.MAX_WORST
    assert torch.equal(made.inverted, after.inverted)
    # 0.8 of eight, give or take the one motion that may not tangle.
    assert 5 <= int((made.inverted > 0).sum()) <= 7
    assert torch.equal(made.undeformed.triangles, made.deformed.triangles)
    assert tm.diagnose(made.deformed) == []
    moved = (made.undeformed.points != made.deformed.points).any(1)
    assert bool(moved.any())
    if family == "jitter":
        assert not bool(moved[made.undeformed.fixed].any())


def test_the_default_method_makes_every_generated_mesh_valid():
    made = domains.generate(len(domains.FAMILIES), seed=11, triangles=300, motions=1, tangled=1.0)
    _, report = tm.improve(made.deformed)
    report.check()


def test_the_number_of_triangles_is_met():
    for triangles in (600, 1500):
        made = domains.generate(3, ["gate", "letter", "onto"], triangles=triangles, motions=1)
        counts = made.deformed.triangle_offsets.diff()
        assert bool((counts.double() / triangles - 1).abs().max() < 0.05)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_the_share_of_tangled_meshes_is_met(share):
    made = domains.generate(24, ["circle", "holes"], triangles=200, motions=6, tangled=share, seed=2)
    assert abs(float((made.inverted > 0).double().mean()) - share) <= 1.5 / 24


def test_how_the_stream_is_cut_changes_no_mesh():
    whole = domains.generate(12, ["bar", "gate"], triangles=200, motions=4, seed=9).deformed
    for size in (1, 5):
        cut = itertools.islice(domains.stream(["bar", "gate"], batch=size, triangles=200, motions=4, seed=9), 12)
        meshes = [mesh for part in cut for mesh in part.split()][:12]
        assert same(tm.join(meshes), whole)


def test_shards_make_up_the_whole():
    options = {"triangles": 200, "motions": 2, "seed": 4}
    whole = domains.generate(12, ["circle", "gate", "bar"], **options).deformed.split()
    shards = [domains.generate(6, ["circle", "gate", "bar"], shard=(i, 2), **options).deformed.split() for i in (0, 1)]
    for number, mesh in enumerate(whole):
        domain, motion = divmod(number, 2)
        assert same(shards[domain % 2][2 * (domain // 2) + motion], mesh)


def test_other_seeds_give_other_meshes():
    one, two = (domains.generate(1, ["holes"], triangles=300, seed=s).deformed for s in (1, 2))
    assert one.points.shape != two.points.shape or not torch.equal(one.points, two.points)


def test_motions_share_their_undeformed_mesh():
    made = domains.generate(4, ["circle"], triangles=300, motions=4)
    first, *others = made.undeformed.split()
    assert all(same(first, other) for other in others)
    moved = made.deformed.split()
    assert not torch.equal(moved[0].points, moved[1].points)


def test_interiors_follow_the_boundary_by_femwarp():
    made = domains.generate(2, ["airfoil"], triangles=600, motions=2)
    warped = tm.femwarp(made.undeformed, made.deformed.points)
    # The same linear system, solved for several motions at once: rounding differs.
    torch.testing.assert_close(warped.points, made.deformed.points, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"families": ["holes", "square"]}, "square"),
        ({"families": []}, "none"),
        ({"seed": -1}, "seed"),
        ({"triangles": 50}, "triangles"),
        ({"tangled": 1.5}, "tangled"),
        ({"tangled": float("nan")}, "tangled"),
        ({"motions": 0}, "motions"),
        ({"shard": (2, 2)}, "shard"),
        ({"batch": 0}, "batch"),
    ],
)
def test_wrong_options_are_refused_when_given(options, message):
    with pytest.raises(ValueError, match=message):
        domains.pairs(**options)


@pytest.mark.parametrize("family", sorted(domains.FAMILIES))
def test_few_triangles_are_met_by_every_family(family):
    made = domains.generate(3, [family], triangles=120, motions=1, seed=1)
    counts = made.deformed.triangle_offsets.diff()
    assert bool(((counts / 120 - 1).abs() <= 0.1).all()), counts.tolist()
    before = tm.quality(made.undeformed)
    assert int(before.inverted.sum()) == 0
    assert float(before.mean.max()) <= domains.MAX_MEAN_COARSE
    assert float(before.max.max()) <= domains.MAX_WORST


def test_too_few_triangles_for_a_good_mesh_are_refused_by_name(monkeypatch):
    monkeypatch.setattr("torchmesh.learning.drawing.MAX_MEAN_COARSE", 1.0)
    with pytest.raises(tm.ConvergenceError, match=r"domain 0 .*'spiral'.*: 3 were drawn.*100 triangles"):
        domains.generate(1, ["spiral"], triangles=100, drawing=domains.DrawOptions(domain_tries=3))


def test_the_stream_goes_on_where_narrow_parts_need_more_triangles_and_says_so(monkeypatch):
    """After the tries as asked, domains get more triangles until their meshes are good."""
    monkeypatch.setattr("torchmesh.learning.drawing.MAX_MEAN_COARSE", domains.MAX_MEAN)
    drawing = domains.DrawOptions(domain_tries_as_asked=0)
    with pytest.warns(tm.MeshWarning, match=r"domain 0, family 'spiral', has \d+ triangles; 100 were asked for"):
        moved = domains.generate(1, ["spiral"], triangles=100, motions=1, drawing=drawing)
    assert moved.undeformed.triangles.shape[0] > 150
    assert tm.quality(moved.undeformed).mean.max() <= domains.MAX_MEAN


def test_the_count_must_be_positive():
    with pytest.raises(ValueError, match="count"):
        domains.generate(0)


def test_one_family_may_be_given_as_a_string():
    assert domains.DomainOptions("holes").families == ("holes",)


def test_a_domain_that_the_paper_has_not_is_refused_with_those_it_has():
    with pytest.raises(ValueError, match=r"domains.moving knows 'circle', 'bar', 'gate', not 'bars'"):
        domains.moving("bars")
