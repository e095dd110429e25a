"""Puts the content of a file round the triangles of a new mesh."""

from typing import NamedTuple

import meshio
import numpy as np
import torch

from ..mesh.batch import MeshBatch, lift
from .content import Content
from .correspondence import Correspondence
from .field_transfer import FieldTransfer, is_floating, is_motion
from .fields import is_numbering, on_triangles
from .placed import Placed
from .quads import on_quads
from .source import default_fixed
from .surface import HeightChoice


class _Block(NamedTuple):
    """Cells to write.

    type      their type
    data      (n, k) their vertices
    origin    (n,) for each the file's cell, counted over all blocks
    triangle  (n,) which triangle of the mesh each one is; None for other cells
    quad      (n,) which quad each one is; None for other cells
    """

    type: str
    data: np.ndarray
    origin: np.ndarray
    triangle: np.ndarray | None = None
    quad: np.ndarray | None = None

    def values(self, given: np.ndarray, made: tuple[np.ndarray, np.ndarray] | None) -> np.ndarray:
        """The values of the cells: those `made` for all triangles and quads, or those `given` with the file's cells."""
        if made is None or (self.triangle is None and self.quad is None):
            return given[self.origin]
        return made[0][self.triangle] if self.quad is None else made[1][self.quad]


def carried(
    mesh: MeshBatch,
    old: Correspondence,
    fields: FieldTransfer | None = None,
    height: HeightChoice = "interpolate",
    placed: Placed | None = None,
) -> tuple[meshio.Mesh, list[str]]:
    """The file's mesh with the new triangles, to be written; and names for what has to be left out of it.

    fields  transfers the fields to where vertices and triangles are now; None: they ride with vertices and rows
    height  where vertices of a surface have moved, their heights are interpolated, or ride
    placed  the mesh with its mid-side nodes, for a file with six-node triangles
    """
    file, dropped = old.source.content.mesh, []
    sets = list(file.cell_sets) if old.example is not None else []
    dropped += [f"cell set {name!r}" for name in file.cell_sets if name not in sets]
    blocks = _blocks(old)
    others = sum(len(b.data) for b in file.cells if b.type != "triangle")
    lost = others - sum(len(b.data) for b in blocks if b.type != "triangle")
    if lost:
        dropped.append(f"{lost} cells whose vertices are gone")
    result = meshio.Mesh(_positions(mesh, old, height, placed), _as_in_the_file(blocks, old, placed))
    dropped = _carry_cell_data(old, fields, blocks, result) + dropped
    for name in sets:
        flags = [np.isin(np.arange(len(b.data)), m) for b, m in zip(file.cells, file.cell_sets[name], strict=True)]
        member, made = np.concatenate([np.zeros(0, bool), *flags]), None
        if old.changed and name not in old.source.content.told_by.sets:
            if fields is None or fields.drops:
                dropped.append(f"cell set {name!r}")
                continue
            made = fields.in_triangles(name, on_triangles(file, flags)[old.source.content.first])
        result.cell_sets[name] = [
            np.flatnonzero(member[b.origin] if made is None or b.triangle is None else made[b.triangle]) for b in blocks
        ]
    dropped += _carry_point_data(old, fields, result)
    _mark_fixed(mesh, old, result)
    result.field_data, result.info = file.field_data, file.info
    # meshio's readers put attributes on a mesh that its type does not declare, such as the families of MED.
    vars(result).update({name: value for name, value in vars(file).items() if name not in vars(result)})
    return result, dropped


def _as_in_the_file(blocks: list[_Block], old: Correspondence, placed: Placed | None) -> list[meshio.CellBlock]:
    """The blocks in the types of the file, with the mid-side nodes that these have."""
    kinds = old.source.content.kinds
    starts = np.cumsum([0] + [len(nodes) for nodes in kinds.middles])
    made = []
    for block in blocks:
        kind, nodes = block.type, np.zeros((len(block.data), 0), np.int64)
        if len(block.origin):
            own = int(starts.searchsorted(block.origin[0], "right")) - 1
            kind = kinds.names[own]
            if kinds.middles[own].shape[1] in (1, 4, 5):  # no side of a quad flips
                nodes = old.new_vertex[kinds.middles[own][block.origin - starts[own]]]
            elif kinds.middles[own].shape[1] == 3:
                assert placed is not None
                nodes = placed.middles.of_sides(block.data)
        kind = "triangle" if kind == "polygon" and block.type == "triangle" else kind
        made.append(meshio.CellBlock(kind, np.concatenate([block.data, nodes], 1) if nodes.shape[1] else block.data))
    return made


def _by_kind(blocks: list[_Block], old: Correspondence) -> list[_Block]:
    """The blocks of triangles, divided where they are in the place of cells of several types."""
    kinds = old.source.content.kinds
    sizes = [len(nodes) for nodes in kinds.middles]
    of_cell = np.repeat([kinds.names.index(name) for name in kinds.names], sizes)
    made = []
    for block in blocks:
        kind = of_cell[block.origin]
        for one in np.unique(kind) if block.triangle is not None and len(kind) else [None]:
            some = slice(None) if one is None else kind == one
            triangle = None if block.triangle is None else block.triangle[some]
            made.append(_Block(block.type, block.data[some], block.origin[some], triangle))
    return made


def _carry_cell_data(
    old: Correspondence, fields: FieldTransfer | None, blocks: list[_Block], result: meshio.Mesh
) -> list[str]:
    """Gives `result` the cell data; returns names for what has no values in the new triangles."""
    content, dropped = old.source.content, []
    regions = content.told_by.data
    for name, given in content.mesh.cell_data.items():
        values, made = np.concatenate(given), None
        on_rows = on_triangles(content.mesh, given)
        if _is_transferred(fields, name, on_rows, regions):
            assert fields is not None
            if fields.drops:
                fields.summary.dropped.append(name)
                continue
            own = on_quads(content.mesh, given)[content.quad_first]
            made = fields.in_elements(name, on_rows[content.first], own)
        elif old.changed and not _survives(old, name, on_rows, regions):
            dropped.append(f"cell data {name!r}")
            continue
        result.cell_data[name] = [b.values(values, made) for b in blocks]
    return dropped


def _is_transferred(fields: FieldTransfer | None, name: str, values: np.ndarray, regions: tuple[str, ...]) -> bool:
    """Is cell data a property of the place?  Region tags follow the interfaces, and numbers of cells their rows."""
    if fields is None or name in regions or fields.unchanged:
        return False
    return is_floating(values) or not (fields.drops or is_numbering(values))


def _survives(old: Correspondence, name: str, values: np.ndarray, regions: tuple[str, ...]) -> bool:
    """Does cell data, whose rows of triangles are `values`, hold for changed triangles?

    Region tags do, if the regions can be told; so do the numbers of the rows, if the rows are the same; and so do whole
    numbers that are the same in all triangles.
    """
    if name in regions:
        return old.example is not None
    if values.dtype.kind in "iub" and bool((values == values[:1]).all()):
        return True
    return old.same_rows and is_numbering(values)


def _blocks(old: Correspondence) -> list[_Block]:
    """The cells to write.

    Triangles stay in their rows if these are the same; otherwise all stand where the file's first ones do.  Other
    cells stay where they are, less those of which a vertex is gone.
    """
    content = old.source.content
    ends = np.cumsum([0] + [len(b.data) for b in content.mesh.cells])
    blocks: list[_Block] = []
    row, quads, written = 0, 0, False
    for start, block, nodes in zip(ends[:-1], content.mesh.cells, content.kinds.middles, strict=True):
        if block.type != "triangle":
            data = old.new_vertex[block.data]
            keep = (data >= 0).all(1) & (old.new_vertex[nodes] >= 0).all(1)
            number = None
            if block.type == "quad":
                number, quads = content.quad[quads : quads + len(data)][keep], quads + len(data)
            blocks.append(_Block(block.type, data[keep], start + np.flatnonzero(keep), quad=number))
        elif old.same_rows:
            own = content.triangle[row : row + len(block.data)]
            blocks.append(_Block("triangle", old.faces[own], start + np.arange(len(block.data)), own))
            row += len(block.data)
        elif not written:
            written = True
            blocks += _triangle_blocks(content, old)
    blocks = [block for block in blocks if old.same_rows or len(block.data)]
    return blocks if old.same_rows else _by_kind(blocks, old)


def _triangle_blocks(content: Content, old: Correspondence) -> list[_Block]:
    """All new triangles; a second block repeats those whose example the file lists twice, and so on."""
    cell_of_row = np.flatnonzero(
        np.concatenate([np.full(len(b.data), b.type == "triangle") for b in content.mesh.cells])
    )
    example = np.zeros(len(old.faces), np.int64) if old.example is None else old.example
    order, copies = content.triangle.argsort(kind="stable"), np.bincount(content.triangle)
    first = np.cumsum(copies) - copies
    blocks = []
    for copy in range(int(copies.max(initial=0))):
        some = np.flatnonzero(copies[example] > copy)
        blocks.append(_Block("triangle", old.faces[some], cell_of_row[order[first[example[some]] + copy]], some))
    return blocks


def _positions(mesh: MeshBatch, old: Correspondence, height: HeightChoice, placed: Placed | None) -> np.ndarray:
    """(V, 3) in space; vertices that have not moved in their plane get the file's own coordinates."""
    given = old.source.content.mesh.points
    given = np.pad(given, ((0, 0), (0, 3 - given.shape[1])))
    points = lift(mesh).numpy()
    points = points.astype(np.result_type(points, given))
    if old.source.surface is not None:
        transfer = FieldTransfer(old.source.mesh, mesh)
        if placed is not None and old.source.middles is not None:
            transfer = transfer.through_nodes(Placed(old.source.mesh, old.source.middles), placed)
        old.source.surface.put_into(points, transfer, old.old_vertex, height)
    before = np.flatnonzero(old.new_vertex >= 0)
    now = old.new_vertex[before]
    still = (old.source.mesh.points.to(mesh.points.dtype)[before] == mesh.points[now]).all(1).numpy()
    points[now[still]] = given[before[still]]
    return points


def _carry_point_data(old: Correspondence, fields: FieldTransfer | None, result: meshio.Mesh) -> list[str]:
    """Gives `result` the point data and point sets; returns names for what has no values at new vertices."""
    file, dropped = old.source.content.mesh, []
    for name, values in file.point_data.items():
        if name == "fixed":
            continue
        if fields is not None and not fields.unchanged and is_floating(values):
            if is_motion(name):
                fields.summary.carried.append(name)
            elif fields.drops:
                fields.summary.dropped.append(name)
                continue
            else:
                result.point_data[name] = fields.at_points(name, values, old.old_vertex)
                continue
        if (old.old_vertex >= 0).all():
            result.point_data[name] = values[old.old_vertex]
        elif old.vertex_map is not None:
            native = np.ascontiguousarray(values, values.dtype.newbyteorder("="))
            result.point_data[name] = old.vertex_map.carry(torch.from_numpy(native)).numpy()
        else:
            dropped.append(f"point data {name!r}")
    for name, members in file.point_sets.items():
        at = old.new_vertex[np.asarray(members, np.int64).reshape(-1)]
        result.point_sets[name] = at[at >= 0]
    return dropped


def _mark_fixed(mesh: MeshBatch, old: Correspondence, result: meshio.Mesh) -> None:
    """Stores `fixed` where the file has it, or where `read` would not find the same without it."""
    marks = old.source.content.mesh.point_data.get("fixed")
    if marks is not None:
        kept = (old.old_vertex >= 0).all()
        as_given = kept and bool((mesh.fixed == old.source.mesh.fixed[old.old_vertex]).all())
        result.point_data["fixed"] = marks[old.old_vertex] if as_given else mesh.fixed.numpy().astype(marks.dtype)
        return
    before = np.flatnonzero(old.new_vertex >= 0)
    pinned = np.zeros(len(mesh.points), bool)
    pinned[old.new_vertex[before]] = old.source.content.pinned[before]
    if bool((mesh.fixed != default_fixed(mesh, pinned)).any()):
        result.point_data["fixed"] = mesh.fixed.numpy().astype(np.int32)
