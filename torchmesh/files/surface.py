"""Surfaces that are maps of a plane, such as terrain and beds of rivers: z is a field of x and y.

       z                     The mesh is improved in plan, by x and y alone, which keep their bits.  Its heights stay
       |   __/\\__           with the file.  Where a vertex has moved, its height is read from the surface as it was, or
       |__/      \\___ x      rides along (`HeightChoice`).

The axis of the heights is z, or y or x where only that one gives a map.  A surface that folds over has two heights at
one position, and is refused.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import torch

from ..errors import InvalidMeshError, MeshWarning
from ..mesh import connectivity
from ..mesh.predicates import orientation
from ..mesh.validation import axes_beside, axis_across, frame_across, to_plane
from ..mesh.winding import oriented
from .field_transfer import FieldTransfer

HeightChoice = Literal["interpolate", "keep"]

# The plan of a surface has an area if the triangles cover no smaller part of the square of its extent.
_LEAST_PLAN = 1e-9

# An edge between a triangle that looks up and one that looks down is smooth if the normals differ by less than this
# angle in degrees.  Where so large a part of these edges is smooth, the surface bends over; in a tangle, triangles are
# folded back sharply.
_SMOOTH, _SMOOTH_PART = 75.0, 0.6


@dataclass(frozen=True, eq=False)
class Surface:
    """The heights of a mesh that lies in no plane of constant height, or in one up to noise.

    axis     0, 1 or 2: the axis of the file along which heights are
    heights  (V,) the coordinates of the vertices along it
    """

    axis: int
    heights: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, faces: np.ndarray, path: Path, depths: bool = False) -> "Surface | None":
        """The surface of a file's points (V, 3) and triangles (T, 3); None where they lie in a plane.

        depths  is the third coordinate a depth or a height by the format?  Then even a tilted plane is seen in plan

        Points that leave a plane that is parallel to two axes by up to 1e-5 of the extent lie in it, and what they
        leave it by is their height.  Raises InvalidMeshError, naming `path`, for a surface that is no map of a plane.
        """
        if points.shape[1] != 3 or not len(faces) or not np.isfinite(points[faces]).all():
            return None
        if depths:
            return None if bool((points[faces, 2] == points[faces[0, 0], 2]).all()) else cls(2, points[:, 2])
        xyz, rows = torch.from_numpy(points).to(torch.float64), torch.from_numpy(faces)
        corners = xyz[rows.reshape(-1)]
        across = axis_across(corners)
        if across is not None:
            level = corners[0, across]
            return None if bool((corners[:, across] == level).all()) else cls(across, points[:, across])
        try:
            to_plane(xyz, rows)
        except InvalidMeshError as error:
            reasons = []
            for axis in (2, 1, 0):
                fault = _fault(xyz, rows, axis)
                if fault is None:
                    return cls(axis, points[:, axis])
                reasons.append(fault)
            raise InvalidMeshError(f"{path}: {error}; as a surface it is no map of a plane: {reasons[0]}") from None
        return None

    def plan(self, points: np.ndarray) -> np.ndarray:
        """(V, 2) the coordinates beside the height."""
        return points[:, axes_beside(self.axis)]

    @property
    def frame(self) -> torch.Tensor:
        """(1, 3, 3) the plane of the plan, at height 0."""
        return frame_across(self.axis, 0.0)[None]

    def put_into(
        self, points: np.ndarray, transfer: FieldTransfer, old_vertex: np.ndarray, choice: HeightChoice
    ) -> None:
        """Gives the points (V', 3) of the mesh after their heights.

        transfer    from the mesh of the file to the mesh after
        old_vertex  (V',) the row of each vertex in the file, -1 for a new one
        """
        heights = np.ascontiguousarray(self.heights, np.float64)
        kept = np.flatnonzero(old_vertex >= 0)
        if choice == "interpolate" or len(kept) < len(points):
            points[:, self.axis] = transfer.at_points("height", heights, old_vertex)
        if choice == "keep":
            points[kept, self.axis] = self.heights[old_vertex[kept]]


def check_height(choice: str) -> None:
    """Raises ValueError for what is no `HeightChoice`."""
    if choice not in get_args(HeightChoice):
        raise ValueError(f"height must be one of {', '.join(get_args(HeightChoice))}, not {choice!r}")


def _fault(xyz: torch.Tensor, faces: torch.Tensor, axis: int) -> str | None:
    """Why the surface is no map of the plane across an axis; None if it is one, tangled or not."""
    names = "xyz"
    one, two = (names[k] for k in axes_beside(axis))
    plan = xyz[:, axes_beside(axis)].contiguous()
    extent = float((plan[faces.reshape(-1)].amax(0) - plan[faces.reshape(-1)].amin(0)).max())
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MeshWarning)
            faces, twin = oriented(plan, faces)
    except InvalidMeshError as error:
        return str(error)
    if not bool((twin < 0).any()):
        return "it is closed"
    (ax, ay), (bx, by), (cx, cy) = (plan[faces[:, k]].unbind(1) for k in range(3))
    area = ((bx - ax) * (cy - ay) - (by - ay) * (cx - ax)).abs().sum() / 2
    if float(area) <= _LEAST_PLAN * extent**2:
        return f"it stands upright over the {one}-{two} plane"
    upright = orientation(ax, ay, bx, by, cx, cy) > 0
    if bool(upright.all()):
        return None
    return _bend(xyz, faces, twin, upright, axis, extent)


def _bend(
    xyz: torch.Tensor, faces: torch.Tensor, twin: torch.Tensor, upright: torch.Tensor, axis: int, extent: float
) -> str | None:
    """Where the surface bends over; None where the triangles that look down are those of a tangle.

    Heights that differ by more than the plan is wide, as metres over degrees do, are scaled down to its width first.
    """
    used = xyz[faces.reshape(-1)]
    relief = float(used[:, axis].amax() - used[:, axis].amin())
    scale = torch.ones(3, dtype=xyz.dtype)
    scale[axis] = min(1.0, extent / relief)
    a, b, c = ((xyz * scale)[faces[:, k]] for k in range(3))
    normal = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1)
    h = ((twin >= 0) & (torch.arange(len(twin)) < twin)).nonzero().squeeze(1)
    one, other = h // 3, twin[h] // 3
    h, one, other = (v[upright[one] != upright[other]] for v in (h, one, other))
    smooth = (normal[one] * normal[other]).sum(1) > np.cos(np.radians(_SMOOTH))
    if len(h) and float(smooth.sum()) < _SMOOTH_PART * len(h):
        return None
    beside = "-".join("xyz"[k] for k in axes_beside(axis))
    if not len(h):
        return f"part of it looks down on the {beside} plane"
    tail = int(connectivity.tails(faces)[h[int(smooth.nonzero()[0, 0])]])
    at = ", ".join(f"{v:.6g}" for v in xyz[tail].tolist())
    return f"it bends over at ({at}), where it has two heights over the {beside} plane"
