"""Telemac's results and geometries (.slf, .sel, .selafin): records of Fortran, single or double precision.

    title of 80 characters, of which the last eight say SERAFIN or SERAFIND (double precision)
    the numbers of variables; their names of 16 characters, with units of 16
    ten parameters; a date if the last one is 1
    the numbers of elements, points, points of an element, and 1
    elements, counted from 1 | numbers of boundary points, 0 inside | x | y
    then for each frame: its time, and the values of each variable

Each record stands between its length, twice.  http://wiki.opentelemac.org (Selafin / Serafin format)
"""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import meshio
import numpy as np

from .format import FLAT, Document, Format, counted_by_type

# More planes than one are layers of prisms.
_PLANES, _DATE = 6, 9


@dataclass
class Selafin:
    """A file as its records.

    order    the byte order, as numpy has it
    size     bytes of a number
    records  where the content of each record begins and ends
    first    the number of the record with the elements; boundary, x and y follow
    names    the names of the variables
    times    the time of each frame
    """

    data: bytes
    order: str = ">"
    size: int = 4
    records: list[tuple[int, int]] = field(default_factory=list)
    first: int = 0
    names: list[str] = field(default_factory=list)
    times: list[float] = field(default_factory=list)

    @property
    def real(self) -> np.dtype:
        return np.dtype(f"{self.order}f{self.size}")

    @property
    def whole(self) -> np.dtype:
        return np.dtype(f"{self.order}i4")

    @classmethod
    def of(cls, data: bytes) -> "Selafin":
        """Raises ValueError for anything but whole records."""
        file = cls(data)
        file.order = next((order for order in "><" if data[:4] == struct.pack(f"{order}i", 80)), "")
        if not file.order:
            raise ValueError("it does not begin with a title of 80 characters")
        at = 0
        while at < len(data):
            if len(data) - at < 8:
                raise ValueError("its last record is cut short")
            (length,) = struct.unpack_from(f"{file.order}i", data, at)
            end = at + 4 + length
            if length < 0 or end + 4 > len(data) or data[end : end + 4] != data[at : at + 4]:
                raise ValueError(f"a record at byte {at} has no end: truncated or damaged")
            file.records.append((at + 4, end))
            at = end + 4
        file._read_head()
        return file

    def numbers(self, record: int, kind: np.dtype, count: int) -> np.ndarray:
        """The numbers of a record.  Raises ValueError if it is not there, or has another size."""
        if record >= len(self.records):
            raise ValueError("it ends within its header: truncated")
        begin, end = self.records[record]
        if end - begin != count * kind.itemsize:
            raise ValueError(f"record {record} has {end - begin} bytes instead of {count * kind.itemsize}: damaged")
        return np.frombuffer(self.data, kind, count, begin)

    def _read_head(self) -> None:
        first, second = self.numbers(1, self.whole, 2).tolist()
        count = first + second
        if first < 0 or second < 0 or count > len(self.records):
            raise ValueError(f"it says that it has {count} variables, for which it is too small: damaged")
        if second:
            raise ValueError("it has variables of second order (quadratic); only linear ones are known")
        for record in range(2, 2 + count):
            begin, end = self.records[record]
            self.names.append(self.data[begin : min(begin + 16, end)].decode("latin-1").strip())
        parameters = self.numbers(2 + count, self.whole, 10)
        if parameters[_PLANES] > 1:
            raise ValueError(f"it has {parameters[_PLANES]} planes: only planar meshes can be improved")
        self.first = 4 + count + int(parameters[_DATE] == 1)
        elements, points, corners, _ = self.numbers(self.first - 1, self.whole, 4).tolist()
        if corners not in (3, 4) or elements < 0 or points < 0:
            raise ValueError(f"its elements have {corners} points; only planar meshes can be improved")
        self.numbers(self.first, self.whole, elements * corners)
        self.numbers(self.first + 1, self.whole, points)
        begin, end = self.records[self.first + 2] if self.first + 2 < len(self.records) else (0, 0)
        self.size = 8 if end - begin == 8 * points and points else 4
        for axis in (2, 3):
            self.numbers(self.first + axis, self.real, points)
        at, width = self.first + 4, 1 + count
        if (len(self.records) - at) % width:
            raise ValueError("its last frame is cut short")
        for record in range(at, len(self.records), width):
            self.times.append(float(self.numbers(record, self.real, 1)[0]))
            for variable in range(count):
                self.numbers(record + 1 + variable, self.real, points)

    @property
    def units(self) -> str:
        """The units of the variables, which the title states beside their names."""
        words = [
            self.data[slice(*self.records[2 + k])][16:32].decode("latin-1").strip() for k in range(len(self.names))
        ]
        return ", ".join(f"{name} in {word}" for name, word in zip(self.names, words, strict=True) if word)

    def mesh(self) -> meshio.Mesh:
        """The mesh; a variable of several frames has a column for each."""
        elements, points, corners, _ = self.numbers(self.first - 1, self.whole, 4).tolist()
        cells = self.numbers(self.first, self.whole, elements * corners).reshape(-1, corners).astype(np.int64) - 1
        axes = [self.numbers(self.first + axis, self.real, points).astype(f"f{self.size}") for axis in (2, 3)]
        data: dict[str, np.ndarray] = {}
        for variable, name in enumerate(self.names):
            frames = [self.numbers(r, self.real, points) for r in self._frames(variable)]
            if frames:
                table = np.stack(frames, 1).astype(f"f{self.size}")
                data[name if name not in data else f"{name} {variable + 1}"] = (
                    table[:, 0] if len(frames) == 1 else table
                )
        return meshio.Mesh(np.stack(axes, 1), [(FLAT[corners - 3], cells)], point_data=data)

    def _frames(self, variable: int) -> range:
        """The records of a variable, one for each frame."""
        width = 1 + len(self.names)
        return range(self.first + 5 + variable, self.first + 4 + width * len(self.times), width)

    def patched(self, mesh: meshio.Mesh, names: list[str]) -> bytes:
        """The bytes with the points, elements and variables of `mesh`, which has the rows of the file.

        names  of the variables in the mesh, in the order of the file
        """
        out = bytearray(self.data)

        def put(record: int, values: np.ndarray, kind: np.dtype) -> None:
            begin, end = self.records[record]
            out[begin:end] = np.ascontiguousarray(values).astype(kind).tobytes()

        put(self.first, mesh.cells[0].data + 1, self.whole)
        for axis in (0, 1):
            put(self.first + 2 + axis, mesh.points[:, axis], self.real)
        for variable, name in enumerate(names):
            table = np.asarray(mesh.point_data[name]).reshape(len(mesh.points), -1)
            for column, record in enumerate(self._frames(variable)):
                put(record, table[:, column], self.real)
        return bytes(out)


@dataclass(frozen=True)
class SelafinFormat(Format):
    """The `rest` of a document is a `Selafin`."""

    def read(self, path: Path) -> Document:
        file = Selafin.of(path.read_bytes())
        mesh = file.mesh()
        nodes = 1 + np.arange(len(mesh.points))
        return Document(
            mesh, self.name, rest=file, node_numbers=nodes, cell_numbers=counted_by_type(mesh, 1), units=file.units
        )

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        names = list(like.mesh.point_data) if like is not None else []
        if like is not None and same_rows and set(names) == set(mesh.point_data):
            path.write_bytes(like.rest.patched(mesh, names))
        else:
            path.write_bytes(_new_file(mesh, like.rest if like is not None else None))

    def fit(self, mesh: meshio.Mesh) -> tuple[meshio.Mesh, set[str]]:
        """Beside what other formats do, names have sixteen characters, and the elements are of one type."""
        fitted, lost = super().fit(mesh)
        kinds = list(dict.fromkeys(block.type for block in fitted.cells))
        if len(kinds) > 1:
            lost |= {f"{kind} cells" for kind in kinds if kind != "triangle"}
            fitted.cells = [block for block in fitted.cells if block.type == "triangle"]
        lost |= {f"the name {name!r} beyond 16 characters" for name in fitted.point_data if len(name) > 16}
        return fitted, lost


SELAFIN = SelafinFormat("selafin", (".slf", ".sel", ".selafin"), FLAT, cell_data="none", planar=True)


def _new_file(mesh: meshio.Mesh, like: Selafin | None) -> bytes:
    """The bytes of a new file, in the precision, the title, the date and the times of `like`."""
    order, size = (like.order, like.size) if like is not None else (">", 8)
    times = like.times if like is not None else [0.0] * bool(mesh.point_data)
    times = times or [0.0] * bool(mesh.point_data)
    real, whole = np.dtype(f"{order}f{size}"), np.dtype(f"{order}i4")
    variables: list[tuple[str, np.ndarray]] = []
    for name, values in mesh.point_data.items():
        table = np.asarray(values, float).reshape(len(mesh.points), -1)
        known = like is not None and name in like.names
        if table.shape[1] == 1 or (known and table.shape[1] == len(times)):
            variables.append((name, np.broadcast_to(table, (len(table), max(len(times), 1)))))
        else:  # the components of a vector are variables of their own
            parts = zip("XYZ456789", table.T, strict=False)
            variables += [(f"{name[:14]} {k}", np.tile(v[:, None], len(times))) for k, v in parts]
    out: list[bytes] = []

    def put(data: bytes) -> None:
        out.extend((struct.pack(f"{order}i", len(data)), data, struct.pack(f"{order}i", len(data))))

    def record(number: int) -> bytes:
        assert like is not None
        return like.data[slice(*like.records[number])]

    title = b"torchmesh".ljust(72) + (b"SERAFIND" if size == 8 else b"SERAFIN ")
    put(record(0) if like is not None else title)
    put(np.array([len(variables), 0], whole).tobytes())
    units = {name: record(2 + k)[16:32] for k, name in enumerate(like.names)} if like is not None else {}
    for name, _ in variables:
        put(name.encode("latin-1", "replace")[:16].ljust(16) + units.get(name, b"").ljust(16))
    if like is None:
        put(np.array([1, *[0] * 9], whole).tobytes())
    else:
        for number in range(2 + len(like.names), like.first - 1):
            put(record(number))
    rows = np.concatenate([block.data for block in mesh.cells])
    put(np.array([len(rows), len(mesh.points), rows.shape[1], 1], whole).tobytes())
    put((rows + 1).astype(whole).tobytes())
    put(_boundary_numbers(rows, len(mesh.points)).astype(whole).tobytes())
    for axis in (0, 1):
        put(mesh.points[:, axis].astype(real).tobytes())
    for frame, time in enumerate(times):
        put(np.array([time], real).tobytes())
        for _, table in variables:
            put(table[:, frame].astype(real).tobytes())
    return b"".join(out)


def _boundary_numbers(rows: np.ndarray, count: int) -> np.ndarray:
    """(count,) numbers from 1 along the boundary, one loop after the other, and 0 inside."""
    tails, heads = rows.reshape(-1), np.roll(rows, -1, 1).reshape(-1)
    alone = ~np.isin(tails * count + heads, heads * count + tails)
    following: dict[int, list[int]] = {}
    for tail, head in zip(tails[alone].tolist(), heads[alone].tolist(), strict=True):
        following.setdefault(tail, []).append(head)
    numbers, number = np.zeros(count, np.int64), 0
    for start in sorted(following):
        at = start
        while following.get(at):
            if not numbers[at]:
                number += 1
                numbers[at] = number
            at = following[at].pop()
    return numbers
