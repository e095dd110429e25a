"""How much memory a file may ask for, measured by its own size.

A file of some kilobytes can ask for terabytes: by a count that is a lie, by compressed data, or by a table of HDF5
whose shape is stated and whose content was never written.  Here this is found out before anything is allocated.
"""

import lzma
import zlib
from pathlib import Path
from typing import Any

from .hdf5_heaps import check_heaps

# A mesh does not grow more than this by being unpacked.  Coordinates compress to a tenth at best; only constant fields
# do by a factor of 1,000, and a file does not consist of them alone.
_FACTOR = 200

# Bytes that do no harm, however small the file is.
_HARMLESS = 1 << 26


def allowed(stored: int) -> int:
    """The bytes of memory that a file of `stored` bytes may ask for."""
    return max(_HARMLESS, _FACTOR * stored)


def check_swelling(needed: int, stored: int) -> None:
    """Raises ValueError if `needed` bytes of memory are too many for a file of `stored` bytes."""
    if needed > allowed(stored):
        raise ValueError(
            f"it asks for {needed:.3g} bytes of memory and has {stored:.3g}, so that it is damaged; "
            "if not, save it uncompressed"
        )


def inflated(block: bytes, compressor: str, most: int) -> bytes:
    """A block of compressed data, unpacked.  Raises ValueError if it has more than `most` bytes.

    compressor  as VTK calls it: "vtkZLibDataCompressor" or "vtkLZMADataCompressor"
    """
    unpack: Any
    if compressor == "vtkZLibDataCompressor":
        unpack = zlib.decompressobj()
    elif compressor == "vtkLZMADataCompressor":
        unpack = lzma.LZMADecompressor()
    else:
        raise ValueError(f"the compressor {compressor!r} is not known")
    data = unpack.decompress(block, most + 1)
    if len(data) > most:
        raise ValueError("its compressed data swells too much, so that it is damaged; if not, save it uncompressed")
    if not unpack.eof:
        raise ValueError("its compressed data is cut short")
    return data


def check_hdf5(path: Path) -> None:
    """Raises ValueError if an HDF5 file is damaged so that it cannot be read safely; OSError if it is no such file.

    Its tables may not need too much memory, its heaps of strings must have an end, and no attribute may be a sequence
    of variable length, which no format of meshes has: the HDF5 library itself was seen to die of one that a damaged
    string had become.
    """
    import h5py

    needed = 0

    def add(_: str, item: Any) -> None:
        nonlocal needed
        check_attributes(item)
        if isinstance(item, h5py.Dataset) and item.shape is not None:
            needed += item.size * item.dtype.itemsize

    with h5py.File(path, "r") as file:
        check_heaps(path)
        check_attributes(file)
        file.visititems(add)
    check_swelling(needed, path.stat().st_size)


def check_attributes(item: Any) -> None:
    """Raises ValueError if an attribute of a group or table is a sequence of variable length, but for references.

    Nothing is read but the types.
    """
    from h5py import h5a, h5t

    for i in range(h5a.get_num_attrs(item.id)):
        attribute = h5a.open(item.id, index=i)
        kind = attribute.get_type()
        if isinstance(kind, h5t.TypeVlenID) and not isinstance(kind.get_super(), h5t.TypeReferenceID):
            name = attribute.name.decode("utf-8", "replace")
            raise ValueError(f"its attribute {name!r} is a sequence of variable length, so that it is damaged")


def check_netcdf(path: Path) -> None:
    """Raises ValueError if the variables of a netCDF file need too much memory; OSError if it is no such file."""
    import math

    import netCDF4

    with netCDF4.Dataset(path) as file:
        needed = sum(len(dimension) for dimension in file.dimensions.values())
        for variable in file.variables.values():
            needed += math.prod(int(n) for n in variable.shape) * (getattr(variable.dtype, "itemsize", None) or 1)
    check_swelling(needed, path.stat().st_size)
