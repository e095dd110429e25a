"""Motions of a mesh's boundary, as the options of `torchmesh warp` describe them: which part moves, and where to.

A part is given by its name (hole:1, cylinder), or is a box.  Nothing here imports torch before it is needed.
"""

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .errors import UsageError

if TYPE_CHECKING:
    from torch import Tensor

    from ..files.parts import Part as FilePart
    from ..files.source import Source
    from ..mesh.batch import MeshBatch

# A displacement field lies in the mesh's plane if it leaves it by less than this part of its length.
_PLANE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Part:
    """What is to move: a part by its name, or the fixed vertices in a box.

    option  the option as it was given on the command line, for messages
    name    a name of `torchmesh warp --list`; empty for a box
    box     two opposite corners x0, y0, x1, y1, in the unit of the file
    """

    option: str
    name: str
    box: tuple[float, ...]

    @classmethod
    def of(cls, option: str, words: list[str]) -> "Part":
        """The part that the words of an option name, which stood between colons; raises UsageError."""
        name = ":".join(words)
        try:
            return cls(option, "", _numbers(option, name, 4))
        except UsageError:
            return cls(option, name, ())

    def chosen(self, source: "Source") -> "Chosen":
        """Its vertices in a file's mesh; raises UsageError for none."""
        import torch

        from ..mesh.boundary_parts import in_box

        mesh = source.mesh
        if not self.name:
            inside = in_box(mesh, self.box)
            if not bool(inside.any()):
                raise UsageError(f"{self.option}: no boundary vertex lies in that box")
            none = torch.zeros(0, dtype=torch.int64)
            return Chosen(inside, none, none, _walls_between(mesh, inside))
        parts = parts_by_name(source)
        if self.name not in parts:
            names = list(parts)
            known = ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
            raise UsageError(f"{self.option}: there is no {self.name}, only {known} (--list shows what they are)")
        part = parts[self.name]
        inside = torch.zeros(len(mesh.points), dtype=torch.bool)
        inside[part.vertices] = True
        return Chosen(inside, part.layer, part.base, part.edges)


def _walls_between(mesh: "MeshBatch", inside: "Tensor") -> "Tensor":
    """(K, 2) the edges of the boundary and of interfaces with both ends `inside` (V,) bool."""
    import torch

    from ..mesh import connectivity
    from ..mesh.quads import halved

    triangles = halved(mesh)
    edges = torch.cat([connectivity.boundary_edges(triangles.triangles, triangles.twin), mesh.constrained_edges])
    return edges[inside[edges].all(1)]


# So many names are told where one is not known.
_NAMED = 12


@functools.lru_cache(maxsize=4)
def parts_by_name(source: "Source") -> "dict[str, FilePart]":
    """The parts of a file's mesh by name."""
    from ..files.parts import parts_of

    return parts_of(source)


@dataclass(frozen=True, eq=False)
class Chosen:
    """The vertices of a part.

    own    (V,) bool, those of the part itself
    layer  (L,) int64, those of the layers of quads that stand on it
    base   (L,) int64, for each of these the vertex of the part that it stands on
    edges  (K, 2) int64, the edges of the part; named points have none
    """

    own: "Tensor"
    layer: "Tensor"
    base: "Tensor"
    edges: "Tensor"

    @property
    def all(self) -> "Tensor":
        """(V,) bool, the vertices of the part and of its layers."""
        inside = self.own.clone()
        inside[self.layer] = True
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
        if len(words) < (3 if _is_loop(words) else 2):
            raise UsageError(f"{option}: expected hole:N:DISTANCE or NAME:DISTANCE or X0,Y0,X1,Y1:DISTANCE")
        distance = _numbers(option, words[-1], 1)[0]
        if not distance > 0:
            raise UsageError(f"{option}: the distance must be positive")
        return cls(Part.of(option, words[:-1]), distance)

    def vertices(self, source: "Source") -> "Tensor":
        """(V,) bool, the part and the free vertices so near to its edges and vertices; raises UsageError for none."""
        import torch

        mesh, chosen = source.mesh, self.part.chosen(source)
        part = chosen.own
        # Vertices that no edge of the part has count as points; those inside of named cells lie behind their outline.
        alone = part & mesh.fixed if len(chosen.edges) else part.clone()
        alone[chosen.edges] = False
        points = alone.nonzero()
        a, b = mesh.points[torch.cat([chosen.edges, points.expand(-1, 2)])].unbind(1)
        way = b - a
        length = way.square().sum(1).clamp_min(1e-300)
        rows = (~mesh.fixed & ~part).nonzero().squeeze(1)
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
        if len(words) < (3 if _is_loop(words) else 2):
            raise UsageError(f"{option}: expected hole:N:DX,DY or NAME:DX,DY or X0,Y0,X1,Y1:DX,DY")
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
        named, centre = _with_centre(words)
        if not named[:-1] or (len(named) == 2 and _is_loop(words)):
            raise UsageError(
                f"{option}: expected hole:N:DEG or NAME:DEG or X0,Y0,X1,Y1:DEG, and :X,Y for another centre"
            )
        return cls(Part.of(option, named[:-1]), _numbers(option, named[-1], 1)[0], centre)

    def apply(self, mesh: "MeshBatch", points: "Tensor", chosen: Chosen) -> "Tensor":
        """(V, 2) the `points` of a mesh after those that are `chosen`, with their layers, have turned.

        Raises UsageError for a centre outside of the plane of the mesh.
        """
        from ..mesh.file_axes import is_seen_from_behind

        centre, rows = _centre(self.part, self.centre, mesh, points[chosen.own]), chosen.all
        angle = math.radians(-self.degrees if is_seen_from_behind(mesh) else self.degrees)
        turn = points.new_tensor([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        points = points.clone()
        points[rows] = centre + (points[rows] - centre) @ turn
        return points


@dataclass(frozen=True)
class Scale:
    """`--scale PART:FACTOR`: make a part larger or smaller, from the middle of its bounding box.

    `--scale PART:FACTOR:X,Y` takes another centre, and FX,FY in place of FACTOR a factor for each axis of the file.
    """

    part: Part
    factors: tuple[float, ...]
    centre: tuple[float, ...] | None

    @classmethod
    def of(cls, text: str) -> "Scale":
        """From what follows `--scale`; raises UsageError."""
        option = f"--scale {text}"
        words = text.split(":")
        named, centre = _with_centre(words)
        if not named[:-1] or (len(named) == 2 and _is_loop(words)):
            raise UsageError(
                f"{option}: expected hole:N:FACTOR or NAME:FACTOR or X0,Y0,X1,Y1:FACTOR, and :X,Y for another centre"
            )
        factors = _numbers(option, named[-1], 1, 2)
        if not all(factor > 0 for factor in factors):
            raise UsageError(f"{option}: a factor must be positive")
        return cls(Part.of(option, named[:-1]), factors, centre)

    def apply(self, mesh: "MeshBatch", points: "Tensor", chosen: Chosen) -> "Tensor":
        """(V, 2) the `points` of a mesh after those that are `chosen` have moved; layers go as what they stand on.

        Raises UsageError for a centre outside of the plane of the mesh.
        """
        from ..mesh.file_axes import vector_in_plane

        centre = _centre(self.part, self.centre, mesh, points[chosen.own])
        # Of a mesh in a tilted plane, the axes of the file stand slantwise.
        pair = self.factors * 2 if len(self.factors) == 1 else self.factors
        basis = [vector_in_plane(mesh, axis) for axis in ((1.0, 0.0), (0.0, 1.0))]
        into = points.new_tensor([b.tolist() for b in basis])
        stretch = into.inverse() @ points.new_tensor([[pair[0], 0.0], [0.0, pair[1]]]) @ into
        moved = points.clone()
        moved[chosen.own] = centre + (points[chosen.own] - centre) @ stretch
        moved[chosen.layer] = points[chosen.layer] + (moved - points)[chosen.base]
        return moved


def _with_centre(words: list[str]) -> tuple[list[str], tuple[float, ...] | None]:
    """The words before a centre X,Y, and the centre; None where the last two words are not a number and a point."""
    if _is_loop(words) and len(words) < 4:
        return words, None
    if len(words) > 2 and "," in words[-1] and _is_numbers(words[-1]) and _is_numbers(words[-2]):
        return words[:-1], tuple(float(word) for word in words[-1].split(","))
    return words, None


def _is_loop(words: list[str]) -> bool:
    """Do the words begin with the name of a loop, as hole:1?"""
    return words[0] in ("outer", "hole") and len(words) > 1 and words[1].isdigit()


def _is_numbers(text: str) -> bool:
    try:
        return all(math.isfinite(float(word)) for word in text.split(","))
    except ValueError:
        return False


def _centre(part: Part, given: tuple[float, ...] | None, mesh: "MeshBatch", own: "Tensor") -> "Tensor":
    """(2,) the centre given, or the middle of the bounding box of the points `own` (N, 2), in the plane of the mesh.

    Raises UsageError for one outside of the plane.
    """
    from ..errors import InvalidMeshError
    from ..mesh.file_axes import point_in_plane, told

    if given is None:
        seen = told(mesh, own)
        given = tuple(((seen.amin(0) + seen.amax(0)) / 2).tolist())
    try:
        return point_in_plane(mesh, given)
    except InvalidMeshError:
        raise UsageError(f"{part.option}: the centre lies outside of the plane of the mesh") from None


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
    """All that `torchmesh warp` is to do: scalings come first, then turns; then moves and the displacement add up."""

    scalings: list[Scale]
    turns: list[Turn]
    shifts: list[Shift]
    displacement: str | None

    @classmethod
    def of(cls, scale: list[str], rotate: list[str], move: list[str], displacement: str | None) -> "Motion":
        """From the values of the options `--scale`, `--rotate`, `--move` and `--displacement`; raises UsageError."""
        scalings, turns = [Scale.of(text) for text in scale], [Turn.of(text) for text in rotate]
        return cls(scalings, turns, [Shift.of(text) for text in move], displacement)

    def apply(self, source: "Source") -> "tuple[Tensor, Tensor]":
        """(V, 2) the positions to which parts of the file's mesh go, and (V,) bool, the vertices of these parts.

        Raises UsageError for a part or a vector field that does not exist, InvalidMeshError for a field that leaves
        the plane of the mesh.
        """
        import torch

        mesh = source.mesh
        goal, held = mesh.points, torch.zeros(len(mesh.points), dtype=torch.bool)
        bodily: list[Scale | Turn] = [*self.scalings, *self.turns]
        for one in bodily:
            chosen = one.part.chosen(source)
            goal, held = one.apply(mesh, goal, chosen), held | chosen.all
        for shift in self.shifts:
            rows = shift.part.chosen(source).all
            goal, held = goal + rows[:, None] * shift.vector(mesh), held | rows
        if self.displacement is not None:
            goal = goal + _field(source, self.displacement)
        return goal, held


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
