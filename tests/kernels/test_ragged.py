"""Rows found, taken, put, spread and counted, compiled, against their twins in torch: the same bits."""

import pytest
import torch
from both_loops import both, need_compiled_loops
from meshes import delaunay, grid, jittered, ring

from torchmesh import join
from torchmesh.kernels import library
from torchmesh.kernels import ragged as compiled
from torchmesh.mesh import connectivity, ragged
from torchmesh.mesh.batch import put
from torchmesh.mesh.detached import without_autograd
from torchmesh.mesh.means import Means

MANY = 5000


def batch():
    return join([ring(), delaunay(700, seed=1), jittered(cells=12.0), delaunay(1500, seed=2), grid(9, 8)])


def same(run):
    """What `run` gives, which is the same by both loops; inside a function of ours, where the loops may be used."""
    expected, got = both(without_autograd(run))
    for one, two in zip(expected, got, strict=True):
        assert one.dtype == two.dtype
        assert torch.equal(one, two)
    return got


def flags(generator, part):
    return torch.rand(MANY, generator=generator) < part


def test_the_rows_of_flags(generator):
    for part in (0.0, 0.01, 0.5, 1.0):
        mask = flags(generator, part)
        same(
            lambda m=mask: (
                ragged.true_rows(m),
                ragged.true_rows(m[3:]),
                ragged.true_rows(m[::2]),
                ragged.true_rows(m[:1]),
            )
        )


@pytest.mark.parametrize("dtype", [torch.bool, torch.float32, torch.float64, torch.int64])
@pytest.mark.parametrize("columns", [(), (1,), (2,), (3,), (2, 2), (5,)])
def test_rows_are_taken_and_put(generator, dtype, columns):
    values = (10 * torch.rand((MANY, *columns), generator=generator)).to(dtype)
    rows = torch.randperm(MANY, generator=generator)[: MANY - 7]
    part = values[torch.randint(0, MANY, (len(rows),), generator=generator)]
    same(lambda: (ragged.take(values, rows), ragged.put_rows(values, rows, part)))
    same(lambda: (ragged.take(values, rows[:0]), ragged.take(values, rows.flip(0)), ragged.take(values[:, None], rows)))


def test_rows_that_are_not_there_are_refused():
    need_compiled_loops()
    values = torch.zeros(MANY, 2)
    for row in (-1, MANY):
        rows = torch.zeros(MANY, dtype=torch.int64)
        rows[-1] = row
        with pytest.raises(IndexError, match=f"from 0 to {MANY - 1}"):
            compiled.take(values, rows)
        with pytest.raises(IndexError):
            compiled.put_rows(values, rows, values)


@pytest.mark.parametrize("choice", ["torch", "compiled"])
def test_what_does_not_fit_is_refused(choice):
    values, rows = torch.zeros(MANY, 2), torch.arange(MANY)
    if choice == "compiled":
        need_compiled_loops()

    @without_autograd
    def wrong():
        for part in (values[1:], values[:, :1], values.double()):
            with pytest.raises((RuntimeError, IndexError)):
                ragged.put_rows(values, rows, part)
        with pytest.raises(RuntimeError):
            ragged.spread(values[:3], torch.tensor([0, 2, MANY]))

    with library.using(choice):
        wrong()


def test_what_belongs_to_meshes(generator):
    mesh = batch()
    offsets, count = mesh.point_offsets, len(mesh)
    mask = torch.rand(len(mesh.points), generator=generator) < 0.3
    per_mesh = torch.rand(count, 2, generator=generator)
    by, some = torch.arange(count) * 100, torch.tensor([3, 0, 0, 4])
    same(lambda: (ragged.spread(per_mesh, offsets), ragged.spread(per_mesh[:, 0], offsets)))
    same(lambda: (ragged.segment_count(mask, offsets), ragged.segment_any(mask, offsets)))
    same(lambda: (ragged.rows_of_each(some, offsets), ragged.rows_of_each(some[:0], offsets)))
    same(lambda: (ragged.shifted(mesh.triangles, by, mesh.triangle_offsets),
                  ragged.shifted(mesh.twin, by, 3 * mesh.triangle_offsets)))  # fmt: skip


def test_meshes_are_taken_out_and_put_back():
    mesh = batch()
    at = torch.tensor([True, False, True, True, False])

    def run():
        part = mesh.select(at)
        part.twin  # noqa: B018
        back = put(mesh, at, part.with_points(2 * part.points))
        return part.points, part.triangles, part.twin, back.points, back.triangles, back.twin

    got = same(run)
    assert torch.equal(got[-1], connectivity.twins(mesh.triangles))


def test_who_touches_whom_and_means(generator):
    mesh = batch()
    vertices = torch.rand(len(mesh.points), generator=generator) < 0.1
    triangles = torch.rand(len(mesh.triangles), generator=generator) < 0.1
    size = torch.rand(len(mesh.points), generator=generator, dtype=torch.float64)

    def run():
        means = Means(mesh)
        at_triangles = means.of_corners(size)
        return at_triangles, means.round_vertices(at_triangles), means.of_corners(size.float())

    same(lambda: (connectivity.touching(mesh.triangles, vertices),
                  connectivity.corners_of(mesh.triangles, triangles, len(mesh.points))))  # fmt: skip
    same(run)


def test_outside_of_plain_functions_torch_does_the_work():
    values = torch.rand(MANY, 2, requires_grad=True)
    ragged.take(values, torch.arange(MANY)).sum().backward()
    assert torch.equal(values.grad, torch.ones(MANY, 2))
