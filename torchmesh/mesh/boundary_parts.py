r"""Parts of a boundary by name: its loops, and boxes.

+--------------------+      outer:1   the outer loop, of the largest piece of the mesh
|   /--\      /--\   |      hole:1    the leftmost hole
|   \--/      \--/   |      hole:2    the next one
+--------------------+      0,0,1,1   the fixed vertices in a box, X0,Y0,X1,Y1
"""

import math

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from . import connectivity
from .batch import MeshBatch
from .file_axes import told
from .quads import halved

# A box is this part of the mesh's extent larger than given, because coordinates in files are rounded.
_BOX_TOLERANCE = 1e-9


def boundary_parts(mesh: MeshBatch, triangles: Tensor | None = None) -> dict[str, Tensor]:
    """The vertices of the boundary's loops, by name: outer loops, largest first, then holes from left to right.

    triangles  (T, 3) int64, which bound the loops; None: those of the mesh, and its quads
    """
    mesh = halved(mesh)
    faces, twin = (mesh.triangles, mesh.twin) if triangles is None else (triangles, connectivity.twins(triangles))
    edges = connectivity.boundary_edges(faces, twin)
    outer: list[tuple] = []
    holes: list[tuple] = []
    for loop in connectivity.boundary_loops(edges):
        xy = mesh.points[loop]
        following = xy.roll(-1, 0)
        area = float((xy[:, 0] * following[:, 1] - xy[:, 1] * following[:, 0]).sum()) / 2
        seen = told(mesh, xy)
        middle = tuple(((seen.amin(0) + seen.amax(0)) / 2).tolist())
        (outer if area > 0 else holes).append((-area if area > 0 else 0.0, middle, loop))
    named = {}
    for name, found in (("outer", outer), ("hole", holes)):
        for number, (_, _, loop) in enumerate(sorted(found, key=lambda f: f[:2]), 1):
            named[f"{name}:{number}"] = loop
    return named


def in_box(mesh: MeshBatch, box: tuple[float, ...]) -> Tensor:
    """(V,) bool: the fixed vertices in the box with the opposite corners x0, y0, x1, y1, in the axes of the file."""
    x0, y0, x1, y1 = box
    points = told(mesh, mesh.points)
    low, high = points.new_tensor([[min(x0, x1), min(y0, y1)], [max(x0, x1), max(y0, y1)]])
    slack = _BOX_TOLERANCE * float(points.amax(0).sub(points.amin(0)).max())
    return mesh.fixed & ((points >= low - slack) & (points <= high + slack)).all(1)


def part_vertices(batch: MeshBatch, name: str) -> Tensor:
    """(V,) bool: the vertices of the part of that name in every mesh; InvalidMeshError where a mesh has none."""
    masks = []
    for b, mesh in enumerate(batch.split()):
        mask = torch.zeros(len(mesh.points), dtype=torch.bool, device=mesh.points.device)
        if name.startswith(("outer", "hole")):
            named = boundary_parts(mesh)
            if name not in named:
                raise InvalidMeshError(f"mesh {b}: there is no part {name!r} of the boundary, only {', '.join(named)}")
            mask[named[name]] = True
        else:
            mask = in_box(mesh, _box(name))
            if not bool(mask.any()):
                raise InvalidMeshError(f"mesh {b}: no boundary vertex lies in the box {name}")
        masks.append(mask)
    return torch.cat(masks)


def _box(name: str) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in name.split(","))
    except ValueError:
        values = ()
    if len(values) != 4 or not all(map(math.isfinite, values)):
        raise InvalidMeshError(
            f"{name!r} names no part: expected outer:N, hole:N, or a box X0,Y0,X1,Y1. A MeshBatch does not know the "
            "groups of its file: torchmesh warp FILE --list tells the box that each of them fills"
        )
    return values
