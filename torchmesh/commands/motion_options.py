"""Motions of a mesh's boundary, as the options of `torchmesh warp` say them: which part, and where to.

A part is a loop by name (hole:1) or a box.  Nothing here imports torch before it is needed.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from torch import Tensor

    from ..mesh.batch import MeshBatch

# Typer carries click inside itself or imports it, depending on its version; either way this is
# click's UsageError.
UsageError: type[Exception] = typer.BadParameter.__mro__[1]


@dataclass(frozen=True)
class Part:
    """A part of the boundary: the loop of that name, or without one what lies in the box.

    option  as given on the command line, for messages
    """

    option: str
    loop: str
    box: tuple[float, ...]

    @classmethod
    def of(cls, option: str, words: list[str]) -> "Part":
        """The part that an option's words, split at colons, name; raises UsageError."""
        if words[0] in ("outer", "hole"):
            return cls(option, ":".join(words), ())
        return cls(option, "", _numbers(option, words[0], 4))

    def vertices(self, mesh: "MeshBatch") -> "Tensor":
        """(V,) bool, which vertices belong to it; raises UsageError if none does."""
        import torch

        inside = torch.zeros(len(mesh.points), dtype=torch.bool)
        if self.loop:
            named = loops(mesh)
            if self.loop not in named:
                raise UsageError(f"{self.option}: there is no {self.loop}, only {', '.join(named)}")
            inside[named[self.loop]] = True
            return inside
        x0, y0, x1, y1 = self.box
        box = torch.tensor([[min(x0, x1), min(y0, y1)], [max(x0, x1), max(y0, y1)]], dtype=torch.float64)
        slack = 1e-9 * float(mesh.points.amax(0).sub(mesh.points.amin(0)).max())
        inside = mesh.fixed & ((mesh.points >= box[0] - slack) & (mesh.points <= box[1] + slack)).all(1)
        if not bool(inside.any()):
            raise UsageError(f"{self.option}: no boundary vertex lies in that box")
        return inside


@dataclass(frozen=True)
class Shift:
    """`--move PART:DX,DY`"""

    part: Part
    by: tuple[float, ...]

    @classmethod
    def of(cls, text: str) -> "Shift":
        """From what follows `--move`; raises UsageError."""
        option = f"--move {text}"
        words = text.split(":")
        if len(words) != (3 if words[0] in ("outer", "hole") else 2):
            raise UsageError(f"{option}: expected hole:N:DX,DY or outer:N:DX,DY or X0,Y0,X1,Y1:DX,DY")
        return cls(Part.of(option, words[:-1]), _numbers(option, words[-1], 2))


@dataclass(frozen=True)
class Turn:
    """`--rotate PART:DEG`, or `--rotate PART:DEG:X,Y` with a centre."""

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
        centre = _numbers(option, words[named + 1], 2) if len(words) > named + 1 else None
        return cls(Part.of(option, words[:named]), _numbers(option, words[named], 1)[0], centre)

    def apply(self, points: "Tensor", rows: "Tensor") -> "Tensor":
        """`points` (V, 2) with the `rows` (V,) bool turned."""
        import torch

        part = points[rows]
        centre = (part.amin(0) + part.amax(0)) / 2 if self.centre is None else torch.tensor(self.centre).to(points)
        angle = math.radians(self.degrees)
        turn = torch.tensor([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]).to(points)
        points = points.clone()
        points[rows] = centre + (part - centre) @ turn
        return points


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    """`count` finite numbers with commas between; raises UsageError."""
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(math.isfinite(v) for v in values):
        what = "a number" if count == 1 else f"{count} numbers with commas between"
        raise UsageError(f"{option}: {text!r} is not {what}")
    return values


def new_boundary(
    mesh: "MeshBatch", turns: list[Turn], shifts: list[Shift], source: Path, displacement: str | None
) -> "Tensor":
    """(V, 2) where the boundary goes: turned, then shifted and displaced by the point field of that name in `source`.

    Raises UsageError for a part or a vector field that is not there, InvalidMeshError for a field that leaves the
    mesh's plane.
    """
    target = mesh.points
    for turn in turns:
        target = turn.apply(target, turn.part.vertices(mesh))
    for shift in shifts:
        rows = shift.part.vertices(mesh)
        target = target + rows[:, None] * target.new_tensor(shift.by)
    return target if displacement is None else target + _field(mesh, source, displacement)


def _field(mesh: "MeshBatch", source: Path, name: str) -> "Tensor":
    """(V, 2) the vectors of a point field of the file, in the mesh's plane."""
    import numpy as np
    import torch

    from ..errors import InvalidMeshError
    from ..files.formats import load

    fields = load(source).mesh.point_data
    if name not in fields:
        known = f"it has {', '.join(map(repr, sorted(fields)))}" if fields else "it has none"
        raise UsageError(f"--displacement {name}: {source} has no such point field; {known}")
    values = np.asarray(fields[name], dtype=np.float64)
    if values.ndim != 2 or values.shape[1] not in (2, 3):
        raise UsageError(f"--displacement {name}: it has shape {values.shape}, not a vector for every point")
    vectors = torch.from_numpy(np.pad(values, ((0, 0), (0, 3 - values.shape[1]))))
    axes = mesh.frames[0, 1:]
    flat = vectors @ axes.T
    away = (vectors - flat @ axes).abs().amax(1)
    off = mesh.fixed & (away > 1e-6 * vectors.abs().amax(1))
    if bool(off.any()):
        row = int(off.nonzero()[0, 0])
        raise InvalidMeshError(f"point field {name!r} row {row} is {values[row].tolist()}: it leaves the plane")
    return flat.to(mesh.points)


def loops(mesh: "MeshBatch") -> dict[str, "Tensor"]:
    """The boundary's closed loops by name: outer ones, largest first, and holes, from left to right."""
    from ..mesh import connectivity

    rim = connectivity.boundary_edges(mesh.triangles, connectivity.twins(mesh.triangles))
    outer: list[tuple] = []
    holes: list[tuple] = []
    for loop in connectivity.boundary_loops(rim):
        xy = mesh.points[loop]
        following = xy.roll(-1, 0)
        area = float((xy[:, 0] * following[:, 1] - xy[:, 1] * following[:, 0]).sum()) / 2
        middle = tuple(((xy.amin(0) + xy.amax(0)) / 2).tolist())
        (outer if area > 0 else holes).append((-area if area > 0 else 0.0, middle, loop))
    named = {}
    for name, found in (("outer", outer), ("hole", holes)):
        for number, (_, _, loop) in enumerate(sorted(found, key=lambda f: f[:2]), 1):
            named[f"{name}:{number}"] = loop
    return named


def check_steps(steps: str, improve_too: bool) -> None:
    """Raises UsageError unless `steps` is auto or a number, and stands alone."""
    if steps != "auto" and not (steps.isascii() and steps.isdigit() and int(steps) > 0):
        raise UsageError(f"--steps {steps}: expected auto or a number of steps, at least 1")
    if improve_too:
        raise UsageError("--steps improves on arrival: leave --improve out")


def deform_file(mesh: "MeshBatch", boundary: "Tensor", steps: str, target: Path, source: Path, quiet: bool) -> int:
    """`torchmesh warp --steps`: move without tangling, write, say how far it got; the exit status."""
    from ..errors import InvalidMeshError
    from ..files.mesh_files import write
    from ..improving.deformation import deform
    from ..mesh.measure import quality as measure
    from ..status import Status
    from . import console

    with console.progress(quiet) as show:
        try:
            after, report = deform(mesh, boundary, "auto" if steps == "auto" else int(steps), progress=show)
        except InvalidMeshError as error:
            raise InvalidMeshError(f"{source}: {error}") from None
    write(target, after, like=source)
    if not quiet:
        columns = {"undeformed": console.record(mesh, measure(mesh)), "deformed": console.record(after, measure(after))}
        console.print_comparison(f"{target}, {report.messages[0]}", columns)
    if int(report.status[0]) == Status.VALID:
        return 0
    console.say(f"not at the goal: {target} is valid, but {report.messages[0]}")
    return 1
