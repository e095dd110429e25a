"""What a mesh must be: arrays as people have them, checked and turned into tensors, or refused with the reason."""

import warnings
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError, MeshWarning
from . import connectivity
from .ragged import offsets_from_counts, segment_sum
from .triangle import corners, signed_area

# A vertex may leave the common plane by this part of the mesh's extent: single-precision files
# of tilted planes are off by a few 1e-7.
_PLANARITY = 1e-5


def _tensor(values: Any, name: str) -> Tensor:
    try:
        tensor = values.detach().clone() if isinstance(values, Tensor) else torch.from_numpy(_native(values))
    except (TypeError, ValueError) as error:
        raise InvalidMeshError(f"{name} is not a rectangular array of numbers: {error}") from None
    return tensor


def _native(values: Any) -> np.ndarray:
    """A copy in the byte order of this machine."""
    array = np.array(values)
    return array.astype(array.dtype.newbyteorder("="))


def _first(rows: Tensor) -> int:
    return int(rows.nonzero()[0, 0])


def checked_points(points: Any) -> Tensor:
    xyz = _tensor(points, "points")
    if xyz.ndim != 2 or xyz.shape[1] not in (2, 3):
        raise InvalidMeshError(f"points must have shape (V, 2) or (V, 3), not {tuple(xyz.shape)}")
    if xyz.dtype == torch.bool or xyz.is_complex():
        raise InvalidMeshError(f"points must be real numbers, not {xyz.dtype}")
    if xyz.dtype not in (torch.float32, torch.float64):
        xyz = xyz.to(torch.float64)
    if len(xyz) == 0:
        raise InvalidMeshError("the mesh is empty: it has no points")
    bad = ~xyz.isfinite().all(1)
    if bool(bad.any()):
        row = _first(bad)
        raise InvalidMeshError(
            f"points row {row} is {xyz[row].tolist()}: every coordinate must be finite ({int(bad.sum())} rows are not)"
        )
    if float(xyz.abs().max()) > 1e150:
        row = int(xyz.abs().amax(1).argmax())
        raise InvalidMeshError(f"points row {row} is {xyz[row].tolist()}: areas beyond 1e150 squared overflow; rescale")
    extent = float((xyz.amax(0).double() - xyz.amin(0).double()).max())
    if 0 < extent < 1e-150:
        raise InvalidMeshError(f"the mesh is {extent:.3g} wide: areas of less than 1e-300 underflow; rescale")
    return xyz


def checked_triangles(triangles: Any, vertices: int) -> Tensor:
    faces = _tensor(triangles, "triangles")
    if faces.numel() == 0:
        raise InvalidMeshError("the mesh is empty: it has no triangles")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InvalidMeshError(f"triangles must have shape (T, 3), not {tuple(faces.shape)}")
    if faces.dtype == torch.bool or faces.is_floating_point() or faces.is_complex():
        raise InvalidMeshError(f"triangles must be integers (rows of points), not {faces.dtype}")
    faces = faces.to(torch.int64)
    outside = ((faces < 0) | (faces >= vertices)).any(1)
    if bool(outside.any()):
        row = _first(outside)
        raise InvalidMeshError(
            f"triangles row {row} is {faces[row].tolist()}: rows of points run from 0 to {vertices - 1}"
        )
    a, b, c = faces.unbind(1)
    repeated = (a == b) | (b == c) | (c == a)
    if bool(repeated.any()):
        row = _first(repeated)
        raise InvalidMeshError(
            f"triangles row {row} is {faces[row].tolist()}: a triangle needs three different vertices"
        )
    return faces


def checked_fixed(fixed: Any, vertices: int, device: torch.device) -> Tensor:
    if fixed is None:
        return torch.zeros(vertices, dtype=torch.bool, device=device)
    mask = _tensor(fixed, "fixed").to(device)
    if mask.shape != (vertices,):
        raise InvalidMeshError(f"fixed must have shape ({vertices},), one value a point, not {tuple(mask.shape)}")
    if mask.dtype != torch.bool:
        raise InvalidMeshError(f"fixed must be bool, not {mask.dtype}")
    return mask


def checked_constraints(constrained_edges: Any, faces: Tensor, twin: Tensor, vertices: int) -> Tensor:
    """The constrained edges that are interior; boundary edges need no constraint."""
    if constrained_edges is None:
        return torch.zeros((0, 2), dtype=torch.int64, device=faces.device)
    given = _tensor(constrained_edges, "constrained_edges").to(faces.device)
    if given.numel() == 0:
        return torch.zeros((0, 2), dtype=torch.int64, device=faces.device)
    if given.ndim != 2 or given.shape[1] != 2:
        raise InvalidMeshError(f"constrained_edges must have shape (K, 2), not {tuple(given.shape)}")
    if given.dtype == torch.bool or given.is_floating_point() or given.is_complex():
        raise InvalidMeshError(f"constrained_edges must be integers (rows of points), not {given.dtype}")
    given = given.to(torch.int64)
    outside = ((given < 0) | (given >= vertices)).any(1)
    if bool(outside.any()):
        row = _first(outside)
        raise InvalidMeshError(
            f"constrained_edges row {row} is {given[row].tolist()}: rows of points run from 0 to {vertices - 1}"
        )
    keys = connectivity.keys_of(given, vertices)
    present = connectivity.edges(faces, twin)
    missing = ~torch.isin(keys, connectivity.keys_of(present, vertices))
    if bool(missing.any()):
        row = _first(missing)
        raise InvalidMeshError(f"constrained_edges row {row} is {given[row].tolist()}: no triangle has that edge")
    boundary = connectivity.boundary_edges(faces, twin)
    interior = ~torch.isin(keys, connectivity.keys_of(boundary, vertices))
    return given[interior]


def to_plane(xyz: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """(V, 2) coordinates in the plane of the points, and that plane (3, 3): origin, x and y axis.

    A plane of constant z keeps its x and y to the bit and is seen from above; any other is seen
    from the side on which most of the area runs counter-clockwise.
    """
    frame = torch.eye(3, dtype=torch.float64, device=xyz.device).roll(1, 0)
    frame[0] = 0
    if xyz.shape[1] == 2:
        return xyz.contiguous(), frame
    frame[0, 2] = xyz[0, 2]
    if bool((xyz[:, 2] == xyz[0, 2]).all()):
        return xyz[:, :2].contiguous(), frame
    wide = xyz.to(torch.float64)
    low, high = wide.amin(0), wide.amax(0)
    extent = float((high - low).max())
    origin = low + (wide - low).mean(0)
    centred = (wide - origin) / extent
    axes = torch.linalg.svd(centred.T @ centred)[2]
    x_axis, normal = axes[0], axes[2]
    a, b, c = centred[faces].unbind(1)
    if float(torch.linalg.cross(b - a, c - a).sum(0) @ normal) < 0:
        normal = -normal
    y_axis = torch.linalg.cross(normal, x_axis)
    height = (centred @ normal).abs()
    if float(height.max()) > _PLANARITY:
        row = int(height.argmax())
        raise InvalidMeshError(
            f"points row {row} is {xyz[row].tolist()}: it lies {float(height.max()) * extent:.3g} off the plane of "
            "the others; torchmesh improves planar meshes"
        )
    flat = torch.stack([centred @ x_axis, centred @ y_axis], 1) * extent
    return flat.to(xyz.dtype), torch.stack([origin, x_axis, y_axis])


def oriented(points: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Triangles with consistent counter-clockwise winding, and their twins.

    Winding is topology (do neighbours run along their edge in opposite directions), inversion is
    geometry (is the area negative): a component is turned as a whole, by the sign of the area
    that its boundary encloses, so inverted triangles stay inverted.
    """
    vertices = len(points)
    u, v = connectivity.tails(faces), connectivity.heads(faces)
    keys, order = connectivity.edge_keys(u, v, vertices).sort(stable=True)
    same = keys[1:] == keys[:-1]
    thrice = same[1:] & same[:-1]
    if bool(thrice.any()):
        first = _first(thrice)
        rows = sorted((order[first : first + 3] // 3).tolist())
        h = order[first]
        raise InvalidMeshError(
            f"triangles rows {rows[0]}, {rows[1]} and {rows[2]} share the edge {[int(u[h]), int(v[h])]}: "
            "an edge may have two triangles at most"
        )
    pairs = same.nonzero().squeeze(1)
    left, right = order[pairs], order[pairs + 1]
    clash = u[left] == u[right]
    twin = torch.full_like(u, -1)
    twin[left], twin[right] = right, left
    component = connectivity.triangle_components(faces, twin)
    turn = torch.zeros(len(faces), dtype=torch.bool, device=faces.device)
    if bool(clash.any()):
        turn = _winding_repair(len(faces), left // 3, right // 3, clash)
        still = turn[left // 3] ^ turn[right // 3] ^ clash
        if bool(still.any()):
            raise InvalidMeshError(
                f"triangles row {int(left[_first(still)] // 3)} closes a loop of triangles that cannot be wound "
                "consistently (a Moebius strip): not a planar mesh"
            )
    area = signed_area(corners(points.to(torch.float64) - points[0].to(torch.float64), faces))
    area = torch.where(turn, -area, area)
    order = component.argsort(stable=True)
    sizes = torch.bincount(component)
    enclosed = segment_sum(area[order], offsets_from_counts(sizes))
    turn = turn ^ (enclosed < 0)[component]
    if not bool(turn.any()):
        return faces, twin
    turned = int(turn.sum())
    if turned == len(faces):
        warnings.warn(MeshWarning("all triangles were wound clockwise; they were turned"), stacklevel=3)
    else:
        warnings.warn(
            MeshWarning(f"{turned} of {len(faces)} triangles were wound against their neighbours; they were turned"),
            stacklevel=3,
        )
    faces = torch.where(turn[:, None], faces.flip(1), faces)
    return faces, connectivity.twins(faces)


def _winding_repair(count: int, left: Tensor, right: Tensor, clash: Tensor) -> Tensor:
    """(T,) bool: which triangles to turn so that neighbours agree, walking out from one per component."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    i, j, k = left.cpu().numpy(), right.cpu().numpy(), clash.cpu().numpy()
    data = np.where(k, 2, 1).astype(np.int8)
    graph = coo_matrix((np.r_[data, data], (np.r_[i, j], np.r_[j, i])), shape=(count, count)).tocsr()
    # Two triangles that share two edges sum their entries; either edge tells the same.
    graph.data = np.where(graph.data % 2 == 0, 2, 1).astype(np.int8)
    turn = np.zeros(count, bool)
    starts = np.unique(connected_components(graph, directed=False)[1], return_index=True)[1]
    for start in starts:
        order, before = breadth_first_order(graph, start, directed=False)
        relation = np.asarray(graph[order[1:], before[order[1:]]]).ravel() == 2
        for child, differs in zip(order[1:].tolist(), relation.tolist(), strict=True):
            turn[child] = turn[before[child]] ^ differs
        members = order
        if 2 * turn[members].sum() > len(members):
            turn[members] = ~turn[members]
    return torch.from_numpy(turn).to(left.device)
