"""What libraries print and raise becomes one clear line of ours, at the line of the caller."""

import os
import sys

import meshio
import numpy as np
import pytest
from file_contents import grid_arrays, save

from torchmesh import MeshBatch
from torchmesh.errors import MeshIOError, MeshWarning, MissingDependencyError
from torchmesh.files.mesh_files import read, write


def test_a_reader_that_calls_exit_is_an_error(tmp_path, monkeypatch):
    path = save(tmp_path / "a.off", meshio.Mesh(*grid_arrays()[:1], [("triangle", grid_arrays()[1])]))
    monkeypatch.setattr(meshio.off, "read", lambda _: sys.exit(1))
    with pytest.raises(MeshIOError, match="cannot be read as off"):
        read(path)


def test_remarks_of_meshio_become_warnings(tmp_path, capfd, monkeypatch):
    path = save(tmp_path / "a.off", meshio.Mesh(*grid_arrays()[:1], [("triangle", grid_arrays()[1])]))
    inner = meshio.off.read

    def talking(name):
        meshio._common.warn("something odd")
        return inner(name)

    monkeypatch.setattr(meshio.off, "read", talking)
    with pytest.warns(MeshWarning, match=r"a\.off: something odd"):
        read(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(("suffix", "package"), [(".exo", "netCDF4"), (".med", "h5py"), (".xdmf", "h5py")])
def test_a_missing_package_is_named(tmp_path, monkeypatch, suffix, package):
    monkeypatch.setitem(sys.modules, package, None)
    points, faces = grid_arrays()
    with pytest.raises(MissingDependencyError, match=f"need the package {package}; install it"):
        write(tmp_path / f"a{suffix}", MeshBatch.from_arrays(points, faces))
    (tmp_path / f"b{suffix}").write_text("something")
    with pytest.raises(MissingDependencyError if suffix != ".xdmf" else MeshIOError):
        read(tmp_path / f"b{suffix}")
    assert os.listdir(tmp_path) == [f"b{suffix}"]


def test_a_warning_points_to_the_line_of_the_caller(tmp_path):
    points, faces = grid_arrays()
    source = save(tmp_path / "a.vtu", meshio.Mesh(np.vstack([points, [9, 9, 0]]), [("triangle", faces)]))
    with pytest.warns(MeshWarning, match="1 vertices belong to no cell") as record:
        mesh = read(source)
    with pytest.warns(MeshWarning, match="do not hold") as more:
        write(tmp_path / "a.off", MeshBatch.from_arrays(points, faces, constrained_edges=[[6, 7]]))
    assert len(mesh) == 1
    assert {w.filename for w in (*record, *more)} == {__file__}
