"""What `transfer` promises: exactness, conservation, no new extremes, bits, gradients, and joined equals alone."""

import dataclasses
import functools

import meshes
import numpy as np
import pytest
import torch

from torchmesh import ImproveOptions, InvalidMeshError, MeshBatch, improve, join, quality, transfer, transfer_matrix
from torchmesh.errors import MeshWarning

VALID = {
    "square": (meshes.jittered(9, 8, 0.12), meshes.scrambled(meshes.jittered(9, 8, 0.15, seed=4), 1)),
    "other counts": (meshes.jittered(9, 8, 0.12), meshes.jittered(7, 11, 0.12, seed=2)),
    "l-shape": (meshes.l_shape(3), meshes.l_shape(4)),
    "ring": (meshes.ring(), meshes.disturbed(meshes.ring(), 0.02, 3)),
}
TANGLED = {
    "square": meshes.jittered(9, 8, 0.6),
    "ring": meshes.disturbed(meshes.ring(), 0.12, 1),
    "hole": meshes.disturbed(MeshBatch.from_arrays(*meshes.holed_arrays()), 0.5, 1),
    "moved hole": meshes.moved_hole(),
}


@functools.cache
def improved(name: str) -> MeshBatch:
    """The valid mesh that a tangled one becomes."""
    after, report = improve(TANGLED[name])
    assert bool(report.valid.all())
    return after


def linear(mesh: MeshBatch) -> torch.Tensor:
    return 2 + 3 * mesh.points[:, 0] - mesh.points[:, 1]


def integral(mesh: MeshBatch, values: torch.Tensor) -> torch.Tensor:
    return (quality(mesh).area[:, None] * values).sum(0)


def field_in(mesh: MeshBatch, seed: int = 0) -> torch.Tensor:
    return torch.rand(len(mesh.triangles), 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize("name", VALID)
def test_the_integral_of_cell_values_is_kept_without_new_extremes(name):
    before, after = VALID[name]
    values = field_in(before)
    made, info = transfer(before, after, values, "triangles", report=True)
    torch.testing.assert_close(integral(after, made), integral(before, values), rtol=1e-12, atol=0)
    assert bool((made.amin(0) >= values.amin(0)).all() & (made.amax(0) <= values.amax(0)).all())
    for count in (info.outside, info.tangled, info.overshoots, info.uncovered, info.missed):
        assert count.tolist() == [0]


@pytest.mark.parametrize("name", TANGLED)
def test_signed_overlaps_keep_the_signed_sum_and_constants(name):
    """Also where folded triangles reach outside the domain, as where a boundary ran over the mesh."""
    before, after = TANGLED[name], improved(name)
    values = field_in(before)
    made, info = transfer(before, after, values, "triangles", report=True)
    scale = quality(before).area.abs().sum()
    assert (integral(after, made) - integral(before, values)).abs().max() < 1e-12 * scale
    ones = transfer(before, after, torch.ones(len(before.triangles), dtype=torch.float64), "triangles")
    assert (ones - 1).abs().max() < 1e-9
    assert info.tangled.tolist() == quality(before).inverted.tolist()
    beyond = ((made < values.amin(0)) | (made > values.amax(0))).any(1).sum()
    assert int(info.overshoots) >= int(beyond)


def test_overshoots_are_counted():
    """A fold: two upright triangles and an inverted one over the same place."""
    before = TANGLED["square"]
    _, info = transfer(before, improved("square"), field_in(before), "triangles", report=True)
    assert int(info.overshoots) > 0


def test_where_domains_differ_the_common_part_is_kept_and_the_rest_told():
    before = meshes.grid(4, 4)
    after = before.with_points(before.points + torch.tensor([0.25, 0.0], dtype=torch.float64))
    values = field_in(before)
    made, info = transfer(before, after, values, "triangles", report=True)
    middle = before.points[before.triangles].mean(1)
    common = integral(before, values * (middle[:, :1] > 0.25))
    inside = after.points[after.triangles].mean(1)[:, :1] < 1
    torch.testing.assert_close(integral(after, made * inside), common, rtol=1e-12, atol=0)
    assert info.outside.tolist() == [8]
    assert info.uncovered.item() == pytest.approx(0.25)
    assert info.missed.item() == pytest.approx(0.25)
    assert bool(made.isfinite().all())


@pytest.mark.parametrize("name", VALID)
def test_linear_functions_are_exact_on_valid_meshes(name):
    before, after = VALID[name]
    for method in ("linear", "conservative"):
        made = transfer(before, after, linear(before), method=method)
        assert (made - linear(after)).abs().max() < 1e-13, method


@pytest.mark.parametrize("name", ["square", "other counts", "l-shape"])
def test_a_projection_keeps_the_integral_of_point_values(name):
    before, after = VALID[name]
    values = torch.rand(len(before.points), 3, dtype=torch.float64)
    made = transfer(before, after, values, method="conservative")

    def whole(mesh, v):
        return (quality(mesh).area[:, None] * v[mesh.triangles].mean(1)).sum(0)

    torch.testing.assert_close(whole(after, made), whole(before, values), rtol=1e-12, atol=0)


def test_what_does_not_move_keeps_its_bits():
    """Also minus zero and NaN, which sums and products would change."""
    before = meshes.jittered(9, 8, 0.12)
    points = before.points.clone()
    moved = (~before.fixed).nonzero().squeeze(1)[:5]
    points[moved] += 0.01
    after = before.with_points(points)
    values = torch.randn(len(points), dtype=torch.float32)
    values[0], values[1] = -0.0, torch.nan
    made = transfer(before, after, values)
    assert made.dtype == torch.float32
    still = torch.ones(len(points), dtype=torch.bool)
    still[moved] = False
    assert made[still].numpy().tobytes() == values[still].numpy().tobytes()
    cells = torch.randn(len(before.triangles), dtype=torch.float32)
    same = ~torch.isin(before.triangles, moved).any(1)
    assert torch.equal(transfer(before, after, cells, "triangles")[same], cells[same])


def test_the_same_mesh_is_the_identity_whatever_the_values():
    mesh = TANGLED["square"]
    flags = torch.arange(len(mesh.points)) % 2 == 0
    assert torch.equal(transfer(mesh, mesh, flags), flags)
    assert torch.equal(transfer(mesh, mesh, linear(mesh)), linear(mesh))
    complex_values = torch.complex(linear(mesh), -linear(mesh))
    assert torch.equal(transfer(mesh, mesh, complex_values), complex_values)


def test_joined_equals_alone():
    before = [VALID["square"][0], TANGLED["ring"], VALID["l-shape"][0], TANGLED["square"], TANGLED["moved hole"]]
    after = [VALID["square"][1], improved("ring"), VALID["l-shape"][1], improved("square"),
             improve(TANGLED["moved hole"], ImproveOptions(topology="full"))[0]]  # fmt: skip
    for where, rows in (("points", "points"), ("triangles", "triangles")):
        values = [torch.rand(len(getattr(m, rows)), 2, dtype=torch.float64) for m in before]
        for method in ("linear", "nearest", "conservative"):
            made, info = transfer(join(before), join(after), torch.cat(values), where, method, report=True)
            parts = zip(before, after, values, strict=True)
            alone = [transfer(b, a, v, where, method, report=True) for b, a, v in parts]
            assert torch.equal(made, torch.cat([one for one, _ in alone])), (where, method)
            for f in dataclasses.fields(info):
                assert torch.equal(getattr(info, f.name), torch.cat([getattr(i, f.name) for _, i in alone])), f.name


@pytest.mark.parametrize("where", ["points", "triangles"])
def test_the_matrix_does_what_transfer_does(where):
    before, after = TANGLED["hole"], improved("hole")
    count = len(before.points if where == "points" else before.triangles)
    values = torch.rand(count, 2, dtype=torch.float64)
    matrix = transfer_matrix(before, after, where)
    assert matrix.shape == (len(after.points if where == "points" else after.triangles), count)
    torch.testing.assert_close(matrix @ values, transfer(before, after, values, where), rtol=0, atol=1e-13)


@pytest.mark.parametrize("method", ["linear", "nearest"])
def test_the_matrix_does_so_between_meshes_with_quads_too(method):
    points, triangles = meshes.grid_arrays(3, 2)
    quads, rest = np.array([[0, 3, 4, 1], [4, 7, 8, 5]]), []
    for row in triangles.tolist():
        if not any(set(row) <= set(quad) for quad in quads.tolist()):
            rest.append(row)
    mixed = MeshBatch.from_arrays(points, np.array(rest), quads=quads)
    inner = ~mixed.fixed
    moved = mixed.with_points(torch.where(inner[:, None], mixed.points + 0.07, mixed.points))
    plain = MeshBatch.from_arrays(points, triangles)
    for before, after in ((mixed, moved), (mixed, plain), (plain, mixed), (join([mixed, plain]), join([plain, moved]))):
        values = torch.rand(len(before.triangles) + len(before.quads), 2, dtype=torch.float64)
        matrix = transfer_matrix(before, after, "triangles", method)
        expected = transfer(before, after, values, "triangles", method)
        torch.testing.assert_close(matrix @ values, expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("where", "method"), [("points", "linear"), ("points", "conservative"), ("triangles", "linear")]
)
def test_gradients(where, method):
    before = meshes.jittered(3, 3, 0.1)
    after = meshes.jittered(4, 3, 0.1, seed=2)
    count = len(before.points if where == "points" else before.triangles)
    values = torch.rand(count, 2, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda v: transfer(before, after, v, where, method), values, atol=1e-7)


@pytest.mark.parametrize("where", ["points", "triangles"])
def test_moving_turning_and_renumbering_change_nothing(where):
    before, after = VALID["square"]
    values = torch.rand(len(before.points if where == "points" else before.triangles), dtype=torch.float64)
    plain = transfer(before, after, values, where)
    turned = [m.with_points(meshes.turned(m.points, 31.0) + 5) for m in (before, after)]
    torch.testing.assert_close(transfer(*turned, values, where), plain, rtol=0, atol=1e-11)
    scaled = [m.with_points(m.points * 2.0**40) for m in (before, after)]
    assert torch.equal(transfer(*scaled, values, where), plain)
    order = torch.randperm(len(before.triangles), generator=torch.Generator().manual_seed(1))
    other = before.with_triangles(before.triangles[order].roll(1, 1))
    given = values[order] if where == "triangles" else values
    torch.testing.assert_close(transfer(other, after, given, where), plain, rtol=0, atol=1e-13)


def test_nearest_copies():
    before, after = VALID["other counts"]
    names = torch.arange(len(before.points))
    found = transfer(before, after, names, method="nearest")
    distance = torch.cdist(after.points, before.points)
    torch.testing.assert_close(distance[torch.arange(len(found)), found], distance.amin(1), rtol=1e-12, atol=1e-15)
    for kind in (torch.uint16, torch.uint32, torch.int8, torch.bool):
        assert torch.equal(transfer(before, after, names.to(kind), method="nearest"), names.to(kind)[found])
    cells = transfer(before, after, torch.arange(len(before.triangles)), "triangles", "nearest")
    middles = after.points[after.triangles].mean(1)
    corners = before.points[before.triangles[cells]]
    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        left = (b - a)[:, 0] * (middles - a)[:, 1] - (b - a)[:, 1] * (middles - a)[:, 0]
        assert bool((left > -1e-14).all())


def test_bad_arguments_are_named():
    mesh = meshes.grid()
    with pytest.raises(InvalidMeshError, match="values must have 42 rows"):
        transfer(mesh, mesh, torch.zeros(3))
    with pytest.raises(InvalidMeshError, match="1 meshes before and 2 after"):
        transfer(mesh, join([mesh, mesh]), torch.zeros(42))
    with pytest.raises(ValueError, match="where must be"):
        transfer(mesh, mesh, torch.zeros(42), "cells")
    with pytest.raises(ValueError, match="method must be"):
        transfer(mesh, mesh, torch.zeros(42), method="cubic")
    with pytest.raises(ValueError, match="no sparse matrix"):
        transfer_matrix(mesh, mesh, method="conservative")
    with pytest.raises(InvalidMeshError, match="only method 'nearest' copies them"):
        transfer(mesh, meshes.grid(3, 3), torch.arange(42))
    bad = mesh.points.clone()
    bad[3] = torch.nan
    with pytest.raises(InvalidMeshError, match=r"after: mesh 0: points row 3 is \[nan, nan\]: not finite"):
        transfer(mesh, mesh.with_points(bad), torch.zeros(42))
    with pytest.raises(InvalidMeshError, match=r"before: mesh 1: points row 45 is \[nan, nan\]: not finite"):
        transfer(join([mesh, mesh.with_points(bad)]), join([mesh, mesh]), torch.zeros(84))
    for values in ("here", [[0.0], [1.0, 2.0]], None):
        with pytest.raises(InvalidMeshError, match="values are no rectangular array"):
            transfer(mesh, mesh, values)
    with pytest.raises(InvalidMeshError, match="values must have 42 rows"):
        transfer(mesh, mesh, 3.0)
    with pytest.raises(InvalidMeshError, match="is inverted, and a projection needs a valid mesh"):
        transfer(mesh, meshes.jittered(6, 5, 0.6), torch.zeros(42), method="conservative")


def test_unused_vertices_may_be_anything():
    """NaN or far outside: what belongs to triangles is as without them."""
    plain = [meshes.jittered(5, 5, 0.1), meshes.jittered(5, 5, 0.1, seed=3)]
    values = linear(plain[0])
    expected = transfer(*plain, values)
    for odd in (torch.nan, 1e200):
        more = []
        for mesh in plain:
            offsets = mesh.point_offsets + torch.tensor([0, 1])
            points = torch.cat([mesh.points, mesh.points.new_full((1, 2), odd)])
            fixed = torch.cat([mesh.fixed, torch.tensor([True])])
            more.append(dataclasses.replace(mesh, points=points, fixed=fixed, point_offsets=offsets))
        made = transfer(*more, torch.cat([values, values.new_tensor([7.0])]))
        assert torch.equal(made[:-1], expected)
        assert float(made[-1]) == 7


def test_unused_vertices_take_part():
    """A vertex of no triangle keeps its value where it is, under every method."""
    points, triangles = meshes.grid_arrays(3, 3)
    with pytest.warns(MeshWarning, match="belong to no triangle"):
        mesh = MeshBatch.from_arrays(np.concatenate([points, [[2.0, 2.0]]]), triangles)
    moved = mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, mesh.points + 0.05))
    for method in ("linear", "nearest", "conservative"):
        made = transfer(mesh, moved, linear(mesh), method=method)
        assert float(made[-1]) == pytest.approx(float(linear(mesh)[-1]), rel=1e-14)


@pytest.mark.parametrize("name", VALID)
@pytest.mark.parametrize("where", ["points", "triangles"])
def test_constants_are_kept_to_the_bit(name, where):
    """A sum of weights is off by a rounding error, the mean is not."""
    before, after = VALID[name]
    values = torch.full((len(before.points if where == "points" else before.triangles),), 1 / 3, dtype=torch.float64)
    made = transfer(before, after, values, where)
    assert torch.equal(made, torch.full_like(made, 1 / 3))


def test_a_projection_of_values_that_are_not_finite_is_refused_by_mesh():
    """It came back as zeros: each value of a projection depends on all values of the mesh."""
    before, after = (join(side) for side in zip(VALID["square"], VALID["ring"], strict=True))
    values = torch.ones(len(before.points), dtype=torch.float64)
    for bad in (torch.nan, torch.inf):
        values[-1] = bad
        with pytest.raises(InvalidMeshError, match="mesh 1: its values are not all finite"):
            transfer(before, after, values, method="conservative")


@pytest.mark.parametrize("where", ["points", "triangles"])
def test_infinite_values_stay_infinite(where):
    before, after = VALID["other counts"]
    values = torch.ones(len(before.points) if where == "points" else len(before.triangles), dtype=torch.float64)
    values[len(values) // 2] = -torch.inf
    found = transfer(before, after, values, where)
    assert bool((found == -torch.inf).any())
    assert not bool(found.isnan().any())


@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_a_mesh_is_covered_by_itself(scale):
    mesh = VALID["square"][0]
    mesh = mesh.with_points(mesh.points * scale)
    info = transfer(mesh, mesh, field_in(mesh), "triangles", report=True)[1]
    assert [int(info.moved), int(info.outside), float(info.uncovered), float(info.missed)] == [0, 0, 0, 0]


def test_a_batch_of_no_meshes_has_no_values():
    none = VALID["square"][0].select(torch.tensor([False]))
    for method in ("linear", "conservative", "nearest"):
        for where in ("points", "triangles"):
            assert transfer(none, none, torch.zeros(0, 2), where, method).shape == (0, 2)
