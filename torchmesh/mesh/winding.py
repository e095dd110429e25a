"""The winding of a mesh: neighbours run along their edge in opposite directions, and components counter-clockwise.

o---->----o        The winding is topology: it is carried from neighbour to neighbour.  Which of the two windings of
|    A    |        a component is counter-clockwise is told by the area that its boundary encloses.  Free vertices
o----<----o        have no part in that area, so inverted triangles stay inverted wherever their vertices are.
"""

import warnings

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError, MeshWarning
from . import connectivity
from .ragged import true_rows

# Each term of an area has three roundings, and the coordinate differences in it have one each; the sum has one a term.
_ROUNDINGS = 8

# Terms below this may have lost digits to underflow.
_UNDERFLOW = 1e-290


def oriented(points: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Triangles with consistent counter-clockwise winding, and their twins.

    points  (V, 2)
    faces   (T, 3) int64

    A component is turned as a whole where its boundary encloses a negative area, by exact sign.  A MeshWarning counts
    the triangles that were turned.  Raises InvalidMeshError for an edge of three triangles, and for a component that
    cannot be wound consistently.
    """
    vertices = len(points)
    u, v = connectivity.tails(faces), connectivity.heads(faces)
    keys, order = connectivity.edge_keys(u, v, vertices).sort(stable=True)
    same = keys[1:] == keys[:-1]
    thrice = same[1:] & same[:-1]
    if bool(thrice.any()):
        first = int(thrice.nonzero()[0, 0])
        rows = sorted((order[first : first + 3] // 3).tolist())
        h = order[first]
        raise InvalidMeshError(
            f"triangles rows {rows[0]}, {rows[1]} and {rows[2]} share the edge {[int(u[h]), int(v[h])]}: "
            "an edge may have two triangles at most; "
            "torchmesh clean IN OUT (tm.clean) mends this where a triangle is there twice"
        )
    pairs = true_rows(same)
    left, right = order[pairs], order[pairs + 1]
    clash = u[left] == u[right]
    twin = torch.full_like(u, -1)
    twin[left], twin[right] = right, left
    turn = torch.zeros(len(faces), dtype=torch.bool, device=faces.device)
    if bool(clash.any()):
        turn = turns_to_agree(len(faces), left // 3, right // 3, clash)
        still = turn[left // 3] ^ turn[right // 3] ^ clash
        if bool(still.any()):
            row = int(left[still.nonzero()[0, 0]] // 3)
            raise InvalidMeshError(
                f"triangles row {row} closes a loop of triangles that cannot be wound consistently "
                "(a Moebius strip, or a surface with a crosscap): not a planar mesh"
            )
    component = connectivity.triangle_components(faces, twin)
    boundary = true_rows(twin < 0)
    back = turn[boundary // 3]
    tails, heads = torch.where(back, v[boundary], u[boundary]), torch.where(back, u[boundary], v[boundary])
    sign = enclosed_signs(points, torch.stack([tails, heads], 1), component[boundary // 3], int(component.max()) + 1)
    turn = turn ^ (sign < 0)[component]
    if not bool(turn.any()):
        return faces, twin
    turned = int(turn.sum())
    if turned == len(faces):
        text = "all triangles were wound clockwise; they were turned"
    else:
        text = f"{turned} of {len(faces)} triangles were wound against their neighbours; they were turned"
    warnings.warn(MeshWarning(text), stacklevel=3)
    faces = torch.where(turn[:, None], faces.flip(1), faces)
    return faces, connectivity.twins(faces)


def enclosed_signs(points: Tensor, edges: Tensor, group: Tensor, groups: int) -> Tensor:
    """(G,) int8 exact sign of the area that the closed walks of each group enclose on their left; 0 for no edge.

    points  (V, 2)
    edges   (E, 2) int64 the directed edges of the walks
    group   (E,) int64 the group of each edge, from 0 to `groups` - 1

    Twice the area is the sum of x_u y_v - x_v y_u over the edges uv (the shoelace formula, Meister 1769).  It is summed
    in floating point, and in integers where rounding could change the sign.
    """
    xy, of = points.detach().to("cpu", torch.float64)[edges.cpu()].numpy(), group.cpu().numpy()
    origin = np.zeros((groups, 2))
    origin[of[::-1]] = xy[::-1, 0]
    with np.errstate(all="ignore"):
        (ux, uy), (vx, vy) = (xy - origin[of, None]).transpose(1, 2, 0)
        left, right = ux * vy, vx * uy
        total = np.bincount(of, left - right, groups)
        magnitude = np.bincount(of, np.abs(left) + np.abs(right), groups)
        terms = np.bincount(of, minlength=groups)
        sure = np.abs(total) > (terms + _ROUNDINGS) * np.finfo(float).eps * magnitude + terms * _UNDERFLOW
        sign = np.sign(np.where(sure, total, 0)).astype(np.int8)
    unsure = ~sure & (terms > 0)
    if unsure.any():
        rows = np.flatnonzero(unsure[of])
        sign[unsure] = _exact_signs(xy[rows], of[rows], groups)[unsure]
    return torch.from_numpy(sign).to(points.device)


def _exact_signs(xy: np.ndarray, group: np.ndarray, groups: int) -> np.ndarray:
    """(G,) int8 the same for edges (E, 2, 2) by their coordinates, in Python integers."""
    mantissa, exponent = np.frexp(xy)
    shift = np.where(mantissa == 0, 0, exponent - exponent[mantissa != 0].min(initial=0))
    whole = (mantissa * 2.0**53).astype(np.int64).astype(object) * (2 ** shift.astype(object))
    total = [0] * groups
    for g, ((ux, uy), (vx, vy)) in zip(group.tolist(), whole.tolist(), strict=True):
        total[g] += ux * vy - vx * uy
    return np.array([(t > 0) - (t < 0) for t in total], np.int8)


def turns_to_agree(count: int, left: Tensor, right: Tensor, clash: Tensor) -> Tensor:
    """(T,) bool: which of `count` triangles to turn so that neighbours agree, fewer than half of each component.

    left, right  (E,) int64 the triangles on both sides of each interior edge
    clash        (E,) bool: they run along it the same way

    The winding is carried from one triangle of each component to the others, breadth first.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    i, j, k = left.cpu().numpy(), right.cpu().numpy(), clash.cpu().numpy()
    data = np.where(k, 2, 1).astype(np.int8)
    graph = coo_matrix((np.r_[data, data], (np.r_[i, j], np.r_[j, i])), shape=(count, count)).tocsr()
    # Two triangles that share two edges sum their entries; either edge tells the same.
    graph.data = np.where(graph.data % 2 == 0, 2, 1).astype(np.int8)
    turn = np.zeros(count, bool)
    label = connected_components(graph, directed=False)[1]
    _, first = np.unique(label, return_index=True)
    starts = first[np.unique(label[i[k]])]
    for start in starts:
        order, before = breadth_first_order(graph, start, directed=False)
        relation = np.asarray(graph[order[1:], before[order[1:]]]).ravel() == 2
        for child, differs in zip(order[1:].tolist(), relation.tolist(), strict=True):
            turn[child] = turn[before[child]] ^ differs
        members = order
        if 2 * turn[members].sum() > len(members):
            turn[members] = ~turn[members]
    return torch.from_numpy(turn).to(left.device)
