"""Heaps of strings that the HDF5 library would read without end are refused."""

import h5py
import meshes
import pytest

import torchmesh as tm
from torchmesh.files.hdf5_heaps import check_heaps


@pytest.fixture
def damaged(tmp_path):
    """A file of meshes whose heap has, behind its first string, an object of no size that is followed by itself."""
    path = tmp_path / "a.h5"
    tm.save_batch(path, meshes.grid())
    check_heaps(path)
    data = bytearray(path.read_bytes())
    free = data.index(b"GCOL") + 16 + 16 + 16  # behind the heads of the heap and the string, and "torchmesh meshes"
    assert int.from_bytes(data[free : free + 2], "little") == 0
    data[free + 8 : free + 16] = bytes(8)
    path.write_bytes(data)
    return path


def test_a_heap_without_end_is_damaged(damaged):
    with pytest.raises(ValueError, match="heap of strings is damaged"):
        check_heaps(damaged)
    with pytest.raises(tm.MeshIOError, match=r"a\.h5: .*its heap of strings is damaged"):
        tm.load_batch(damaged)


def test_only_the_first_bytes_are_looked_at_on_request(damaged):
    check_heaps(damaged, most=100)


def test_many_strings_are_no_damage(tmp_path):
    with h5py.File(tmp_path / "b.h5", "w") as file:
        file["names"] = [f"name {i}" * (i % 7) for i in range(3000)]
        file.attrs["title"] = "x" * 5000
    check_heaps(tmp_path / "b.h5")


@pytest.mark.parametrize("name", ["a.cgns", "a.med", "a.vtkhdf"])
def test_files_of_others_are_asked_too(tmp_path, name, monkeypatch):
    tm.write(tmp_path / name, meshes.grid())
    asked = []
    monkeypatch.setattr("torchmesh.files.swelling.check_heaps", asked.append)
    tm.read(tmp_path / name)
    assert asked
