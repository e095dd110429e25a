"""Positions and vectors of a mesh in the axes of its file, whatever plane of space it lies in.

A mesh in the x-y, x-z or y-z plane has the coordinates of its file, in their order.  A mesh in a tilted plane has
coordinates of its own, so that its shapes are true.  Users give and read two coordinates of the file there, those that
determine a point of the plane best; the third one follows.
"""

import re

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from .batch import MeshBatch
from .validation import axes_beside

# How messages tell a position.
_POSITION = re.compile(r"\b(at|about|near) \((-?[0-9.]+(?:e[+-]?\d+)?), (-?[0-9.]+(?:e[+-]?\d+)?)\)")

# A vector lies in a plane if it leaves it by no more than this part of its length.
_IN_PLANE = 1e-6


def told_axes(mesh: MeshBatch) -> list[int]:
    """The two axes of the file by which positions of a batch of one are told: 0, 1 or 2 each, in their order."""
    x_axis, y_axis = mesh.frames[0, 1:]
    normal = torch.linalg.cross(x_axis, y_axis).abs()
    # Where several components are as large, the plane is told by x and y rather than by z.
    across = max((2, 1, 0), key=lambda axis: round(float(normal[axis]), 9))
    return axes_beside(across)


def is_tilted(mesh: MeshBatch) -> bool:
    """Has a batch of one other coordinates than its file?"""
    return not bool((mesh.frames[0, 1:] == torch.eye(3).to(mesh.frames)[told_axes(mesh)]).all())


def is_seen_from_behind(mesh: MeshBatch) -> bool:
    """Do turns from the first to the second of `told_axes` run clockwise in the coordinates of a batch of one?"""
    return float(torch.linalg.det(mesh.frames[0, 1:, told_axes(mesh)])) < 0


def told(mesh: MeshBatch, flat: Tensor) -> Tensor:
    """(N, 2) the coordinates along `told_axes` of the points `flat` (N, 2) in the plane of a batch of one."""
    if not is_tilted(mesh):
        return flat
    axes = told_axes(mesh)
    return (mesh.frames[0, 0, axes] + flat.to(torch.float64) @ mesh.frames[0, 1:, axes]).to(flat.dtype)


def told_in_space(mesh: MeshBatch, text: str) -> str:
    """The text about a batch of one, with the positions in it in space where the mesh does not lie as x and y do."""
    frame = mesh.frames[0]
    if told_axes(mesh) == [0, 1] and not is_tilted(mesh):
        return text

    def in_space(match: re.Match[str]) -> str:
        x, y = float(match[2]), float(match[3])
        at = (frame[0] + x * frame[1] + y * frame[2]).tolist()
        return f"{match[1]} ({', '.join(f'{v:.6g}' for v in at)})"

    return _POSITION.sub(in_space, text)


def vector_in_plane(mesh: MeshBatch, vector: tuple[float, ...]) -> Tensor:
    """(2,) a vector of the file in the plane of a batch of one.

    vector  its components along `told_axes`, or all three

    Raises InvalidMeshError for three components of which a vector results that leaves the plane.
    """
    given = mesh.frames.new_tensor(vector)
    axes, pair = mesh.frames[0, 1:], told_axes(mesh)
    if len(given) == 3:
        flat = given @ axes.T
        if float((given - flat @ axes).abs().max()) > _IN_PLANE * float(given.abs().max()):
            raise InvalidMeshError(f"the vector {tuple(vector)} leaves the plane of the mesh")
    elif is_tilted(mesh):
        flat = torch.linalg.solve(axes[:, pair].T, given)
    else:
        flat = given
    return flat.to(mesh.points.dtype)


def point_in_plane(mesh: MeshBatch, point: tuple[float, ...]) -> Tensor:
    """(2,) a point of the file, given as for `vector_in_plane`, in the plane of a batch of one."""
    if len(point) == 2 and not is_tilted(mesh):
        return mesh.points.new_tensor(point)
    origin = mesh.frames[0, 0]
    origin = origin if len(point) == 3 else origin[told_axes(mesh)]
    return vector_in_plane(mesh, tuple((mesh.frames.new_tensor(point) - origin).tolist()))
