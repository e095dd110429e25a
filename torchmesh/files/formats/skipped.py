"""What is in a file that its reader passes over, by name, so that its loss can be told.

Each function takes the bytes of a file of one format, or its path where the format is HDF5, and gives names.  Lines
that meshio writes of itself into every file are no content.
"""

import re
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from .checks import is_binary_stl

# The names of Medit's binary keywords that a mesh of triangles can do without.
_GMF_OTHERS = {13: "Corners", 14: "Ridges", 15: "RequiredVertices", 16: "RequiredEdges", 17: "RequiredTriangles",
               18: "RequiredQuadrilaterals", 20: "NormalAtVertices", 58: "Tangents", 59: "TangentAtVertices",
               60: "Normals"}  # fmt: skip
# Version, dimension, vertices, and all kinds of cells; the end.
_GMF_KNOWN = {1, 3, 4, 5, 6, 7, 8, 9, 10, 49, 54}

_MEDIT_KNOWN = {"MeshVersionFormatted", "Dimension", "Vertices", "Edges", "Triangles", "Quadrilaterals", "End"}
_MEDIT_KNOWN |= {"Tetrahedra", "Hexahedra", "Prisms", "Pyramids"}

_PERMAS_KNOWN = ("ENTER COMPONENT", "STRUCTURE", "COOR", "ELEMENT", "END STRUCTURE", "EXIT COMPONENT", "FIN")

_NETGEN_SKIPPED = rb"face_colours|singular_edge_left|singular_edge_right|singular_face_inside|singular_face_outside"

# Comments with which Netgen and meshio say what stands in the columns below.
_NETGEN_HEADS = rb"#\s*(Generated|surfnr|surfid|matnr|pnum|p1|X)\b"

_XML_KNOWN = {
    "vtu": {"VTKFile", "UnstructuredGrid", "Piece", "Points", "Cells", "DataArray", "PointData", "CellData",
            "FieldData", "AppendedData"},
    "dolfin-xml": {"dolfin", "mesh", "vertices", "vertex", "cells", "triangle"},
    "xdmf": {"Xdmf", "Domain", "Grid", "xi", "Geometry", "Topology", "DataItem", "Attribute"},
}  # fmt: skip


def in_off(data: bytes) -> list[str]:
    return _comments(data, b"#")


def in_stl(data: bytes) -> list[str]:
    if not is_binary_stl(data):
        name = data.split(b"\n", 1)[0].strip().removeprefix(b"solid").strip()
        return [f"the name {_text(name)!r}"] if name else []
    head = data[:80].strip(b"\0 ")
    found = [] if not head or b"meshio" in head else [f"the title {_text(head)!r}"]
    rows = np.frombuffer(data, [("corners", "V48"), ("attribute", "<u2")], offset=84)
    return [*found, "attributes of triangles"] if rows["attribute"].any() else found


def in_ply(data: bytes) -> list[str]:
    found: list[str] = []
    for line in data[: data.find(b"end_header")].split(b"\n"):
        words = line.split()
        if words[:1] == [b"comment"] and b"Created by meshio" not in line:
            found.append("comments")
        elif words[:1] == [b"obj_info"]:
            found.append("obj_info")
        elif words[:1] == [b"element"] and len(words) > 1 and words[1] not in (b"vertex", b"face"):
            found.append(f"the elements {_text(words[1])!r}")
    return found


def in_medit(data: bytes) -> list[str]:
    if data[:4] in (b"\1\0\0\0", b"\0\0\0\1"):
        return _in_binary_medit(data)
    names = re.findall(rb"^[ \t]*([A-Za-z]\w*)", data, re.M)
    return [*_comments(data, b"#"), *(name for name in map(_text, names) if name not in _MEDIT_KNOWN)]


def _in_binary_medit(data: bytes) -> list[str]:
    """Keywords stand in a chain: a number, the place of the next one, the content."""
    order = "<" if data[0] else ">"
    version = struct.unpack_from(order + "i", data, 4)[0]
    place, found, at = order + ("i" if version < 3 else "q"), [], 8
    while 0 < at <= len(data) - 4 - struct.calcsize(place):
        (code,), (following,) = struct.unpack_from(order + "i", data, at), struct.unpack_from(place, data, at + 4)
        if code not in _GMF_KNOWN:
            found.append(_GMF_OTHERS.get(code, f"the keyword {code}"))
        at = following if following > at else 0
    return found


def in_netgen(data: bytes) -> list[str]:
    found = re.findall(rb"^(%b|singular_points)\s+[1-9]" % _NETGEN_SKIPPED, data, re.M)
    found += re.findall(rb"^(surfaceelementsgi|surfaceelementsuv)\s", data, re.M)
    # A row begins with the numbers of its surface, boundary condition and domains, of which the second is kept.
    rows = re.findall(rb"^\s*(\d+) +\d+ +(\d+) +(\d+) +[34] +\d+ +\d+ +\d+", data, re.M)
    domains = [b"domains of surfaceelements"] if any(row[1:] != (b"0", b"0") for row in rows) else []
    names = re.findall(rb"^[ \t]*\d+[ \t]+([^\s\d][^\r\n]*?[ \t]+[^\r\n]*\S)", _netgen_names(data), re.M)
    lost = [f"the name {_text(name)!r}" for name in names]
    return [*_comments(data, b"#", but=_NETGEN_HEADS), *map(_text, found + domains), *lost]


def _netgen_names(data: bytes) -> bytes:
    """The sections of names: of those names that are several words meshio reads none."""
    sections = re.findall(rb"^(?:materials|bcnames|cd[23]names)[ \t\r]*\n(?:[ \t]*\d.*\n?)*", data, re.M)
    return b"\n".join(sections)


def in_permas(data: bytes) -> list[str]:
    words = [_text(line).strip().upper() for line in re.findall(rb"^\$([^\r\n]*)", data, re.M)]
    found = [f"${word.split('NAME')[0].strip()}" for word in words if not word.startswith(_PERMAS_KNOWN)]
    name = re.search(rb"^\$ENTER COMPONENT\s+NAME\s*=\s*(\S+)", data, re.M | re.I)
    names = [f"the name {_text(name[1])!r}"] if name and name[1].upper() != b"DFLT_COMP" else []
    types = re.findall(rb"^\$ELEMENT\s+TYPE\s*=\s*(\w+)", data, re.M | re.I)
    others = [f"the element type {_text(kind)}" for kind in types if not _is_written_in_permas(_text(kind).upper())]
    return [*_comments(data, b"!", but=rb"!PERMAS|!\s*$"), *names, *others, *found]


def _is_written_in_permas(kind: str) -> bool:
    """Does meshio write elements of this type under the same name?"""
    from meshio.permas._permas import meshio_to_permas_type, permas_to_meshio_type

    return meshio_to_permas_type.get(permas_to_meshio_type.get(kind, "")) == kind


def in_avs(data: bytes) -> list[str]:
    return _comments(data, b"#")


def in_tecplot(data: bytes) -> list[str]:
    title = re.search(rb'^\s*TITLE\s*=\s*"?([^"\r\n]*)', data, re.M | re.I)
    found = [f"the title {_text(title[1])!r}"] if title and b"meshio" not in title[1] else []
    kinds = re.findall(rb"^\s*(TEXT|GEOMETRY|CUSTOMLABELS|DATASETAUXDATA|VARAUXDATA|AUXDATA)\b", data, re.M | re.I)
    zone = re.search(rb"^\s*ZONE\b.*?(?=^\s*[-+.\d])", data, re.M | re.S | re.I)
    inside = (
        re.findall(rb"\b(T|SOLUTIONTIME|STRANDID|PARENTZONE)\s*=\s*(\"[^\"]*\"|[^\s,]+)", zone[0], re.I) if zone else []
    )
    found += [f"{_text(key).upper()}={_text(value)}" for key, value in inside if value != b'"Zone 1"']
    return [*_comments(data, b"#"), *found, *(_text(kind).upper() for kind in kinds)]


def in_vtk(data: bytes) -> list[str]:
    tables = re.findall(rb"^LOOKUP_TABLE\s+(\S+)\s+\d+\s*$", data, re.M)
    found = [f"the lookup table {_text(name)!r}" for name in tables]
    return [*found, "METADATA"] if re.search(rb"^METADATA\s*$", data, re.M) else found


def in_xml(data: bytes, form: str) -> list[str]:
    """Elements of an XML file that are not known, comments, and arrays that are no numbers."""
    found = ["comments"] if re.search(rb"<!--(?!\s*This file was created by meshio)", _without_raw(data)) else []
    head = _without_raw(data)
    tags = {_text(name) for name in re.findall(rb"<([A-Za-z]\w*)", head)}
    found += [f"<{tag}>" for tag in sorted(tags - _XML_KNOWN[form])]
    if form == "xdmf":
        names = [_text(name) for name in re.findall(rb"<Grid\b[^>]*\bName=\"([^\"]*)\"", head)]
        found += [f"the name {name!r}" for name in names if name not in ("Grid", "mesh", "")]
    if form == "vtu":
        for name in re.findall(rb"<(?:Data)?Array[^>]*type=\"String\"[^>]*>", head):
            title = re.search(rb'Name="([^"]*)"', name)
            found.append(f"the text {_text(title[1]) if title else ''!r}")
        found += [f"the active {_text(kind)} {_text(name)!r}" for kind, name in re.findall(
            rb"<(?:Point|Cell)Data[^>]*?\b(Scalars|Vectors|Normals|Tensors|TCoords)=\"([^\"]+)\"", head)]  # fmt: skip
    return found


def _without_raw(data: bytes) -> bytes:
    """An XML file as far as it is text: raw binary data may follow."""
    return data.partition(b"<AppendedData")[0]


def in_med(path: Path) -> list[str]:
    import h5py

    found: list[str] = []

    def look(name: str, item: Any) -> None:
        words = name.split("/")
        if words[0] == "ENS_MAA" and isinstance(item, h5py.Dataset) and words[-1] not in ("COO", "FAM", "NOD"):
            found.append(f"{words[-1]} of {words[-2]}")

    with h5py.File(path, "r") as file:
        found += [name for name in file if name not in ("INFOS_GENERALES", "ENS_MAA", "FAS", "CHA")]
        for name, mesh in file.get("ENS_MAA", {}).items():
            found += [f"the name {name!r}"] if name != "mesh" else []
            description = _attribute(mesh, "DES")
            found += [f"the description {description!r}"] if description and "meshio" not in description else []
            found += ["units of coordinates"] if _attribute(mesh, "UNI") or _attribute(mesh, "UNT") else []
        for name, steps in file.get("CHA", {}).items():
            found += [f"units of {name!r}"] if _attribute(steps, "UNI") or _attribute(steps, "UNT") else []
            times = [float(step.attrs.get("PDT", 0.0)) for step in steps.values()]
            found += [f"times of {name!r}"] if any(time not in (0.0, -1.0) for time in times) else []
        file.visititems(look)
    return found


def _attribute(item: Any, name: str) -> str:
    """An attribute of HDF5 that is text; "" where there is none."""
    value = item.attrs.get(name, b"")
    return (_text(value) if isinstance(value, bytes) else str(value)).strip("\0 ")


def in_hmf(path: Path) -> list[str]:
    import h5py

    known = {"type", "version", "TopologyType", "GeometryType"}
    found: list[str] = []
    with h5py.File(path, "r") as file:
        found += [f"the attribute {name!r}" for name in file.attrs if name not in known]
        file.visititems(
            lambda name, item: found.extend(
                f"the attribute {key!r} of {name}" for key in item.attrs if key not in known
            )
        )
    return found


def in_h5m(path: Path) -> list[str]:
    import h5py

    found: list[str] = []
    known = ("coordinates", "connectivity", "history", "GLOBAL_ID", "elemtypes", "id_list", "values")

    def look(name: str, item: Any) -> None:
        words = name.split("/")
        if isinstance(item, h5py.Dataset) and words[-1] not in known:
            found.append("/".join(words[1:]))

    with h5py.File(path, "r") as file:
        file.visititems(look)
    return found


def each_once(names: Iterable[str]) -> tuple[str, ...]:
    """The names without control characters, each once; of more than ten the first ten, and that there are more."""
    found = list(dict.fromkeys("".join(c if c.isprintable() else "?" for c in name)[:80] for name in names))
    return (*found[:10], f"{len(found) - 10} more of the kind") if len(found) > 10 else tuple(found)


def _comments(data: bytes, sign: bytes, but: bytes = b"") -> list[str]:
    """["comments"] if a line begins with the sign, is not meshio's own, and does not match `but`; else none."""
    for line in re.findall(rb"^[ \t]*(%b[^\r\n]*)" % re.escape(sign), data, re.M):
        if b"meshio" not in line and not (but and re.match(but, line)):
            return ["comments"]
    return []


def _text(words: bytes) -> str:
    return words.decode(errors="replace").strip()
