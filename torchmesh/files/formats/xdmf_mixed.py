"""One grid of an XDMF file, read by meshio, which is handed a list of cells of several types as lists of one type.

    Mixed   36 0 1 2 3 4 5   37 1 6 7 2 8 9 10 4      a type, then the nodes; lines and polygons with their number first

meshio itself knows no curved cells in such lists.
"""

import itertools
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import meshio
import numpy as np

from .xdmf_text import alone

# XDMF's numbers of types: its names for them, and the number of nodes.  Cells of the types 2 and 3 have their number of
# nodes in front of these.
_KINDS = {1: ("Polyvertex", 1), 2: ("Polyline", 2), 4: ("Triangle", 3), 5: ("Quadrilateral", 4),
          6: ("Tetrahedron", 4), 7: ("Pyramid", 5), 8: ("Wedge", 6), 9: ("Hexahedron", 8), 34: ("Edge_3", 3),
          35: ("Quadrilateral_9", 9), 36: ("Triangle_6", 6), 37: ("Quadrilateral_8", 8)}  # fmt: skip
_OF_POLYGON = {3: 4, 4: 5}


def read_grid(path: Path, domain: ET.Element, grid: ET.Element) -> meshio.Mesh:
    """A grid of the domain as a mesh.  Raises ValueError for lists of cells that cannot be read."""
    reader = meshio.xdmf.main.XdmfReader(str(path))
    document = alone(domain, grid)
    own = document.find("Domain/Grid")
    assert own is not None
    for topology in own.findall("Topology"):
        item = topology.find("DataItem")
        if item is None or (topology.get("TopologyType") or topology.get("Type")) != "Mixed":
            continue
        place = list(own).index(topology)
        own.remove(topology)
        for name, nodes in _runs(np.asarray(reader._read_data_item(item)).reshape(-1)):
            made = ET.Element("Topology", TopologyType=name)
            size = " ".join(map(str, nodes.shape))
            part = ET.SubElement(made, "DataItem", DataType="Int", Precision="8", Format="XML", Dimensions=size)
            part.text = " ".join(map(str, nodes.reshape(-1).tolist()))
            own.insert(place, made)
            place += 1
    return reader.read_xdmf3(document)


def _runs(numbers: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Runs of cells of one type: XDMF's name of it and the nodes (n, k)."""
    values, at = numbers.astype(np.int64).tolist(), 0
    kinds, places = [], []
    while at < len(values):
        kind, start = values[at], at + 1
        if kind in (2, 3):
            count = values[start] if start < len(values) else 0
            if (kind == 2 and count != 2) or (kind == 3 and count not in _OF_POLYGON):
                raise ValueError(f"its list of mixed cells has one of the type {kind} with {count} nodes")
            kind, start = (2 if kind == 2 else _OF_POLYGON[count]), start + 1
        if kind not in _KINDS:
            raise ValueError(f"its list of mixed cells has the type {kind}, which is not known")
        kinds.append(kind)
        places.append(start)
        at = start + _KINDS[kind][1]
    if at > len(values):
        raise ValueError("its list of mixed cells is cut short")
    ends = [0, *(1 + np.flatnonzero(np.diff(kinds))).tolist(), len(kinds)]
    for low, high in itertools.pairwise(ends):
        if low < high:
            name, width = _KINDS[kinds[low]]
            yield name, numbers[np.array(places[low:high])[:, None] + np.arange(width)]
