"""What files that meshio reads call their nodes and cells, and units; meshio itself passes these over."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import meshio
import numpy as np

from .format import counted_by_type, numbers_by_type

Names = tuple[np.ndarray | None, Mapping[str, np.ndarray]]

# From the mesh, and the bytes of its file, or its path where a library opens it: the numbers of nodes and of cells.
Numbers = Callable[[meshio.Mesh, "bytes | Path"], Names]

# Types of elements in MED, by what meshio calls them.
_MED = {
    "triangle": "TR3",
    "quad": "QU4",
    "triangle6": "TR6",
    "quad8": "QU8",
    "quad9": "QU9",
    "line": "SE2",
    "line3": "SE3",
}


def counted(mesh: meshio.Mesh, _file: bytes | Path) -> Names:
    """Nodes and the cells of each type are counted from 1."""
    return 1 + np.arange(len(mesh.points)), counted_by_type(mesh, 1)


def of_avs(mesh: meshio.Mesh, file: bytes | Path) -> Names:
    """A row of a node and of a cell begins with its number."""
    assert isinstance(file, bytes)
    rows = [line for line in file.splitlines() if line.strip() and not line.lstrip().startswith(b"#")]
    nodes, cells = (int(word) for word in rows[0].split()[:2])
    found = [int(float(row.split()[0])) for row in rows[1 : 1 + nodes + cells]]
    return np.array(found[:nodes], np.int64), numbers_by_type(mesh, _in_blocks(mesh, found[nodes:]))


def of_permas(mesh: meshio.Mesh, file: bytes | Path) -> Names:
    """A row of a node and of an element begins with its number."""
    assert isinstance(file, bytes)
    found: dict[bool, list[int]] = {True: [], False: []}
    for section in re.split(rb"^[ \t]*\$", file, flags=re.M)[1:]:
        head, *rows = section.splitlines()
        if (nodes := head.upper().startswith(b"COOR")) or head.upper().startswith(b"ELEMENT"):
            starts = [
                row
                for before, row in zip([b"", *rows], rows, strict=False)
                if before.lstrip()[:1] == b"!" or not before.rstrip().endswith(b"!")
            ]
            found[nodes] += [int(match[1]) for row in starts if (match := re.match(rb"\s*(\d+)\s", row))]
    nodes = np.array(found[True], np.int64)
    return nodes if len(nodes) == len(mesh.points) else None, numbers_by_type(mesh, _in_blocks(mesh, found[False]))


def of_med(mesh: meshio.Mesh, file: bytes | Path) -> Names:
    """Numbers stand in arrays of their own; without them, nodes and the elements of each type are counted from 1."""
    import h5py

    nodes, cells = counted(mesh, file)
    made = dict(cells)
    with h5py.File(file, "r") as opened:
        step = next(iter(opened["ENS_MAA"].values()))
        step = step if "NOE" in step else next(iter(step.values()))
        if "NUM" in step["NOE"] and step["NOE/NUM"].shape == (len(mesh.points),):
            nodes = step["NOE/NUM"][()].astype(np.int64)
        for kind, own in cells.items():
            place = f"MAI/{_MED.get(kind, '')}/NUM"
            if place in step and step[place].shape == own.shape:
                made[kind] = step[place][()].astype(np.int64)
    return nodes, made


def med_units(path: Path) -> str:
    """The units of the axes, each once."""
    import h5py

    with h5py.File(path, "r") as opened:
        found = next(iter(opened["ENS_MAA"].values())).attrs.get("UNI", b"")
    words = found.decode("latin-1") if isinstance(found, bytes) else str(found)
    return ", ".join(dict.fromkeys(words.replace("\0", " ").split()))


def _in_blocks(mesh: meshio.Mesh, numbers: list[int]) -> list[np.ndarray]:
    """The numbers of the cells of each block, where there are as many numbers as cells."""
    ends = np.cumsum([len(block.data) for block in mesh.cells])
    if not len(ends) or ends[-1] != len(numbers):
        return [np.zeros(0, np.int64) for _ in mesh.cells]
    return np.split(np.array(numbers, np.int64), ends[:-1])
