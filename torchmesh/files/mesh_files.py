"""Mesh files in and out: `read` makes a MeshBatch of one, `write` puts it back beside everything else.

What is not a triangle stays in the file's own data and comes back through `like`:

    file ---- read ----> MeshBatch  (points, triangles, fixed, constrained edges)
      \\                     |  improve
       `---- like ----> write ----> file  (the same fields, groups, lines, quads ...)
"""

import os
import warnings
from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
import torch

from ..errors import InvalidMeshError, MeshIOError, MeshWarning
from ..mesh import connectivity
from ..mesh.batch import MeshBatch, lift
from ..mesh.vertex_map import VertexMap
from . import formats
from .content import Content, on_triangles, region_names


def read(path: str | os.PathLike[str]) -> MeshBatch:
    """The triangles of a mesh file, as a batch of one.

    The format follows the extension (`formats.FORMATS`).  Points may lie in any plane.

    fixed              point data `fixed` where it is not zero; always the boundary, and the vertices
                       of cells that are neither triangles nor edges of them (quads, bars; vertex
                       cells unless every vertex has one)
    constrained_edges  edges between triangles of different regions, and line cells inside the mesh

    A region is told by cell data of integers, one a cell: under a name that means regions
    (`formats.REGION_TAGS`) always, under another one when it has at most half as many values as
    there are triangles (a number for every cell is an identity and no region); and by cell sets.
    Float fields are never regions.

    Raises MeshIOError (the file), InvalidMeshError (the mesh in it; both name the file), and
    MissingDependencyError (a package for the format).  MeshWarning tells of repairs.
    """
    return Source.open(path).mesh


@dataclass(frozen=True, eq=False)
class Source:
    """A file that was read, for whoever will write its mesh back: `write(..., like=source)` need not read it again.

    path      where it is
    document  all that is in it
    content   what of that binds the triangles
    mesh      the batch of one that `read` gives
    """

    path: Path
    document: formats.Document
    content: Content
    mesh: MeshBatch

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> "Source":
        """Raises and warns as `read` does."""
        path = _path(path)
        return cls.of(formats.load(path), path)

    @classmethod
    def of(cls, document: formats.Document, path: Path) -> "Source":
        content = Content.of(document, path)
        return cls(path, document, content, _batch(content, path))


def held(path: str | os.PathLike[str] | Source) -> torch.Tensor:
    """(V,) bool: the boundary and interface vertices of a file that must not slide; for `improve(..., hold=...)`.

    Those of quads and other cells that are not triangles, those of vertex cells (if not every vertex
    has one), those between lines of different tags or sets, and those that the point data `fixed`
    marks, unless it marks the whole boundary, as what `write` stores does.  Raises as `read` does.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)
        source = path if isinstance(path, Source) else Source.open(path)
    content, mesh = source.content, source.mesh
    hold = torch.from_numpy(content.pinned | content.seams)
    if content.fixed is not None:
        rim = connectivity.boundary_vertices(mesh.triangles, connectivity.twins(mesh.triangles), len(hold))
        marked = torch.from_numpy(content.fixed)
        if not bool(marked[rim].all()):
            hold |= marked
    return hold


def write(
    path: str | os.PathLike[str],
    mesh: MeshBatch,
    like: str | os.PathLike[str] | Source | None = None,
    vertex_map: VertexMap | None = None,
) -> None:
    """Writes a batch of one in the format of the path's extension, all or nothing.

    With `like`, the file the mesh was read from (it may be `path` itself), everything else of that
    file is carried over: fields, sets, names, lines, quads, version, text or binary.  Vertices that
    have not moved keep their coordinates to the bit.  When triangles changed, cell data is dropped
    that is neither a region nor a number for every cell; when their number or that of the vertices
    did, so is whatever has no place in the new mesh.  Region tags follow the boundary and the
    constrained edges, whatever the order of the rows.  A MeshWarning names what was dropped.

    vertex_map  of a remeshed mesh (`Report.vertex_map`): point data is interpolated at inserted vertices
                and integers copied; without it, point data of meshes that got other vertices is dropped

    `fixed` is stored as point data where `like` has it, or where it is not what `read` would find
    anyway.  Without `like`, constrained edges are stored as line cells.

    Raises MeshIOError, after which no trace is left and an existing file is as it was; and
    InvalidMeshError for a batch of several meshes.
    """
    path = _path(path)
    if len(mesh) != 1:
        raise InvalidMeshError(f"{path}: a file holds one mesh, this batch has {len(mesh)}: write each of mesh.split()")
    formats.format_of(path)
    if like is not None and not isinstance(like, Source):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeshWarning)  # they were given when the mesh was read
            like = Source.open(like)
    document, content, same_rows = content_for(path, mesh, like, vertex_map)
    formats.save(path, content, document, same_rows)


def content_for(
    path: Path, mesh: MeshBatch, like: Source | None, vertex_map: VertexMap | None = None
) -> tuple[formats.Document | None, meshio.Mesh, bool]:
    """What `formats.save` takes to write a batch of one at `path`; a MeshWarning names what is not carried over."""
    mesh = mesh.with_points(mesh.points.detach()).to("cpu")
    if like is None:
        document, content, same_rows = None, _fresh(mesh), False
    else:
        document = like.document
        content, dropped, same_rows = _carried(mesh, _Carry.plan(mesh, like.content, like.mesh, vertex_map))
        dropped += formats.foreign(document, formats.format_of(path), same_rows)
        if dropped:
            text = f"{path}: not carried over from {like.path}: {', '.join(dropped)}"
            warnings.warn(MeshWarning(text), stacklevel=3)
    content.points = _in_space(path, content.points, mesh, document)
    return document, content, same_rows


def _path(path: str | os.PathLike[str]) -> Path:
    try:
        return Path(path)
    except TypeError:
        raise MeshIOError(f"{path!r} is not a path") from None


def _batch(content: Content, path: Path) -> MeshBatch:
    fixed = content.pinned if content.fixed is None else content.pinned | content.fixed
    faces = content.rows[content.first]
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            mesh = MeshBatch.from_arrays(content.mesh.points, faces, fixed, content.walls)
    except InvalidMeshError as error:
        raise InvalidMeshError(f"{path}: {error}") from None
    lost = np.setdiff1d(np.flatnonzero(~content.elsewhere), faces)
    texts = [str(w.message) for w in said if "belong to no triangle" not in str(w.message)]
    texts += [f"{len(lost)} vertices belong to no cell; they are kept"] if len(lost) else []
    for text in texts:
        warnings.warn(MeshWarning(f"{path}: {text}"), stacklevel=3)
    return mesh


def _default_fixed(mesh: MeshBatch, pinned: np.ndarray | None = None) -> torch.Tensor:
    """(V,) bool what `read` finds fixed without being told."""
    count = len(mesh.points)
    rim = connectivity.boundary_vertices(mesh.triangles, connectivity.twins(mesh.triangles), count)
    rim[mesh.constrained_edges.reshape(-1)] = True
    rim |= connectivity.vertex_triangle_counts(mesh.triangles, count) == 0
    return rim if pinned is None else rim | torch.from_numpy(pinned)


def _fresh(mesh: MeshBatch) -> meshio.Mesh:
    cells = [("triangle", mesh.triangles.numpy())]
    if len(mesh.constrained_edges):
        cells.append(("line", mesh.constrained_edges.numpy()))
    plain = bool((mesh.fixed == _default_fixed(mesh)).all())
    point_data = {} if plain else {"fixed": mesh.fixed.numpy().astype(np.int32)}
    return meshio.Mesh(lift(mesh).numpy(), cells, point_data=point_data)


def _in_space(path: Path, points: np.ndarray, mesh: MeshBatch, like: formats.Document | None) -> np.ndarray:
    """Two or three coordinates, as the format of `path` wants them."""
    form = formats.format_of(path)
    if formats.FORMATS[form].planar:
        if bool((points[:, 2] != points[0, 2]).any()):
            warnings.warn(
                MeshWarning(f"{path}: {form} is two-dimensional: the mesh is laid into the plane"), stacklevel=3
            )
            return mesh.points.numpy()
        return points[:, :2]
    if like is not None and like.format == form and like.mesh.points.shape[1] == 2:
        return points[:, :2]
    return points


@dataclass(frozen=True)
class _Carry:
    """How the rows of a file answer to the rows of the mesh that takes their place.

    content      the file
    old          the mesh that was read from it
    new_vertex   (V_old,) row of each old vertex in the new mesh, -1 if it is gone
    changed      are there other triangles than before
    same_rows    has every triangle the row, and the region, it had
    faces        (T, 3) the triangles to write, wound as in the file
    source       (T,) the old triangle whose region tags each one takes; None: not to be told
    vertex_map   where new vertices take their fields from; None: not known
    """

    content: Content
    old: MeshBatch
    new_vertex: np.ndarray
    changed: bool
    same_rows: bool
    faces: np.ndarray
    source: np.ndarray | None
    vertex_map: VertexMap | None = None

    @classmethod
    def plan(cls, mesh: MeshBatch, content: Content, old: MeshBatch, vertex_map: VertexMap | None = None) -> "_Carry":
        before, after = old.triangles.numpy(), mesh.triangles.numpy()
        same_counts = len(after) == len(before) and len(mesh.points) == len(old.points)
        changed = not same_counts or bool((np.sort(before, 1) != np.sort(after, 1)).any())
        if vertex_map is None:
            new_vertex = _new_vertices(old, mesh, changed)
        else:
            _check_map(vertex_map, old, mesh)
            new_vertex = vertex_map.old_to_new.cpu().numpy()
        region = _new_regions(mesh, old, content.region, new_vertex) if changed else content.region
        if same_counts:
            region = np.where(region < 0, content.region, region)
        same_rows = same_counts and bool((region == content.region).all())
        raw = content.rows[content.first]
        turned = bool((raw != before).any(1).all())  # wholly clockwise in the file: it stays so
        faces = after[:, ::-1] if turned else after
        if same_counts:
            # The same three vertices may come back wound the other way, when one has travelled past the others.
            untouched = np.any([(raw == np.roll(faces, k, 1)).all(1) for k in range(3)], 0)
            untouched &= turned | (raw == before).all(1)
            faces = np.where(untouched[:, None], raw, faces)
        example = np.zeros(int(content.region.max()) + 1, np.int64)
        example[content.region] = np.arange(len(before))
        source = None if bool((region < 0).any()) else example[region]
        return cls(content, old, new_vertex, changed, same_rows, faces, source, vertex_map)


def _check_map(vertex_map: VertexMap, old: MeshBatch, mesh: MeshBatch) -> None:
    given, needed = (len(vertex_map.old_to_new), len(vertex_map.new_to_old)), (len(old.points), len(mesh.points))
    if given != needed:
        raise InvalidMeshError(
            f"vertex_map leads from {given[0]} to {given[1]} vertices, but the file has {needed[0]} and the mesh "
            f"{needed[1]}: give the map of this mesh (VertexMap.split gives those of a batch)"
        )


def _new_vertices(old: MeshBatch, mesh: MeshBatch, changed: bool) -> np.ndarray:
    """(V_old,) where each vertex went: nowhere while their number is the same, else by its coordinates."""
    here, there = old.points.to(mesh.points.dtype).numpy(), mesh.points.numpy()
    identity = np.arange(len(here))
    if len(here) == len(there) and not changed:
        return identity
    _, first, point = np.unique(np.concatenate([there, here]), axis=0, return_index=True, return_inverse=True)
    place = first[point.reshape(-1)[len(there) :]]
    place = np.where(place < len(there), place, -1)
    if len(here) == len(there):
        anchored = old.fixed.numpy()
        if not (place[anchored] >= 0).all() or 2 * (here == there).all(1)[anchored].sum() > anchored.sum():
            return identity
    return place


def _new_regions(mesh: MeshBatch, old: MeshBatch, region: np.ndarray, new_vertex: np.ndarray) -> np.ndarray:
    """(T,) the region of each new triangle, -1 where it cannot be told.

    Boundary and constrained edges are the walls of the regions and survive every change; each part
    between walls belongs to the region that its walls bordered on the same side before.
    """
    if len(np.unique(region)) == 1:
        return np.full(len(mesh.triangles), region[0])
    count = len(mesh.points)
    was, tail, head = _wall_sides(old)
    tail, head = new_vertex[tail.numpy()], new_vertex[head.numpy()]
    there = (tail >= 0) & (head >= 0)
    keys, sides = (tail * count + head)[there], region[(was // 3).numpy()[there]]
    order = keys.argsort()
    keys, sides = keys[order], sides[order]
    now, tail, head = _wall_sides(mesh)
    wanted = (tail * count + head).numpy()
    place = keys.searchsorted(wanted).clip(max=max(len(keys) - 1, 0))
    found = keys[place] == wanted if len(keys) else np.zeros(len(wanted), bool)
    blocked = torch.zeros(3 * len(mesh.triangles), dtype=torch.bool)
    blocked[now] = True
    part = connectivity.triangle_components(mesh.triangles, connectivity.twins(mesh.triangles), blocked).numpy()
    low = np.full(int(part.max()) + 1, np.iinfo(np.int64).max)
    high = np.full(len(low), -1)
    owner = part[(now // 3).numpy()[found]]
    np.minimum.at(low, owner, sides[place[found]])
    np.maximum.at(high, owner, sides[place[found]])
    return np.where(low == high, high, -1)[part]


def _wall_sides(mesh: MeshBatch) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """The half-edges on the boundary or constrained, their tails and their heads."""
    twin, count = connectivity.twins(mesh.triangles), len(mesh.points)
    tail, head = connectivity.tails(mesh.triangles), connectivity.heads(mesh.triangles)
    kept = connectivity.edge_keys(mesh.constrained_edges[:, 0], mesh.constrained_edges[:, 1], count)
    wall = ((twin < 0) | torch.isin(connectivity.edge_keys(tail, head, count), kept)).nonzero().squeeze(1)
    return wall, tail[wall], head[wall]


def _carried(mesh: MeshBatch, carry: _Carry) -> tuple[meshio.Mesh, list[str], bool]:
    """The file's mesh with new triangles; what was dropped; are all rows where they were."""
    file, dropped = carry.content.mesh, []
    names = [name for name in file.cell_data if not carry.changed or _survives(carry, name)]
    dropped += [f"cell data {name!r}" for name in file.cell_data if name not in names]
    sets = list(file.cell_sets) if carry.source is not None else []
    dropped += [f"cell set {name!r}" for name in file.cell_sets if name not in sets]
    pieces = _cell_pieces(carry)
    lost = sum(len(b.data) for b in file.cells if b.type != "triangle") - sum(
        len(data) for kind, data, _ in pieces if kind != "triangle"
    )
    if lost:
        dropped.append(f"{lost} cells whose vertices are gone")
    ends = np.cumsum([0] + [len(b.data) for b in file.cells])
    result = meshio.Mesh(_carried_positions(mesh, carry), [meshio.CellBlock(kind, data) for kind, data, _ in pieces])
    for name in names:
        values = np.concatenate(file.cell_data[name])
        result.cell_data[name] = [values[rows] for _, _, rows in pieces]
    for name in sets:
        member = np.zeros(ends[-1], bool)
        for start, rows in zip(ends[:-1], file.cell_sets[name], strict=True):
            member[start + rows] = True
        result.cell_sets[name] = [np.flatnonzero(member[rows]) for _, _, rows in pieces]
    _carry_point_data(mesh, carry, result, dropped)
    result.field_data, result.info = file.field_data, file.info
    extra = {name: value for name, value in vars(file).items() if name not in vars(result)}
    vars(result).update(extra)
    return result, dropped, carry.same_rows


def _survives(carry: _Carry, name: str) -> bool:
    """Cell data of changed triangles: region tags do, and so do the rows' own numbers if the rows do."""
    values = on_triangles(carry.content.mesh, carry.content.mesh.cell_data[name])
    if name in region_names(carry.content.mesh):
        return carry.source is not None
    whole = values.dtype.kind in "iu" and values.ndim == 1
    return carry.same_rows and whole and len(np.unique(values)) == len(values)


def _cell_pieces(carry: _Carry) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Each block to write: its kind, its cells, and for each cell the file's (counting all blocks) it stands for."""
    file, content = carry.content.mesh, carry.content
    ends = np.cumsum([0] + [len(b.data) for b in file.cells])
    kinds = np.concatenate([np.full(len(b.data), b.type == "triangle") for b in file.cells])
    cell_of_row = np.flatnonzero(kinds)
    pieces, row, placed = [], 0, False
    for start, block in zip(ends[:-1], file.cells, strict=True):
        if block.type != "triangle":
            data = carry.new_vertex[block.data]
            keep = (data >= 0).all(1)
            pieces.append((block.type, data[keep], start + np.flatnonzero(keep)))
        elif carry.same_rows:
            own = content.triangle[row : row + len(block.data)]
            pieces.append(("triangle", carry.faces[own], start + np.arange(len(block.data))))
            row += len(block.data)
        elif not placed:
            placed = True
            source = np.zeros(len(carry.faces), np.int64) if carry.source is None else carry.source
            order, copies = content.triangle.argsort(kind="stable"), np.bincount(content.triangle)
            rows = np.cumsum(copies) - copies
            for copy in range(int(copies.max())):  # Gmsh lists a triangle once for each of its groups
                some = copies[source] > copy
                pieces.append(("triangle", carry.faces[some], cell_of_row[order[rows[source[some]] + copy]]))
    return [piece for piece in pieces if carry.same_rows or len(piece[1])]


def _carried_positions(mesh: MeshBatch, carry: _Carry) -> np.ndarray:
    """(V, 3) in space; vertices that have not moved in their plane get the file's own coordinates."""
    given = carry.content.mesh.points
    given = np.pad(given, ((0, 0), (0, 3 - given.shape[1])))
    points = lift(mesh).numpy()
    points = points.astype(np.result_type(points, given))
    old = np.flatnonzero(carry.new_vertex >= 0)
    new = carry.new_vertex[old]
    still = (carry.old.points.to(mesh.points.dtype)[old] == mesh.points[new]).all(1).numpy()
    points[new[still]] = given[old[still]]
    return points


def _carry_point_data(mesh: MeshBatch, carry: _Carry, result: meshio.Mesh, dropped: list[str]) -> None:
    file, count = carry.content.mesh, len(mesh.points)
    there = np.flatnonzero(carry.new_vertex >= 0)
    before = np.full(count, -1)
    before[carry.new_vertex[there]] = there
    for name, values in file.point_data.items():
        if name == "fixed":
            continue
        if (before >= 0).all():
            result.point_data[name] = values[before]
        elif carry.vertex_map is not None:
            native = np.ascontiguousarray(values, values.dtype.newbyteorder("="))
            result.point_data[name] = carry.vertex_map.carry(torch.from_numpy(native)).numpy()
        else:
            dropped.append(f"point data {name!r}")
    for name, members in file.point_sets.items():
        at = carry.new_vertex[np.asarray(members, np.int64).reshape(-1)]
        result.point_sets[name] = at[at >= 0]
    marks = file.point_data.get("fixed")
    pinned = np.zeros(count, bool)
    pinned[carry.new_vertex[there]] = carry.content.pinned[there]
    if marks is not None:
        as_given = (before >= 0).all() and bool((mesh.fixed == carry.old.fixed[before]).all())
        result.point_data["fixed"] = marks[before] if as_given else mesh.fixed.numpy().astype(marks.dtype)
    elif bool((mesh.fixed != _default_fixed(mesh, pinned)).any()):
        result.point_data["fixed"] = mesh.fixed.numpy().astype(np.int32)
