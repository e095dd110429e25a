"""Mesh files in and out: `read` makes a MeshBatch of one, `write` puts it back beside everything else.

What is not a triangle stays in the file's own data and comes back through `like`:

    file ---- read ----> MeshBatch  (points, triangles, fixed, constrained edges)
      \\                     |  improve
       `---- like ----> write ----> file  (the same fields, groups, lines, quads ...)
"""

import os
import warnings
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import torch

from ..errors import InvalidMeshError, MeshWarning
from ..mesh import connectivity
from ..mesh.batch import MeshBatch, lift
from ..mesh.quads import halved
from ..mesh.typed import typed
from ..mesh.vertex_map import VertexMap
from .carry_over import carried
from .correspondence import Correspondence
from .curved import ends_of_curved, given, replaced
from .drafts import Draft
from .field_transfer import FieldChoice, FieldTransfer, check_choice, mesh_of_values
from .formats.format import Document
from .formats.registry import FORMATS, format_of
from .messages import warn
from .placed import Placed
from .source import Source, as_path, default_fixed
from .split_quads import split_rows, with_split_quads
from .surface import HeightChoice, check_height

# The corners and nodes of cells that are turned round.
_TURNED = {"triangle": [0, 2, 1], "quad": [0, 3, 2, 1], "triangle6": [0, 2, 1, 5, 4, 3],
           "quad8": [0, 3, 2, 1, 7, 6, 5, 4], "quad9": [0, 3, 2, 1, 7, 6, 5, 4, 8]}  # fmt: skip


def read(path: str | os.PathLike[str], *, regions: str | None = None) -> MeshBatch:
    """The triangles and quads of a mesh file, as a batch of one.

    The format follows the extension (`formats.registry`).  Points may lie in any plane.  Of a surface that is a map of
    a plane, such as terrain, the mesh is that in plan, and the heights stay with the file (`surface.Surface`).

    fixed              point data `fixed` where it is not zero; always the boundary, and the vertices of cells that
                       are neither triangles, quads nor edges of them (bars; vertex cells unless every vertex has one)
    constrained_edges  edges between triangles of different regions, and line cells inside the mesh; their ends are
                       not `fixed`, but what moves vertices holds them unless it is told otherwise

    regions  None: regions are told by cell sets, and by cell data of integers with one component whose name means
             regions: those of `fields.REGION_TAGS` (physical groups, blocks, materials), and names with a word such as
             material, region, domain, zone, block, phase, group, attribute, label, tag or property, if there are at
             most half as many values as triangles.  Other data that repeats (rank, part_id, level, flag) tells none,
             and neither do fields of floats.  "none": nothing does.  Otherwise the name of the one cell data (of
             whole numbers) or cell set that does

    Raises MeshIOError (the file), InvalidMeshError (the mesh in it; both name the file), and MissingDependencyError
    (a package for the format).  A MeshWarning tells of each repair.
    """
    return Source.open(path, regions).mesh


def held(path: str | os.PathLike[str] | Source) -> torch.Tensor:
    """(V,) bool: the boundary and interface vertices of a file that must not slide; for `improve(..., hold=...)`.

    These are the vertices of cells that are neither triangles nor quads, those of vertex cells (if not every
    vertex has one), those between lines of different tags or sets, those that are paired by Gmsh's $Periodic, and those
    that the point data `fixed` marks, unless it marks the whole boundary, as what `write` stores does.
    Raises as `read` does.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)
        source = path if isinstance(path, Source) else Source.open(path)
    content, mesh = source.content, source.mesh
    hold = torch.from_numpy(content.pinned | content.seams)
    hold[torch.from_numpy(source.document.tied)] = True
    if source.middles is not None:
        hold[ends_of_curved(source)] = True
    if content.fixed is not None:
        edges = halved(mesh)
        boundary = connectivity.boundary_vertices(edges.triangles, edges.twin, len(hold))
        marked = torch.from_numpy(content.fixed)
        if not bool(marked[boundary].all()):
            hold |= marked
    return hold


@typed
def write(
    path: str | os.PathLike[str],
    mesh: MeshBatch,
    like: str | os.PathLike[str] | Source | None = None,
    vertex_map: VertexMap | None = None,
    *,
    fields: FieldChoice = "carry",
    before: MeshBatch | None = None,
    height: HeightChoice = "interpolate",
) -> None:
    """Writes a batch of one in the format of the path's extension, whole or not at all.

    With `like`, the file that the mesh was read from (it may be `path` itself), everything else of that file is
    carried over: fields, sets, names, lines, quads, version, text or binary.  Vertices that have not moved keep
    their coordinates to the bit.  When triangles changed, cell data is dropped unless it tells regions, is a number
    for every cell, or is transferred (`fields`).  When the number of triangles or vertices changed, everything is
    dropped that has no place in the new mesh.  Region tags follow the boundary and the constrained edges, whatever the
    order of the rows.  A MeshWarning names what was dropped.

    vertex_map  of a remeshed mesh (`Report.vertex_map`): point data is interpolated at inserted vertices and integers
                are copied; without it, point data of meshes that got other vertices is dropped
    fields      "carry": values ride with their vertices, which is right where the domain itself moved.  "interpolate":
                floating-point data is transferred to where vertices and triangles are now, as by `transfer`, which is
                right where the domain is the same; vectors of motion (`field_transfer.MOTIONS`) still ride, as do
                integers at points; integers in cells take the value of the largest overlap.  "drop": what would be
                transferred is left out
    before      the mesh that has the values for "interpolate"; None: the mesh of `like`
    height      for surfaces (terrain), whose z is a field of x and y: where a vertex has moved, "interpolate" reads z
                from the surface of `like`, "keep" lets z ride with the vertex

    `fixed` is stored as point data where `like` has it, or where `read` would not find the same without it.  Without
    `like`, constrained edges are stored as line cells.

    Raises MeshIOError, after which no trace is left and an existing file is as it was; InvalidMeshError for a
    batch of several meshes; and ValueError for unknown `fields`.
    """
    check_choice(fields)
    check_height(height)
    path = as_path(path)
    if len(mesh) != 1:
        raise InvalidMeshError(f"{path}: a file holds one mesh, this batch has {len(mesh)}: write each of mesh.split()")
    format_of(path)
    if like is not None and not isinstance(like, Source):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeshWarning)  # they were given when the mesh was read
            like = Source.open(like)
    transfer = None
    if like is not None and fields != "carry":
        transfer = FieldTransfer(mesh_of_values(path, like.mesh, before), mesh, fields)
    made = draft(path, mesh, like, vertex_map, transfer, height)
    made.tell()
    made.save()


def draft(
    path: Path,
    mesh: MeshBatch,
    like: Source | None,
    vertex_map: VertexMap | None = None,
    fields: FieldTransfer | None = None,
    height: HeightChoice = "interpolate",
    placed: Placed | None = None,
) -> Draft:
    """A batch of one, ready to be written at `path`; raises as `write` does.

    fields  transfers the fields of `like`; None: they ride with vertices and rows
    placed  the mesh with its mid-side nodes, if they have been placed; None: they are, where `like` has any
    """
    mesh = mesh.with_points(mesh.points.detach()).to("cpu")
    split = like is not None and len(mesh.quads) < len(like.mesh.quads)
    if like is not None and split:
        gone = split_rows(like, mesh, vertex_map)
        like, fields = with_split_quads(like, gone), None if fields is None else fields.with_split_quads(gone)
    if like is None:
        content = _new_content(mesh)
        content.points = _in_space(path, content.points, mesh, None)
        return Draft.of(path, content)
    if like.middles is not None:
        placed = placed or replaced(like, mesh, vertex_map, None if fields is None else fields.before)
        mesh, vertex_map = placed.mesh, placed.vertex_map
        fields = None if fields is None else fields.through_nodes(given(like, fields.before), placed)
    document, correspondence = like.document, Correspondence.between(mesh, like, vertex_map)
    # What else the file ties to its rows does not hold for quads that became triangles.
    same_rows = correspondence.same_rows and not split
    content, dropped = carried(mesh, correspondence, fields, height, placed)
    dropped += FORMATS[document.format].left_behind(document, format_of(path, document), same_rows)
    if correspondence.changed and document.format == format_of(path, document).name:
        dropped += document.by_element
    before, content.points = content.points, _in_space(path, content.points, mesh, document)
    if content.points.shape[1] < before.shape[1] and not np.array_equal(content.points, before[:, :2]):
        _seen_from_above(content, mesh)
    stale = [] if fields is None or not same_rows else _stale(document, content.points)
    made = Draft.of(path, content, document, same_rows, like.path, tuple(dropped), tuple(stale))
    return made if placed is None else replace(made, curved=placed.summary())


def _stale(document: Document, points: np.ndarray) -> list[str]:
    """Names for values of `document` at nodes that are somewhere else now, with how many nodes these are."""
    width = min(points.shape[1], document.mesh.points.shape[1])
    moved = (points[:, :width] != document.mesh.points[:, :width]).any(1)
    counts = {name: int(moved[np.unique(rows)].sum()) for name, rows in document.at_nodes.items()}
    return [f"{name} at {count} node{'' if count == 1 else 's'}" for name, count in counts.items() if count]


def _new_content(mesh: MeshBatch) -> meshio.Mesh:
    """The content of a new file that follows no other."""
    cells = [("triangle", mesh.triangles.numpy())] if len(mesh.triangles) else []
    if len(mesh.quads):
        cells.append(("quad", mesh.quads.numpy()))
    if len(mesh.constrained_edges):
        cells.append(("line", mesh.constrained_edges.numpy()))
    plain = bool((mesh.fixed == default_fixed(mesh)).all())
    point_data = {} if plain else {"fixed": mesh.fixed.numpy().astype(np.int32)}
    return meshio.Mesh(lift(mesh).numpy(), cells, point_data=point_data)


def _seen_from_above(content: meshio.Mesh, mesh: MeshBatch) -> None:
    """Turns the cells of a mesh that is laid into the plane where they run clockwise there."""
    flat = mesh.points.numpy()
    rows = [b.data for b in content.cells if b.type in _TURNED]
    area = sum(float(_doubled_areas(flat[r[:, :3]]).sum()) for r in rows)
    if area < 0:
        content.cells = [
            meshio.CellBlock(b.type, b.data[:, _TURNED[b.type]] if b.type in _TURNED else b.data) for b in content.cells
        ]


def _doubled_areas(corners: np.ndarray) -> np.ndarray:
    """(N,) twice the signed areas of triangles (N, 3, 2)."""
    (ax, ay), (bx, by) = (corners[:, k].T - corners[:, 0].T for k in (1, 2))
    return ax * by - ay * bx


def _in_space(path: Path, points: np.ndarray, mesh: MeshBatch, like: Document | None) -> np.ndarray:
    """The points with two or three coordinates, as the format of `path` and the file that is followed have them."""
    form = format_of(path, like)
    if form.planar:
        if bool((points[:, 2] != points[0, 2]).any()):
            warn(f"{path}: {form.name} is two-dimensional: the mesh is laid into the plane")
            return mesh.points.numpy()
        return points[:, :2]
    if like is not None and like.format == form.name and like.mesh.points.shape[1] == 2:
        return points[:, :2]
    return points
