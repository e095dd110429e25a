"""Formats that meshio reads and writes: one implementation, and the facts of each format in a table."""

import importlib
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from .format import FLAT, LINEAR, Document, Format

HEAD = 4096  # bytes in which a file says whether it is text or binary

# meshio makes these anew when it writes: the normals of STL, the numbers of H5M.
_MADE_ANEW = ("facet_normals", "GLOBAL_ID")


@dataclass(frozen=True)
class MeshioFormat(Format):
    """A format of meshio.

    inspect        says whether the bytes of a file are binary; raises ValueError for a file that is cut short where
                   meshio would take it for a smaller one or never return; None: there is nothing to find out
    cell_count     the number of cells in the bytes of a file, as the first group of a regular expression
    guarded        meshio would read for ever past the end of the file, which it reads as "bytes" or "text"
    binary_option  can meshio write it both as text and as binary
    in_memory      is it written to memory first, because HDF5 crashes the process when a disk is full
    """

    inspect: Callable[[bytes], bool | None] | None = None
    cell_count: bytes = b""
    guarded: str = ""
    binary_option: bool = False
    in_memory: bool = False

    def read(self, path: Path) -> Document:
        data = path.read_bytes() if self.inspect or self.cell_count else b""
        binary = self.inspect(data) if self.inspect else None
        reader = importlib.import_module(f"meshio.{self.name.removesuffix('-xml')}")
        if self.guarded:
            with _GuardedBytes(io.FileIO(path)) as stream:
                mesh = reader.read(stream if self.guarded == "bytes" else _GuardedText(stream))
        else:
            mesh = reader.read(str(path))
        said = re.search(self.cell_count, data) if self.cell_count else None
        found = sum(len(block) for block in mesh.cells)
        if said and int(said[1]) != found:
            raise ValueError(f"of its {int(said[1])} cells only {found} could be read")
        mesh.cell_data.pop(_MADE_ANEW[0], None)
        mesh.point_data.pop(_MADE_ANEW[1], None)
        return Document(mesh, self.name, binary)

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        if self.in_memory:
            memory = io.BytesIO()
            meshio.write(memory, mesh, file_format=self.name)
            path.write_bytes(memory.getvalue())
        elif self.binary_option and like is not None:
            meshio.write(str(path), mesh, file_format=self.name, binary=like.binary)
        else:
            meshio.write(str(path), mesh, file_format=self.name)


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


def _inspect_ply(data: bytes) -> bool:
    if b"end_header" not in data:
        raise ValueError("its header has no end")
    return b"format ascii" not in data[:HEAD]


def _inspect_stl(data: bytes) -> bool:
    # A binary file has a head of 80 bytes, the number of triangles, and 50 bytes for each.
    binary = len(data) >= 84 and len(data) == 84 + 50 * int.from_bytes(data[80:84], "little")
    if not binary and b"endsolid" not in data[-500:]:
        raise ValueError("it does not end with endsolid: truncated")
    return binary


def _inspect_permas(data: bytes) -> None:
    if b"$FIN" not in data:
        raise ValueError("it does not end with $FIN: truncated")


def _inspect_tecplot(data: bytes) -> None:
    zones = len(re.findall(rb"^[ \t]*ZONE\b", data, re.IGNORECASE | re.MULTILINE))
    if zones > 1:
        raise ValueError(f"it has {zones} zones, and only one would come back; give each zone its own file")


_TRIANGLES: dict[str, Any] = {"cells": ("triangle",), "point_data": "none", "cell_data": "none"}
_NO_DATA: dict[str, Any] = {"point_data": "none", "cell_data": "none"}
_ONE_TAG: dict[str, Any] = {"point_data": "none", "cell_data": "regions"}

SURFACE_FORMATS = (
    MeshioFormat("off", (".off",), **_TRIANGLES),
    MeshioFormat("stl", (".stl",), **_TRIANGLES, inspect=_inspect_stl, binary_option=True),
    MeshioFormat(
        "ply", (".ply",), FLAT, point_data="scalars", cell_data="none", index_type=np.int32,
        inspect=_inspect_ply, cell_count=rb"\nelement face\s+(\d+)", binary_option=True,
    ),
)  # fmt: skip

SOLVER_FORMATS = (
    MeshioFormat("medit", (".mesh", ".meshb"), LINEAR, **_ONE_TAG, region_name="medit:ref"),
    MeshioFormat("med", (".med",), ("vertex", *LINEAR, "higher"), field_data=True, in_memory=True),
    MeshioFormat("permas", (".post", ".dato"), LINEAR, **_NO_DATA, inspect=_inspect_permas),
    MeshioFormat("netgen", (".vol",), LINEAR, **_ONE_TAG, region_name="netgen:index", field_data=True),
    MeshioFormat("avsucd", (".avs",), FLAT, **_ONE_TAG, region_name="avsucd:material"),
    MeshioFormat(
        "tecplot", (".dat", ".tec"), ("triangle",), cell_data="none", guarded="text", inspect=_inspect_tecplot
    ),
    MeshioFormat("h5m", (".h5m",), **_TRIANGLES, in_memory=True),
    MeshioFormat("hmf", (".hmf",), **_TRIANGLES, in_memory=True),
    MeshioFormat("dolfin-xml", (".xml",), **_TRIANGLES),
)
