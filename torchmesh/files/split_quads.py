"""A file whose quads have become two triangles each, as if it had been read with these triangles."""

from dataclasses import replace

import meshio
import numpy as np
import torch

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch
from ..mesh.quads import better_diagonals, halves_of, split_quads
from ..mesh.vertex_map import VertexMap
from .content import Content
from .fields import triangle_regions
from .source import Source

UNDIVIDED = (
    "its quads have mid-side nodes, and such quads do not become two triangles each: without quads='split' (--quads "
    "split) they stay quads, and with elements of first order they can be split"
)


def split_rows(like: Source, mesh: MeshBatch, vertex_map: VertexMap | None = None) -> torch.Tensor:
    """(Q,) bool, the quads of `like` that `mesh` has no more.

    Raises InvalidMeshError for a mesh with a quad that the file does not have.
    """
    now = mesh.quads if vertex_map is None else vertex_map.new_to_old[mesh.quads]
    given = like.mesh.quads
    known, number = torch.unique(torch.cat([given, now]).sort(1).values, dim=0, return_inverse=True)
    here = torch.zeros(len(known), dtype=torch.bool).index_fill_(0, number[len(given) :], True)
    gone = ~here[number[: len(given)]]
    if int((~gone).sum()) != len(now):
        raise InvalidMeshError(f"{like.path}: the mesh has quads that the file does not have")
    return gone


def with_split_quads(like: Source, gone: torch.Tensor) -> Source:
    """`like` with the quads `gone` (Q,) bool as two triangles each.

    The triangles follow the others, in the order of the quads, as `mesh.quads.split_quads` has them; both have the
    cell data and are in the cell sets of their quad.
    """
    if like.content.curved_quads[gone.numpy()].any():
        raise InvalidMeshError(f"{like.path}: {UNDIVIDED}")
    other = better_diagonals(like.mesh, gone)
    after = split_quads(like.mesh, gone, other)
    diagonal = torch.zeros_like(gone).index_put((gone.nonzero().squeeze(1),), other)
    content = _content(like.content, gone.numpy(), diagonal.numpy(), after)
    document = replace(like.document, mesh=content.mesh, cell_numbers={})
    return replace(like, document=document, content=content, mesh=after)


def _content(content: Content, gone: np.ndarray, diagonal: np.ndarray, after: MeshBatch) -> Content:
    """The content with the quads `gone` (Q,) bool as triangles behind all others.

    diagonal  (Q,) bool, the second diagonal splits the quad
    """
    file, row = content.mesh, 0
    kept, made, cells, more = [], [], [], []
    for block in file.cells:
        rows = np.arange(len(block.data))
        out = np.zeros(len(rows), bool)
        if block.type == "quad":
            own = content.quad[row : row + len(rows)]
            out, row = gone[own], row + len(rows)
            quads = np.where(diagonal[own[out]][:, None], np.roll(block.data[out], -1, 1), block.data[out])
            if out.any():
                more.append(meshio.CellBlock("triangle", halves_of(torch.from_numpy(quads)).numpy()))
                made.append(np.repeat(rows[out], 2))
        cells.append(meshio.CellBlock(block.type, block.data[~out]))
        kept.append(rows[~out])
    sources = [i for i, (b, k) in enumerate(zip(file.cells, kept, strict=True)) if len(k) < len(b.data)]
    mesh = meshio.Mesh(file.points, [*cells, *more], point_data=file.point_data, field_data=file.field_data)
    for name, values in file.cell_data.items():
        old = [v[k] for v, k in zip(values, kept, strict=True)]
        mesh.cell_data[name] = old + [values[i][m] for i, m in zip(sources, made, strict=True)]
    for name, members in file.cell_sets.items():
        flags = [np.isin(np.arange(len(b.data)), m) for b, m in zip(file.cells, members, strict=True)]
        old = [np.flatnonzero(f[k]) for f, k in zip(flags, kept, strict=True)]
        mesh.cell_sets[name] = old + [np.flatnonzero(flags[i][m]) for i, m in zip(sources, made, strict=True)]
    mesh.point_sets, mesh.info = file.point_sets, file.info
    vars(mesh).update({name: value for name, value in vars(file).items() if name not in vars(mesh)})
    rows = np.concatenate([content.rows, *(b.data for b in more)])
    _, first, triangle = np.unique(np.sort(rows, 1), axis=0, return_index=True, return_inverse=True)
    order = first.argsort()
    first, triangle = first[order], order.argsort()[triangle.reshape(-1)]
    number = gone.cumsum() - 1
    left = ~gone[content.quad]
    return replace(
        content,
        mesh=mesh,
        kinds=content.kinds.changed(kept, [len(block.data) for block in more]),
        middles=np.concatenate([content.middles, np.full((len(rows) - len(content.rows), 3), -1)]),
        rows=rows,
        first=first,
        triangle=triangle,
        region=triangle_regions(mesh, triangle, len(first), content.told_by),
        constrained=after.constrained_edges.numpy(),
        quad_rows=content.quad_rows[left],
        quad_middles=content.quad_middles[left],
        quad_first=_first_of(content.quad[left]),
        quad=(content.quad - 1 - number[content.quad])[left],
    )


def _first_of(numbers: np.ndarray) -> np.ndarray:
    """The first position of each number, in ascending order of the numbers."""
    return np.unique(numbers, return_index=True)[1]
