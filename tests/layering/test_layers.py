"""Layers are found where they are, and nowhere else."""

import pytest
import torch
from layered import flat_layer, heights, round_body
from meshes import delaunay, disc, equilateral, grid, l_shape, moved_hole

import torchmesh as tm
from torchmesh import MeshBatch, join
from torchmesh.layering.layers import LayerOptions, find_layers


def test_every_thin_row_over_a_straight_wall_is_found():
    mesh = flat_layer(columns=10, rows=16)
    found = find_layers(mesh)
    # A row of a wall of edges 0.1 is at most 0.05 high: 1e-4 1.6^13 is, and 1e-4 1.6^14 is not.
    assert int(found.row.max()) == 14
    assert torch.equal(torch.bincount(found.row), torch.tensor([0] + [10] * 14))
    step = torch.tensor(heights(16, 1e-4, 1.6)).diff()
    assert torch.allclose(found.height, step[found.row - 1], rtol=1e-12)
    assert sorted(found.vertices(len(mesh.points)).nonzero().squeeze(1).tolist()) == list(range(11, 15 * 11))


@pytest.mark.parametrize("first", [1e-6, 1e-3])
def test_layers_round_a_body_are_found_whichever_way_diagonals_lie(first):
    found = find_layers(round_body(sides=24, rows=6, first=first, growth=1.5))
    assert torch.equal(torch.bincount(found.row)[:7], torch.tensor([0] + [24] * 6))


def test_a_layer_on_both_sides_of_an_interface():
    above = flat_layer(columns=6, rows=5)
    count = len(above.points)
    mirrored = above.points * torch.tensor([1.0, -1.0])
    below = torch.where(above.triangles < 7, above.triangles, above.triangles + count - 7)
    points = torch.cat([above.points, mirrored[7:]])
    wall = torch.stack([torch.arange(6), torch.arange(1, 7)], 1)
    mesh = MeshBatch.from_arrays(points, torch.cat([above.triangles, below.flip(1)]), constrained_edges=wall)
    found = find_layers(mesh)
    assert torch.equal(torch.bincount(found.row), torch.tensor([0] + [12] * 5))
    # Without the interface there is no wall inside, and the rows at the other walls are high.
    assert len(find_layers(MeshBatch.from_arrays(points, mesh.triangles))) == 0


@pytest.mark.parametrize(
    "mesh",
    [grid(), delaunay(), disc(), l_shape(), equilateral(), moved_hole(), grid().with_points(grid().points * 0.01)],
    ids=["grid", "delaunay", "disc", "interface", "equilateral", "moved hole", "small"],
)
def test_no_layer_where_there_is_none(mesh):
    assert len(find_layers(mesh)) == 0


def test_what_a_deformation_flattens_is_no_layer():
    """The paper's three domains and a sample of every family, tangled."""
    cases = tm.domains.generate(18, triangles=600, seed=11).deformed
    assert len(find_layers(cases)) == 0


def test_strips_that_come_together_end_where_they_are_no_longer_thin():
    """Over six wall edges of 1, rows of height 0.1 whose quadrilaterals become narrower by 0.05 from row to row."""
    rows, columns = torch.meshgrid(torch.arange(21), torch.arange(7), indexing="ij")
    width = (1 - 0.05 * rows).clamp_min(0.05).double()
    points = torch.stack([(columns - 3) * width, 0.1 * rows.double()], 2).reshape(-1, 2)
    a = (7 * rows + columns)[:-1, :-1].reshape(-1)
    corners = torch.cat([torch.stack([a, a + 1, a + 8], 1), torch.stack([a, a + 8, a + 7], 1)])
    found = find_layers(MeshBatch.from_arrays(points, corners))
    # Row k is 1.025 - 0.05 k wide on average, and as long as that is 0.2 it is thin.
    assert torch.equal(torch.bincount(found.row), torch.tensor([0] + [6] * 16))


def test_triangles_that_a_motion_flattened_and_sheared_are_no_layer():
    """Before a bar at 45 degrees that moved stand strips of 1, 4, 7, 2 and 7 rows, too few and too uneven."""
    mesh = flat_layer(columns=9, rows=8, growth=1.3)
    points = mesh.points.clone()
    # Where a column leans by more than 60 degrees the strips at both its sides end.
    for column, row in ((2, 2), (5, 5), (7, 3)):
        points[column + 10 * row, 0] += 0.09
    assert len(find_layers(mesh.with_points(points))) == 0
    assert len(find_layers(flat_layer(columns=5, rows=8))) == 0
    assert len(find_layers(flat_layer(columns=6, rows=8))) == 48


def test_two_or_three_rows_that_a_motion_left_are_no_layer():
    assert len(find_layers(flat_layer(columns=9, rows=3, growth=1.3))) == 0
    assert int(find_layers(flat_layer(columns=9, rows=5, growth=1.3)).row.max()) == 5


def test_neighbours_that_differ_in_height_are_no_layer():
    mesh = flat_layer(columns=9, rows=5)
    points = mesh.points.clone()
    # Every other column is six times as high.
    points[1::2, 1] *= 6
    assert len(find_layers(mesh.with_points(points))) == 0


def test_a_layer_ends_below_an_inverted_triangle():
    mesh = flat_layer(columns=10, rows=16)
    points = mesh.points.clone()
    points[5 + 11 * 13, 1] -= 0.06
    rows = torch.zeros(10, dtype=torch.int64)
    found = find_layers(mesh.with_points(points))
    rows.scatter_reduce_(0, found.wall // 3, found.row, "amax")
    assert rows.tolist() == [14] * 4 + [12] * 2 + [14] * 4


def test_joined_equals_alone():
    meshes = [flat_layer(), delaunay(), round_body(), flat_layer(columns=5, rows=4)]
    whole = find_layers(join(meshes))
    corners, heights_alone, first = [], [], 0
    for mesh in meshes:
        alone = find_layers(mesh)
        corners += (alone.corners + first).tolist()
        heights_alone += alone.height.tolist()
        first += len(mesh.points)
    assert sorted(map(tuple, corners)) == sorted(map(tuple, whole.corners.tolist()))
    assert sorted(heights_alone) == sorted(whole.height.tolist())


def test_lower_rows_and_unbroken_strips():
    found = find_layers(flat_layer(columns=6, rows=10))
    assert int(found.row.max()) == 10
    assert int(found.up_to(0.25).row.max()) == 3
    good = ~((found.row == 5) & (found.wall == found.wall.min()))
    left = found.unbroken(good)
    assert len(left) == len(found) - 6
    assert int(left.row[left.wall == found.wall.min()].max()) == 4


def test_options_refuse_what_cannot_be():
    with pytest.raises(ValueError, match=r"LayerOptions\.first must be positive, not 0"):
        LayerOptions(first=0)
