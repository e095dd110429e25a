"""What a file calls its walls: boundaries and interfaces, as edges by name.

Names come from physical groups, markers and sets of line cells, and from side sets and surfaces.  An interface between
regions that has no name of its own is called as the regions are.
"""

from collections.abc import Iterator

import meshio
import numpy as np
import torch

from ..mesh.batch import MeshBatch
from ..mesh.connectivity import keys_of
from .content import Content
from .fields import REGION_TAGS
from .formats.groups import families, is_group
from .source import Source


def walls_of(source: Source) -> dict[str, torch.Tensor]:
    """The edges (K, 2) int64 of each wall that the file has a name for, as rows of vertices."""
    content, count = source.content, len(source.mesh.points)
    named = [(name, edges) for name, edges in lines_of(content) if len(edges)]
    known = torch.cat([torch.zeros(0, dtype=torch.int64), *(keys_of(edges, count) for _, edges in named)])
    for name, edges in _frames_of_regions(content, source.mesh):
        edges = edges[~torch.isin(keys_of(edges, count), known)]
        if len(edges):
            named.append((name, edges))
    walls: dict[str, list[torch.Tensor]] = {}
    for name, edges in named:
        walls.setdefault(name, []).append(edges)
    return {name: torch.cat(edges) for name, edges in walls.items()}


def lines_of(content: Content) -> Iterator[tuple[str, torch.Tensor]]:
    """The named groups of lines, and of sides of elements."""
    for name, edges in content.sides.items():
        yield name, torch.from_numpy(np.asarray(edges, np.int64).reshape(-1, 2))
    for name, rows in groups(content.mesh, 1):
        blocks = [b.data[r] for b, r in zip(content.mesh.cells, rows, strict=True) if b.type == "line"]
        yield name, torch.from_numpy(np.concatenate([np.zeros((0, 2), np.int64), *blocks]))


def _frames_of_regions(content: Content, mesh: MeshBatch) -> Iterator[tuple[str, torch.Tensor]]:
    """The interior edges between the triangles of a named group and others."""
    twin = mesh.twin
    inner = (twin >= 0).nonzero().squeeze(1)
    for name, rows in groups(content.mesh, 2):
        blocks = [np.zeros(len(b.data), bool) for b in content.mesh.cells]
        for block, members in zip(blocks, rows, strict=True):
            block[members] = True
        parts = [p for b, p in zip(content.mesh.cells, blocks, strict=True) if b.type == "triangle"]
        inside = np.zeros(len(content.first), bool)
        if parts:
            inside[content.triangle[np.concatenate(parts)]] = True
        own = torch.from_numpy(inside)
        h = inner[own[inner // 3] & ~own[twin[inner] // 3]]
        corners = mesh.triangles.reshape(-1)
        yield name, torch.stack([corners[h], corners[h - h % 3 + (h + 1) % 3]], 1)


def groups(mesh: meshio.Mesh, dimension: int) -> Iterator[tuple[str, list[np.ndarray]]]:
    """The named groups of cells of a dimension: for each block the rows that are in the group."""
    for name, members in mesh.cell_sets.items():
        yield name, [np.asarray(m, np.int64) for m in members]
    # What MED calls families: numbers with any number of names, of cells of any dimension.
    for name, masks in families(mesh).items():
        yield str(name), [np.flatnonzero(mask) for mask in masks]
    tags = next((mesh.cell_data[tag] for tag in REGION_TAGS if tag in mesh.cell_data), None)
    if tags is None:
        return
    numbered = [
        (name, int(value[0]))
        for name, value in mesh.field_data.items()
        if is_group(value) and int(value[1]) == dimension
    ]
    for name, number in numbered:
        yield name, [np.flatnonzero(values == number) for values in tags]
