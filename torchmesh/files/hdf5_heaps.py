"""Heaps of strings in HDF5 files: the HDF5 library reads a damaged one without end.

Strings of variable length lie in global heap collections, which have no checksum (HDF5 File Format Specification 3.0,
III.E): a head of 16 bytes, and then objects one after another, each with a head of 16 bytes and its size.  An object
with the number 0 is what is free, and its size has the head in it.  HDF5 2.0 steps from object to object by these
sizes, and a size of nothing keeps it where it is.
"""

import mmap
from pathlib import Path

# The signature, the only version, and three bytes that are zero.
_START = b"GCOL\x01\x00\x00\x00"
_HEAD = 16


def check_heaps(path: Path, most: int | None = None) -> None:
    """Raises ValueError if the first `most` bytes of a file, None: all, hold a heap that would be read without end."""
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        end = len(data) if most is None else min(most, len(data))
        at = data.find(_START, 0, end)
        while at >= 0:
            if _is_endless(data, at):
                raise ValueError("its heap of strings is damaged")
            at = data.find(_START, at + _HEAD, end)


def _is_endless(data: mmap.mmap, at: int) -> bool:
    """Whether an object of the heap that begins `at` this byte is followed by itself."""
    end = min(at + int.from_bytes(data[at + 8 : at + 16], "little"), len(data))
    at += _HEAD
    while at + _HEAD <= end:
        number, size = (int.from_bytes(data[at + a : at + b], "little") for a, b in ((0, 2), (8, 16)))
        step = _HEAD + -(-size // 8) * 8 if number else size
        if step == 0:
            return True
        at += step
    return False
