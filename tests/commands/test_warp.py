"""`torchmesh warp`: how the boundary and the interior move, at once and in steps."""

from pathlib import Path

import meshes
import meshio
import numpy as np
import pytest
from command_line import channel, inverted, is_one_clear_line, plate

from torchmesh import MeshBatch, read, write


def test_warp_lists_the_parts_of_the_boundary(call):
    done = call("warp", "plate.msh", "--list")
    assert (done.status, done.err) == (0, "")
    rows = [line.split() for line in done.out.splitlines()]
    assert ["outer:1", "40", "0", "1", "0", "1", "4", "loop", "40", "triangles"] in rows
    assert ["hole:1", "16", "0.3", "0.7", "0.3", "0.7", "1.6", "loop", "16", "triangles"] in rows


def moved(folder: Path) -> np.ndarray:
    """(V, 2) how far each vertex of plate.msh went on its way to out.vtu."""
    return (read(folder / "out.vtu").points - read(folder / "plate.msh").points).numpy()


def parts() -> tuple[np.ndarray, np.ndarray]:
    """(V,) bool each: the vertices of the hole, and those of the outer loop."""
    points, _ = plate()
    return np.abs(points - 0.5).max(1) < 0.21, np.abs(points - 0.5).max(1) > 0.49


def test_warp_moves_a_hole_and_carries_the_interior_along(call, folder):
    done = call("warp", "plate.msh", "out.vtu", "--move", "hole:1:0.1,0.05")
    assert (done.status, done.err) == (0, "")
    by, (hole, outer) = moved(folder), parts()
    assert by[hole] == pytest.approx(np.tile([0.1, 0.05], (16, 1)))
    assert (by[outer] == 0).all()
    between = by[~hole & ~outer]
    assert (between[:, 0] > 0).all()
    assert (between[:, 0] < 0.1).all()
    assert (read(folder / "out.vtu").triangles == read(folder / "plate.msh").triangles).all()


def test_warp_turns_about_the_middle_or_a_point(call, folder):
    points, (hole, _) = plate()[0], parts()
    assert call("warp", "plate.msh", "out.vtu", "--rotate", "hole:1:90").status == 0
    x, y = points[hole].T - 0.5
    assert points[hole] + moved(folder)[hole] == pytest.approx(np.stack([0.5 - y, 0.5 + x], 1))
    assert call("warp", "plate.msh", "out.vtu", "--rotate", "hole:1:90:0.5,0.4").status == 0
    x, y = (points[hole] - [0.5, 0.4]).T
    assert points[hole] + moved(folder)[hole] == pytest.approx(np.stack([0.5 - y, 0.4 + x], 1))


def test_warp_moves_what_lies_in_a_box_and_moves_add_up(call, folder):
    box = ["--move", "-1,-1,0.001,2:-0.1,0", "--move", "outer:1:0,0.2"]
    assert call("warp", "plate.msh", "out.vtu", *box).status == 0
    points, (hole, outer) = plate()[0], parts()
    left = points[:, 0] == 0
    by = moved(folder)
    assert by[left] == pytest.approx(np.tile([-0.1, 0.2], (11, 1)))
    assert by[outer & ~left] == pytest.approx(np.tile([0.0, 0.2], (29, 1)))
    assert (by[hole] == 0).all()


def test_warp_by_a_point_field(call, folder):
    assert call("warp", "plate.vtu", "out.vtu", "--displacement", "displacement").status == 0
    hole, outer = parts()
    assert moved(folder)[hole] == pytest.approx(np.tile([0.1, 0.05], (16, 1)))
    assert (moved(folder)[outer] == 0).all()


def test_a_warp_that_tangles_says_how_much_and_improve_mends_it(call, folder):
    far = ["--move", "hole:1:0.2,0", "--rotate", "hole:1:45"]
    done = call("warp", "plate.msh", "out.vtu", *far)
    count = inverted(folder / "out.vtu")
    assert count > 0
    assert done.status == 0, "warp does not promise a valid mesh"
    assert done.err == f"{count} inverted triangles in out.vtu; to mend: torchmesh improve out.vtu OUT\n"
    done = call("warp", "plate.msh", "out.vtu", *far, "--improve")
    assert (done.status, done.err) == (0, "")
    assert inverted(folder / "out.vtu") == 0
    assert [word in done.out for word in ("undeformed", "warped", "improved")] == [True] * 3


@pytest.mark.parametrize("steps", ["auto", "3"])
def test_a_warp_in_steps_never_tangles(call, folder, steps):
    done = call("warp", "plate.msh", "out.vtu", "--rotate", "hole:1:180", "--move", "hole:1:0.1,0", "--steps", steps)
    assert (done.status, done.err) == (0, "")
    assert inverted(folder / "out.vtu") == 0
    assert "arrived in" in done.out
    assert [word in done.out for word in ("undeformed", "deformed")] == [True] * 2
    hole, outer = parts()
    points = plate()[0]
    assert points[hole] + moved(folder)[hole] == pytest.approx(1 - points[hole] + [0.1, 0.0])
    assert (moved(folder)[outer] == 0).all()


def test_a_warp_in_steps_stops_at_the_wall(call, folder):
    done = call("warp", "plate.msh", "out.vtu", "--move", "hole:1:2,0", "--steps", "auto", "-q")
    assert done.status == 1
    assert done.out == ""
    assert done.err.startswith("not at the goal: out.vtu is valid, but stuck after ")
    assert "outside the outer loop" in done.err
    assert inverted(folder / "out.vtu") == 0


def test_bad_steps_are_usage_errors(call):
    for steps in ("0", "-1", "many", "1.5", ""):
        done = call("warp", "plate.msh", "out.vtu", "--move", "hole:1:0.1,0", f"--steps={steps}")
        assert done.status == 2
        assert "expected auto or a number of steps" in done.err
    done = call("warp", "plate.msh", "out.vtu", "--move", "hole:1:0.1,0", "--steps", "2", "--improve")
    assert done.status == 2
    assert "--improve" in done.err


def test_warp_by_a_point_field_in_a_plane_of_space(call, folder):
    points, triangles = plate()
    wall = np.pad(points, ((0, 0), (1, 0)), constant_values=7.0)
    hole, outer = parts()
    fields = {"along": hole[:, None] * [0.0, 0.1, 0.05], "out": hole[:, None] * [0.1, 0.0, 0.05]}
    meshio.Mesh(wall, [("triangle", triangles)], point_data=fields).write(folder / "wall.vtu")
    assert call("warp", "wall.vtu", "out.vtu", "--displacement", "along").status == 0
    by = meshio.read(folder / "out.vtu").points - wall
    assert by[hole] == pytest.approx(np.tile([0.0, 0.1, 0.05], (16, 1)), abs=1e-12)
    assert by[outer] == pytest.approx(0)
    done = call("warp", "wall.vtu", "out.vtu", "--displacement", "out")
    assert is_one_clear_line(done, "it leaves the plane")


def test_warp_carries_what_is_near_a_part_as_one_body(call, folder):
    args = ["--rotate", "hole:1:40", "--move", "hole:1:0.05,0", "--steps", "auto"]
    done = call("warp", "plate.msh", "out.vtu", *args, "--rigid", "hole:1:0.12")
    assert (done.status, done.err) == (0, "")
    points, (hole, outer) = plate()[0], parts()
    near = (np.abs(points - 0.5).max(1) < 0.2 + 0.12) & ~outer
    body = hole | (near & (np.linalg.norm(np.maximum(np.abs(points - 0.5) - 0.2, 0), axis=1) <= 0.12))
    assert body.sum() > hole.sum()
    angle = np.radians(40)
    x, y = (points[body] - 0.5).T
    turned = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], 1)
    assert points[body] + moved(folder)[body] == pytest.approx(turned + 0.5 + [0.05, 0.0], abs=1e-12)
    assert inverted(folder / "out.vtu") == 0


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (["--rigid", "hole:1:0.1"], "--rigid goes with --steps"),
        (["--rigid", "hole:1", "--steps", "auto"], "expected hole:N:DISTANCE"),
        (["--rigid", "hole:1:-1", "--steps", "auto"], "must be positive"),
        (["--rigid", "hole:1:1e-9", "--steps", "auto"], "no free vertex"),
    ],
)
def test_warp_refuses_bodies_that_are_none(call, wrong, said):
    done = call("warp", "plate.msh", "out.vtu", "--move", "hole:1:0.1,0", *wrong)
    assert is_one_clear_line(done, said)


def cells_of(path: Path, kind: str) -> np.ndarray:
    return np.concatenate([block.data for block in meshio.read(path).cells if block.type == kind])


def test_a_part_of_the_file_moves_by_its_name_with_its_layers_of_quads(call, folder):
    given = meshio.read(folder / "channel.msh")
    quads = np.unique(cells_of(folder / "channel.msh", "quad"))
    assert call("warp", "channel.msh", "out.msh", "--move", "body:0.2,0.1").status == 0
    by = meshio.read(folder / "out.msh").points - given.points
    assert by[quads] == pytest.approx(np.tile([0.2, 0.1, 0], (len(quads), 1)))
    assert call("warp", "channel.msh", "out.msh", "--rotate", "body:30").status == 0
    turned = meshio.read(folder / "out.msh").points
    assert np.linalg.norm(turned[quads], axis=1) == pytest.approx(np.linalg.norm(given.points[quads], axis=1))
    assert np.linalg.norm(turned[quads] - given.points[quads], axis=1).min() > 0.4
    # A larger hole pushes its layers outwards, and these keep their heights.
    assert call("warp", "channel.msh", "out.msh", "--scale", "body:1.2").status == 0
    scaled = np.linalg.norm(meshio.read(folder / "out.msh").points[quads], axis=1)
    assert scaled - np.linalg.norm(given.points[quads], axis=1) == pytest.approx(0.2)


@pytest.mark.parametrize("quads", [2, 6])
@pytest.mark.parametrize("part", ["body", "hole:1", "-1.1,-1.1,1.1,1.1"])
def test_what_is_near_a_wall_of_quads_is_carried_as_one_body(call, folder, part, quads):
    """Layers of quads that go along anyway, and quads that go through to another boundary."""
    channel(quads=quads).write(folder / "q.msh", file_format="gmsh22", binary=False)
    given = meshio.read(folder / "q.msh").points
    from_the_middle = np.linalg.norm(given, axis=1)
    args = ["--rotate", f"{part}:20", "--move", f"{part}:0.1,0", "--steps", "auto", "-q"]
    for distance in (0.6, 1.6):
        done = call("warp", "q.msh", "out.msh", *args, "--rigid", f"{part}:{distance}")
        assert (done.status, done.out, done.err) == (0, "", "")
        body = from_the_middle < 1 + distance
        assert body.sum() > 12
        c, s = np.cos(np.radians(20)), np.sin(np.radians(20))
        goal = given[:, :2] @ np.array([[c, s], [-s, c]]) + [0.1, 0.0]
        off = np.abs(meshio.read(folder / "out.msh").points[:, :2] - goal).max(1)
        assert off[body].max() < 1e-12


def shaken(folder: Path, **motion) -> meshio.Mesh:
    """plate.vtu with vertices that are in need of smoothing, and fields of which the values are known."""
    given = meshio.read(folder / "plate.vtu")
    hole, outer = parts()
    free = ~hole & ~outer
    given.points[free, :2] += np.random.default_rng(0).uniform(-0.02, 0.02, (free.sum(), 2))
    given.point_data = {"x": given.points[:, 0].copy(), "number": np.arange(len(given.points))}
    given.cell_data = {"one": [np.ones(len(given.cells[0].data))]}
    given.write(folder / "fields.vtu")
    return given


@pytest.mark.parametrize("way", [["--steps", "auto"], ["--steps", "3"], ["--improve"]])
def test_values_ride_with_the_boundary_and_keep_their_places_where_vertices_are_smoothed(call, folder, way):
    given = shaken(folder)
    move = ["--move", "hole:1:0.000001,0"]
    done = call("warp", "fields.vtu", "out.vtu", *move, *way)
    assert (done.status, done.err) == (0, "")
    assert done.out.splitlines()[-1] == "fields: 1 point field interpolated, 1 cell field averaged over overlaps"
    made = meshio.read(folder / "out.vtu")
    assert np.abs(made.points - given.points).max() > 1e-3, "vertices were smoothed"
    assert np.abs(made.point_data["x"] - made.points[:, 0]).max() < 2e-6
    assert np.abs(made.cell_data["one"][0] - 1).max() < 1e-12
    assert (made.point_data["number"] == np.arange(len(made.points))).all()
    done = call("warp", "fields.vtu", "out.vtu", *move, *way, "--fields", "drop")
    assert done.out.splitlines()[-1] == "fields: dropped: one, x"
    assert set(meshio.read(folder / "out.vtu").point_data) == {"number"}
    assert "fields:" not in call("warp", "fields.vtu", "out.vtu", *move, *way, "--fields", "carry").out
    assert (meshio.read(folder / "out.vtu").point_data["x"] == given.point_data["x"]).all()


def test_a_warp_alone_moves_nothing_but_the_material_and_its_values(call, folder):
    given = shaken(folder)
    done = call("warp", "fields.vtu", "out.vtu", "--move", "hole:1:0.05,0")
    assert (done.status, done.err) == (0, "")
    assert "fields:" not in done.out
    made = meshio.read(folder / "out.vtu")
    assert (made.point_data["x"] == given.point_data["x"]).all()
    assert (made.cell_data["one"][0] == 1).all()


def test_scales_for_each_axis_and_from_a_point(call, folder):
    points, (hole, _) = plate()[0], parts()
    assert call("warp", "plate.msh", "out.vtu", "--scale", "hole:1:1.2,0.9").status == 0
    assert points[hole] + moved(folder)[hole] == pytest.approx(0.5 + (points[hole] - 0.5) * [1.2, 0.9])
    assert call("warp", "plate.msh", "out.vtu", "--scale", "hole:1:1.1:0.3,0.3").status == 0
    assert points[hole] + moved(folder)[hole] == pytest.approx(0.3 + (points[hole] - 0.3) * 1.1)
    for wrong, text in (
        ("hole:1", "expected hole:N:FACTOR"),
        ("hole:1:-1", "must be positive"),
        ("hole:1:a", "'a' is"),
    ):
        assert is_one_clear_line(call("warp", "plate.msh", "out.vtu", "--scale", wrong), text)


def test_the_list_says_what_lies_on_each_part(call, folder):
    rows = [line.split() for line in call("warp", "channel.msh", "--list").out.splitlines()]
    row = next(row for row in rows if row[:1] == ["body"])
    assert row[1] == "12"
    assert row[7:] == ["lines", "12", "quads;", "24", "vertices", "of", "layers", "go", "along"]
    assert is_one_clear_line(call("warp", "channel.msh", "x.msh", "--move", "bodie:1,0"), "only outer:1, hole:1, body")


def test_what_a_failed_improvement_advises_is_an_option_of_warp(call, folder):
    """An interface round a hole, over which the hole moves."""
    points, triangles = meshes.ring_arrays(32, 8, 0.4, 1.6)
    radius = np.linalg.norm(points, axis=1)
    edges = np.unique(np.sort(np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]), 1), axis=0)
    edges = edges[(np.abs(radius - np.unique(radius.round(6))[2]) < 1e-5)[edges].all(1)]
    write(folder / "ring.msh", MeshBatch.from_arrays(points, triangles, constrained_edges=edges))
    move = ["--move", "hole:1:0.9,0"]
    done = call("warp", "ring.msh", "out.msh", *move, "--improve", "-q")
    assert done.status == 1
    assert "(--interfaces free) lets them move" in done.err
    done = call("warp", "ring.msh", "out.msh", *move, "--improve", "--interfaces", "free", "-q")
    assert (done.status, done.out, done.err) == (0, "", "")
    for more in (["--interfaces", "free"], ["--quads", "split"], ["--interfaces", "free", "--steps", "2"]):
        assert is_one_clear_line(call("warp", "ring.msh", "out.msh", *move, *more), "go with --improve")
