"""VTK's legacy files as their bytes: where each array stands, and what changes in them.

    # vtk DataFile Version 5.1
    a title
    ASCII                          or BINARY, which is big-endian
    DATASET UNSTRUCTURED_GRID      or POLYDATA
    POINTS 5 double                each array follows the line that announces it
    CELLS 5 12                     from version 5 on: OFFSETS and CONNECTIVITY with types of their own;
                                   before: for each cell its number of nodes, and the nodes
    CELL_TYPES 4
    CELL_DATA 4 / POINT_DATA 5     SCALARS, VECTORS, FIELD ...

https://docs.vtk.org/en/latest/vtk_file_formats/vtk_legacy_file_format.html
"""

import re
import warnings
from dataclasses import dataclass, field

import numpy as np

_TYPES = {
    "bit": "bit", "unsigned_char": "u1", "char": "i1", "signed_char": "i1", "unsigned_short": "u2", "short": "i2",
    "unsigned_int": "u4", "int": "i4", "unsigned_long": "u8", "long": "i8", "unsigned_long_long": "u8",
    "long_long": "i8", "unsigned___int64": "u8", "__int64": "i8", "vtktypeint64": "i8", "vtktypeuint64": "u8",
    "vtktypeint32": "i4", "vtktypeuint32": "u4", "vtktypeint16": "i2", "vtktypeuint16": "u2", "vtktypeint8": "i1",
    "vtktypeuint8": "u1", "vtkidtype": "i4", "float": "f4", "double": "f8", "vtktypefloat32": "f4",
    "vtktypefloat64": "f8",
}  # fmt: skip
TYPE_NAMES = {np.dtype("i1"): "char", np.dtype("u1"): "unsigned_char", np.dtype("i2"): "short",
              np.dtype("u2"): "unsigned_short", np.dtype("i4"): "int", np.dtype("u4"): "unsigned_int",
              np.dtype("i8"): "long", np.dtype("u8"): "unsigned_long", np.dtype("f4"): "float",
              np.dtype("f8"): "double"}  # fmt: skip

# A line that is no row of numbers.
_KEYWORD = re.compile(rb"^[ \t]*(?![-+]?(?:nan|inf)\b)[A-Za-z_]", re.M | re.I)

# The data of one array after its name and type, and its components.
_ATTRIBUTES = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1}


@dataclass
class LegacyArray:
    """An array of a file.

    section  "points", "point", "cell", "field", or the keyword of cells (CELLS, POLYGONS ...) with its part
    name     of data
    kind     the type of its numbers, as numpy has it, or "bit"
    values   (n,) or (n, components) in the machine's byte order
    span     the bytes that it takes
    whole    the bytes from the line that announces it to its end
    of       the number of the FIELD that it stands in; -1 for none
    """

    section: str
    name: str
    kind: str
    values: np.ndarray
    span: tuple[int, int]
    whole: tuple[int, int]
    of: int = -1


@dataclass
class VtkLegacy:
    """A file as its bytes.

    version   of the format: 5.1, 4.2, ...
    title     its second line
    binary    is it binary
    dataset   UNSTRUCTURED_GRID or POLYDATA
    arrays    in file order
    fields    the bytes of the data of the whole file, before the points
    skipped   names for what is no array of numbers
    ends      where the data at points and in cells ends, by "point" and "cell"
    heads     for each FIELD the bytes of the number of its arrays
    """

    data: bytes
    version: str = ""
    title: bytes = b""
    binary: bool = False
    dataset: str = ""
    arrays: list[LegacyArray] = field(default_factory=list)
    fields: bytes = b""
    skipped: list[str] = field(default_factory=list)
    ends: dict[str, int] = field(default_factory=dict)
    heads: list[tuple[int, int]] = field(default_factory=list)
    at: int = 0

    @classmethod
    def of(cls, data: bytes) -> "VtkLegacy":
        """Raises ValueError for anything but a whole file."""
        file = cls(data)
        first = file._line()
        if not first.startswith(b"# vtk DataFile"):
            raise ValueError("it does not begin with '# vtk DataFile Version'")
        file.version = first.split()[-1].decode(errors="replace")
        file.title = file._line()
        file.binary = file._line().strip().upper() == b"BINARY"
        words = file._words()
        if words[:1] != ["DATASET"] or len(words) < 2:
            raise ValueError("its header has no DATASET: cut short or damaged")
        file.dataset = words[1].upper()
        if file.dataset in ("UNSTRUCTURED_GRID", "POLYDATA"):
            file._read()
        return file

    @property
    def offsets(self) -> bool:
        """Have cells offsets, as from version 5 on?"""
        return self.version.split(".")[0].isdigit() and int(self.version.split(".")[0]) >= 5

    def array(self, section: str) -> LegacyArray | None:
        return next((array for array in self.arrays if array.section == section), None)

    def _line(self) -> bytes:
        """The next line, without its end."""
        end = self.data.find(b"\n", self.at)
        end = len(self.data) if end < 0 else end
        line, self.at = self.data[self.at : end], min(end + 1, len(self.data))
        return line

    def _words(self) -> list[str]:
        """The words of the next line that is not blank; none at the end."""
        while self.at < len(self.data):
            words = self._line().decode(errors="surrogateescape").split()
            if words:
                return words
        return []

    def _read(self) -> None:
        where, rows = "field", 0
        while True:
            while self.at < len(self.data) and self.data[self.at : self.at + 1].isspace():
                self.at += 1
            begin = self.at
            words = self._words()
            if not words:
                return
            key = words[0].upper()
            if key in ("POINT_DATA", "CELL_DATA"):
                where, rows = key.split("_")[0].lower(), _count(words, 1)
                self.ends[where] = self.at
            elif key == "POINTS":
                self._take("points", "", words[2] if len(words) > 2 else "float", (_count(words, 1), 3), begin)
            elif key in ("CELLS", "VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS"):
                self._read_cells(key, words, begin)
            elif key == "CELL_TYPES":
                self._take("types", "", "int", (_count(words, 1),), begin)
            elif key == "METADATA":
                self._skip_metadata()
            elif key == "FIELD":
                head = self.data[begin : self.at].rstrip()
                self.heads.append((begin + len(head) - len(words[-1]), begin + len(head)))
                self._read_field(where, words)
                if where == "field":
                    self.fields = self.data[begin : self.at]
            elif key == "LOOKUP_TABLE":
                self.skipped.append(f"the lookup table {words[1] if len(words) > 1 else ''!r}")
                self._take_raw("unsigned_char" if self.binary else "float", 4 * _count(words, 2))
            else:
                self._read_attribute(key, where, rows, words, begin)
            if where in self.ends:
                self.ends[where] = self.at

    def _read_cells(self, key: str, words: list[str], begin: int) -> None:
        first, second = _count(words, 1), _count(words, 2)
        if not self.offsets:
            self._take(key, "", "int", (second,), begin)
            return
        for part, count in (("OFFSETS", first), ("CONNECTIVITY", second)):
            head = self._words()
            if head[:1] != [part] or len(head) < 2:
                raise ValueError(f"{key} should have {part}: {' '.join(head)[:60]!r}")
            self._take(f"{key} {part}", "", head[1], (count,), begin)

    def _read_field(self, where: str, words: list[str]) -> None:
        for _ in range(_count(words, 2)):
            begin = self.at
            head = self._words()
            if head[:1] == ["METADATA"]:
                self._skip_metadata()
                begin = self.at
                head = self._words()
            if len(head) < 4:
                raise ValueError(f"an array of a FIELD has no name, size and type: {' '.join(head)[:60]!r}")
            width, count = _count(head, 1), _count(head, 2)
            name, kind = _decoded(head[0]), head[3].lower()
            if kind in ("string", "utf8_string", "variant"):
                self.skipped.append(f"the text {name!r}")
                self._skip_strings(width * count)
            else:
                self._take(where, name, kind, (count,) if width == 1 else (count, width), begin)
                self.arrays[-1].of = len(self.heads) - 1

    def _read_attribute(self, key: str, where: str, rows: int, words: list[str], begin: int) -> None:
        if len(words) < 3 or where == "field":
            raise ValueError(f"the line {' '.join(words)[:60]!r} is not understood: damaged or truncated")
        name = _decoded(words[1])
        if key == "SCALARS":
            width = int(words[3]) if len(words) > 3 and words[3].isdigit() else 1
            at = self.at
            if self._words()[:1] != ["LOOKUP_TABLE"]:
                self.at = at
            shape = (rows,) if width == 1 else (rows, width)
            self._take(where, name, words[2], shape, begin)
        elif key == "TEXTURE_COORDINATES" and len(words) > 3:
            self._take(where, name, words[3], (rows, _count(words, 2)), begin)
        elif key == "COLOR_SCALARS":
            kind = "unsigned_char" if self.binary else "float"
            self._take(where, name, kind, (rows, _count(words, 2)), begin)
        elif key in _ATTRIBUTES:
            width = _ATTRIBUTES[key]
            self._take(where, name, words[2], (rows,) if width == 1 else (rows, width), begin)
        else:
            raise ValueError(f"the line {' '.join(words)[:60]!r} is not understood: damaged or truncated")

    def _take(self, section: str, name: str, kind: str, shape: tuple[int, ...], begin: int) -> None:
        """Reads the next array."""
        at = self.at
        values = self._take_raw(kind, int(np.prod(shape, dtype=object)))
        span = (at, self.at)
        self.arrays.append(LegacyArray(section, name, _kind(kind), values.reshape(shape), span, (begin, self.at)))

    def _take_raw(self, name: str, count: int) -> np.ndarray:
        """The next numbers, of a type that VTK has a name for.  Raises ValueError if there are fewer."""
        kind = _kind(name)
        if count > 8 * (len(self.data) - self.at) + 8:
            raise ValueError(
                f"it says that it has {count} numbers more, for which it is too small: truncated or damaged"
            )
        if not self.binary:
            return self._take_text(kind, count)
        size = -(-count // 8) if kind == "bit" else count * np.dtype(kind).itemsize
        raw = self.data[self.at : self.at + size]
        if len(raw) < size:
            raise ValueError(f"an array of {count} numbers is cut short: truncated")
        self.at += size
        if kind == "bit":
            return np.unpackbits(np.frombuffer(raw, np.uint8))[:count]
        return np.frombuffer(raw, np.dtype(kind).newbyteorder(">")).astype(kind)

    def _take_text(self, kind: str, count: int) -> np.ndarray:
        following = _KEYWORD.search(self.data, self.at)
        end = following.start() if following else len(self.data)
        text = self.data[self.at : end]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                numbers = np.fromstring(text, sep=" ") if text.strip() else np.zeros(0)
            except (DeprecationWarning, ValueError):
                raise ValueError(f"an array of {count} numbers has text that is not numbers") from None
        if len(numbers) != count:
            raise ValueError(f"an array has {len(numbers)} numbers instead of {count}: truncated or damaged")
        exact = "i" in kind or "u" in kind
        if exact and len(numbers) and np.abs(numbers).max() > 1 << 52:  # more digits than a float has
            numbers = np.array(text.split(), dtype=np.dtype(kind))
        self.at = end
        return numbers.astype("u1" if kind == "bit" else kind)

    def _skip_strings(self, count: int) -> None:
        """Texts: a line each, or with their length in front, in one to eight bytes, of which two bits say how many."""
        for _ in range(count):
            if self.at >= len(self.data):
                raise ValueError("a text of it is cut short")
            if not self.binary:
                self._line()
                continue
            size = {3: 1, 2: 2, 1: 4, 0: 8}[self.data[self.at] >> 6]
            length = int.from_bytes(self.data[self.at : self.at + size], "big") & ((1 << (8 * size - 2)) - 1)
            self.at += size + length

    def _skip_metadata(self) -> None:
        """Goes behind the blank line that ends it."""
        self.skipped.append("METADATA")
        while self.at < len(self.data) and self._line().strip():
            pass


def _kind(name: str) -> str:
    """The type of numbers that VTK calls so.  Raises ValueError.

    FreeFem writes the number of components, 1, without a blank behind it.
    """
    known = name.lower().removesuffix("1")
    if known not in _TYPES:
        raise ValueError(f"numbers of the type {name[:40]!r} are not known")
    return _TYPES[known]


def _count(words: list[str], index: int) -> int:
    """A count in a line.  Raises ValueError."""
    if index >= len(words) or not re.fullmatch(r"\d{1,15}", words[index]):
        raise ValueError(f"the line {' '.join(words)[:60]!r} should have a whole number: damaged")
    return int(words[index])


def _decoded(name: str) -> str:
    """A name, in which VTK writes blanks and the like as %20."""
    return re.sub(r"%([0-9A-Fa-f]{2})", lambda m: chr(int(m[1], 16)), name)


def coded(name: str) -> str:
    """A name as it stands in a file."""
    return re.sub(r"[\s%\"]", lambda m: f"%{ord(m[0]):02X}", name) or "data"
