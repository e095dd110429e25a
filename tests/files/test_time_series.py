"""XDMF time series: every step comes back with its data, steps that share a mesh share it, and mistakes are named."""

import warnings
from pathlib import Path

import meshes
import meshio
import numpy as np
import pytest
import torch

from torchmesh import (
    ImproveOptions,
    InvalidMeshError,
    MeshBatch,
    MeshIOError,
    MeshWarning,
    improve,
    improve_files,
    join,
    read,
    read_series,
    write,
    write_series,
)
from torchmesh.batches.batches import Job, improve_jobs
from torchmesh.files import time_series as series

TIMES = [0.0, 0.5, 2.25]


def fields(mesh: MeshBatch, step: int) -> dict:
    count = len(mesh.points)
    return {"u": np.arange(count) / 7 + step, "v": np.arange(3.0 * count).reshape(-1, 3) + step}


def shared(path: Path, mesh: MeshBatch, **options) -> Path:
    """A series of one mesh with data that changes, as meshio writes it: steps refer to a grid with the mesh."""
    points = np.pad(mesh.points.numpy(), ((0, 0), (0, 1)))
    with meshio.xdmf.TimeSeriesWriter(path, **options) as writer:
        writer.write_points_cells(points, [("triangle", mesh.triangles.numpy())])
        for step, time in enumerate(TIMES):
            writer.write_data(time, point_data=fields(mesh, step))
    return path


GRID = """<Grid Name="g{step}" GridType="Uniform"><Time Value="{time}"/>
<Topology TopologyType="Triangle" NumberOfElements="{count}">
<DataItem DataType="Int" Dimensions="{count} 3" Format="XML" Precision="8">{cells}</DataItem></Topology>
<Geometry GeometryType="XY"><DataItem DataType="Float" Dimensions="{vertices} 2" Format="XML" Precision="8">{points}
</DataItem></Geometry></Grid>"""


def grid(mesh: MeshBatch, step: int) -> str:
    return GRID.format(
        step=step,
        time=TIMES[step],
        count=len(mesh.triangles),
        vertices=len(mesh.points),
        cells=" ".join(map(str, mesh.triangles.flatten().tolist())),
        points=" ".join(map(repr, mesh.points.flatten().tolist())),
    )


def document(*grids: str, more: str = "") -> str:
    collection = '<Grid Name="run" GridType="Collection" CollectionType="Temporal">'
    return f'<Xdmf Version="3.0"><Domain>{more}{collection}{"".join(grids)}</Grid></Domain></Xdmf>'


@pytest.fixture
def motion() -> list[MeshBatch]:
    """A hole that moves through its mesh: valid, tangled, and more tangled."""
    return [meshes.moved_hole(distance) for distance in (0.0, 3.0, 5.0)]


@pytest.fixture
def moving(tmp_path, motion) -> Path:
    (tmp_path / "moving.xdmf").write_text(document(*(grid(mesh, step) for step, mesh in enumerate(motion))))
    return tmp_path / "moving.xdmf"


def test_each_step_has_its_mesh_and_its_time(moving, motion):
    found = read_series(moving)
    assert len(found) == 3
    assert found.times == TIMES
    assert found.mesh_of_step == [0, 1, 2]
    assert torch.equal(found.batch.points, join(motion).points)
    assert torch.equal(found.batch.triangles, join(motion).triangles)
    assert torch.equal(found.batch.fixed, join(motion).fixed)


@pytest.mark.parametrize("data_format", ["XML", "HDF"])
def test_steps_that_share_a_mesh_are_one_mesh(tmp_path, monkeypatch, data_format):
    monkeypatch.chdir(tmp_path)  # meshio puts the .h5 file into the working directory
    mesh = meshes.jittered()
    found = read_series(shared(tmp_path / "data.xdmf", mesh, data_format=data_format))
    assert (len(found), len(found.batch), found.mesh_of_step) == (3, 1, [0, 0, 0])
    better, report = improve(found.batch)
    assert report.valid.all()
    write_series(tmp_path / "better.xdmf", better, found)
    again = read_series(tmp_path / "better.xdmf")
    assert again.times == TIMES
    assert torch.equal(again.batch.points, better.points)
    assert torch.equal(again.batch.triangles, better.triangles)
    for step, source in enumerate(again.sources):
        for name, values in fields(mesh, step).items():
            assert np.array_equal(source.content.mesh.point_data[name], values)


def test_meshio_reads_the_steps_that_are_written(tmp_path, moving):
    found = read_series(moving)
    write_series(tmp_path / "out.xdmf", found.batch, found)
    with meshio.xdmf.TimeSeriesReader(tmp_path / "out.xdmf") as reader:
        points, cells = reader.read_points_cells()
        assert reader.num_steps == 3
        assert [reader.read_data(step)[0] for step in range(3)] == TIMES
    assert np.array_equal(points[:, :2], found.batch.split()[0].points)
    assert np.array_equal(cells[0].data, found.batch.split()[0].triangles)


@pytest.mark.parametrize(
    "pointer",
    [
        "xpointer(//Grid[@Name='mesh']/*[self::Topology or self::Geometry])",
        "xpointer(//Grid[@Name=&quot;run&quot;]/Grid[1]/*[self::Topology or self::Geometry])",
        "xpointer(/Xdmf/Domain/Grid[@GridType='Uniform'][1]/*[self::Topology or self::Geometry])",
    ],
)
def test_references_of_other_writers_are_followed(tmp_path, motion, pointer):
    mesh = motion[0]
    named = grid(mesh, 0).replace('"g0"', '"mesh"').replace('<Time Value="0.0"/>', "")
    step = '<Grid><xi:include xmlns:xi="http://www.w3.org/2001/XInclude" xpointer="{}"/><Time Value="{}"/></Grid>'
    steps = [step.format(pointer, time) for time in TIMES]
    first = [grid(mesh, 0), *steps[1:]] if "run" in pointer else steps
    (tmp_path / "a.xdmf").write_text(document(*first, more=named))
    found = read_series(tmp_path / "a.xdmf")
    assert (found.times, found.mesh_of_step) == (TIMES, [0, 0, 0])
    assert torch.equal(found.batch.triangles, mesh.triangles)


def two_functions(mesh: MeshBatch, times: tuple[float, float] = (0.0, 0.5)) -> str:
    """A mesh, tags of facets, and two functions of it in a series each, as FEniCSx writes them."""
    count = len(mesh.points)

    def values(step: int) -> str:
        numbers = " ".join(map(repr, (np.arange(count) + step / 8).tolist()))
        return f'<DataItem Dimensions="{count}" Format="XML" Precision="8">{numbers}</DataItem>'

    base = grid(mesh, 0)
    facets = """<Grid Name="facets"><xi:include xpointer="xpointer(/Xdmf/Domain/Grid/Geometry)"/>
<Topology TopologyType="PolyLine"><DataItem Dimensions="1 2" NumberType="Int" Format="XML">0 1</DataItem></Topology>
<Attribute Name="facets" Center="Cell"><DataItem Dimensions="1" NumberType="Int" Format="XML">4</DataItem></Attribute>
</Grid>"""
    series = ""
    where = "/Xdmf/Domain/Grid[@GridType='Uniform'][1]/*[self::Topology or self::Geometry]"
    for name, all_times in (("u", (0.0, 0.5)), ("p", times)):
        steps = "".join(
            f'<Grid Name="{name}" GridType="Uniform"><xi:include xpointer="xpointer({where})"/><Time Value="{time}"/>'
            f'<Attribute Name="{name}" Center="Node">{values(step)}</Attribute></Grid>'
            for step, time in enumerate(all_times)
        )
        series += f'<Grid Name="{name}" GridType="Collection" CollectionType="Temporal">{steps}</Grid>'
    return f'<Xdmf Version="3.0" xmlns:xi="https://www.w3.org/2001/XInclude"><Domain>{base}{facets}{series}</Domain></Xdmf>'


def test_functions_with_a_series_each_are_one_series_and_tags_beside_it_are_told(tmp_path, motion):
    path = tmp_path / "run.xdmf"
    path.write_text(two_functions(motion[0]))
    given = read_series(path)
    assert given.times == [0.0, 0.5]
    assert len(given.batch) == 1
    assert [set(s.document.mesh.point_data) for s in given.sources] == [{"u", "p"}] * 2
    assert given.sources[1].document.mesh.point_data["p"][0] == 1 / 8
    with pytest.warns(MeshWarning, match="not carried over.*the grid 'facets'"):
        write_series(tmp_path / "out.xdmf", given.batch, given)
    assert [set(s.document.mesh.point_data) for s in read_series(tmp_path / "out.xdmf").sources] == [{"u", "p"}] * 2


def test_functions_of_other_times_are_not_put_together(tmp_path, motion):
    path = tmp_path / "run.xdmf"
    path.write_text(two_functions(motion[0], (0.0, 0.75)))
    with pytest.raises(MeshIOError, match="its time series 'p' has other times than the first one"):
        read_series(path)


def test_any_file_is_a_series_of_one_step(tmp_path):
    write(tmp_path / "a.vtu", meshes.jittered())
    found = read_series(tmp_path / "a.vtu")
    assert (found.times, found.mesh_of_step) == ([0.0], [0])
    write_series(tmp_path / "b.msh", found.batch, found)
    assert torch.equal(read(tmp_path / "b.msh").triangles, found.batch.triangles)


def test_what_is_dropped_is_said_once_with_the_real_name(tmp_path, motion):
    """Flips change the triangles that cell data belongs to, so that it is dropped from every step."""
    attribute = '<Attribute Name="p" AttributeType="Scalar" Center="Cell"><DataItem DataType="Float" Dimensions="{0}" '
    attribute += 'Format="XML" Precision="8">{1}</DataItem></Attribute></Grid>'
    mesh = motion[2]
    data = attribute.format(len(mesh.triangles), " ".join(f"{n / 7}" for n in range(len(mesh.triangles))))
    (tmp_path / "a.xdmf").write_text(document(*(grid(mesh, s).replace("</Grid>", data) for s in range(3))))
    found = read_series(tmp_path / "a.xdmf")
    with pytest.warns(MeshWarning) as said:
        write_series(tmp_path / "b.xdmf", improve(found.batch)[0], found)
    assert [str(w.message) for w in said] == [
        f"{tmp_path / 'b.xdmf'}: not carried over from {tmp_path / 'a.xdmf'}: cell data 'p'"
    ]


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        (document(), MeshIOError, "its time series has no steps"),
        (document("<Grid/>"), MeshIOError, "step 0 has no Geometry or no Topology"),
        (document('<Grid GridType="Collection"/>'), MeshIOError, "step 0 is a collection of grids"),
        (document('<Grid><include xpointer="else"/></Grid>'), MeshIOError, "the reference 'else' is not understood"),
        (
            document("<Grid><include xpointer=\"Grid[@Name='x']\"/></Grid>"),
            MeshIOError,
            "leads to no grid with Topology and Geometry",
        ),
        (document("<Grid/>", more='<Grid CollectionType="Temporal"/>'), MeshIOError, "step 0 has no Geometry"),
        (document()[:-20], MeshIOError, "cannot be read as xdmf"),
    ],
)
def test_mistakes_are_one_clear_line(tmp_path, text, error, words):
    (tmp_path / "bad.xdmf").write_text(text)
    with pytest.raises(error, match=r"bad\.xdmf") as caught:
        read_series(tmp_path / "bad.xdmf")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_step_of_a_bad_mesh_is_named(tmp_path, motion):
    bad = grid(motion[1], 1).replace(repr(motion[1].points[7, 0].item()), "nan", 1)
    (tmp_path / "bad.xdmf").write_text(document(grid(motion[0], 0), bad))
    with pytest.raises(InvalidMeshError, match=r"step 1 of .*bad\.xdmf: points row \d+ is \[nan"):
        read_series(tmp_path / "bad.xdmf")


def test_read_says_where_to_turn(moving):
    with pytest.raises(MeshIOError, match="it is a time series: read it by read_series"):
        read(moving)


def test_a_series_fits_no_other_format_and_no_other_batch(tmp_path, moving):
    found = read_series(moving)
    with pytest.raises(MeshIOError, match=r"vtu files hold one step, the series has 3: write \.xdmf"):
        write_series(tmp_path / "a.vtu", found.batch, found)
    with pytest.raises(InvalidMeshError, match="the series has 3 meshes, the batch has 1"):
        write_series(tmp_path / "a.xdmf", meshes.grid(), found)
    assert [p.name for p in tmp_path.iterdir()] == ["moving.xdmf"]


def test_a_write_that_fails_leaves_the_old_file(tmp_path, moving, monkeypatch):
    found, before = read_series(moving), moving.read_bytes()
    monkeypatch.setattr(series.ET.ElementTree, "write", lambda *_, **__: (_ for _ in ()).throw(OSError(28, "full")))
    with pytest.raises(MeshIOError, match="full"):
        write_series(moving, found.batch, found)
    assert moving.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["moving.xdmf"]


def test_a_series_is_one_file_of_a_run(tmp_path, moving, motion, inline):
    """All meshes of a series are in the batch, and the result of the file sums them up."""
    (tmp_path / "in").mkdir()
    moving.rename(tmp_path / "in" / "moving.xdmf")
    write(tmp_path / "in" / "other.vtu", meshes.jittered())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)
        results = {r.name: r for r in improve_files(tmp_path / "in", tmp_path / "out", workers=1)}
    result = results["moving.xdmf"]
    after, report = improve(join(motion))
    assert (result.valid, result.steps, results["other.vtu"].steps) == (True, 3, 1)
    assert result.triangles == len(after.triangles)
    assert result.inverted_before == sum(int(steps[0].inverted) for steps in report.steps) > 0
    assert result.imr_maximum_after == float(report.quality.max.max())
    assert result.imr_average_after == pytest.approx(float(report.quality.mean.mean()))
    found = read_series(tmp_path / "out" / "moving.xdmf")
    assert found.times == TIMES
    assert torch.equal(found.batch.points, after.points)


def test_the_step_that_stays_tangled_is_named(tmp_path, motion):
    points, triangles = meshes.grid_arrays(6, 6)
    points[0] = 1.4
    crossed = MeshBatch.from_arrays(points, triangles)
    (tmp_path / "a.xdmf").write_text(document(grid(motion[0], 0), grid(crossed, 1)))
    job = Job("a.xdmf", str(tmp_path / "a.xdmf"), str(tmp_path / "out" / "a.xdmf"), str(tmp_path / "out" / ".staging"))
    (result,) = improve_jobs([job], ImproveOptions(), 10**6)
    assert (result.status, result.valid) == ("stalled", False)
    assert result.message.startswith("mesh 1 of 2: ")


@pytest.mark.parametrize("boundary", ["fixed", "slide"])
def test_what_a_file_holds_does_not_slide_in_a_batch(tmp_path, boundary):
    """A file with a quad has the same result alone and in a batch."""
    from torchmesh import held

    points, triangles = meshes.grid_arrays(6, 6)
    points = np.pad(points + 0.01 * np.sin(40 * points[:, ::-1]), ((0, 0), (0, 1)))
    triangles = triangles[~np.isin(triangles, [0, 1, 8, 7]).all(1)]
    meshio.Mesh(points, [("triangle", triangles), ("quad", [[0, 7, 8, 1]])]).write(tmp_path / "quad.vtu")
    write(tmp_path / "other.vtu", meshes.jittered())
    jobs = [
        Job(n, str(tmp_path / n), str(tmp_path / "out" / n), str(tmp_path / "out" / ".staging"))
        for n in ("other.vtu", "quad.vtu")
    ]
    options = ImproveOptions(boundary=boundary)
    results = list(improve_jobs(jobs, options, 10**6))
    assert [r.error for r in results] == [None, None]
    hold = held(tmp_path / "quad.vtu") if boundary == "slide" else None
    alone, _ = improve(read(tmp_path / "quad.vtu"), options, hold=hold)
    assert torch.equal(read(tmp_path / "out" / "quad.vtu").points, alone.points)
