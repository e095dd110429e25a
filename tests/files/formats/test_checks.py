"""What a library's reader would hang on, misread, or allocate without bound for is refused before it is called."""

import base64
import re
import struct
import zlib
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pytest
from file_contents import grid, grid_arrays, save

from torchmesh import MeshBatch, MeshError, MeshWarning, read, write
from torchmesh.files.formats.registry import FORMATS

VTK = "# vtk DataFile Version 3.0\nx\nASCII\nDATASET "
SQUARE = "0 0 0\n1 0 0\n1 1 0\n0 1 0\n"


def refused(path: Path, text: str | bytes, *words: str) -> None:
    """The file is refused in one line of at most 300 characters that has the words."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(MeshError) as caught:
        read(path)
    line = str(caught.value)
    assert line.startswith(f"{path}: ")
    assert len(line) <= 300
    assert "\n" not in line
    for word in words:
        assert word in line


@pytest.mark.parametrize(
    ("name", "text", "word"),
    [
        ("a.off", "OFF\n", "no line with the numbers of vertices"),
        ("a.off", "OFF\n# only this\n\n", "no line with the numbers of vertices"),
        ("a.off", f"OFF\n4 999999999999 0\n{SQUARE}3 0 1 2\n", "999999999999 faces"),
        ("a.bdf", "CEND\nBEGIN BULK\n", "no ENDDATA"),
        ("a.mdpa", "Begin Nodes\n1 0 0 0\n", "has no end"),
        ("a.ply", "ply\nformat ascii 1.0\ncomment\nend_header\n", "ply"),
        ("a.ply", "ply\ncomment x\ncomment end_header", "ply"),
        ("a.avs", "4 2 0 0 0\n1 0 0 0\n", "too small"),
        ("a.avs", "1 2\n", "five counts"),
        ("a.vol", "mesh3d\nsurfaceelements\n99999999\n", "netgen"),
        ("a.vtk", f"{VTK}STRUCTURED_POINTS\nDIMENSIONS 90000 90000 1\n", "memory"),
        ("a.xml", '<dolfin><mesh celltype="triangle" dim="2"><vertices size="9"/></mesh></dolfin>', "of them once"),
        ("a.xdmf", '<Xdmf><DataItem Format="Binary">/dev/zero</DataItem></Xdmf>', "which is no file"),
    ],
)  # fmt: skip
def test_a_file_that_lies_or_ends_early_is_refused_at_once(tmp_path, name, text, word):
    refused(tmp_path / name, text, word)


@pytest.mark.parametrize("number", ["99999999999999999999", "1.5", "-99999999999999999999"])
def test_a_vertex_that_is_no_number_of_64_bits_is_an_error_of_the_file(tmp_path, number):
    path = tmp_path / "a.dat"
    write(path, MeshBatch.from_arrays(*grid_arrays()))
    lines = path.read_text().rstrip().split("\n")
    lines[-1] = f"{lines[-1].split()[0]} {number} 3"
    refused(path, "\n".join(lines))


def test_a_vertex_of_dolfin_that_comes_twice_leaves_no_other_undefined(tmp_path):
    path = save(tmp_path / "a.xml", grid())
    refused(path, path.read_text().replace('vertex index="7"', 'vertex index="6"'), "each of them once")


@cache
def zeros(size):
    """So many bytes of zero, compressed."""
    return zlib.compress(bytes(size), 9)


def swollen(path: Path, compressor: str, encoding: str) -> bytes:
    """A vtu file whose points are 200 MB of zeros in some hundred kilobytes."""
    size = 200_000_000
    packed = zeros(size)
    block = struct.pack("<4I", 1, size, size, len(packed)), packed
    head = f'<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian" compressor="{compressor}">'
    array = '<DataArray type="Float64" NumberOfComponents="3" Name="Points" '
    body = f'<UnstructuredGrid><Piece NumberOfPoints="8333333" NumberOfCells="0"><Points>{array}'
    end = "</Points></Piece></UnstructuredGrid>"
    if encoding == "raw":
        appended = f'format="appended" offset="0"/>{end}<AppendedData encoding="raw">\n_'
        return f"{head}{body}{appended}".encode() + b"".join(block) + b"\n</AppendedData></VTKFile>"
    text = b"".join(base64.b64encode(part) for part in block).decode()
    return f'{head}{body}format="binary">{text}</DataArray>{end}</VTKFile>'.encode()


@pytest.mark.parametrize("encoding", ["inline", "raw"])
def test_compressed_data_that_swells_a_thousandfold_is_not_unpacked(tmp_path, encoding):
    refused(tmp_path / "a.vtu", swollen(tmp_path / "a.vtu", "vtkZLibDataCompressor", encoding), "swells")


def test_every_compression_of_vtu_is_still_read(tmp_path):
    import meshio

    points = read(save(tmp_path / "a.vtu", grid())).points
    for compression in ("zlib", "lzma", None):
        for header in ("UInt32", "UInt64"):
            meshio.vtu.write(tmp_path / "b.vtu", grid(), compression=compression, header_type=header)
            assert (read(tmp_path / "b.vtu").points == points).all()


@pytest.mark.parametrize("name", ["a.med", "a.h5m", "a.hmf", "a.xdmf"])
def test_hdf5_that_states_more_than_it_holds_is_refused(tmp_path, name):
    hdf5 = tmp_path / (name if name != "a.xdmf" else "a.h5")
    if name == "a.xdmf":
        import meshio

        meshio.write(tmp_path / name, grid(), data_format="HDF")
    else:
        save(hdf5, grid())
    with h5py.File(hdf5, "a") as file:
        file.create_dataset("huge", (10**12,), float, chunks=(10**6,))
    path = tmp_path / name
    refused(path, path.read_bytes(), "asks for", "memory")


@pytest.mark.parametrize("form", [name for name, form in FORMATS.items() if not form.counts])
def test_a_file_without_counts_that_ends_in_a_line_is_told(tmp_path, form):
    path = save(tmp_path / f"a{FORMATS[form].extensions[0]}", grid())
    read(path)
    whole = re.sub(rb"\s+\Z", b"", path.read_bytes())
    path.write_bytes(whole)
    with pytest.warns(MeshWarning, match="ends in the middle of a line"):
        read(path)


def test_counts_are_those_of_numpy(tmp_path):
    """A count that fits the file is no reason to refuse it, however small the file is."""
    path = tmp_path / "a.off"
    path.write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2")
    assert np.array_equal(read(path).triangles, [[0, 1, 2]])
