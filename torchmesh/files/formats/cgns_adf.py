"""CGNS files in ADF, the form before HDF5: read by our own, and changed in place.

    NoDe name label     a node: how many nodes are below it, and where their table stands; type and size of its data,
         ... TaiL       and where these stand
    SNTb name where     the table of the nodes below a node
    DCtb from to        the table of the parts of data, where there are several
    DaTa ... dEnD       data

A place is a block of 4096 bytes and an offset in it.  In version A, all numbers are hexadecimal text; in version B,
places and sizes are binary.
https://cgns.org/standard/ADF (ADF user's guide, file layout)
"""

import math
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from .cgns_tree import DATA, Tree

_BLOCK, _NODE, _ENTRY = 4096, 246, 44
_TYPES = {"I4": "i4", "I8": "i8", "U4": "u4", "U8": "u8", "R4": "f4", "R8": "f8", "C1": "i1", "B1": "u1"}


class AdfNode(Tree):
    """A node of a file.

    data      the bytes of the file; a bytearray may be changed
    at        where the node begins
    location  its path
    """

    def __init__(self, data: bytes | bytearray, at: int, location: str) -> None:
        self._data, self._at, self.location = data, at, location
        head = bytes(data[at : at + _NODE])
        if len(head) < _NODE or head[:4] != b"NoDe" or head[-4:] != b"TaiL":
            raise ValueError(f"it has no node at byte {at}, where {location or 'its root'!r} should be: damaged")
        self._head = head

    @classmethod
    def root(cls, data: bytes | bytearray) -> "AdfNode":
        return cls(data, 266, "")

    @property
    def name(self) -> str:
        return self._text(4, 36)

    @property
    def label(self) -> str:
        return self._text(36, 68)

    def every(self) -> "Iterator[AdfNode]":
        for entry in self._entries():
            name = bytes(self._data[entry : entry + 32]).decode("latin-1").strip("\0 ")
            place = self._place(bytes(self._data[entry + 32 : entry + _ENTRY]))
            yield AdfNode(self._data, place, f"{self.location}/{name}")

    def data(self) -> Any:
        kind = self._text(96, 128)
        spans = self._spans()
        if kind not in _TYPES or not spans:
            raise ValueError(f"its node {self.name!r} has no data")
        raw = b"".join(bytes(self._data[start:end]) for start, end in spans)
        shape = self._shape()
        return np.frombuffer(raw, self._kind(kind), math.prod(shape)).reshape(shape)

    def put(self, values: np.ndarray) -> None:
        """Puts other values in place of the data."""
        raw = np.ascontiguousarray(values).astype(self._kind(self._text(96, 128))).tobytes()
        for start, end in self._spans():
            self._write(start, raw[: end - start])
            raw = raw[end - start :]

    def without(self, name: str) -> None:
        """Takes the node of that name out of the table of those below."""
        entries = list(self._entries())
        for entry in entries:
            if bytes(self._data[entry : entry + 32]).decode("latin-1").strip("\0 ") == name:
                last = bytes(self._data[entries[-1] : entries[-1] + _ENTRY])
                self._write(entry, last)
                self._write(self._at + 68, f"{len(entries) - 1:08X}".encode())

    def _write(self, start: int, raw: bytes) -> None:
        """Puts bytes into the file, which must have been read to be changed."""
        if not isinstance(self._data, bytearray):
            raise TypeError("the bytes of a file that is only read cannot be changed")
        self._data[start : start + len(raw)] = raw

    def _entries(self) -> list[int]:
        """Where the entries of the nodes below it stand."""
        count = self._number(68, 76)
        if not count:
            return []
        table = self._place(self._head[84:96])
        if bytes(self._data[table : table + 4]) != b"SNTb" or table + 16 + count * _ENTRY > len(self._data):
            raise ValueError(f"the table of nodes below {self.location or 'its root'!r} is damaged")
        return [table + 16 + k * _ENTRY for k in range(count)]

    def _spans(self) -> list[tuple[int, int]]:
        """Where the bytes of its data begin and end."""
        left = math.prod(self._shape()) * np.dtype(_TYPES.get(self._text(96, 128), "i1")).itemsize
        count, place = self._number(226, 230), self._head[230:242]
        if not count or left <= 0:
            return []
        at = self._place(place)
        chunks = [(at, len(self._data))]
        if count > 1:
            table = bytes(self._data[at + 16 : at + 16 + 24 * count])
            rows = [table[k : k + 24] for k in range(0, len(table), 24)]
            chunks = [(self._place(row[:12]), self._place(row[12:])) for row in rows]
        spans = []
        for start, end in chunks:
            if bytes(self._data[start : start + 4]) != b"DaTa":
                raise ValueError(f"the data of {self.location!r} are damaged")
            size = min(left, end - start - 16)
            spans.append((start + 16, start + 16 + size))
            left -= size
        if left:
            raise ValueError(f"the data of {self.location!r} are cut short")
        return spans

    def _shape(self) -> tuple[int, ...]:
        """The shape of its data, with the axes in the order of C."""
        count = min(self._number(128, 130), 12)
        if self._binary:
            return tuple(struct.unpack_from("<Q", self._head, 130 + 8 * k)[0] for k in reversed(range(count))) or (0,)
        return tuple(self._number(130 + 8 * k, 138 + 8 * k) for k in reversed(range(count))) or (0,)

    @property
    def _binary(self) -> bool:
        return b"Version B" in bytes(self._data[:32])

    def _kind(self, kind: str) -> np.dtype:
        at = bytes(self._data[:200]).find(b"AdF2")
        order = ">" if self._data[at + 4 : at + 5] == b"B" else "<"
        return np.dtype(order + _TYPES[kind])

    def _place(self, text: bytes) -> int:
        try:
            if self._binary:
                block, offset = struct.unpack("<QI", text)
                return int(block) * _BLOCK + int(offset)
            return int(text[:8], 16) * _BLOCK + int(text[8:12], 16)
        except (ValueError, struct.error):
            raise ValueError(f"a place in {self.location or 'its root'!r} is damaged") from None

    def _number(self, begin: int, end: int) -> int:
        try:
            return int(self._head[begin:end], 16)
        except ValueError:
            raise ValueError(f"the head of {self.location or 'its root'!r} is damaged") from None

    def _text(self, begin: int, end: int) -> str:
        return self._head[begin:end].decode("latin-1").strip("\0 ")


class AdfStore:
    """A file whose arrays are found by the paths of their nodes, as in HDF5, and changed."""

    def __init__(self, data: bytes) -> None:
        self.data = bytearray(data)

    def __getitem__(self, path: str) -> "AdfArray":
        return AdfArray(self._node(path.removesuffix(f"/{DATA}")))

    def __delitem__(self, path: str) -> None:
        above, _, name = path.rpartition("/")
        self._node(above).without(name)

    def _node(self, path: str) -> AdfNode:
        node = AdfNode.root(self.data)
        for name in path.strip("/").split("/"):
            node = next(child for child in node.every() if child.name == name)
        return node


class AdfArray:
    """The data of a node, to be read and written as a whole."""

    def __init__(self, node: AdfNode) -> None:
        self.node = node
        values = node.data()
        self.dtype, self.shape = values.dtype, values.shape

    def __getitem__(self, _: Any) -> np.ndarray:
        return np.array(self.node.data())

    def __setitem__(self, _: Any, values: np.ndarray) -> None:
        self.node.put(values)
