"""Quads beside the triangles of a mesh: which of them are inverted.

d-------c       A quad is upright if all four triangles of a corner and its two neighbours are: dab, abc, bcd, cda.
|       |       If one of them is not, the quad is folded or has a corner of 180 degrees or more, and the map from
|       |       the unit square is not one to one (Knupp, Achieving finite element mesh quality via optimization of
a-------b       the Jacobian matrix norm, International Journal for Numerical Methods in Engineering 48, 2000).
"""

import warnings

import torch
from torch import Tensor

from ..errors import InvalidMeshError, MeshWarning
from .predicates import orientation
from .winding import oriented


def inverted_quads(points: Tensor, quads: Tensor) -> Tensor:
    """(Q,) bool: a corner of the quad is not upright, by exact sign.

    points  (V, 2)
    quads   (Q, 4) int64, counter-clockwise where a quad is upright
    """
    x, y = points.to(torch.float64).unbind(1)
    corners = [quads.roll(-k, 1).unbind(1) for k in range(4)]
    signs = [orientation(x[a], y[a], x[b], y[b], x[c], y[c]) for a, b, c, _ in corners]
    return (torch.stack(signs) <= 0).any(0)


def oriented_quads(points: Tensor, triangles: Tensor, quads: Tensor) -> Tensor:
    """(Q, 4) the `quads` (Q, 4), wound as the `triangles` (T, 3) are: neighbours run along an edge in opposite ways.

    Quads that belong to no consistent mesh with the triangles come back as they are.
    """
    halves = torch.cat([quads[:, :3], quads[:, [0, 2, 3]]])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeshWarning)
            faces, _ = oriented(points, torch.cat([triangles, halves]))
    except InvalidMeshError:
        return quads
    first = faces[len(triangles) : len(triangles) + len(quads)]
    # The triangle a, b, c has been turned where b does not follow a any more.
    follows = first.roll(-1, 1)[first == quads[:, :1]]
    return torch.where((follows == quads[:, 1])[:, None], quads, quads.flip(1))
