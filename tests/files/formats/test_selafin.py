"""Telemac's files: of all records those of moved points, elements and fields change."""

import struct

import numpy as np
import pytest
from dialects import divided

import torchmesh as tm
from torchmesh.files.documents import load

POINTS = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [1.4, 0.5]])
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def selafin(order: str = ">", size: int = 4, frames: int = 2, date: bool = True) -> bytes:
    """A file of two variables: BOTTOM is x, and FREE SURFACE is 2 y + the number of the frame."""
    real = np.dtype(f"{order}f{size}")
    out = b""

    def put(data: bytes) -> None:
        nonlocal out
        out += struct.pack(f"{order}i", len(data)) + data + struct.pack(f"{order}i", len(data))

    put(b"a channel".ljust(72) + (b"SERAFIND" if size == 8 else b"SERAFIN "))
    put(np.array([2, 0], f"{order}i4").tobytes())
    put(b"BOTTOM          M               ")
    put(b"FREE SURFACE    M               ")
    put(np.array([1, 0, 0, 0, 0, 0, 0, 0, 0, int(date)], f"{order}i4").tobytes())
    if date:
        put(np.array([2026, 11, 28, 12, 0, 0], f"{order}i4").tobytes())
    put(np.array([4, 5, 3, 1], f"{order}i4").tobytes())
    put((FACES + 1).astype(f"{order}i4").tobytes())
    put(np.array([1, 2, 3, 4, 0], f"{order}i4").tobytes())
    for axis in (0, 1):
        put(POINTS[:, axis].astype(real).tobytes())
    for frame in range(frames):
        put(np.array([0.5 * frame], real).tobytes())
        put(POINTS[:, 0].astype(real).tobytes())
        put((2 * POINTS[:, 1] + frame).astype(real).tobytes())
    return out


CASES = [(">", 4, 2, True), (">", 8, 1, False), ("<", 4, 1, True), (">", 4, 0, False)]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_an_unchanged_file_comes_back_and_a_moved_point_changes_its_numbers(tmp_path, case):
    source, out = tmp_path / "a.slf", tmp_path / "b.slf"
    source.write_bytes(selafin(*case))
    mesh = tm.read(source)
    assert mesh.triangles.tolist() == FACES.tolist()
    assert load(source).units == "BOTTOM in M, FREE SURFACE in M"
    tm.write(out, mesh, like=source)
    assert out.read_bytes() == source.read_bytes()
    points = mesh.points.clone()
    points[4, 0] = 0.5
    turned = tm.MeshBatch.from_arrays(points, mesh.triangles[[1, 0, 2, 3]], mesh.fixed)
    tm.write(out, turned, like=source, fields="interpolate")
    before, after = source.read_bytes(), out.read_bytes()
    assert len(before) == len(after)
    assert after[:84] == before[:84]
    found = load(out)
    assert found.mesh.points[4, 0] == 0.5
    assert np.array_equal(found.mesh.cells[0].data, FACES[[1, 0, 2, 3]])
    assert found.rest.times == load(source).rest.times
    if case[2]:
        np.testing.assert_allclose(
            found.mesh.point_data["BOTTOM"].reshape(5, -1)[:, 0], found.mesh.points[:, 0], rtol=1e-6
        )
        assert found.mesh.point_data["FREE SURFACE"].shape == ((5,) if case[2] == 1 else (5, case[2]))


@pytest.mark.parametrize("case", CASES[:3], ids=str)
def test_a_mesh_with_more_points_has_the_head_and_the_times_of_its_file(tmp_path, case):
    source, out = tmp_path / "a.slf", tmp_path / "b.slf"
    source.write_bytes(selafin(*case))
    mesh, _ = divided(source)
    with pytest.warns(tm.MeshWarning, match="BOTTOM"):
        tm.write(out, mesh, like=source)  # without a vertex map, fields have no values at new points
    assert np.array_equal(tm.read(out).triangles, mesh.triangles)
    assert load(out).rest.size == case[1]
    assert out.read_bytes()[4:84] == source.read_bytes()[4:84]
    numbers = np.frombuffer(out.read_bytes(), f"{case[0]}i4", 6, load(out).rest.records[load(out).rest.first + 1][0])
    assert sorted(numbers.tolist()) == [0, 0, 1, 2, 3, 4]


def test_new_files_are_in_double_precision_with_vectors_by_components(tmp_path):
    source = tmp_path / "a.slf"
    source.write_bytes(selafin(frames=1))
    tm.write(tmp_path / "a.vtu", tm.read(source), like=source)
    tm.write(tmp_path / "b.slf", tm.read(tmp_path / "a.vtu"), like=tmp_path / "a.vtu")
    assert load(tmp_path / "b.slf").rest.size == 8
    assert set(load(tmp_path / "b.slf").mesh.point_data) == {"BOTTOM", "FREE SURFACE"}


@pytest.mark.parametrize(
    ("at", "value", "what"),
    [
        (0, 81, "title of 80 characters"),
        (92, 7000, "7000 variables"),
        (96, 1, "second order"),
        (4 + 88 + 16 + 2 * 40 + 4 + 6 * 4 - 4, 5, "5 planes"),
    ],
)
def test_mistakes_are_named(tmp_path, at, value, what):
    data = bytearray(selafin(date=False))
    data[at : at + 4] = struct.pack(">i", value)
    (tmp_path / "a.slf").write_bytes(data)
    with pytest.raises(tm.MeshIOError, match=what):
        tm.read(tmp_path / "a.slf")
    for end in (100, 200, 333, len(data) - 4):
        (tmp_path / "a.slf").write_bytes(selafin()[:end])
        with pytest.raises(tm.MeshIOError, match=r"cut short|truncated|damaged"):
            tm.read(tmp_path / "a.slf")
