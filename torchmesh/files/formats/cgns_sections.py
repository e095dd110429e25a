"""The elements of CGNS files: sections of an unstructured zone.

A section has elements of one type, or of several, whose types stand in front of their nodes, or polygons (NGON_n):

    ElementConnectivity    5 1 2 5  5 2 3 5  7 2 6 7 3     mixed: 5 is a triangle, 7 a quad
    ElementConnectivity    1 2 5  2 3 5  2 6 7 3           NGON_n, with ElementStartOffset 0 3 6 10
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .cgns_tree import Tree

# The numbers of element types: meshio's name, the number of nodes.  The order of nodes is meshio's.
_KINDS = {2: ("vertex", 1), 3: ("line", 2), 4: ("line3", 3), 5: ("triangle", 3), 6: ("triangle6", 6), 7: ("quad", 4),
          8: ("quad8", 8), 9: ("quad9", 9)}  # fmt: skip
NUMBERS = {name: number for number, (name, _) in _KINDS.items()}
_HIGHER = (24, 25, 26, 27, 28, 40, 41, 42, 43, 44)
_MIXED, _POLYGONS, _POLYHEDRA = 20, 22, 23


@dataclass(frozen=True)
class Section:
    """Elements of one type of a section.

    kind    meshio's name of the type
    nodes   (n, k) their nodes, as rows of the mesh
    path    of the array of nodes
    places  (n,) where the nodes of each begin there
    number  (n,) the numbers of the elements
    start   the first vertex of their zone
    """

    kind: str
    nodes: np.ndarray
    path: str
    places: np.ndarray
    number: np.ndarray
    start: int


def sections_of(node: Tree, begin: int, start: int, count: int) -> Iterator[Section]:
    """Runs of elements of one type.  Raises ValueError for other types, and nodes that are none of the zone's."""
    number = int(node.whole("a type of elements").reshape(-1)[0])
    if number == _POLYHEDRA:
        raise ValueError(f"its section {node.name!r} has polyhedra (NFACE_n); only planar meshes can be improved")
    array = next(node.children("DataArray_t", "ElementConnectivity"), None)
    if array is None:
        raise ValueError(f"its section {node.name!r} has no nodes")
    nodes = array.whole("nodes of elements").reshape(-1)
    if number == _MIXED:
        types, places = _mixed(nodes, node.name)
    elif number == _POLYGONS:
        types, places = _polygons(node, nodes)
    else:
        _check_kind(number, node.name)
        width = _KINDS[number][1]
        if len(nodes) % width:
            raise ValueError(f"its section {node.name!r} has {len(nodes)} nodes, which are no rows of {width}")
        places = np.arange(0, len(nodes), width)
        types = np.full(len(places), number)
    ends = [0, *(1 + np.flatnonzero(np.diff(types))).tolist(), len(types)]
    for low, high in itertools.pairwise(ends):
        if low == high:
            continue
        kind, width = _KINDS[int(types[low])]
        rows = nodes[places[low:high, None] + np.arange(width)]
        if (rows < 1).any() or (rows > count).any():
            raise ValueError(f"its section {node.name!r} has a vertex that is none of 1 to {count}")
        yield Section(kind, rows - 1 + start, array.path, places[low:high], begin + np.arange(low, high), start)


def _mixed(nodes: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """The types of elements that stand in front of their nodes, and where these nodes begin."""
    types, places, at, numbers = [], [], 0, nodes.tolist()
    while at < len(numbers):
        _check_kind(numbers[at], name)
        types.append(numbers[at])
        places.append(at + 1)
        at += 1 + _KINDS[numbers[at]][1]
    if at > len(numbers):
        raise ValueError(f"its section {name!r} is cut short")
    return np.array(types, np.int64), np.array(places, np.int64)


def _polygons(node: Tree, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The types of polygons of three and four corners, and where the nodes of each begin.

    Before version 3.4 the number of its corners stood in front of each polygon.  Raises ValueError for other polygons.
    """
    offsets = next(node.children("DataArray_t", "ElementStartOffset"), None)
    if offsets is not None:
        ends = offsets.whole("where polygons begin").reshape(-1)
        places, widths = ends[:-1], np.diff(ends)
        if (widths < 0).any() or (len(ends) and (ends[0] != 0 or ends[-1] > len(nodes))):
            raise ValueError(f"the polygons of its section {node.name!r} begin out of order")
    else:
        numbers, at, found = nodes.tolist(), 0, []
        while at < len(numbers):
            found.append((at + 1, numbers[at]))
            at += 1 + max(numbers[at], 0)
        if at > len(numbers):
            raise ValueError(f"its section {node.name!r} is cut short")
        places, widths = np.array(found, np.int64).reshape(-1, 2).T
    wrong = ~np.isin(widths, (3, 4))
    if wrong.any():
        raise ValueError(
            f"its section {node.name!r} has polygons (NGON_n) of {widths[wrong][0]} corners; those of three and four "
            "can be improved: divide the others"
        )
    return np.where(widths == 3, 5, 7), places


def _check_kind(number: int, name: str) -> None:
    if number not in _KINDS:
        what = "planar elements of first and second order" if number in _HIGHER else "only planar meshes"
        raise ValueError(f"its section {name!r} has elements of type {number}; {what} can be improved")
