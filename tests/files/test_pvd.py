"""Collections of ParaView: steps come back with their data, in files of the format that they had."""

from pathlib import Path

import meshes
import meshio
import numpy as np
import pytest

from torchmesh import ImproveOptions, MeshIOError, improve, improve_files, read, read_series, write_series

TIMES = [0.0, 0.5, 2.25]


def collection(*rows: tuple[float, str], more: str = "") -> str:
    sets = "".join(f'<DataSet timestep="{time}" part="0" file="{file}"/>' for time, file in rows)
    return f'<VTKFile type="Collection" version="0.1"><Collection>{sets}{more}</Collection></VTKFile>'


@pytest.fixture
def run(tmp_path) -> Path:
    """A hole that moves: its steps lie in a folder, are named out of order, and have a field each."""
    (tmp_path / "in" / "steps").mkdir(parents=True)
    rows = []
    for step, time in enumerate(TIMES):
        mesh = meshes.moved_hole(2.0 * step)
        points = np.pad(mesh.points.numpy(), ((0, 0), (0, 1)))
        name = f"steps/{chr(122 - step)}.vtk"
        meshio.Mesh(points, [("triangle", mesh.triangles.numpy())], point_data={"u": points[:, 0] + step}).write(
            tmp_path / "in" / name
        )
        rows.append((time, name))
    (tmp_path / "in" / "run.pvd").write_text(collection(*rows[::-1]))
    return tmp_path / "in" / "run.pvd"


def test_steps_are_read_by_time_and_written_beside_the_collection(run, tmp_path):
    given = read_series(run)
    assert given.times == TIMES
    assert given.names() == ["step 0 (time 0)", "step 1 (time 0.5)", "step 2 (time 2.25)"]
    better, report = improve(given.batch)
    assert report.valid.all()
    write_series(tmp_path / "out.pvd", better, given)
    assert sorted(p.name for p in tmp_path.glob("out*")) == ["out.pvd", *(f"out_000{k}.vtk" for k in range(3))]
    again = read_series(tmp_path / "out.pvd")
    assert again.times == TIMES
    assert (again.batch.points == better.points).all()
    for step, source in enumerate(again.sources):
        np.testing.assert_array_equal(
            source.content.mesh.point_data["u"], given.sources[step].content.mesh.point_data["u"]
        )


def test_in_place_every_step_keeps_its_name(run):
    given = read_series(run)
    write_series(run, improve(given.batch)[0], given)
    assert sorted(p.name for p in run.parent.rglob("*") if p.is_file()) == ["run.pvd", "x.vtk", "y.vtk", "z.vtk"]
    assert read_series(run).times == TIMES


def test_a_series_changes_its_format(run, tmp_path):
    given = read_series(run)
    write_series(tmp_path / "a.xdmf", given.batch, given)
    write_series(tmp_path / "b.pvd", given.batch, read_series(tmp_path / "a.xdmf"))
    assert (tmp_path / "b_0002.vtu").exists()
    assert (read_series(tmp_path / "b.pvd").batch.points == given.batch.points).all()
    with pytest.raises(MeshIOError, match=r"hold one step, the series has 3: write \.xdmf or \.pvd"):
        write_series(tmp_path / "c.vtu", given.batch, given)


def test_a_folder_counts_a_collection_once(run, tmp_path, inline):
    results = list(improve_files(run.parent, tmp_path / "out", ImproveOptions(), workers=1))
    assert [(r.name, r.steps, r.valid) for r in results] == [("run.pvd", 3, True)]
    assert len(read_series(tmp_path / "out" / "run.pvd")) == 3


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("no xml", "run.pvd: cannot be read as pvd"),
        (collection(), "its collection has no steps"),
        (collection((0.0, "steps/z.vtk"), (0.0, "steps/y.vtk")), "time 0 has several parts"),
        (collection((0.0, "steps/absent.vtk")), "absent.vtk: there is no such file"),
        (collection(more="<DataSet timestep='0'/>"), "names no file"),
    ],
)
def test_what_cannot_be_read_is_named(run, text, why):
    run.write_text(text)
    with pytest.raises(MeshIOError, match=why):
        read_series(run)


def test_a_collection_is_no_single_mesh(run):
    with pytest.raises(MeshIOError, match="read_series"):
        read(run)
