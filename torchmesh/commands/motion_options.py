"""Motions of a mesh's boundary, as the options of `torchmesh warp` describe them: which part moves, and where to.

A part is a loop, given by its name (hole:1), or a box.  Nothing here imports torch before it is needed.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .errors import UsageError

if TYPE_CHECKING:
    from torch import Tensor

    from ..files.source import Source
    from ..mesh.batch import MeshBatch

# A displacement field lies in the mesh's plane if it leaves it by less than this part of its length.
_PLANE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Part:
    """A part of the boundary: the loop of that name, or, if there is no name, the fixed vertices in the box.

    option  the option as it was given on the command line, for messages
    loop    the name of a loop; empty for a box
    box     two opposite corners x0, y0, x1, y1, in the unit of the file
    """

    option: str
    loop: str
    box: tuple[float, ...]

    @classmethod
    def of(cls, option: str, words: list[str]) -> "Part":
        """The part that the words of an option name, which stood between colons; raises UsageError."""
        if words[0] in ("outer", "hole"):
            return cls(option, ":".join(words), ())
        return cls(option, "", _numbers(option, words[0], 4))

    def vertices(self, mesh: "MeshBatch") -> "Tensor":
        """(V,) bool, which vertices belong to it; raises UsageError if none does."""
        import torch

        from ..mesh.boundary_parts import boundary_parts, in_box

        inside = torch.zeros(len(mesh.points), dtype=torch.bool)
        if self.loop:
            named = boundary_parts(mesh)
            if self.loop not in named:
                raise UsageError(f"{self.option}: there is no {self.loop}, only {', '.join(named)}")
            inside[named[self.loop]] = True
            return inside
        inside = in_box(mesh, self.box)
        if not bool(inside.any()):
            raise UsageError(f"{self.option}: no boundary vertex lies in that box")
        return inside


@dataclass(frozen=True)
class Follower:
    """`--rigid PART:DISTANCE`: what lies so near to a part of the boundary follows it exactly."""

    part: Part
    distance: float

    @classmethod
    def of(cls, text: str) -> "Follower":
        """From what follows `--rigid`; raises UsageError."""
        option = f"--rigid {text}"
        words = text.split(":")
        if len(words) != (3 if words[0] in ("outer", "hole") else 2):
            raise UsageError(f"{option}: expected hole:N:DISTANCE or outer:N:DISTANCE or X0,Y0,X1,Y1:DISTANCE")
        distance = _numbers(option, words[-1], 1)[0]
        if not distance > 0:
            raise UsageError(f"{option}: the distance must be positive")
        return cls(Part.of(option, words[:-1]), distance)

    def vertices(self, mesh: "MeshBatch") -> "Tensor":
        """(V,) bool, the part and the free vertices within the distance of its edges; raises UsageError for none."""
        from ..mesh import connectivity

        part = self.part.vertices(mesh)
        edges = connectivity.boundary_edges(mesh.triangles, mesh.twin)
        edges = edges[part[edges].all(1)]
        a, b = mesh.points[edges].unbind(1)
        way = b - a
        length = way.square().sum(1).clamp_min(1e-300)
        rows = (~mesh.fixed).nonzero().squeeze(1)
        inside = part.clone()
        for some in rows.split(1024):
            p = mesh.points[some][:, None]
            along = (((p - a) * way).sum(2) / length).clamp(0, 1)
            away = (p - a - along[:, :, None] * way).norm(dim=2)
            inside[some] = (away <= self.distance).any(1)
        if not bool((inside & ~mesh.fixed).any()):
            raise UsageError(f"{self.part.option}: no free vertex lies within {self.distance:g} of that part")
        return inside


@dataclass(frozen=True)
class Shift:
    """`--move PART:DX,DY`: move a part of the boundary by a vector, in the axes of the file."""

    part: Part
    by: tuple[float, ...]

    @classmethod
    def of(cls, text: str) -> "Shift":
        """From what follows `--move`; raises UsageError."""
        option = f"--move {text}"
        words = text.split(":")
        if len(words) != (3 if words[0] in ("outer", "hole") else 2):
            raise UsageError(f"{option}: expected hole:N:DX,DY or outer:N:DX,DY or X0,Y0,X1,Y1:DX,DY")
        return cls(Part.of(option, words[:-1]), _numbers(option, words[-1], 2, 3))

    def vector(self, mesh: "MeshBatch") -> "Tensor":
        """(2,) the vector in the plane of the mesh; raises UsageError if it leaves that."""
        from ..errors import InvalidMeshError
        from ..mesh.file_axes import vector_in_plane

        try:
            return vector_in_plane(mesh, self.by)
        except InvalidMeshError as error:
            raise UsageError(f"{self.part.option}: {error}") from None


@dataclass(frozen=True)
class Turn:
    """`--rotate PART:DEG`: turn a part of the boundary about the middle of its bounding box.

    `--rotate PART:DEG:X,Y` gives another centre.
    """

    part: Part
    degrees: float
    centre: tuple[float, ...] | None

    @classmethod
    def of(cls, text: str) -> "Turn":
        """From what follows `--rotate`; raises UsageError."""
        option = f"--rotate {text}"
        words = text.split(":")
        named = 2 if words[0] in ("outer", "hole") else 1
        if len(words) - named not in (1, 2):
            raise UsageError(
                f"{option}: expected hole:N:DEG or outer:N:DEG or X0,Y0,X1,Y1:DEG, and :X,Y for another centre"
            )
        centre = _numbers(option, words[named + 1], 2, 3) if len(words) > named + 1 else None
        return cls(Part.of(option, words[:named]), _numbers(option, words[named], 1)[0], centre)

    def apply(self, mesh: "MeshBatch", points: "Tensor", rows: "Tensor") -> "Tensor":
        """(V, 2) the `points` of a mesh after those that `rows` (V,) bool marks have turned.

        Raises UsageError for a centre outside of the plane of the mesh.
        """
        from ..errors import InvalidMeshError
        from ..mesh.file_axes import is_seen_from_behind, point_in_plane, told

        part = points[rows]
        try:
            if self.centre is None:
                seen = told(mesh, part)
                centre = (seen.amin(0) + seen.amax(0)) / 2
                centre = point_in_plane(mesh, tuple(centre.tolist()))
            else:
                centre = point_in_plane(mesh, self.centre)
        except InvalidMeshError:
            raise UsageError(f"{self.part.option}: the centre lies outside of the plane of the mesh") from None
        angle = math.radians(-self.degrees if is_seen_from_behind(mesh) else self.degrees)
        turn = points.new_tensor([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        points = points.clone()
        points[rows] = centre + (part - centre) @ turn
        return points


def _numbers(option: str, text: str, count: int, most: int | None = None) -> tuple[float, ...]:
    """`count` finite numbers with commas between, or up to `most`; raises UsageError."""
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if not count <= len(values) <= (most or count) or not all(math.isfinite(v) for v in values):
        what = "a number" if count == 1 else f"{count} numbers with commas between"
        raise UsageError(f"{option}: {text!r} is not {what}")
    return values


@dataclass(frozen=True)
class Motion:
    """All that `torchmesh warp` is to do to a boundary: turns come first, then moves and the displacement add up."""

    turns: list[Turn]
    shifts: list[Shift]
    displacement: str | None

    @classmethod
    def of(cls, rotate: list[str], move: list[str], displacement: str | None) -> "Motion":
        """From the values of the options `--rotate`, `--move` and `--displacement`; raises UsageError."""
        return cls([Turn.of(text) for text in rotate], [Shift.of(text) for text in move], displacement)

    def apply(self, source: "Source") -> "Tensor":
        """(V, 2) the positions to which the boundary of the file's mesh goes.

        Raises UsageError for a part or a vector field that does not exist, InvalidMeshError for a field that leaves
        the plane of the mesh.
        """
        mesh = source.mesh
        goal = mesh.points
        for turn in self.turns:
            goal = turn.apply(mesh, goal, turn.part.vertices(mesh))
        for shift in self.shifts:
            rows = shift.part.vertices(mesh)
            goal = goal + rows[:, None] * shift.vector(mesh)
        return goal if self.displacement is None else goal + _field(source, self.displacement)


def _field(source: "Source", name: str) -> "Tensor":
    """(V, 2) the vectors of a point field of the file, in the plane of its mesh."""
    import numpy as np
    import torch

    from ..errors import InvalidMeshError

    mesh, fields = source.mesh, source.document.mesh.point_data
    if name not in fields:
        known = f"it has {', '.join(map(repr, sorted(fields)))}" if fields else "it has none"
        raise UsageError(f"--displacement {name}: {source.path} has no such point field; {known}")
    values = np.asarray(fields[name], dtype=np.float64)
    if values.ndim != 2 or values.shape[1] not in (2, 3):
        raise UsageError(f"--displacement {name}: it has shape {values.shape}, not a vector for every point")
    vectors = torch.from_numpy(np.pad(values, ((0, 0), (0, 3 - values.shape[1]))))
    axes = mesh.frames[0, 1:]
    flat = vectors @ axes.T
    away = (vectors - flat @ axes).abs().amax(1)
    off = mesh.fixed & (away > _PLANE_TOLERANCE * vectors.abs().amax(1))
    if bool(off.any()):
        row = int(off.nonzero()[0, 0])
        raise InvalidMeshError(f"point field {name!r} row {row} is {values[row].tolist()}: it leaves the plane")
    return flat.to(mesh.points)
