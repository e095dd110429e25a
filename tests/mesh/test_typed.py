"""What is no mesh, and what are no options, is refused by name."""

import inspect

import meshes
import pytest
import torch

import torchmesh as tm

MESH = meshes.grid()


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (MESH.points, "not a Tensor: MeshBatch.from_arrays(points, triangles) makes one"),
        (MESH.points.numpy(), "not an ndarray: MeshBatch.from_arrays(points, triangles) makes one"),
        ([MESH, MESH], "not a list: join(meshes) makes one"),
        ("tangled.vtu", "not a str: read(path) makes one"),
        (None, "not None"),
        (tm.MeshBatch, "not <class 'torchmesh.mesh.batch.MeshBatch'>"),
    ],
)
def test_what_is_no_mesh_is_refused_and_how_to_get_one_is_said(value, said):
    for verb in (tm.improve, tm.quality, tm.untangle, tm.smooth, tm.femwarp, tm.deform):
        more = (MESH.points,) if verb in (tm.femwarp, tm.deform) else ()
        with pytest.raises(TypeError) as caught:
            verb(value, *more)
        assert str(caught.value) == f"{verb.__name__} expects a MeshBatch as batch=, {said}"


def test_every_public_function_looks_at_its_meshes():
    seen = 0
    for name in tm.__all__:
        verb = getattr(tm, name)
        if not inspect.isfunction(verb):
            continue
        parameters = list(inspect.signature(verb).parameters.values())
        for place, one in enumerate(parameters):
            if one.annotation is not tm.MeshBatch:
                continue
            seen += 1
            arguments = [MESH if p.annotation is tm.MeshBatch else 0 for p in parameters[:place]] + [MESH.points]
            rest = {p.name: 0 for p in parameters[place + 1 :] if p.default is inspect.Parameter.empty}
            with pytest.raises(TypeError, match=f"{name} expects a MeshBatch as {one.name}=, not a Tensor"):
                verb(*arguments, **rest)
    assert seen > 20


def test_options_of_another_function_are_refused():
    for call, said in (
        (lambda: tm.improve(MESH, {"topology": "keep"}), "improve expects ImproveOptions as options=, not a dict: "
         "ImproveOptions(**options)"),
        (lambda: tm.improve(MESH, tm.DeformOptions()),
         "improve expects ImproveOptions as options=, not a DeformOptions"),
        (lambda: tm.deform(MESH, MESH.points, options=tm.ImproveOptions()),
         "deform expects DeformOptions as options=, not an ImproveOptions"),
        (lambda: tm.untangle(MESH, options=3), "untangle expects UntangleOptions as options=, not an int"),
        (lambda: tm.DeformOptions(reference="undeformed.vtk"),
         "DeformOptions expects a MeshBatch as reference=, not a str: read(path) makes one"),
        (lambda: tm.ImproveOptions(smooth={}), "ImproveOptions expects SmoothOptions as smooth=, not a dict: "
         "SmoothOptions(**smooth)"),
        (lambda: tm.DeformOptions(improve=None), "DeformOptions expects ImproveOptions as improve=, not None"),
    ):  # fmt: skip
        with pytest.raises(TypeError) as caught:
            call()
        assert str(caught.value) == said


def test_join_looks_at_each_of_its_meshes():
    with pytest.raises(TypeError, match=r"join expects several MeshBatch, and among them not a Tensor: MeshBatch"):
        tm.join([MESH, MESH.points])
    with pytest.raises(TypeError, match=r"join expects several MeshBatch, not an int"):
        tm.join(5)


def test_none_is_taken_where_it_stands_for_the_default():
    assert torch.equal(tm.smooth(MESH, None)[0].points, tm.smooth(MESH)[0].points)
