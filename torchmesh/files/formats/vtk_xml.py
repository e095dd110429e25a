"""VTK's XML files as their bytes: where each array stands, how its numbers are stored, and what changes in them.

    <DataArray type="Float64" Name="Points" NumberOfComponents="3" format="ascii"> 0 0 0 ... </DataArray>
    <DataArray type="Int64" Name="connectivity" format="appended" offset="168"/>
    ...
    <AppendedData encoding="raw">_ ... </AppendedData>

Arrays are text, base64 between their tags, or stand behind the rest, raw or in base64; compressed or not.
https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

import re
import warnings
import xml.parsers.expat
from dataclasses import dataclass, field

import numpy as np

from ..swelling import allowed
from .edits import edited
from .vtk_blocks import Coding, decoded, encoded, length_of

_TYPES = {"Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Int64": "i8",
          "UInt64": "u8", "Float32": "f4", "Float64": "f8"}  # fmt: skip
TYPE_NAMES = {np.dtype(kind): name for name, kind in _TYPES.items()}

_APPENDED = re.compile(rb"<AppendedData\b[^>]*>\s*_")


@dataclass
class XmlArray:
    """An array of a file.

    section  the element that it stands in: Points, Cells, PointData, CellData, FieldData, Polys ...
    piece    the number of its piece; -1 for data of the whole file
    tag      the attributes of its element
    start    the byte that the element begins at
    inner    the bytes between which its text stands; the same byte twice for an element without any
    keys     the byte at which information on the array ends, which follows its text; that where it begins for none
    end      the byte behind the element
    """

    section: str
    piece: int
    tag: dict[str, str]
    start: int
    inner: tuple[int, int]
    keys: int
    end: int

    @property
    def name(self) -> str:
        return self.tag.get("Name", "")

    @property
    def components(self) -> int:
        """The numbers in a row.  Raises ValueError."""
        return max(int(self.tag.get("NumberOfComponents") or 1), 1)


@dataclass
class VtkXml:
    """A file as its bytes.

    kind      UnstructuredGrid or PolyData
    version   of the format
    coding    how numbers are stored that are not text
    pieces    the attributes of each piece
    arrays    in file order
    sections  where the content of each section ends, by its name and piece; and where each piece ends, by ""
    appended  where the appended data begins and ends, and whether it is raw; None if there is none
    left      the bytes that may still be unpacked
    """

    data: bytes
    kind: str = ""
    version: str = ""
    coding: Coding = field(default_factory=Coding)
    pieces: list[dict[str, str]] = field(default_factory=list)
    arrays: list[XmlArray] = field(default_factory=list)
    sections: dict[tuple[str, int], int] = field(default_factory=dict)
    appended: tuple[int, int, bool] | None = None
    left: int = 0

    @classmethod
    def of(cls, data: bytes) -> "VtkXml":
        """Raises ValueError for anything but a whole file of unstructured grids or polygons."""
        if b"</VTKFile>" not in data[-500:]:
            raise ValueError("it does not end with </VTKFile>: truncated")
        file = cls(data, left=allowed(len(data)))
        text, start = data, _APPENDED.search(data)
        if start is not None:
            end = data.rfind(b"</AppendedData>")
            if end < start.end():
                raise ValueError("its appended data has no end: truncated")
            raw = re.search(rb"encoding\s*=\s*[\"']raw[\"']", start[0]) is not None
            file.appended = (start.end(), end, raw)
            text = data[: start.end() - 1] + b"</AppendedData></VTKFile>"
        _Parser(file).run(text)
        if file.kind not in ("UnstructuredGrid", "PolyData"):
            raise ValueError(f"it holds a {file.kind or 'file of another kind'}, not an unstructured grid or polygons")
        return file

    def of_piece(self, section: str, piece: int) -> dict[str, int]:
        """The numbers of the arrays of numbers of a section, by their names."""
        return {
            array.name: number
            for number, array in enumerate(self.arrays)
            if (array.section, array.piece) == (section, piece) and array.tag.get("type") in _TYPES
        }

    def values(self, array: XmlArray) -> np.ndarray:
        """The numbers of an array, (n,) or (n, components), in the machine's byte order.  Raises ValueError."""
        kind = np.dtype(_TYPES[array.tag["type"]])
        if array.tag.get("format", "ascii") == "ascii":
            text = self.data[slice(*array.inner)]
            flat = _from_text(text, array.name).astype(kind)
        else:
            raw = decoded(self._stored(array), self.coding, self._is_raw(array), self.left)
            self.left -= len(raw)
            if len(raw) % kind.itemsize:
                raise ValueError(f"the array {array.name!r} ends within a number")
            flat = np.frombuffer(raw, kind.newbyteorder(self.coding.order)).astype(kind)
        width = array.components
        if len(flat) % width:
            raise ValueError(f"the array {array.name!r} has {len(flat)} numbers, and {width} in each row")
        return flat if width == 1 else flat.reshape(-1, width)

    def _is_raw(self, array: XmlArray) -> bool:
        return array.tag.get("format") == "appended" and self.appended is not None and self.appended[2]

    def _stored(self, array: XmlArray) -> bytes:
        """The bytes of an array, as they stand in the file; those of appended data may have others behind them."""
        if array.tag.get("format") != "appended":
            return self.data[slice(*array.inner)].strip()
        if self.appended is None:
            raise ValueError("it has no appended data")
        begin, end, _ = self.appended
        offset = int(array.tag.get("offset", 0))
        if not 0 <= offset <= end - begin:
            raise ValueError(f"the array {array.name!r} lies behind the end of the appended data: truncated")
        return self.data[begin + offset : end]

    def patched(
        self, changes: dict[int, np.ndarray], added: list[tuple[str, int, str, np.ndarray]], gone: set[int]
    ) -> bytes:
        """The bytes with other values in some arrays.

        changes  the values by the number of the array
        added    new arrays: section, piece, name and values
        gone     the numbers of arrays to leave out
        """
        edits: list[tuple[int, int, bytes]] = []
        extra: list[bytes] = []
        offset_of, total = self._appended_again(changes, gone, extra)
        for number, array in enumerate(self.arrays):
            if number in gone:
                edits.append((array.start, array.end, b""))
                continue
            tag = self.data[array.start : array.inner[0]] if array.inner[0] > array.start else b""
            appended = array.tag.get("format") == "appended"
            if appended and number in offset_of:
                tag = _with(tag, "offset", str(offset_of[number]))
            if number in changes:
                tag = _with_range(tag, changes[number])
                if not appended:
                    edits.append((*array.inner, self._rendered(array, changes[number])))
                keys = self.data[array.inner[1] : array.keys]
                if keys.strip():
                    edits.append((array.inner[1], array.keys, _with_norms(keys, changes[number])))
            if tag != self.data[array.start : array.inner[0]]:
                edits.append((array.start, array.inner[0], tag))
        for section, piece, name, values in added:
            edits.append(self._addition(section, piece, name, values))
        if self.appended is not None and (extra or total):
            edits.append((self.appended[0], self.appended[1], b"".join(extra) + b"\n"))
        return edited(self.data, edits)

    def _appended_again(
        self, changes: dict[int, np.ndarray], gone: set[int], extra: list[bytes]
    ) -> tuple[dict[int, int], int]:
        """The new offset of each appended array; fills `extra` with the appended data.  None if nothing changes."""
        own = [n for n, a in enumerate(self.arrays) if a.tag.get("format") == "appended" and n not in gone]
        if not (set(own) & set(changes)) and not any(self.arrays[n].tag.get("format") == "appended" for n in gone):
            return {}, 0
        offsets: dict[int, int] = {}
        known: dict[str, int] = {}  # arrays may share their data
        total = 0
        for n in own:
            array = self.arrays[n]
            at = array.tag.get("offset", "0")
            if n not in changes and at in known:
                offsets[n] = known[at]
                continue
            if n in changes:
                stored = encoded(self._raw(array, changes[n]), self.coding, self._is_raw(array))
            else:
                stored = self._stored(array)
                stored = stored[: length_of(stored, self.coding, self._is_raw(array))]
                known[at] = total
            offsets[n] = total
            extra.append(stored)
            total += len(stored)
        return offsets, total

    def _raw(self, array: XmlArray, values: np.ndarray) -> bytes:
        kind = np.dtype(_TYPES[array.tag["type"]]).newbyteorder(self.coding.order)
        return np.ascontiguousarray(values).astype(kind).tobytes()

    def _rendered(self, array: XmlArray, values: np.ndarray) -> bytes:
        """The text between the tags of an array."""
        old = self.data[slice(*array.inner)]
        before, after = old[: len(old) - len(old.lstrip())], old[len(old.rstrip()) :]
        if array.tag.get("format", "ascii") != "ascii":
            return before + encoded(self._raw(array, values), self.coding, False) + after
        return renewed_text(old, self.values(array), np.asarray(values).astype(_TYPES[array.tag["type"]]))

    def _addition(self, section: str, piece: int, name: str, values: np.ndarray) -> tuple[int, int, bytes]:
        """The text of a new array, and where it goes."""
        values = np.asarray(values)
        kind = TYPE_NAMES[values.dtype]
        width = f' NumberOfComponents="{values.shape[1]}"' if values.ndim > 1 else ""
        text = as_text(values, True).decode()
        element = f'<DataArray type="{kind}" Name="{escaped(name)}"{width} format="ascii">\n{text}\n</DataArray>\n'
        if (section, piece) in self.sections:
            at = self.sections[section, piece]
            return at, at, element.encode()
        at = self.sections["", piece]
        return at, at, f"<{section}>\n{element}</{section}>\n".encode()


class _Parser:
    """Finds the arrays of a file."""

    def __init__(self, file: VtkXml) -> None:
        self.file = file
        self.stack: list[str] = []
        self.open: XmlArray | None = None
        self.parser = xml.parsers.expat.ParserCreate()
        self.parser.StartElementHandler, self.parser.EndElementHandler = self._start, self._end

    def run(self, text: bytes) -> None:
        try:
            self.parser.Parse(text, True)
        except xml.parsers.expat.ExpatError as error:
            raise ValueError(f"it is no XML: {error}") from None

    def _start(self, name: str, tag: dict[str, str]) -> None:
        file, at = self.file, self.parser.CurrentByteIndex
        if self.open is not None and self.open.keys < 0:  # the first element inside of an array
            self.open.inner, self.open.keys = (self.open.inner[0], at), at
        if name == "VTKFile":
            file.kind, file.version = tag.get("type", ""), tag.get("version", "")
            file.coding = Coding.of(tag)
        elif name == "Piece":
            file.pieces.append(tag)
        elif name in ("DataArray", "Array"):
            inside = "Piece" in self.stack
            piece = len(file.pieces) - 1 if inside else -1
            close = _end_of_tag(file.data, at)
            array = XmlArray(self.stack[-1] if self.stack else "", piece, tag, at, (close, close), -1, close)
            file.arrays.append(array)
            self.open = array
        self.stack.append(name)

    def _end(self, name: str) -> None:
        file, at = self.file, self.parser.CurrentByteIndex
        self.stack.pop()
        piece = len(file.pieces) - 1
        if name in ("DataArray", "Array") and self.open is not None:
            begin = self.open.inner[0]
            closed = file.data[begin - 2 : begin] == b"/>"
            if self.open.keys < 0:
                self.open.inner = (begin, begin if closed else at)
            self.open.keys = begin if closed else at
            self.open.end = begin if closed else _end_of_tag(file.data, at)
            self.open = None
        elif name in ("PointData", "CellData") and file.data[at : at + 2] == b"</":
            file.sections[name, piece] = at
        elif name == "Piece":
            file.sections["", piece] = at


def _end_of_tag(data: bytes, at: int) -> int:
    """The byte behind a tag that begins at `at`."""
    end = re.compile(rb"(?:[^>\"']|\"[^\"]*\"|'[^']*')*>").match(data, at)
    return end.end() if end else len(data)


def _from_text(text: bytes, name: str) -> np.ndarray:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, sep=" ") if text.strip() else np.zeros(0)
        except (DeprecationWarning, ValueError):
            raise ValueError(f"the array {name!r} has text that is not numbers") from None


def as_text(values: np.ndarray, by_row: bool) -> bytes:
    """The numbers as text, with as many digits as they need; a row a line, or all in one."""
    rows = values.reshape(len(values), -1)
    if rows.dtype == np.float32:  # the shortest text of a float is shorter than that of the same number as a double
        texts = [" ".join(map(str, row)) for row in rows]
    else:
        texts = [" ".join(map(repr, row)) for row in rows.tolist()]
    return ("\n" if by_row else " ").join(texts).encode()


def renewed_text(text: bytes, before: np.ndarray, after: np.ndarray) -> bytes:
    """The text of numbers with other words for those that changed; written anew if it has another number of words."""
    words = list(re.finditer(rb"\S+", text))
    old, new = before.reshape(-1), after.reshape(-1)
    if len(words) != len(old) or len(old) != len(new):
        head, tail = text[: len(text) - len(text.lstrip())], text[len(text.rstrip()) :]
        return head + as_text(after, b"\n" in text.strip()) + (tail or b"\n")
    out, at = [], 0
    for k in np.flatnonzero((old != new) & ~((old != old) & (new != new))).tolist():
        out += [text[at : words[k].start()], as_text(new[k : k + 1], False)]
        at = words[k].end()
    return b"".join([*out, text[at:]])


def escaped(text: str) -> str:
    """Text inside an attribute."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")


def _with(tag: bytes, name: str, value: str) -> bytes:
    """The tag with another value of an attribute that it has."""
    return re.sub(rb"(\b%b\s*=\s*[\"'])[^\"']*" % name.encode(), lambda m: m[1] + value.encode(), tag, count=1)


# VTK's notes of the least and the largest length of the rows of an array.
_NORMS = re.compile(rb"(<InformationKey\b[^>]*name=\"L2_NORM_(?:FINITE_)?RANGE\"[^>]*>)(.*?)(</InformationKey>)", re.S)
_VALUE = re.compile(rb"(<Value\b[^>]*index=\"([01])\"[^>]*>)[^<]*")


def _with_norms(keys: bytes, values: np.ndarray) -> bytes:
    """Information on an array, with the lengths of the rows of other values."""
    sizes = np.linalg.norm(values.reshape(len(values), -1).astype(float), axis=1)
    sizes = sizes[np.isfinite(sizes)]
    if not len(sizes):
        return keys
    ends = {b"0": repr(sizes.min().item()).encode(), b"1": repr(sizes.max().item()).encode()}
    return _NORMS.sub(lambda m: m[1] + _VALUE.sub(lambda v: v[1] + ends[v[2]], m[2]) + m[3], keys)


def _with_range(tag: bytes, values: np.ndarray) -> bytes:
    """The tag with the range of other values, as VTK states it: of the numbers, or of the lengths of the rows."""
    sizes = values if values.ndim == 1 else np.linalg.norm(values.astype(float), axis=1)
    sizes = sizes[np.isfinite(sizes)] if sizes.dtype.kind == "f" else sizes
    if b"RangeM" not in tag or not len(sizes):
        return tag
    tag = _with(tag, "RangeMin", repr(sizes.min().item()))
    return _with(tag, "RangeMax", repr(sizes.max().item()))
