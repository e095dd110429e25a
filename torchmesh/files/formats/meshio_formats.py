"""Formats that meshio reads and writes: one implementation, and the facts of each format in a table."""

import importlib
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..swelling import check_hdf5
from .checks import (
    check_avs,
    check_dolfin,
    check_off,
    check_permas,
    check_ply,
    check_stl,
    is_binary_stl,
)
from .format import FLAT, LINEAR, Document, Format
from .groups import names_of, one_word_each, said_of_words, with_positive_numbers
from .meshio_numbers import Numbers, counted, of_avs, of_permas
from .skipped import (
    each_once,
    in_avs,
    in_h5m,
    in_hmf,
    in_medit,
    in_netgen,
    in_off,
    in_permas,
    in_ply,
    in_stl,
    in_tecplot,
    in_xml,
)

HEAD = 4096  # bytes in which a file says whether it is text or binary

# meshio makes these anew when it writes: the normals of STL, the numbers of H5M.
_MADE_ANEW = ("facet_normals", "GLOBAL_ID")


@dataclass(frozen=True)
class MeshioFormat(Format):
    """A format of meshio.

    check          raises ValueError for the bytes of a file that is cut short or lies, where meshio would take it for
                   a smaller one, allocate without bound or never return; None: meshio notices
    check_file     the same for a file that a library opens by itself
    is_binary      says whether the bytes of a file are binary; None: there is nothing to find out
    skipped        names for what is in the bytes of a file that meshio passes over
    skipped_file   the same for a file that a library opens by itself
    cell_count     the number of cells in the bytes of a file, as the first group of a regular expression
    stream         the file is handed to meshio as "bytes" or "text", in a stream that raises when it is read past its
                   end again and again, as meshio does in many loops; "": meshio opens it
    binary_option  can meshio write it both as text and as binary
    in_memory      is it written to memory first, because HDF5 crashes the process when a disk is full
    numbers        what a file calls its nodes and cells; None: they are counted from 0, or have no numbers
    units          what a file says of units
    foreign        what a file begins with that has the extension and is of another format
    """

    check: Callable[[bytes], None] | None = None
    check_file: Callable[[Path], None] | None = None
    is_binary: Callable[[bytes], bool] | None = None
    skipped: Callable[[bytes], list[str]] | None = None
    skipped_file: Callable[[Path], list[str]] | None = None
    cell_count: bytes = b""
    stream: str = ""
    binary_option: bool = False
    in_memory: bool = False
    numbers: Numbers | None = None
    units: Callable[[Path], str] | None = None
    foreign: bytes = b""

    def recognises(self, head: bytes) -> bool:
        return not self.foreign or not head.lstrip().startswith(self.foreign)

    def read(self, path: Path) -> Document:
        data = b"" if self.check_file else path.read_bytes()
        if self.check_file:
            self.check_file(path)
        if self.check:
            self.check(data)
        mesh = self.parse(path, data)
        said = re.search(self.cell_count, data) if self.cell_count else None
        found = sum(len(block) for block in mesh.cells)
        if said and int(said[1]) != found:
            raise ValueError(f"of its {int(said[1])} cells only {found} could be read")
        mesh.cell_data.pop(_MADE_ANEW[0], None)
        mesh.point_data.pop(_MADE_ANEW[1], None)
        names = self.skipped(data) if self.skipped else self.skipped_file(path) if self.skipped_file else []
        nodes, cells = self.numbers(mesh, data or path) if self.numbers else (None, {})
        return Document(
            mesh, self.name, self.is_binary(data) if self.is_binary else None, skipped=each_once(names),
            node_numbers=nodes, cell_numbers=cells, units=self.units(path) if self.units else "",
        )  # fmt: skip

    def parse(self, path: Path, data: bytes) -> meshio.Mesh:
        """The mesh of a file that has passed the checks; `data` are its bytes."""
        reader = importlib.import_module(f"meshio.{self.name.removesuffix('-xml')}")
        # meshio knows by the name whether a Medit file is binary, and reads that without lines.
        if not self.stream or path.suffix.lower() == ".meshb":
            return reader.read(str(path))
        with _GuardedBytes(io.FileIO(path)) as stream:
            if self.stream == "bytes":
                return reader.read(stream)
            return reader.read(_GuardedText(stream, encoding="utf-8", errors="surrogateescape"))

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        if self.in_memory:
            memory = io.BytesIO()
            meshio.write(memory, mesh, file_format=self.name)
            path.write_bytes(memory.getvalue())
        elif self.binary_option and like is not None:
            meshio.write(str(path), mesh, file_format=self.name, binary=like.binary)
        else:
            meshio.write(str(path), mesh, file_format=self.name)


@dataclass(frozen=True)
class NetgenFormat(MeshioFormat):
    """A name is one word, and its number is positive."""

    def fit(self, mesh: meshio.Mesh) -> tuple[meshio.Mesh, set[str]]:
        fitted, lost = super().fit(mesh)
        words = one_word_each(fitted.field_data)
        new = with_positive_numbers(fitted, self.region_name) if self.region_name in fitted.cell_data else {}
        fitted.field_data = {
            words[name]: np.array([new.get(int(n), int(n)), int(dim)]) for name, (n, dim) in fitted.field_data.items()
        }
        return fitted, lost

    def conversions(self, mesh: meshio.Mesh) -> list[str]:
        return said_of_words(names_of(mesh, (1, 2)))


class _Guard:
    """A stream that raises when it is read past its end again and again."""

    ends = 0

    def readline(self, size: int = -1) -> Any:
        line = super().readline(size)  # type: ignore[misc]
        self.ends += not line
        if self.ends > 100:
            raise ValueError("the file ends early")
        return line


class _GuardedBytes(_Guard, io.BufferedReader):  # type: ignore[misc]
    pass


class _GuardedText(_Guard, io.TextIOWrapper):  # type: ignore[misc]
    pass


def _is_binary_ply(data: bytes) -> bool:
    return b"format ascii" not in data[:HEAD]


def _check_tecplot(data: bytes) -> None:
    zones = len(re.findall(rb"^[ \t]*ZONE\b", data, re.IGNORECASE | re.MULTILINE))
    if zones > 1:
        raise ValueError(f"it has {zones} zones, and only one would come back; give each zone its own file")


_TRIANGLES: dict[str, Any] = {"cells": ("triangle",), "point_data": "none", "cell_data": "none"}
_NO_DATA: dict[str, Any] = {"point_data": "none", "cell_data": "none"}
_ONE_TAG: dict[str, Any] = {"point_data": "none", "cell_data": "regions"}

SURFACE_FORMATS = (
    MeshioFormat("off", (".off",), **_TRIANGLES, check=check_off, skipped=in_off, stream="text"),
    MeshioFormat(
        "stl", (".stl",), **_TRIANGLES, check=check_stl, skipped=in_stl, is_binary=is_binary_stl,
        binary_option=True,
    ),
    MeshioFormat(
        "ply", (".ply",), FLAT, point_data="scalars", cell_data="none", index_type=np.int32,
        check=check_ply, skipped=in_ply, is_binary=_is_binary_ply, cell_count=rb"\nelement face\s+(\d+)",
        stream="bytes", binary_option=True,
    ),
)  # fmt: skip

SOLVER_FORMATS = (
    MeshioFormat(
        "medit", (".mesh", ".meshb"), LINEAR, **_ONE_TAG, region_name="medit:ref", skipped=in_medit, stream="text",
        foreign=b"MFEM", numbers=counted,
    ),
    MeshioFormat(
        "permas", (".post", ".dato"), LINEAR, **_NO_DATA, check=check_permas, skipped=in_permas, stream="text",
        numbers=of_permas,
    ),
    NetgenFormat(
        "netgen", (".vol",), LINEAR, **_ONE_TAG, region_name="netgen:index", field_data=True, names_only=True,
        skipped=in_netgen, stream="text", numbers=counted,
    ),
    MeshioFormat(
        "avsucd", (".avs",), FLAT, **_ONE_TAG, region_name="avsucd:material", check=check_avs, skipped=in_avs,
        stream="text", numbers=of_avs,
    ),
    MeshioFormat(
        "tecplot", (".dat", ".tec"), ("triangle",), cell_data="none", check=_check_tecplot, skipped=in_tecplot,
        stream="text", numbers=counted,
    ),
    MeshioFormat("h5m", (".h5m",), **_TRIANGLES, in_memory=True, check_file=check_hdf5, skipped_file=in_h5m),
    MeshioFormat("hmf", (".hmf",), **_TRIANGLES, in_memory=True, check_file=check_hdf5, skipped_file=in_hmf),
    MeshioFormat("dolfin-xml", (".xml",), **_TRIANGLES, check=check_dolfin, skipped=partial(in_xml, form="dolfin-xml")),
)  # fmt: skip
