"""Layers that were meant outlive the improvement of the mesh round them."""

import re

import pytest
import torch
from judges import assert_same_domain
from layered import first_heights, flat_layer, round_body, turned_body
from meshes import jittered

from torchmesh import ImproveOptions, MeshBatch, RemeshOptions, SmoothOptions, improve, join, quality, target_from
from torchmesh.layering.layers import find_layers

# A few rounds of remeshing take every step of it.
FEW = RemeshOptions(max_rounds=3)
TOPOLOGIES = {
    "flip": ImproveOptions(),
    "keep": ImproveOptions(topology="keep"),
    "full": ImproveOptions(topology="full", remesh=FEW),
    "slide": ImproveOptions(boundary="slide"),
}


def flat() -> MeshBatch:
    """Layers over a flat wall; the two highest rows are none."""
    return flat_layer(columns=6, rows=9, first=4e-3, growth=1.6)


def pushed() -> MeshBatch:
    """The same with one vertex above the layer pushed down: tangled."""
    mesh = flat()
    points = mesh.points.clone()
    points[3 + 7 * 8, 1] -= 0.2
    return mesh.with_points(points)


@pytest.mark.parametrize("options", TOPOLOGIES.values(), ids=TOPOLOGIES)
@pytest.mark.parametrize("tangled", [False, True], ids=["valid", "tangled"])
def test_a_layer_keeps_its_bits_and_the_rest_becomes_valid(options, tangled):
    mesh = pushed() if tangled else flat()
    out, report = improve(mesh, options)
    assert bool(report.certified[0])
    assert report.messages[0].endswith("; layer of 7 at the wall near (0.5, 0), first height 0.004: kept")
    held = find_layers(mesh).vertices(len(mesh.points)).nonzero().squeeze(1)
    new = held if report.vertex_map is None else report.vertex_map.old_to_new[held]
    assert torch.equal(out.points[new], mesh.points[held])
    # Vertices and edges are as free as they were.
    assert len(out.constrained_edges) == 0
    assert torch.equal(out.fixed[new], mesh.fixed[held])


@pytest.mark.parametrize("degrees", [5, 60])
@pytest.mark.parametrize("topology", ["flip", "keep", "full"])
def test_with_a_reference_layers_follow_a_body_that_turns(topology, degrees):
    mesh = round_body(first=1e-5, growth=2.2)
    moved = turned_body(mesh, 24, degrees, (0.1, 0.0))
    assert int(quality(moved).inverted[0]) > 0
    out, report = improve(moved, ImproveOptions(topology=topology, reference=mesh, remesh=FEW))
    assert bool(report.certified[0])
    assert torch.allclose(first_heights(out, 24), first_heights(mesh, 24), rtol=1e-6)
    assert re.search(r"layer of 8 at the wall near \(.*\), first height 1e-05: kept$", report.messages[0])


@pytest.mark.parametrize("topology", ["flip", "full"])
def test_a_layer_for_which_there_is_no_room_gives_way_row_by_row(topology):
    mesh = round_body(sides=24, rows=8, first=0.01, growth=1.5, around=2, far=2.0)
    found = find_layers(mesh)
    assert float(found.height.sum()) / 24 > 0.3
    # The wall comes within 0.1 of the outer boundary; its layer is higher than that.
    moved = turned_body(mesh, 24, 0.0, (0.9, 0.0))
    out, report = improve(moved, ImproveOptions(topology=topology, reference=mesh, remesh=FEW))
    assert bool(report.valid[0])
    assert_same_domain(moved, out)
    if report.vertex_map is not None:
        kept = report.vertex_map.old_to_new[:24]
        assert torch.equal(out.points[kept], moved.points[:24])
    assert [step.stage for step in report.steps[0]][-1] == "layers"
    assert "layer of 4 at" in report.messages[0] or "layer of 2 at" in report.messages[0]


def test_a_fault_elsewhere_does_not_cost_a_mesh_its_layers():
    """Two vertices of the outer boundary have changed places, which nothing mends while the boundary is fixed."""
    mesh = round_body(sides=16, rows=5, growth=2.0, around=3)
    points = mesh.points.clone()
    points[[-3, -4]] = points[[-4, -3]]
    moved = mesh.with_points(points)
    out, report = improve(moved)
    assert not bool(report.valid[0])
    held = find_layers(mesh).vertices(len(mesh.points))
    assert torch.equal(out.points[held], mesh.points[held])
    assert "kept" in report.messages[0]
    assert "not kept" not in report.messages[0]


def test_equilateral_shapes_and_targets_have_no_layers():
    mesh = pushed()
    for options in (
        ImproveOptions(shapes="equilateral", relocate=False, polish=None),
        ImproveOptions.paper(),
        ImproveOptions(topology="keep", smooth=SmoothOptions(targets=target_from(flat()))),
    ):
        _, report = improve(mesh, options)
        assert "layer" not in report.messages[0]
    with pytest.raises(ValueError, match=r"ImproveOptions\.shapes must be 'auto' or 'equilateral', not 'square'"):
        ImproveOptions(shapes="square")  # type: ignore[arg-type]


@pytest.mark.parametrize("topology", ["flip", "full"])
def test_joined_equals_alone_to_the_bit(topology):
    meshes = [jittered(), pushed(), round_body(sides=12, rows=4, growth=3.0, around=2)]
    options = ImproveOptions(topology=topology, workers=1, remesh=FEW)
    whole, _ = improve(join(meshes), options)
    for mesh, joined in zip(meshes, whole.split(), strict=True):
        alone, _ = improve(mesh, options)
        assert torch.equal(alone.points, joined.points)
        assert torch.equal(alone.triangles, joined.triangles)
        assert torch.equal(alone.fixed, joined.fixed)
        assert torch.equal(alone.constrained_edges, joined.constrained_edges)


def test_observers_see_the_mesh_as_free_as_it_was_given():
    mesh, seen = pushed(), []
    improve(mesh, observe=lambda stage, batch: seen.append((stage, batch)))
    assert len(seen) > 3
    assert all(torch.equal(batch.fixed, mesh.fixed) and not len(batch.constrained_edges) for _, batch in seen)
