"""Gmsh's files (.msh), versions 2.2 and 4.1, text and binary, without loss; version 4.0 is read by meshio.

meshio's own reader forgets what its mesh type cannot hold (groups of entities without nodes, second physical
groups, node numbers, partitions, periodicity) and refuses files whose groups cover only some of the entities.
Here a file is the list of its sections.  Nodes and elements are parsed; all other sections are kept as the bytes
that they are, and written back.  Of $Entities one thing changes: where only some entities have a physical group, the
others are put into the group 0, so that meshio reads what is written.

    $MeshFormat ... $PhysicalNames ... $Entities ... $Nodes ... $Elements ... $NodeData ...

    gmsh_file    the sections and the parsed tables      gmsh_write  a known file with new content
    gmsh_read    a file from bytes                       gmsh_new    a new file for any mesh
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..fields import REGION_TAGS, region_tag
from . import gmsh_read, gmsh_write
from .format import ALL_BUT_POLYGONS, Document, Format
from .gmsh_file import DATA_SECTIONS, KINDS, MshFile, data_head, data_name
from .gmsh_new import new_file

# The sections that are parsed and built anew.
_KNOWN = ("MeshFormat", "PhysicalNames", "Entities", "Nodes", "Elements", "NodeData", "ElementData")


@dataclass(frozen=True)
class GmshFormat(Format):
    def recognises(self, head: bytes) -> bool:
        return head.lstrip().startswith(b"$")

    def read(self, path: Path) -> Document:
        mesh, file = gmsh_read.read(path)
        if file is None:
            with open(path, "rb") as stream:
                words = stream.read(200).split(b"$MeshFormat", 1)[-1].split()
            return Document(mesh, self.name, binary=words[1:2] == [b"1"])
        tied = gmsh_read.paired_nodes(file)
        corners = any(name == "ElementNodeData" for name, _ in file.sections)
        return Document(
            mesh, self.name, file.binary, file, repeats_triangles=file.version == "2.2", tied=tied,
            by_element=("$ElementNodeData",) if corners else (), **_own_numbers(file),
        )  # fmt: skip

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        file = like.rest if like is not None else None
        if file is None or not same_rows:
            binary = like is None or like.binary is None or like.binary
            mesh, file = new_file(mesh, file.version if file else _version(mesh), binary, file)
        gmsh_write.write(path, mesh, gmsh_read.with_group_0(file) if file.version == "4.1" else file)

    def remarks(self, like: Document | None, same_rows: bool) -> list[str]:
        file = like.rest if like is not None else None
        if like is not None and file is None:
            return [f"it is in version {_version(like.mesh)} instead of 4.0"]
        if file is None or file.version != "4.1" or gmsh_read.with_group_0(file) is file:
            return []
        return ["cells without a physical group are in the group 0 now, as meshio reads no file that has some of each"]

    def fit(self, mesh: meshio.Mesh) -> tuple[meshio.Mesh, set[str]]:
        """Beside what other formats do, the regions become physical groups."""
        fitted, lost = super().fit(mesh)
        tag = region_tag(mesh)
        if "gmsh:physical" not in fitted.cell_data and tag not in (None, "gmsh:geometrical"):
            fitted.cell_data["gmsh:physical"] = [v.astype(np.int64) for v in fitted.cell_data[tag]]
            if tag in REGION_TAGS:
                del fitted.cell_data[tag]
        return fitted, lost

    def left_behind(self, document: Document, target: Format, same_rows: bool) -> list[str]:
        if document.rest is None or (target is self and same_rows):
            return []
        sections = document.rest.sections
        timed = [
            f"times and steps of {data_name(payload)!r}"
            for name, payload in sections
            if name in DATA_SECTIONS and _is_timed(payload)
        ]
        file: MshFile = document.rest
        more = ["partitions of elements"] if any(block.tags.shape[1] > 2 for block in file.elements) else []
        if target is not self and any(len(groups) > 1 for groups in gmsh_read.entity_groups(file).values()):
            more.append("further physical groups of entities")
        return [*(f"${name}" for name, _ in sections if name not in _KNOWN), *dict.fromkeys(timed), *more]


def _is_timed(payload: bytes) -> bool:
    """Does a data section state another time, or another number of its step, than 0?"""
    _, (_, times, numbers) = data_head(payload)
    return any(float(word) != 0 for word in [*times, *numbers[:1]])


def _version(mesh: meshio.Mesh) -> str:
    """The version of a new file: 4.1, unless only a part of the cells has a physical group.

    Version 4.1 gives groups to entities, and meshio refuses files in which only some have one; 2.2 has 0 for none.
    """
    groups = mesh.cell_data.get("gmsh:physical", [])
    grouped = [bool(values.any()) for values in groups if len(values)]
    return "2.2" if any(grouped) and not all(bool(values.all()) for values in groups) else "4.1"


GMSH = GmshFormat("gmsh", (".msh",), ALL_BUT_POLYGONS, field_data=True, names_only=True)


def _own_numbers(file: MshFile) -> dict[str, Any]:
    """What Gmsh calls the nodes and elements, as `Document` has it."""
    cells: dict[str, list[np.ndarray]] = {}
    for block in file.elements:
        cells.setdefault(KINDS[block.kind][0], []).append(block.numbers)
    return {
        "node_numbers": np.concatenate([np.zeros(0, np.int64), *(block.numbers for block in file.nodes)]),
        "cell_numbers": {kind: np.concatenate(numbers) for kind, numbers in cells.items()},
    }
