"""From a batch to one vector of unknowns, compiled: the twins of `pack` and of what its callers measure first."""

import ctypes
from typing import Any

import torch
from torch import Tensor

from .library import ADDRESS, INT32, INT64, call, function, pointer


class _Batch(ctypes.Structure):
    """`BatchArgument` of source/packing.cpp."""

    _fields_ = [
        ("points", ADDRESS), ("triangles", ADDRESS), ("free", ADDRESS), ("point_offsets", ADDRESS),
        ("triangle_offsets", ADDRESS), ("centre", ADDRESS), ("unit", ADDRESS),
        ("vertices", INT64), ("meshes", INT64), ("block", INT64),
    ]  # fmt: skip


class _Packing(ctypes.Structure):
    """`PackingArgument` of source/packing.cpp."""

    _fields_ = [
        ("unknowns", ADDRESS), ("anchored", ADDRESS), ("rows", ADDRESS), ("x_rows", ADDRESS), ("y_rows", ADDRESS),
        ("vertices", ADDRESS), ("triangles", ADDRESS), ("point_mesh", ADDRESS), ("edges", ADDRESS),
        ("size", INT64), ("kept", INT64), ("anchors", INT64),
    ]  # fmt: skip


def packed(
    points: Tensor,
    triangles: Tensor,
    free: Tensor,
    point_offsets: Tensor,
    triangle_offsets: Tensor,
    frame: tuple[Tensor, Tensor],
    displacements: bool,
    block: int,
) -> dict[str, Any]:
    """The fields of `optimising.objective.Packing` but for its frame, as `pack` makes them of points (V, 2) float64.

    frame  centre (B, 2) and unit (B,)
    """
    whole = [v.contiguous() for v in (points, triangles, free, point_offsets, triangle_offsets, *frame)]
    meshes = len(point_offsets) - 1
    batch = _Batch(*(pointer(v) for v in whole), len(points), meshes, block)
    free_counts, kept_counts = torch.empty((2, meshes), dtype=torch.int64)
    anchor = torch.zeros(len(points), dtype=torch.bool)
    counts = (ADDRESS(pointer(v)) for v in (free_counts, kept_counts, anchor))
    anchors = call("tm_pack_counts", INT64, ctypes.byref(batch), *counts)
    block_offsets, kept_offsets = torch.zeros((2, meshes + 1), dtype=torch.int64)
    torch.cumsum((free_counts + (block - 1)) // block * 2, 0, out=block_offsets[1:])
    torch.cumsum(kept_counts, 0, out=kept_offsets[1:])
    size, kept, count = int(block_offsets[-1]) * block, int(kept_offsets[-1]), int(free_counts.sum())
    kind = torch.float32 if displacements else torch.float64
    vector, anchored = torch.zeros(size, dtype=kind), torch.zeros(2 * anchors, dtype=kind)
    edges = torch.empty((4, kept), dtype=torch.float32) if displacements else None
    rows = torch.empty((6, kept), dtype=torch.int32)
    of_vertices = torch.empty((4, count), dtype=torch.int64)
    x_rows, y_rows, vertices, point_mesh = of_vertices
    taken = torch.empty(kept, dtype=torch.int64)
    columns = {
        "unknowns": vector, "anchored": anchored, "rows": rows, "x_rows": x_rows, "y_rows": y_rows,
        "vertices": vertices, "triangles": taken, "point_mesh": point_mesh, "edges": edges,
    }  # fmt: skip
    out = _Packing(*(pointer(v) for v in columns.values()), size, kept, anchors)
    call("tm_pack", None, ctypes.byref(batch), ADDRESS(pointer(block_offsets)), ADDRESS(pointer(anchor)),
         ctypes.byref(out))  # fmt: skip
    return columns | {"block_offsets": block_offsets, "triangle_offsets": kept_offsets}


def scattered(values: Tensor, vertices: Tensor, x_rows: Tensor, y_rows: Tensor, like: Tensor) -> Tensor:
    """(N,) in the type of `like` (N,) the `values` (V,) float64; `optimising.objective.Packing.spread_vertices`."""
    values, out = values.contiguous(), torch.zeros_like(like)
    rows = (v.contiguous() for v in (vertices, x_rows, y_rows))
    name = "tm_scatter_single" if out.dtype == torch.float32 else "tm_scatter"
    function(name, None, ADDRESS, ADDRESS, ADDRESS, ADDRESS, INT64, ADDRESS)(
        values.data_ptr(), *(v.data_ptr() for v in rows), vertices.numel(), out.data_ptr()
    )
    return out


def unpacked(packing: Any, unknowns: Tensor, points: Tensor) -> Tensor:
    """(V, 2) `optimising.objective.Packing.unpack` of the `packing`, with points (V, 2) float64."""
    moved = points.clone(memory_format=torch.contiguous_format)
    columns = (packing.unknowns, unknowns, packing.vertices, packing.x_rows, packing.y_rows, packing.point_mesh,
               packing.centre, packing.unit)  # fmt: skip
    whole = [v.contiguous() for v in columns]
    name = "tm_unpack_single" if unknowns.dtype == torch.float32 else "tm_unpack"
    function(name, None, *[ADDRESS] * 8, INT32, INT64, ADDRESS)(
        *(v.data_ptr() for v in whole), packing.edges is not None, packing.vertices.numel(), moved.data_ptr()
    )
    return moved


def vertex_size(points: Tensor, triangles: Tensor) -> Tensor:
    """(V,) `mesh.means.vertex_size`, over points (V, 2) float64."""
    points, triangles = points.contiguous(), triangles.contiguous()
    size = torch.empty(len(points), dtype=torch.float64)
    call("tm_vertex_size", None, ADDRESS(pointer(points)), ADDRESS(pointer(triangles)), INT64(len(triangles)),
         INT64(len(points)), ADDRESS(pointer(size)))  # fmt: skip
    return size


def centre_and_unit(points: Tensor, offsets: Tensor) -> tuple[Tensor, Tensor]:
    """`mesh.units.centre_and_unit`, over points (V, 2) float64."""
    points, offsets = points.contiguous(), offsets.contiguous()
    meshes = len(offsets) - 1
    centre, unit = torch.empty((meshes, 2), dtype=torch.float64), torch.empty(meshes, dtype=torch.float64)
    call("tm_centre_and_unit", None, ADDRESS(pointer(points)), ADDRESS(pointer(offsets)), INT64(meshes),
         ADDRESS(pointer(centre)), ADDRESS(pointer(unit)))  # fmt: skip
    return centre, unit
