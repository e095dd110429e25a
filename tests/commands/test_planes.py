"""Planes and surfaces in space on the command line: options, lists and results are in the axes of the file."""

import meshes
import meshio
import numpy as np
import pytest
from command_line import is_one_clear_line, plate

AXES = {"x-y": [0, 1], "x-z": [0, 2], "y-z": [1, 2]}


def in_space(folder, points, triangles, name="wall.vtu"):
    meshio.Mesh(points, [("triangle", triangles)]).write(folder / name)
    return name


@pytest.mark.parametrize("plane", ["x-z", "y-z"])
@pytest.mark.parametrize("seen", [1, -1])
def test_moves_turns_boxes_and_lists_are_in_the_axes_of_the_file(call, folder, plane, seen):
    points, triangles = plate()
    space = np.zeros((len(points), 3))
    space[:, AXES[plane]] = points + np.array([3, 5])
    name = in_space(folder, space, triangles[:, ::seen])
    listed = call("warp", name, "--list").out
    one, two = plane.split("-")
    assert f"{one} from" in listed
    assert f"{two} to" in listed
    assert "5.3" in listed
    done = call("warp", name, "out.vtu", "--move", "hole:1:0.05,0.01", "--rotate", "2.9,4.9,4.1,5.01:10:3,5")
    assert done.status == 0
    assert "clockwise" not in done.err
    after = meshio.read(folder / "out.vtu").points
    hole = (np.abs(points - 0.5) < 0.21).all(1)
    expected = space[hole].copy()
    expected[:, AXES[plane]] += [0.05, 0.01]
    np.testing.assert_allclose(after[hole], expected, rtol=0, atol=1e-15)
    corner = (points == [1, 0]).all(1)
    turned = space[corner].copy()
    turned[:, AXES[plane]] = [3 + np.cos(np.radians(10)), 5 + np.sin(np.radians(10))]
    np.testing.assert_allclose(after[corner], turned, rtol=0, atol=1e-14)
    across = ({0, 1, 2} - set(AXES[plane])).pop()
    assert (after[:, across] == 0).all()


@pytest.mark.parametrize("seen", [1, -1])
def test_a_tilted_plane_is_moved_by_vectors_of_the_file(call, folder, seen):
    points, triangles = plate()
    x, y = points.T
    name = in_space(folder, np.stack([x, y, 0.5 * x - 0.25 * y + 2], 1), triangles[:, ::seen])
    before = meshio.read(folder / name).points
    hole = (np.abs(points - 0.5) < 0.21).all(1)
    for vector in ("0.04,0.02", "0.04,0.02,0.015"):
        assert call("warp", name, "out.vtu", "--move", f"hole:1:{vector}").status == 0
        step = meshio.read(folder / "out.vtu").points - before
        np.testing.assert_allclose(step[hole], [[0.04, 0.02, 0.015]] * hole.sum(), rtol=0, atol=1e-14)
    row = next(line for line in call("warp", name, "--list").out.splitlines() if "hole:1" in line)
    assert row.split()[2:6] == ["0.3", "0.7", "0.3", "0.7"]
    assert is_one_clear_line(call("warp", name, "out.vtu", "--move", "hole:1:0.04,0.02,0.5"), "leaves the plane")
    assert call("warp", name, "out.vtu", "--rotate", "0.9,-0.1,1.1,0.05:20:0,0").status == 0
    step = meshio.read(folder / "out.vtu").points[(points == [1, 0]).all(1)] - before[(points == [1, 0]).all(1)]
    assert step[0, 1] > 0.2  # counter-clockwise, as x and y are seen


def test_the_command_line_takes_the_choice_of_heights(call, folder):
    done = call("improve", "terrain.vtk", "kept.vtk", "--height", "keep")
    assert done.status == 0, done.err
    before, after = meshio.read(folder / "terrain.vtk").points, meshio.read(folder / "kept.vtk").points
    assert (before[:, 2] == after[:, 2]).all()
    assert (before[:, :2] != after[:, :2]).any()


def test_improving_an_upright_plane_gives_what_improving_it_lying_gives(call, folder):
    mesh = meshes.moved_hole()
    points, triangles = mesh.points.numpy(), mesh.triangles.numpy()
    in_space(folder, np.insert(points, 1, 0.5, axis=1), triangles)
    in_space(folder, np.insert(points, 2, 0.5, axis=1), triangles, "floor.vtu")
    assert call("improve", "wall.vtu", "a.vtu").status == 0
    assert call("improve", "floor.vtu", "b.vtu").status == 0
    a, b = meshio.read(folder / "a.vtu"), meshio.read(folder / "b.vtu")
    assert (a.points == b.points[:, [0, 2, 1]]).all()
    assert (a.cells_dict["triangle"] == b.cells_dict["triangle"]).all()


def test_messages_tell_positions_in_space(call, folder):
    points, triangles = meshes.grid_arrays(6, 6)
    points[0] = 1.4  # pulled through the opposite corner: the boundary crosses itself
    in_space(folder, np.insert(points, 1, 7.0, axis=1), triangles)
    done = call("improve", "wall.vtu", "out.vtu")
    assert done.status == 1
    assert ", 7, " in done.err


def test_every_command_that_writes_takes_the_choice_of_heights(call, folder):
    """Heights that ride are those of the file, and those read from the surface are others where a vertex has moved."""
    assert call("improve", "terrain.vtk", "flat.vtk", "--quiet").status == 0
    for k, command in enumerate(
        (
            ("report", "terrain.vtk", "{out}", "page.html", "--no-stages"),
            ("warp", "flat.vtk", "{out}", "--move", "hole:1:0.03,0"),
            ("warp", "flat.vtk", "{out}", "--move", "hole:1:0.03,0", "--steps", "auto"),
        )
    ):
        heights = {}
        for choice in ("keep", "interpolate"):
            out = f"{choice}-{k}.vtk"
            done = call(*(word.format(out=out) for word in command), "--height", choice, "--quiet")
            assert done.status == 0, done.err
            heights[choice] = meshio.read(folder / out).points
        given = meshio.read(folder / command[1]).points
        moved = (heights["keep"][:, :2] != given[:, :2]).any(1)
        assert moved.any()
        assert np.array_equal(heights["keep"][:, 2], given[:, 2]), command
        assert not np.array_equal(heights["interpolate"][moved, 2], given[moved, 2]), command
