"""Named groups of cells, which formats hold in three ways.

numbers   cell data with a number for each cell, and field data {name: [number, dimension]}: Gmsh, SU2, Netgen
sets      cell sets: Abaqus, CGNS, UNV
families  cell data `cell_tags` with a number for each cell, and any names for each number: MED
"""

from collections.abc import Iterable
from typing import Any

import meshio
import numpy as np

from ..fields import REGION_TAGS

FAMILY = "cell_tags"

# For each block of cells (n,) bool: the cell is in the group.
Masks = list[np.ndarray]


def is_group(value: Any) -> bool:
    """Is this field data the number and the dimension of a group?"""
    return np.shape(value) == (2,) and np.asarray(value).dtype.kind in "iu"


def numbered(mesh: meshio.Mesh, tag: str | None = None) -> dict[str, Masks]:
    """The groups that have numbers with names; those without cells are left out.

    tag  the cell data with the numbers; None: the first that is there
    """
    tag = tag or next((name for name in REGION_TAGS if name in mesh.cell_data), None)
    found: dict[str, Masks] = {}
    for name, value in mesh.field_data.items() if tag in mesh.cell_data else ():
        if is_group(value):
            blocks = zip(mesh.cells, mesh.cell_data[tag], strict=True)
            masks = [(np.asarray(v) == value[0]) & (b.dim == value[1]) for b, v in blocks]
            if any(mask.any() for mask in masks):
                found[name] = masks
    return found


def families(mesh: meshio.Mesh) -> dict[str, Masks]:
    """The groups of the families of MED."""
    found: dict[str, Masks] = {}
    for number, names in getattr(mesh, "cell_tags", {}).items() if FAMILY in mesh.cell_data else ():
        masks = [np.asarray(values) == number for values in mesh.cell_data[FAMILY]]
        for name in names:
            found[name] = [a | b for a, b in zip(found.get(name, masks), masks, strict=True)]
    return found


def names_of(mesh: meshio.Mesh, dimensions: Iterable[int]) -> list[str]:
    """The names of the groups that have numbers, and of families, of cells of these dimensions."""
    names = [name for name, value in mesh.field_data.items() if is_group(value) and int(value[1]) in dimensions]
    for name, masks in families(mesh).items():
        if any(b.dim in dimensions and mask.any() for b, mask in zip(mesh.cells, masks, strict=True)):
            names.append(name)
    return list(dict.fromkeys(names))


def in_sets(mesh: meshio.Mesh) -> dict[str, Masks]:
    """The groups that are cell sets."""
    return {
        name: [np.isin(np.arange(len(b.data)), m) for b, m in zip(mesh.cells, members, strict=True)]
        for name, members in mesh.cell_sets.items()
    }


def as_sets(groups: dict[str, Masks]) -> dict[str, list[np.ndarray]]:
    return {name: [np.flatnonzero(mask) for mask in masks] for name, masks in groups.items()}


def numbers_for(mesh: meshio.Mesh, groups: dict[str, Masks], tag: str | None) -> dict[str, np.ndarray]:
    """Field data for those of the groups that are just the cells of one number, by the cell data `tag`."""
    found: dict[str, np.ndarray] = {}
    for name, masks in groups.items() if tag in mesh.cell_data else ():
        blocks = list(zip(mesh.cells, mesh.cell_data[tag], masks, strict=True))
        keys = {(int(n), block.dim) for block, values, mask in blocks for n in np.unique(values[mask])}
        number, dimension = next(iter(keys), (0, 0))
        whole = all((mask == (values == number)).all() for block, values, mask in blocks if block.dim == dimension)
        if len(keys) == 1 and number and whole and not any(value[0] == number for value in found.values()):
            found[name] = np.array([number, dimension])
    return found


def with_positive_numbers(mesh: meshio.Mesh, tag: str) -> dict[int, int]:
    """Gives the cells other numbers of groups where these are negative: which one each became."""
    every = np.unique(np.concatenate([np.zeros(0, np.int64), *(np.asarray(v, np.int64) for v in mesh.cell_data[tag])]))
    used = {int(n) for n in every if n > 0}
    new: dict[int, int] = {}
    for number in sorted((int(n) for n in every if n < 0), reverse=True):
        free = -number if -number not in used else max(used) + 1
        new[number] = free
        used.add(free)
    if new:
        mesh.cell_data[tag] = [
            np.array([new.get(n, n) for n in np.asarray(v).tolist()], np.int64) for v in mesh.cell_data[tag]
        ]
    return new


def one_word_each(names: Iterable[str]) -> dict[str, str]:
    """For each name a word of its own, in which blanks are underscores."""
    found: dict[str, str] = {}
    for name in names:
        word, count = "_".join(name.split()) or "_", 1
        while word in found.values():
            count += 1
            word = f"{'_'.join(name.split())}_{count}"
        found[name] = word
    return found


def said_of_words(names: Iterable[str]) -> list[str]:
    """What to say of names that are written as another word."""
    return [f"the name {name!r} is written as {word!r}" for name, word in one_word_each(names).items() if name != word]
