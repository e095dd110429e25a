import json

import meshes
import pytest
import torch
from exact import inverted

from torchmesh import ImproveOptions, InvalidMeshError, MeshBatch, improve, join, quality
from torchmesh.improving.report import triangles_left


def collapsed(mesh: MeshBatch) -> MeshBatch:
    return mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, torch.zeros(2, dtype=torch.float64)))


def test_the_report_is_json_even_where_qualities_are_infinite():
    flat = collapsed(meshes.grid())
    assert quality(flat).max.item() == float("inf")
    _, report = improve(join([flat, meshes.moved_hole(), meshes.disc()]))
    records = report.to_dict()
    assert json.loads(json.dumps(records, allow_nan=False)) == records
    assert records[0]["steps"][0]["max"] is None
    assert [r["worked"] for r in records] == report.worked
    assert records[2]["worked"] == "initial"
    assert records[0]["worked"] == "average"
    for record in records:
        assert record["tried"] == list(dict.fromkeys(step["stage"] for step in record["steps"][1:]))


def test_the_report_counts_moves_flips_and_cavities():
    before = join([meshes.moved_hole(), meshes.moved_hole(12.0), meshes.equilateral()])
    after, report = improve(before)
    for b, (old, new) in enumerate(zip(before.split(), after.split(), strict=True)):
        assert report.moved[b].item() == int((old.points != new.points).any(1).sum())
        assert report.flipped[b].item() == sum(step.flips for step in report.steps[b])
        assert report.cavities[b].item() == sum(step.cavities for step in report.steps[b])
    assert report.moved[:2].min() > 0
    assert report.flipped[:2].min() > 0


def test_cavities_are_counted_where_nothing_else_helped():
    # Untangle-beta gets no step and so no chance.
    from torchmesh import UntangleOptions

    options = ImproveOptions(untangle=UntangleOptions("beta", max_iterations=1), untangle_rounds=1)
    after, report = improve(meshes.moved_hole(12.0), options)
    assert inverted(after) == 0
    assert report.worked == ["retriangulate"]
    assert report.cavities.item() > 0
    step = next(step for step in report.steps[0] if step.stage == "retriangulate")
    assert step.kept


def test_a_try_that_brought_nothing_is_marked():
    _, report = improve(meshes.moved_hole(12.0))
    relaxed = report.steps[0][1]
    assert relaxed.stage == "average"
    assert relaxed.kept == (relaxed.inverted < report.steps[0][0].inverted)


# --- with the undeformed mesh at hand ---


@pytest.mark.parametrize("topology", ["keep", "flip"])
@pytest.mark.parametrize("how", ["jittered", "collapsed", "shuffled"])
def test_a_reference_gives_back_the_undeformed_quality(how, topology):
    mesh = meshes.disc(14, 6)
    free = (~mesh.fixed).nonzero().squeeze(1)
    points = mesh.points.clone()
    if how == "jittered":
        tangled = meshes.disturbed(mesh, 0.4, 1)
    elif how == "collapsed":
        tangled = collapsed(mesh)
    else:
        points[free] = points[free[torch.randperm(len(free), generator=torch.Generator().manual_seed(0))]]
        tangled = mesh.with_points(points)
    assert inverted(tangled) > 0
    after, report = improve(tangled, ImproveOptions(topology=topology, reference=mesh))
    assert inverted(after) == 0
    assert report.worked == ["femwarp"]
    assert report.quality.mean.item() <= 1.01 * quality(mesh).mean.item()
    if topology == "keep":
        assert torch.equal(after.triangles, mesh.triangles)


def test_a_reference_in_a_batch_and_alone_to_the_bit():
    parts = [meshes.disc(), meshes.grid(), meshes.ring()]
    tangled = [meshes.disturbed(m, 0.3, 1) for m in parts]
    both, report = improve(join(tangled), ImproveOptions(reference=join(parts)))
    for m, t, together in zip(parts, tangled, both.split(), strict=True):
        alone, _ = improve(t, ImproveOptions(reference=m))
        assert torch.equal(alone.points, together.points)
    assert report.valid.all()


def test_a_reference_of_other_triangles_is_refused():
    with pytest.raises(InvalidMeshError, match="the reference has"):
        improve(meshes.jittered(), ImproveOptions(reference=meshes.grid(3, 3)))
    with pytest.raises(InvalidMeshError, match="inverted in the reference"):
        improve(meshes.jittered(), ImproveOptions(reference=meshes.jittered()))


def test_one_triangle_is_left_and_several_are():
    assert triangles_left(1) == "1 inverted triangle is left"
    assert triangles_left(2) == "2 inverted triangles are left"
