"""`scope="damage"`: what is damaged is mended, what is not keeps its bits, whatever the mesh is stretched to."""

import meshes
import pytest
import torch
from judges import inverted

import torchmesh as tm
from torchmesh import ImproveOptions, MeshBatch, improve, quality
from torchmesh.improving.shapes_meant import Meant, damaged
from torchmesh.improving.state import State
from torchmesh.improving.step_options import Damage

BASE = meshes.disturbed(meshes.equilateral(30, 25), 0.08, 0)
STRETCH = torch.tensor([4.0, 1.0], dtype=torch.float64)


def stretched(mesh: MeshBatch) -> MeshBatch:
    return mesh.with_points(mesh.points * STRETCH)


def tangled(mesh: MeshBatch, *places: tuple[float, float], radius: float = 1.8, size: float = 1.0) -> MeshBatch:
    """The mesh with its free vertices near the `places` thrown about."""
    thrown = meshes.disturbed(mesh, size, 1).points
    for place in places:
        near = (mesh.points - torch.tensor(place, dtype=torch.float64)).norm(dim=1) < radius
        mesh = mesh.with_points(torch.where(near[:, None], thrown, mesh.points))
    assert inverted(mesh) > 3
    return mesh


def damage(**options) -> ImproveOptions:
    return ImproveOptions(scope="damage", workers=1, **options)


def share_moved(before: MeshBatch, after: MeshBatch) -> float:
    return float((before.points != after.points).any(1).double().mean())


@pytest.mark.parametrize("topology", ["keep", "flip", "full"])
@pytest.mark.parametrize("stretch", [False, True])
def test_a_small_tangle_moves_at_most_an_eighth_and_the_mesh_stays_stretched(topology, stretch):
    mesh = tangled(BASE, (10.0, 10.0))
    mesh = stretched(mesh) if stretch else mesh
    better, report = improve(mesh, damage(topology=topology))
    assert report.valid.tolist() == report.certified.tolist() == [True]
    before, after = mesh, better
    if topology == "full":
        assert int(report.moved[0]) <= len(mesh.points) / 8
        kept = report.vertex_map.new_to_old
        assert int((better.points[kept >= 0] == mesh.points[kept[kept >= 0]]).all(1).sum()) >= 7 / 8 * len(mesh.points)
    else:
        assert 0 < share_moved(before, after) <= 1 / 8
        moved = (before.points != after.points).any(1)
        changed = (before.triangles != after.triangles).any(1)
        # All that changed lies together: what is more than ten edges away is the same to the bit.
        middle = torch.tensor([10.0, 10.0], dtype=torch.float64) * (STRETCH if stretch else 1.0)
        away = ((before.points - middle) / (STRETCH if stretch else 1.0)).norm(dim=1)
        assert float(away[moved].max()) < 8
        assert not bool((away[before.triangles] > 8).all(1)[changed].any())
    # As the stretching sees them, triangles are as good there as elsewhere.
    seen = better.with_points(better.points / STRETCH) if stretch else better
    assert float(quality(seen).max[0]) < 1.5
    assert "round the damage" in report.messages[0]


@pytest.mark.parametrize("topology", ["keep", "flip", "full"])
def test_what_is_not_damaged_comes_back_to_the_bit(topology):
    batch = tm.join([BASE, stretched(BASE), meshes.ring(), meshes.l_shape(4), meshes.jittered(12, 11, 0.12)])
    assert quality(batch).inverted.tolist() == [0] * 5
    better, report = improve(batch, damage(topology=topology))
    assert torch.equal(better.points, batch.points)
    assert torch.equal(better.triangles, batch.triangles)
    assert report.certified.all()
    assert report.status.tolist() == [tm.Status.SETTLED] * 5
    assert "all is as it was given" in report.messages[1]


def test_layers_are_what_is_meant():
    points, triangles = meshes.ring_arrays(40, 12, 0.4, 1.3)
    plain = MeshBatch.from_arrays(points, triangles)
    radius = plain.points.norm(dim=1, keepdim=True)
    layer = ((radius - 0.4) / 0.075).round()
    heights = 0.4 + 1e-4 * (1.8**layer - 1) / 0.8
    mesh = plain.with_points(plain.points / radius * heights)
    assert float(quality(mesh).max[0]) > 100
    state = State.of(mesh, damage())
    assert not damaged(state, Meant.of(state), damage()).any()


def test_a_bad_triangle_is_mended_though_none_is_inverted():
    mesh = meshes.equilateral(14, 13)
    points = mesh.points.clone()
    row = 6 * 14 + 6
    neighbours = mesh.triangles[(mesh.triangles == row).any(1)].unique()
    other = neighbours[neighbours != row][:2]
    # All but on the edge opposite.
    points[row] = 0.02 * mesh.points[row] + 0.98 * mesh.points[other].mean(0)
    mesh = mesh.with_points(points)
    assert quality(mesh).inverted.tolist() == [0]
    assert float(quality(mesh).max[0]) > 5
    better, report = improve(mesh, damage())
    assert float(quality(better).max[0]) < 2
    assert 0 < share_moved(mesh, better) < 1 / 8
    assert float(report.travel.max[0]) <= 1


def test_places_are_mended_apart_so_that_one_in_vain_does_not_stop_the_others():
    mesh = tangled(BASE, (10.0, 10.0))
    # Two neighbours on the lower boundary have passed each other: with a fixed boundary nothing mends that.
    points = mesh.points.clone()
    lower = ((points[:, 1] == points[:, 1].min()) & mesh.fixed).nonzero().squeeze(1)
    lower = lower[points[lower, 0].argsort()][20:22]
    points[lower] = points[lower.flip(0)]
    mesh = mesh.with_points(points)
    better, report = improve(mesh, damage())
    left = quality(better)
    assert 0 < int(left.inverted[0]) <= 4
    bad = better.points[better.triangles[~left.upright]].mean(1)
    assert float((bad - points[lower].mean(0)).norm(dim=1).max()) < 3
    assert report.certified.tolist() == [False]


def test_a_place_beside_one_in_vain_is_mended_by_a_smaller_try():
    mesh = meshes.grid(7, 7)
    points = mesh.points.clone()
    # Two neighbours on the lower side have passed each other, and two vertices two rows above have gone astray.
    lower = ((points[:, 1] == 0) & (points[:, 0] > 0.2) & (points[:, 0] < 0.5)).nonzero().squeeze(1)
    points[lower] = points[lower.flip(0)]
    astray = [int((points - torch.tensor(p)).square().sum(1).argmin()) for p in ([2 / 7, 3 / 7], [5 / 7, 5 / 7])]
    points[astray] += torch.tensor([[0.2, 0.25], [-0.3, 0.2]], dtype=torch.float64)
    mesh = mesh.with_points(points)
    better, report = improve(mesh, damage())
    left = better.triangles[~quality(better).upright]
    assert 0 < len(left) < inverted(mesh)
    assert bool((left[:, :, None] == lower).any(1).all(1).any())
    assert not bool(torch.isin(left, torch.tensor(astray[1:])).any())
    assert report.status.tolist() == [tm.Status.PARTLY]


def test_a_part_grows_until_it_can_be_mended():
    hole = meshes.ring(24, 5)
    inner = torch.arange(len(hole.points)) < 24
    goal = hole.points + inner[:, None] * torch.tensor([0.75, 0.0], dtype=torch.float64)
    mesh = tm.femwarp(hole, goal)
    assert inverted(mesh) > 3
    _, report = improve(mesh, damage(damage=Damage(rings=1)))
    assert report.certified.tolist() == [True]
    assert [Damage().rings_at(tries) for tries in range(5)] == [2, 1, 4, 8, 16]
    assert [Damage(rings=1, growth=1.1).rings_at(tries) for tries in range(5)] == [1, 1, 2, 3, 4]


def test_a_batch_is_each_mesh_alone():
    parts = [
        tangled(BASE, (10.0, 10.0), (22.0, 6.0)),
        stretched(tangled(BASE, (12.0, 8.0))),
        meshes.grid(),
        meshes.jittered(),
    ]
    for topology in ("keep", "flip", "full"):
        options = damage(topology=topology, remesh=tm.RemeshOptions(max_rounds=3))
        whole, report = improve(tm.join(parts), options)
        for b, (mesh, joined) in enumerate(zip(parts, whole.split(), strict=True)):
            alone, its = improve(mesh, options)
            assert torch.equal(alone.points, joined.points)
            assert torch.equal(alone.triangles, joined.triangles)
            assert its.messages[0] == report.messages[b]
            assert [step.stage for step in its.steps[0]] == [step.stage for step in report.steps[b]]


@pytest.mark.parametrize("topology", ["flip", "full"])
def test_rows_of_the_report_are_about_whole_meshes(topology):
    mesh = tangled(BASE, (10.0, 10.0), (22.0, 6.0))
    seen = []
    better, report = improve(
        mesh, damage(topology=topology), observe=lambda name, batch: seen.append((name, quality(batch)))
    )
    assert [name for name, _ in seen] == [step.stage for step in report.steps[0]]
    for step, (_, q) in zip(report.steps[0], seen, strict=True):
        assert (step.inverted, step.max) == (int(q.inverted[0]), float(q.max[0]))
        assert step.mean == pytest.approx(float(q.mean[0]), rel=1e-12)
    assert seen[-1][1].inverted.tolist() == [0]
    assert torch.equal(report.quality.inverse_mean_ratio, quality(better).inverse_mean_ratio)


def aims(mesh: MeshBatch, undeformed: MeshBatch) -> dict[str, dict]:
    long = torch.tensor([[1.0, 0.0]], dtype=torch.float64)
    field = tm.MetricField.stretched(long.expand(len(mesh.points), 2), 4.0)
    function = tm.MetricField.stretched(lambda places: long.expand(len(places), 2), 4.0)
    return {
        "metric": {"smooth": tm.SmoothOptions(targets=field)},
        "function": {"smooth": tm.SmoothOptions(targets=function)},
        "metric full": {"smooth": tm.SmoothOptions(targets=field), "topology": "full"},
        "matrices": {"smooth": tm.SmoothOptions(targets=tm.target_from(undeformed)), "topology": "keep"},
        "reference": {"reference": undeformed},
        "reference full": {"reference": undeformed, "topology": "full"},
        "slide": {"boundary": "slide"},
        "fast": {"polish": None, "relocate": False, "smooth_rounds": 4},
    }


@pytest.mark.parametrize(
    "name", ["metric", "function", "metric full", "matrices", "reference", "reference full", "slide", "fast"]
)
def test_every_aim_is_served(name):
    undeformed = stretched(BASE)
    mesh = stretched(tangled(BASE, (10.0, 10.0), (20.0, 3.0)))
    better, report = improve(mesh, damage(**aims(mesh, undeformed)[name]))
    assert report.certified.tolist() == [True]
    assert 0 < int(report.moved[0]) <= len(mesh.points) / 6
    assert float(quality(better.with_points(better.points / STRETCH)).max[0]) < 1.6


def test_inserted_vertices_have_their_names_and_the_rest_its_bits():
    mesh = tangled(BASE, (10.0, 10.0), (22.0, 6.0))
    sizes = torch.full((len(mesh.points),), 0.4, dtype=torch.float64)
    better, report = improve(mesh, damage(topology="full", remesh=tm.RemeshOptions(sizes=sizes)))
    assert report.certified.tolist() == [True]
    mapped = report.vertex_map
    inserted = mapped.new_to_old < 0
    assert int(inserted.sum()) > 50
    assert int(report.remeshed.splits[0]) >= int(inserted.sum())
    kept = mapped.new_to_old[~inserted]
    # Kept vertices keep their order, and inserted ones come after them.
    assert torch.equal(kept, kept.sort().values)
    assert not bool(inserted[: len(kept)].any())
    assert int(report.moved[0]) < len(mesh.points) / 5
    assert torch.equal(better.fixed[: len(kept)], mesh.fixed[kept])
    weights = torch.zeros(len(better.points), dtype=torch.float64).index_add_(0, mapped.rows, mapped.weights)
    torch.testing.assert_close(weights, torch.ones_like(weights))


def test_what_cannot_be_is_refused_by_name():
    with pytest.raises(ValueError, match=r"ImproveOptions.scope must be 'all' or 'damage', not 'some'"):
        ImproveOptions(scope="some")
    with pytest.raises(ValueError, match=r"scope='damage' and remesh.split_boundary exclude each other"):
        damage(topology="full", remesh=tm.RemeshOptions(split_boundary=True))
    for name, value in (("worse", 1.0), ("stretched", 0.5), ("growth", 1.0), ("rings", 0), ("growths_for_shapes", -1)):
        with pytest.raises(ValueError, match=rf"Damage.{name} must"):
            Damage(**{name: value})
