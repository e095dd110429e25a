"""Fields of a file come out where the vertices are now; what names a vertex or moves it stays with the vertex."""

import warnings

import meshes
import meshio
import numpy as np
import pytest
from file_contents import load, save, triangle_data, warned

from torchmesh import ImproveOptions, InvalidMeshError, MeshBatch, improve, quality, read, read_series, write
from torchmesh.errors import MeshWarning
from torchmesh.files.field_transfer import FieldSummary, FieldTransfer, is_motion
from torchmesh.files.time_series import write_series

TOPOLOGIES = ("keep", "flip", "full")


def fields(seed: int = 0) -> meshio.Mesh:
    """A grid thrown about, valid with a quad beside it, with fields of all kinds."""
    n = 7
    x = np.arange(n) / (n - 1)
    points = np.array([[a, b, 0.0] for b in x for a in x])
    starts = [j * n + i for j in range(n - 1) for i in range(n - 1)]
    triangles = np.array([t for p in starts for t in ([p, p + 1, p + n + 1], [p, p + n + 1, p + n])])
    inner = ((points[:, :2] > 0) & (points[:, :2] < 1)).all(1)
    points[inner, :2] += np.random.default_rng(seed).uniform(-0.05, 0.05, (inner.sum(), 2))
    points = np.concatenate([points, [[1.2, 0, 0], [1.2, x[1], 0]]])
    quad = np.array([[n - 1, len(points) - 2, len(points) - 1, 2 * n - 1]])
    lines = np.stack([np.arange(n - 1), np.arange(1, n)], 1)
    rng = np.random.default_rng(1)
    count = len(triangles)
    return meshio.Mesh(
        points,
        [("line", lines), ("triangle", triangles), ("quad", quad)],
        point_data={
            "height": 1 + 2 * points[:, 0] - points[:, 1],
            "velocity": np.stack([points[:, 1], points[:, 0], 0 * points[:, 0]], 1).astype(np.float32),
            "displacement": rng.normal(size=points.shape),
            "id": np.arange(len(points)) + 100,
            "flag": (rng.random(len(points)) > 0.5).astype(np.int32),
        },
        cell_data={
            "one": [np.ones(len(lines)), np.ones(count), np.ones(1)],
            "density": [rng.random(len(lines)), rng.random(count), rng.random(1)],
            "number": [np.arange(len(lines)), np.arange(count) + 50, np.array([900])],
            # Too many different values to be regions, and no numbering.
            "grade": [np.zeros(len(lines), int), np.minimum(np.arange(count), count - 2), np.zeros(1, int)],
        },
    )


@pytest.fixture
def source(tmp_path):
    path = tmp_path / "in.vtu"
    fields().write(path)
    return path


def written(source, after: MeshBatch, report=None, **options) -> tuple[meshio.Mesh, str]:
    """What `write` makes of the file with another mesh, and what it warns of."""
    target = source.with_name("out.vtu")
    vertex_map = None if report is None else report.vertex_map
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", MeshWarning)
        write(target, after, like=source, vertex_map=vertex_map, **options)
    return load(target), " ".join(str(w.message) for w in said)


@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_interpolated_fields_are_right_where_vertices_are_now(source, topology):
    before = load(source)
    mesh = read(source)
    after, report = improve(mesh, ImproveOptions(topology=topology))
    made, said = written(source, after, report, fields="interpolate")
    x, y = made.points[:, 0], made.points[:, 1]
    np.testing.assert_allclose(made.point_data["height"], 1 + 2 * x - y, atol=1e-13)
    np.testing.assert_allclose(made.point_data["velocity"][:, :2], np.stack([y, x], 1), atol=1e-7)
    assert made.point_data["velocity"].dtype == np.float32
    assert [block.type for block in made.cells] == ["line", "triangle", "quad"]
    area, old_area = quality(after).area.numpy(), quality(mesh).area.numpy()
    np.testing.assert_allclose(triangle_data(made, "one"), 1, atol=1e-13)
    density, old = triangle_data(made, "density"), triangle_data(before, "density")
    assert density @ area == pytest.approx(old @ old_area, rel=1e-12)
    assert old.min() <= density.min() <= density.max() <= old.max()
    for block in (0, 2):
        np.testing.assert_array_equal(made.cell_data["density"][block], before.cell_data["density"][block])
    assert set(triangle_data(made, "grade")) <= set(triangle_data(before, "grade"))
    if topology == "full":
        assert "cell data 'number'" in said
    else:
        assert said == ""
        np.testing.assert_array_equal(triangle_data(made, "number"), triangle_data(before, "number"))


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("choice", ["interpolate", "carry", "drop"])
def test_what_names_a_vertex_or_moves_it_rides_with_it(source, topology, choice):
    before, mesh = load(source), read(source)
    after, report = improve(mesh, ImproveOptions(topology=topology))
    made, _ = written(source, after, report, fields=choice)
    new, old = np.arange(len(after.points)), np.arange(len(mesh.points))
    if report.vertex_map is not None:
        old = report.vertex_map.new_to_old.numpy()
        new = np.flatnonzero(old >= 0)
        old = old[new]
    for name in ("displacement", "id", "flag"):
        np.testing.assert_array_equal(made.point_data[name][new], before.point_data[name][old])


def test_carry_is_as_it_was_to_the_bit(source):
    before, mesh = load(source), read(source)
    after, _ = improve(mesh, ImproveOptions(topology="keep"))
    made, said = written(source, after)
    assert said == ""
    for name, values in before.point_data.items():
        np.testing.assert_array_equal(made.point_data[name], values)
    for name in before.cell_data:
        np.testing.assert_array_equal(triangle_data(made, name), triangle_data(before, name))


def test_drop_leaves_out_what_would_be_transferred(source):
    after, _ = improve(read(source), ImproveOptions(topology="keep"))
    made, _ = written(source, after, fields="drop")
    assert set(made.point_data) == {"displacement", "id", "flag"}
    assert set(made.cell_data) == {"number", "grade"}


@pytest.mark.parametrize("choice", ["interpolate", "carry", "drop"])
def test_a_mesh_that_did_not_change_keeps_every_field(source, choice):
    before = load(source)
    made, said = written(source, read(source), fields=choice)
    assert said == ""
    for name, values in before.point_data.items():
        np.testing.assert_array_equal(made.point_data[name], values)
    for name, blocks in before.cell_data.items():
        np.testing.assert_array_equal(np.concatenate(made.cell_data[name]), np.concatenate(blocks))


def test_values_are_those_of_the_mesh_before(source):
    """The file's values may belong to a mesh that has moved since: `before` says where its vertices are."""
    mesh = read(source)
    moved = mesh.with_points(mesh.points * 2 + 5)
    after, _ = improve(moved, ImproveOptions(topology="keep"))
    made, _ = written(source, after, fields="interpolate", before=moved)
    x, y = (made.points[:, :2].T - 5) / 2
    np.testing.assert_allclose(made.point_data["height"], 1 + 2 * x - y, atol=1e-12)
    with pytest.raises(InvalidMeshError, match="51 vertices and 72 triangles, but `before` has 1 meshes, 9 vertices"):
        written(source, after, fields="interpolate", before=meshes.grid(2, 2))


def test_other_kinds_of_numbers(tmp_path):
    """Big-endian, complex and half precision survive; NaN stays where it was."""
    mesh = fields()
    holes = mesh.point_data["height"].copy()
    holes[0] = np.nan
    mesh.point_data = {"height": mesh.point_data["height"].astype(">f8"), "holes": holes}
    mesh.cell_data = {}
    source = save(tmp_path / "in.vtk", mesh)
    given = read(source)
    after, _ = improve(given)
    write(tmp_path / "out.vtk", after, like=source, fields="interpolate")
    made = load(tmp_path / "out.vtk")
    assert np.isnan(made.point_data["holes"][0])
    x, y = made.points[:, 0], made.points[:, 1]
    np.testing.assert_allclose(made.point_data["height"], 1 + 2 * x - y, atol=1e-13)
    transfer = FieldTransfer(given, after)
    height = np.asarray(load(source).point_data["height"], np.float64)
    both = transfer.at_points("both", height + 2j * height, np.arange(len(height)))
    np.testing.assert_allclose(both, (1 + 2j) * (1 + 2 * x - y), atol=1e-12)
    half = transfer.at_points("half", height.astype(np.float16), np.arange(len(height)))
    assert half.dtype == np.float16


def test_a_series_transfers_each_step_and_says_what_it_did(tmp_path):
    import fields as coarse_fields

    steps = [coarse_fields.coarse(), coarse_fields.coarse(3)]
    coarse_fields.write_steps(tmp_path / "in.xdmf", steps)
    series = read_series(tmp_path / "in.xdmf")
    after, report = improve(series.batch, ImproveOptions(topology="full"))
    maps = report.vertex_map.split(series.batch, after)
    summary = write_series(tmp_path / "out.xdmf", after, series, maps, fields="interpolate")
    assert summary.interpolated == ["height"]
    for step in coarse_fields.read_steps(tmp_path / "out.xdmf"):
        expected = 1 + step.points[:, 0] + 2 * step.points[:, 1]
        np.testing.assert_allclose(step.point_data["height"], expected, atol=1e-13)


def test_the_summary_says_it_in_words():
    one = FieldSummary(interpolated=["a", "b"], outside=12, averaged=["p"], overshoots=1, carried=["disp"])
    assert str(one) == (
        "2 point fields interpolated (12 vertices lay outside the mesh before), 1 cell field averaged over overlaps "
        "(1 value lay beyond the old ones), carried with its vertices: disp"
    )
    assert str(FieldSummary()) == ""
    both = one + FieldSummary(interpolated=["a"], outside=1, missed=0.5)
    assert (both.interpolated, both.outside, both.missed) == (["a", "b"], 13, 0.5)


@pytest.mark.parametrize(
    "name", ["displacement", "Displacement", "mesh_displacement", "disp_x", "DISPLACEMENT", "DispY"]
)
def test_vectors_of_motion_are_known_by_name(name):
    assert is_motion(name)


@pytest.mark.parametrize("name", ["velocity", "temperature", "dispersion", "x", "", "displacement_magnitude"])
def test_other_fields_are_no_motion(name):
    assert not is_motion(name)


def test_an_unknown_choice_is_refused(source):
    with pytest.raises(ValueError, match="fields must be one of interpolate, carry, drop, not 'keep'"):
        write(source.with_name("out.vtu"), read(source), like=source, fields="keep")
    assert not source.with_name("out.vtu").exists()


def test_carrying_says_what_it_drops(source):
    after, _ = improve(read(source))
    with pytest.warns(MeshWarning, match="not carried over") as record:
        write(source.with_name("out.vtu"), after, like=source)
    assert "cell data 'density'" in warned(record)
