"""A stage that raises on purpose: one mesh says so, the others come out of `improve` as alone, to the bit."""

import functools

import meshes
import pytest
import torch

import torchmesh as tm
from torchmesh import ImproveOptions, Status, improve, join
from torchmesh.diagnosing import diagnosis
from torchmesh.improving import ending, stages

# A module that is first imported while a function fails on purpose would keep that one.
from torchmesh.remeshing import relocation, remeshing  # noqa: F401
from torchmesh.smoothing import boundary_order, sliding
from torchmesh.untangling import averaging

# A few rounds of remeshing take every step of it.
FEW = tm.RemeshOptions(max_rounds=2)

# Where a stage or another part of the strategy does its work, the options under which it does, and its name.
PLACES = [
    (stages, "flip_to_delaunay", {}, "flip"),
    (averaging, "average", {}, "average"),
    (stages.smoothing, "smooth", {}, "smooth"),
    (stages.smoothing, "smooth", {"boundary": "slide"}, "smooth"),
    (stages.polishing, "polish", {}, "polish"),
    (diagnosis, "diagnose", {}, "diagnose"),
    (ending, "same_frame", {}, "certify"),
    (ending, "size_field", {"topology": "full", "remesh": FEW}, "sizes"),
    (ending, "size_conformity", {"topology": "full", "remesh": FEW}, "sizes"),
]


def given() -> list[tm.MeshBatch]:
    return [meshes.jittered(5, 4, 0.6, seed) for seed in (0, 1, 2)]


def same(a: tm.MeshBatch, b: tm.MeshBatch) -> bool:
    return torch.equal(a.points, b.points) and torch.equal(a.triangles, b.triangles)


@functools.cache
def improved_alone(options: ImproveOptions) -> list[tuple[tm.MeshBatch, tm.Report]]:
    """What becomes of the given meshes where nothing fails; each is alone."""
    return [improve(mesh, options) for mesh in given()]


@pytest.mark.parametrize(("module", "name", "options", "stage"), PLACES)
def test_an_error_inside_a_stage_becomes_the_status_of_its_mesh(monkeypatch, module, name, options, stage):
    options = ImproveOptions(workers=1, polish=tm.PolishOptions(ratio=1.01), **options)
    alone = improved_alone(options)
    # The boundary and the batch are the same: the guilty mesh is larger.
    guilty = given()[1].with_points(given()[1].points * 4)
    verb, calls = getattr(module, name), []

    def fails(batch, *args, **kwargs):
        if bool((batch.points > 2).any()):
            calls.append(len(batch))
            raise ZeroDivisionError("on purpose")
        return verb(batch, *args, **kwargs)

    monkeypatch.setattr(module, name, fails)
    after, report = improve(join([given()[0], guilty, given()[2]]), options)
    assert calls
    assert report.status[1] == Status.FAILED
    assert f"the stage {stage} failed: ZeroDivisionError: on purpose" in report.messages[1]
    assert report.messages[1].count(f"the stage {stage} failed") == 1
    parts = after.split()
    for b in (0, 2):
        mesh, own = alone[b]
        assert same(parts[b], mesh)
        assert report.status[b] == own.status[0]
        assert report.messages[b] == own.messages[0]
        assert report.certified[b] == own.certified[0]
        assert report.quality.mean[b] == own.quality.mean[0]
    # Another way is tried where one has failed.
    assert bool(report.valid[1]) == (int(tm.quality(after).inverted[1]) == 0)
    if stage in ("flip", "average", "diagnose", "certify", "polish", "sizes"):
        assert report.valid[1]
    assert report.certified[1] == (bool(report.valid[1]) and stage != "certify")


def test_failures_come_back_from_other_processes(monkeypatch):
    from torchmesh.improving import forked

    def fails(batch, *args, **kwargs):
        raise MemoryError

    monkeypatch.setattr(forked, "_LEAST", 10)
    monkeypatch.setattr(stages.smoothing, "smooth", fails)
    _, report = improve(join(given()), ImproveOptions(workers=2))
    assert report.status.tolist() == [Status.FAILED] * 3
    assert all("the stage smooth failed: MemoryError" in text for text in report.messages)


def test_what_is_wrong_with_the_options_is_raised_at_once():
    mesh = meshes.grid(5, 4)

    def wrong(points):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        improve(mesh, ImproveOptions(remesh=tm.RemeshOptions(sizes=wrong)))
    with pytest.raises(tm.InvalidMeshError, match="sizes must have shape"):
        improve(mesh, ImproveOptions(remesh=tm.RemeshOptions(sizes=torch.ones(3))))
    targets = torch.eye(2).expand(3, 2, 2)
    with pytest.raises(tm.InvalidMeshError, match="targets must be"):
        improve(mesh, ImproveOptions(topology="keep", smooth=tm.SmoothOptions(targets=targets)))


@pytest.mark.parametrize("place", ["fit_curves", "_side"])
def test_an_error_while_the_boundary_is_prepared_touches_one_mesh(monkeypatch, place):
    """The curves to slide along, and the order of straight sides, are found before any stage."""
    options = ImproveOptions(boundary="slide", workers=1)
    good = [folded(mesh) for mesh in given()]
    alone = [improve(mesh, options) for mesh in good]
    guilty = good[1].with_points(good[1].points * 4)
    module = sliding if place == "fit_curves" else boundary_order
    verb, calls = getattr(module, place), []

    def fails(points, *args, **kwargs):
        if bool((points > 2).any()):
            calls.append(len(points))
            raise IndexError("on purpose")
        return verb(points, *args, **kwargs)

    monkeypatch.setattr(module, place, fails)
    after, report = improve(join([good[0], guilty, good[2]]), options)
    assert calls
    stage = "curves" if place == "fit_curves" else "boundary order"
    assert report.status[1] == Status.FAILED
    assert f"the stage {stage} failed: IndexError: on purpose" in report.messages[1]
    parts = after.split()
    for b in (0, 2):
        assert same(parts[b], alone[b][0])
        assert report.status[b] == alone[b][1].status[0]
        assert report.messages[b] == alone[b][1].messages[0]
        assert report.moved[b] == alone[b][1].moved[0]
    if place == "fit_curves":
        valid = [meshes.grid(5, 4), meshes.grid(5, 4).with_points(meshes.grid(5, 4).points * 4), meshes.ring()]
        sliding_options = tm.SmoothOptions(boundary="slide")
        moved, info = tm.smooth(join(valid), sliding_options)
        assert info.status[1] == Status.FAILED
        assert torch.equal(moved.split()[1].points, valid[1].points)
        for b in (0, 2):
            assert torch.equal(moved.split()[b].points, tm.smooth(valid[b], sliding_options)[0].points)


def folded(mesh: tm.MeshBatch) -> tm.MeshBatch:
    """The mesh with two neighbours on its lower side exchanged."""
    low = (mesh.points[:, 1] == 0).nonzero().squeeze(1)
    low = low[mesh.points[low, 0].argsort()]
    points = mesh.points.clone()
    points[low[[1, 2]]] = points[low[[2, 1]]]
    return mesh.with_points(points)
