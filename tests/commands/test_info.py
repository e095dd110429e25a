"""`torchmesh info`: what is in a file."""

import json

import meshes
import meshio
import numpy as np
from command_line import crossed, plate
from layered import round_body

from torchmesh import quality, write


def told(call, *arguments) -> tuple[int, dict]:
    done = call("info", *arguments, "--json")
    return done.status, json.loads(done.out)


def test_elements_groups_fields_and_regions(call):
    status, record = told(call, "channel.msh")
    assert status == 0
    assert record["format"] == "gmsh"
    assert record["elements"] == {"line": 12, "triangle": 96, "quad": 24}
    groups = {group["name"]: group for group in record["groups"]}
    assert groups["body"] | {"length": 0} == {
        "name": "body", "kind": "lines", "vertices": 12, "length": 0, "triangles": 0, "quads": 12,
    }  # fmt: skip
    assert groups["fluid"]["quads"] == 24
    assert record["regions"]["told_by"] == "cell data 'gmsh:physical' and 'gmsh:geometrical'"
    status, record = told(call, "plate.vtu")
    fields = {field["name"]: field for field in record["fields"]}
    assert (fields["displacement"]["components"], fields["displacement"]["maximum"]) == (3, 0.1)
    out = call("info", "channel.msh").out
    for word in ("elements: 12 line, 96 triangle, 24 quad", "units: the file states none", "body", "gmsh:physical"):
        assert word in out


def test_what_is_no_region_is_said(call, folder):
    points, triangles = meshes.grid_arrays(4, 4)
    rank = np.arange(len(triangles)) % 2
    meshio.Mesh(points, [("triangle", triangles)], cell_data={"rank": [rank]}).write(folder / "parts.vtu")
    assert told(call, "parts.vtu")[1]["regions"]["not_taken"] == ["rank"]
    assert told(call, "parts.vtu", "--regions", "rank")[1]["regions"]["count"] == 2


def test_layers_are_found(call, folder):
    write(folder / "body.vtu", round_body())
    assert "layer of" in told(call, "body.vtu")[1]["layers"]


def test_problems_are_told_and_the_exit_status_says_it(call, folder):
    status, record = told(call, "tangled.vtu")
    assert (status, record["inverted"]) == (1, int(quality(meshes.moved_hole()).inverted[0]))
    crossed().write(folder / "crossed.vtu")
    status, record = told(call, "crossed.vtu")
    assert status == 1
    assert "meet at about" in record["problems"][0]
    status, record = told(call, "nan.vtk")
    assert status == 2
    assert record["elements"]["triangle"] == 18
    assert "points row 5" in record["problems"][0]
    assert call("info", "empty.vtu").status == 2


def test_a_time_series_is_one(call):
    status, record = told(call, "run.xdmf")
    assert status == 1
    assert (record["steps"], record["times"]) == (3, [0.0, 1.0, 2.0])
    assert "time series: 3 steps, time 0 to 2" in call("info", "run.xdmf").out


def test_regions_of_quads_alone_are_counted(call, folder):
    points = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1.0]])
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4]])
    meshio.Mesh(points, [("quad", quads)], cell_data={"material": [np.array([1, 2])]}).write(folder / "two.vtu")
    status, record = told(call, "two.vtu")
    assert (status, record["regions"]["count"]) == (0, 2)


def test_folded_quads_count_as_inverted_and_the_exit_status_says_it(call, folder):
    points = np.array([[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1.0]])
    quads = np.array([[0, 1, 4, 3], [1, 2, 5, 4]])
    points[4] = 1.5, -0.5
    meshio.Mesh(points, [("quad", quads)]).write(folder / "folded.vtu")
    status, record = told(call, "folded.vtu")
    assert (status, record["inverted"]) == (1, 2)
    points[4] = 1, 1
    middles = [(points[a] + points[b]) / 2 for a, b in ((0, 1), (1, 4), (4, 3), (3, 0))]
    middles[1] = np.array([-0.5, 0.5])  # the corners are right, and a side runs through the opposite one
    rows = np.array([[0, 1, 4, 3, 6, 7, 8, 9]])
    meshio.Mesh(np.concatenate([points, middles]), [("quad8", rows)]).write(folder / "folded8.vtu")
    status, record = told(call, "folded8.vtu")
    assert (status, record["inverted"]) == (1, 1)


def test_layers_of_quads_are_found(call):
    assert "layer of 2 of quads at wall 'body', first height 0.5" in told(call, "channel.msh")[1]["layers"]


def test_a_field_with_nan_has_the_range_of_its_finite_values(call, folder):
    points, triangles = plate()
    values = np.arange(len(points), dtype=np.float64)
    values[[3, 5]] = np.nan, np.inf
    nothing = np.full(len(points), np.nan)
    meshio.Mesh(points, [("triangle", triangles)], point_data={"some": values, "none": nothing}).write(
        folder / "nan.vtu"
    )
    rows = [line.split() for line in call("info", "nan.vtu").out.splitlines()]
    last = str(len(points) - 1)
    assert ["some", "points", "float64", "1", "0", last, "2"] in rows
    assert ["none", "points", "float64", "1", str(len(points))] in rows
    found = json.loads(call("info", "nan.vtu", "--json").out)["fields"]
    assert [(f["minimum"], f["not_finite"]) for f in found] == [(0.0, 2), (None, len(points))]


def test_data_that_tells_triangles_from_quads_only_is_named(call, folder):
    """It is no border of regions, as blocks of one type of cells are none."""
    mesh = meshes.mixed(6, 5, 3)
    cells = [("triangle", mesh.triangles.numpy()), ("quad", mesh.quads.numpy())]
    for name, values, said in (("kinds", (1, 2), "differs between triangles and quads only"), ("same", (1, 1), "")):
        data = {"material": [np.full(len(block), v) for (_, block), v in zip(cells, values, strict=True)]}
        meshio.Mesh(np.pad(mesh.points.numpy(), ((0, 0), (0, 1))), cells, cell_data=data).write(folder / f"{name}.vtu")
        for done in (call("info", f"{name}.vtu"), call("improve", f"{name}.vtu", "out.vtu")):
            lines = [line for line in done.out.splitlines() if line.startswith("regions: 1")]
            assert (f"'material' {said}" in "".join(lines)) or not said
            assert said or not lines or "differs" not in lines[0]
