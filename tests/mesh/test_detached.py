"""Autograd, autocast and inference mode outside change no result, and nothing in it requires a gradient."""

import contextlib
from dataclasses import dataclass, fields, is_dataclass, replace

import meshes
import pytest
import torch

import torchmesh as tm
from torchmesh.mesh.detached import detached, without_autograd

# A few rounds of remeshing take every step of it.
FEW = tm.RemeshOptions(max_rounds=2)
VERBS = {
    "improve": lambda rest, tangled, valid: tm.improve(tangled),
    "keep": lambda rest, tangled, valid: tm.improve(tangled, tm.ImproveOptions(topology="keep", reference=rest)),
    "full": lambda rest, tangled, valid: tm.improve(tangled, tm.ImproveOptions(topology="full", remesh=FEW)),
    "slide": lambda rest, tangled, valid: tm.improve(tangled, tm.ImproveOptions(boundary="slide")),
    "paper": lambda rest, tangled, valid: tm.improve(tangled, tm.ImproveOptions.paper()),
    "sizes": lambda rest, tangled, valid: tm.improve(
        tangled, tm.ImproveOptions(remesh=tm.RemeshOptions(sizes=rest.points[:, 0].abs() + 1))
    ),
    "targets": lambda rest, tangled, valid: tm.smooth(valid, tm.SmoothOptions(targets=tm.target_from(rest))),
    "metric": lambda rest, tangled, valid: tm.smooth(valid, tm.SmoothOptions(targets=tm.metric_from(rest))),
    "untangle": lambda rest, tangled, valid: tm.untangle(tangled),
    "regularised": lambda rest, tangled, valid: tm.untangle(tangled, tm.UntangleOptions("regularised"), reference=rest),
    "smooth": lambda rest, tangled, valid: tm.smooth(valid, tm.SmoothOptions(single=True)),
    "flip": lambda rest, tangled, valid: tm.flip_to_delaunay(tangled),
    "polish": lambda rest, tangled, valid: tm.polish(valid),
    "remesh": lambda rest, tangled, valid: tm.remesh(valid, FEW),
    "relax": lambda rest, tangled, valid: tm.relax(tangled),
    "femwarp": lambda rest, tangled, valid: tm.femwarp(rest, tangled.points),
    "deform": lambda rest, tangled, valid: tm.deform(rest, tangled.points.detach()),
    "largest_step": lambda rest, tangled, valid: tm.largest_step(rest, tangled.points),
    "diagnose": lambda rest, tangled, valid: tm.diagnose(tangled, "keep"),
    "size_field": lambda rest, tangled, valid: tm.size_field(valid),
    "size_conformity": lambda rest, tangled, valid: tm.size_conformity(valid, "keep"),
    "transfer_matrix": lambda rest, tangled, valid: tm.transfer_matrix(rest, rest, where="points").to_dense(),
}


def tensors(value) -> list[torch.Tensor]:
    """All tensors in a result, but for the seconds of a report and the like."""
    if isinstance(value, torch.Tensor):
        return [value]
    if is_dataclass(value):
        return [t for f in fields(value) if not f.name.startswith("_") for t in tensors(getattr(value, f.name))]
    if isinstance(value, tuple | list):
        return [t for part in value for t in tensors(part)]
    return []


def graded(mesh: tm.MeshBatch) -> tm.MeshBatch:
    return replace(mesh, points=mesh.points.clone().requires_grad_())


def three(dtype: torch.dtype) -> tuple[tm.MeshBatch, ...]:
    rest = meshes.grid(5, 4).to(dtype)
    return rest, meshes.jittered(5, 4, 0.5, 0).to(dtype), rest


def halves() -> torch.autocast:
    return torch.autocast("cpu", dtype=torch.bfloat16)


@pytest.mark.parametrize("verb", VERBS)
@pytest.mark.parametrize("dtype", [torch.float32])  # autocast leaves double precision alone
def test_results_are_the_same_with_gradients_required_and_under_autocast(verb, dtype):
    run, given = VERBS[verb], three(dtype)
    expected = tensors(run(*given))
    with_grad = tuple(map(graded, given))
    with halves():
        found = tensors(run(*with_grad))
    assert len(found) == len(expected)
    for a, b in zip(found, expected, strict=True):
        # A warp is differentiable in the goal of its boundary.
        assert not a.requires_grad or (verb == "femwarp" and a is found[0])
        assert a.dtype == b.dtype
        assert torch.equal(a.nan_to_num(7.0), b.nan_to_num(7.0))
    if verb != "diagnose":
        assert expected


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_layers_and_their_gradients_are_the_same_under_autocast(dtype):
    rest, tangled, _ = three(dtype)

    def run(around) -> list[torch.Tensor]:
        out = []
        for layer, mesh in ((tm.nn.Smooth(), rest), (tm.nn.Untangle(), rest)):
            points = (rest if layer.__class__ is tm.nn.Smooth else tangled).points.clone().requires_grad_()
            with around:
                valid = layer(points, mesh)
            (valid * torch.arange(len(valid), dtype=dtype)[:, None]).sum().backward()
            assert layer.info.converged.all()
            out += [valid.detach(), points.grad]
        return out

    for a, b in zip(run(contextlib.nullcontext()), run(halves()), strict=True):
        assert torch.equal(a, b)


def test_layers_reach_the_minimum_in_inference_mode():
    """There autograd is off for good: second derivatives that are taken by it were zero."""
    rest = three(torch.float64)[0]
    expected = tm.nn.Smooth()(rest.points, rest)
    with torch.inference_mode():
        layer = tm.nn.Smooth()
        assert torch.equal(layer(rest.points, rest), expected)
    assert layer.info.converged.all()


def test_what_requires_no_gradient_stays_the_same_object():
    mesh = three(torch.float64)[0]
    options = tm.ImproveOptions(reference=mesh)
    for value in (mesh, options, [mesh, 1], {"a": mesh.points}, (mesh,), "text", None):
        assert detached(value) is value


def test_gradients_are_left_behind_however_deep():
    @dataclass(frozen=True)
    class Box:
        inside: object

    points = torch.ones(2, requires_grad=True)
    box = detached(Box([{"a": (points, Box(points))}]))
    (inner,) = box.inside
    assert not inner["a"][0].requires_grad
    assert not inner["a"][1].inside.requires_grad
    assert inner["a"][0].data_ptr() == points.data_ptr()


def test_a_function_of_the_caller_may_use_autograd_and_verbs_of_its_own():
    seen = []

    @without_autograd
    def outer(call):
        call()
        return torch.is_grad_enabled()

    @without_autograd
    def inner(points):
        seen.append(points.requires_grad)

    assert outer(lambda: inner(torch.ones(1, requires_grad=True))) is False
    assert seen == [False]
    assert torch.is_grad_enabled()
