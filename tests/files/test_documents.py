"""Files of every format in and out: what a format holds comes back, and what is broken is one clear line."""

import errno
import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import meshio
import numpy as np
import pytest
import torch
from file_contents import ALL, N, grid, grid_arrays, load, moved, save

from torchmesh import MeshBatch
from torchmesh.errors import InvalidMeshError, MeshError, MeshIOError, MeshWarning
from torchmesh.files import atomic
from torchmesh.files.formats.registry import FORMATS
from torchmesh.files.formats.vtu import VtkXmlFormat
from torchmesh.files.mesh_files import read, write

# How far off coordinates may be in formats that do not keep every bit: Nastran's columns have 16 characters.
INEXACT = {"nastran": 1e-9}

# Which of the grid's content a format gives back; the table in the README says the same.
HOLDS_POINT_DATA = {"vtm", "selafin", "vtkhdf", "vtu", "vtp", "vtk", "gmsh", "xdmf", "med", "ply", "tecplot"}
HOLDS_POINT_DATA |= {"cgns"}
HOLDS_REGIONS = {
    "vtm",
    "vtkhdf",
    "vtu",
    "vtp",
    "vtk",
    "gmsh",
    "xdmf",
    "med",
    "obj",
    "medit",
    "nastran",
    "netgen",
    "avsucd",
}
HOLDS_REGIONS |= {"unv", "freefem", "mfem", "triangle", "sms", "comsol"}
HOLDS_LINES = {*HOLDS_REGIONS, "cgns", "su2", "abaqus", "mdpa", "permas", "adcirc"} - {"avsucd"}


@pytest.mark.parametrize("form", ALL)
@pytest.mark.parametrize("extra", [False, True], ids=["triangles", "everything"])
def test_every_format_gives_the_mesh_back(tmp_path, form, extra):
    source = grid() if extra else meshio.Mesh(*grid_arrays()[:1], [("triangle", grid_arrays()[1])])
    given = moved(read(save(tmp_path / "in.vtu", source)))
    path = tmp_path / f"out{FORMATS[form].extensions[0]}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)  # what the format cannot hold, tested below
        write(path, given, like=tmp_path / "in.vtu")
        back = read(path)
    if form == "stl":  # it lists triangles only: vertices come in their order
        assert torch.equal(back.points[back.triangles], given.points[given.triangles])
        return
    assert torch.equal(back.triangles, given.triangles)
    torch.testing.assert_close(back.points, given.points, rtol=0, atol=INEXACT.get(form, 0))
    mesh = load(path)
    if extra:
        assert ("u" in mesh.point_data) == (form in HOLDS_POINT_DATA)
        assert any(b.type == "line" for b in mesh.cells) == (form in HOLDS_LINES)
        assert (len(back.constrained_edges) == N - 1) == (form in HOLDS_REGIONS)


@pytest.mark.parametrize("form", ALL)
def test_every_format_onto_itself_moves_nothing(tmp_path, form):
    path = tmp_path / f"a{FORMATS[form].extensions[0]}"
    save(path, grid())
    first = read(path)
    write(path, first, like=path)  # input and output may be one file
    again = read(path)
    assert torch.equal(again.points, first.points)
    assert torch.equal(again.triangles, first.triangles)
    assert torch.equal(again.constrained_edges, first.constrained_edges)
    beside = {"triangle": ["a.ele", "a.poly"], "vtm": ["a_0.vtu"]}.get(form, [])
    assert sorted(os.listdir(tmp_path)) == sorted([path.name, *beside])


@pytest.mark.parametrize(
    ("name", "options", "mark"),
    [
        ("a.vtu", {"binary": False}, b'format="ascii"'),
        ("a.vtk", {"binary": False, "file_format": "vtk42"}, b"DataFile Version 4.2\n"),
        ("a.vtk", {"binary": False}, b"\nASCII\n"),
        ("a.vtk", {"binary": True}, b"\nBINARY\n"),
        ("a.ply", {"binary": False}, b"format ascii"),
        ("a.ply", {"binary": True}, b"format binary"),
        ("a.stl", {"binary": False}, b"endsolid"),
        ("a.stl", {"binary": True}, b"meshio"),
        ("a.msh", {"binary": False, "file_format": "gmsh22"}, b"2.2 0 8"),
        ("a.msh", {"binary": True, "file_format": "gmsh22"}, b"2.2 1 8"),
        ("a.msh", {"binary": False, "file_format": "gmsh"}, b"4.1 0 8"),
        ("a.msh", {"binary": True, "file_format": "gmsh"}, b"4.1 1 8"),
    ],
)
def test_text_stays_text_and_versions_stay(tmp_path, name, options, mark):
    points, faces = grid_arrays()
    source = save(tmp_path / name, meshio.Mesh(points, [("triangle", faces.astype(np.int32))]), **options)
    mesh = read(source)
    target = tmp_path / f"out{source.suffix}"
    write(target, mesh, like=source)
    assert mark in source.read_bytes()
    assert mark in target.read_bytes()
    assert torch.equal(read(target).points, mesh.points)


def broken(tmp_path: Path, case: str) -> Path:
    points, faces = grid_arrays()
    path = tmp_path / "bad.vtu"
    if case == "missing":
        return path
    if case == "directory":
        path.mkdir()
    elif case == "empty":
        path.touch()
    elif case == "truncated":
        save(path, grid())
        path.write_bytes(path.read_bytes()[:-400])
    elif case == "another format":
        path.write_text("solid\nendsolid\n")
    elif case in ("extension", "no extension"):
        path = tmp_path / ("bad.xyz" if case == "extension" else "bad")
        path.write_text("1 2 3")
    elif case in ("nan", "off the plane"):
        if case == "nan":
            points[7, 1] = np.nan
        else:
            x = points[:, 0] - points[:, 0].mean()
            turn = 5 * x / np.ptp(x)
            points[:, 0], points[:, 2] = np.sin(turn), np.cos(turn)  # an arch that bends in again at both feet
        save(path, meshio.Mesh(points, [("triangle", faces)]))
    else:
        kind = {"sixteen nodes": "VTK_LAGRANGE_QUADRILATERAL", "tetrahedra": "tetra", "no cells": "line"}[case]
        rows = np.arange({"tetra": 4, "line": 2}.get(kind, 16))[None]
        save(path, meshio.Mesh(points, [(kind, rows)]), file_format="vtu")
    return path


@pytest.mark.parametrize(
    ("case", "kind", "text"),
    [
        ("missing", MeshIOError, "no such file"),
        ("directory", MeshIOError, "is a directory"),
        ("empty", MeshIOError, "the file is empty"),
        ("truncated", MeshIOError, "cannot be read as vtu"),
        ("another format", MeshIOError, "cannot be read as vtu"),
        (
            "extension",
            MeshIOError,
            r"extension '\.xyz' is not known; known ones are \.vtu \.vtp \.vtk \.vtkhdf \.vtm \.msh",
        ),
        ("no extension", MeshIOError, "no extension"),
        ("nan", InvalidMeshError, "points row 7 .*finite"),
        ("off the plane", InvalidMeshError, "points row .* off the plane.*no map of a plane: it bends over at"),
        ("sixteen nodes", MeshIOError, "its quads have 16 nodes: their order is too high"),
        ("no cells", InvalidMeshError, "no triangles: it has line cells only"),
        ("tetrahedra", InvalidMeshError, "tetra cells; only planar"),
    ],
)
def test_a_bad_file_is_one_clear_line(tmp_path, capfd, case, kind, text):
    path = broken(tmp_path, case)
    with pytest.raises(kind, match=text) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("form", ALL)
def test_a_truncated_file_is_no_foreign_exception_and_no_endless_loop(tmp_path, form, capfd):
    class EndlessError(BaseException):
        """Raised when time is up; no code catches it."""

    def stop(*_):
        raise EndlessError

    suffix = FORMATS[form].extensions[0]
    whole = save(tmp_path / f"a{suffix}", grid()).read_bytes()
    before = signal.signal(signal.SIGALRM, stop)
    silent = foreign = 0
    ends = [int(part * len(whole)) for part in (*np.linspace(0, 0.9, 10), 0.92, 0.94, 0.96, 0.97, 0.98)]
    try:
        for end in [*ends, *(whole.rfind(b"\n", 0, end) + 1 for end in ends)]:
            cut = tmp_path / f"cut{suffix}"
            cut.write_bytes(whole[:end])
            signal.alarm(10)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore", MeshWarning)
                    silent += len(read(cut).triangles) < 32
            except MeshError as error:
                foreign += not str(error).startswith(f"{cut}: ")
            finally:
                signal.alarm(0)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert foreign == 0
    # obj and abaqus say nowhere how long they are: a file cut between two lines is a file.
    assert silent == 0 or form in ("obj", "abaqus")
    assert capfd.readouterr() == ("", "")


def test_an_unreadable_file_says_so(tmp_path, monkeypatch):
    path = save(tmp_path / "a.vtu", grid())

    def denied(*_):
        raise PermissionError(errno.EACCES, "Permission denied")  # root may read anything: pretend

    monkeypatch.setattr(VtkXmlFormat, "read", denied)
    with pytest.raises(MeshIOError, match=r"a\.vtu: cannot be read: Permission denied"):
        read(path)


@pytest.mark.parametrize("kind", ["point_data", "cell_data"])
def test_data_with_too_few_rows_is_one_line(tmp_path, monkeypatch, kind):
    """Whatever a reader makes of a file: nobody behind it meets rows that are not there."""
    path, whole = save(tmp_path / "a.vtu", grid()), VtkXmlFormat.read

    def short(form, at):
        document = whole(form, at)
        data = getattr(document.mesh, kind)
        name = next(iter(data))
        data[name] = data[name][:3] if kind == "point_data" else [values[:3] for values in data[name]]
        return document

    monkeypatch.setattr(VtkXmlFormat, "read", short)
    with pytest.raises(
        MeshIOError, match=rf"a\.vtu: cannot be read as vtu: its {kind.replace('_', ' ')} .* not one row"
    ):
        read(path)


@pytest.fixture
def mesh() -> MeshBatch:
    return MeshBatch.from_arrays(*grid_arrays())


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.xyz", "extension"), ("none/a.vtu", "the directory .*none does not exist"), ("folder.vtu", "is a directory")],
)
def test_a_path_that_cannot_be_written_is_named(tmp_path, mesh, name, text):
    (tmp_path / "folder.vtu").mkdir()
    with pytest.raises(MeshIOError, match=text):
        write(tmp_path / name, mesh)
    assert os.listdir(tmp_path) == ["folder.vtu"]


def full_disk(*args, **_):
    Path(args[0]).write_text("the beginning")
    raise OSError(errno.ENOSPC, "No space left on device")


FAILURES = {
    "no space": (full_disk, "cannot be written: No space left on device"),
    "foreign": (lambda *_, **__: 1 // 0, "cannot be written: .*division"),
    "exit": (lambda *_, **__: sys.exit(1), "cannot be written"),
}


@pytest.mark.parametrize("failure", FAILURES)
@pytest.mark.parametrize("existing", [False, True])
def test_a_failed_write_leaves_no_trace(tmp_path, monkeypatch, mesh, failure, existing):
    target = tmp_path / "a.vtu"
    if existing:
        target.write_text("precious")
    write_badly, text = FAILURES[failure]
    monkeypatch.setattr(VtkXmlFormat, "write", lambda _, path, *__: write_badly(path))
    with pytest.raises(MeshIOError, match=rf"a\.vtu: {text}"):
        write(target, mesh)
    assert os.listdir(tmp_path) == (["a.vtu"] if existing else [])
    assert not existing or target.read_text() == "precious"


def test_a_directory_that_may_not_be_written_is_named(tmp_path, monkeypatch, mesh):
    def denied(**_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(atomic.tempfile, "mkdtemp", denied)
    with pytest.raises(MeshIOError, match=r"a\.vtu: cannot be written: Permission denied"):
        write(tmp_path / "a.vtu", mesh)


def test_a_file_that_may_not_grow_leaves_no_trace(tmp_path):
    """The system refuses to write more than 200 bytes, as it does when a disk is full."""
    code = f"""
import resource, sys
from torchmesh import MeshBatch
from torchmesh.errors import MeshIOError
from torchmesh.files.mesh_files import write
mesh = MeshBatch.from_arrays({grid_arrays()[0].tolist()}, {grid_arrays()[1].tolist()})
resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))
for suffix in ("e", "vtu", "vtk", "msh", "su2", "obj", "xdmf", "stl", "med", "off", "ply"):
    try:
        write({str(tmp_path)!r} + "/a." + suffix, mesh)
        sys.exit(suffix + ": no error")
    except MeshIOError as error:
        if suffix != "med" and "cannot be written: File too large" not in str(error):
            sys.exit(str(error))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert (done.returncode, done.stderr) == (0, "")
    assert os.listdir(tmp_path) == []


def test_permissions_and_links_stay(tmp_path, mesh):
    target = tmp_path / "a.vtu"
    write(target, mesh)
    umask = os.umask(0)
    os.umask(umask)
    assert target.stat().st_mode & 0o777 == 0o666 & ~umask
    target.chmod(0o640)
    (tmp_path / "link.vtu").symlink_to(target)
    write(tmp_path / "link.vtu", mesh)
    assert (tmp_path / "link.vtu").is_symlink()
    assert target.stat().st_mode & 0o777 == 0o640


def test_nothing_is_printed(tmp_path, capfd, mesh):
    for form in ALL:
        path = tmp_path / f"a{FORMATS[form].extensions[0]}"
        write(path, mesh)
        read(path)
    assert capfd.readouterr() == ("", "")
