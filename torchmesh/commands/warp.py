"""`torchmesh warp`: move parts of a mesh's boundary, and the interior with it.

Nothing here imports torch or rich before it is needed.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from . import console
from .errors import UsageError
from .motion_options import Follower, Motion
from .shared_options import (
    Fields,
    FieldsOption,
    Height,
    HeightOption,
    InArgument,
    InPlaceOption,
    InterfacesOption,
    Quads,
    QuadsOption,
    QuietOption,
    RegionsOption,
    StrictOption,
    ThreadsOption,
    improve_options,
    use_threads,
)
from .targets import check_mesh_target, target_of

if TYPE_CHECKING:
    from torch import Tensor

    from ..files.field_transfer import FieldChoice
    from ..files.parts import Part as FilePart
    from ..files.surface import HeightChoice
    from ..files.time_series import Series, SeriesDraft
    from ..improving.options import ImproveOptions
    from ..mesh.batch import MeshBatch

EXAMPLES = (
    "torchmesh warp plate.msh --list",
    "torchmesh warp plate.msh moved.vtu --move hole:1:0.5,0",
    "torchmesh warp channel.msh moved.msh --move body:0.1,0.05 --rotate body:20",
    "torchmesh warp plate.msh larger.vtu --scale hole:1:1.2",
    "torchmesh warp plate.msh turned.vtu --rotate hole:1:120 --improve",
    "torchmesh warp plate.msh turned.vtu --rotate hole:1:120 --steps auto",
    "torchmesh warp plate.msh bent.vtu --move 0,0,0.2,1:0,-0.1 --rotate hole:1:30:0.5,0.5",
    "torchmesh warp plate.vtu moved.vtu --displacement displacement",
    "torchmesh warp plate.msh moved.vtu --move hole:1:0.1,0 --rigid hole:1:0.12 --steps auto",
)


OutArgument = Annotated[
    Path | None, typer.Argument(metavar="OUT", help="Mesh file to write; none with --list.", show_default=False)
]
ListOption = Annotated[
    bool,
    typer.Option("--list", help="List what can be moved by name, with positions, lengths and what lies on it."),
]
MoveOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PART:DX,DY", help="Move a part of the boundary; may be given several times.", show_default=False
    ),
]
RotateOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PART:DEG",
        help="Turn a part counter-clockwise about the middle of its bounding box, or, PART:DEG:X,Y, about a point.",
        show_default=False,
    ),
]
ScaleOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PART:FACTOR",
        help="Make a part larger or smaller from the middle of its bounding box, or, PART:FACTOR:X,Y, from a point; "
        "FX,FY is a factor for each axis.",
        show_default=False,
    ),
]
DisplacementOption = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="Move the boundary by this point field of IN.", show_default=False),
]
ImproveOption = Annotated[
    bool, typer.Option("--improve", help="Improve the warped mesh at once, as torchmesh improve does.")
]
StepsOption = Annotated[
    str | None,
    typer.Option(
        metavar="auto|N",
        help="Move in so many steps at least, each so small that nothing tangles; edges may flip.",
        show_default=False,
    ),
]
RigidOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PART:DISTANCE",
        help="With --steps: what lies so near to a part, as its layer, shifts and turns with it exactly; its edges "
        "stay. May be given several times.",
        show_default=False,
    ),
]


def warp(
    source: InArgument,
    target: OutArgument = None,
    list_parts: ListOption = False,
    move: MoveOption = None,
    rotate: RotateOption = None,
    scale: ScaleOption = None,
    displacement: DisplacementOption = None,
    improve_too: ImproveOption = False,
    steps: StepsOption = None,
    rigid: RigidOption = None,
    regions: RegionsOption = None,
    interfaces: InterfacesOption = None,
    quads: QuadsOption = Quads.keep,
    fields: FieldsOption = Fields.interpolate,
    height: HeightOption = Height.interpolate,
    strict: StrictOption = False,
    in_place: InPlaceOption = False,
    threads: ThreadsOption = 1,
    quiet: QuietOption = False,
) -> int:
    """Move parts of a mesh's boundary and carry the interior along (FEMWARP).

    A PART is a name that --list shows: 'outer:N' or 'hole:N', a loop of the boundary, or a physical group, marker,
    side set, block or node set of the file; or it is 'X0,Y0,X1,Y1', the boundary and other fixed vertices inside
    that box of the undeformed mesh. Layers of quads that stand on a part go along with it. Scalings come first,
    then turns, then all moves and the displacement field add up; what is not named stays. In a time series every
    step moves. Coordinates and vectors are those of the file: X and Z of a mesh in the x-z plane; in a tilted plane
    the two that --list shows, or all three. Interfaces between regions follow as the rest of the interior does,
    unless the point field 'fixed' marks them.

    Values ride with their vertices where these follow the boundary. Where --improve and --steps move vertices to better
    places or flip edges, --fields says what becomes of them.

    A large motion inverts triangles. That is no failure: the mesh is written and the count is said. With --steps
    none inverts on the way; a boundary that runs into itself stops there, standard error says where, and the exit
    status is 1.
    """
    asked = bool(move or rotate or scale or displacement)
    followers = [Follower.of(text) for text in rigid or []]
    if list_parts:
        if target or asked or improve_too or followers:
            raise UsageError("--list goes with IN alone")
        return _list(source, regions)
    target = target_of(source, target, in_place)
    if not asked:
        raise UsageError("nothing to move: give --move, --rotate, --scale or --displacement (--list names the parts)")
    motion = Motion.of(scale or [], rotate or [], move or [], displacement)
    if steps is not None:
        _check_steps(steps, improve_too)
    if not improve_too and (interfaces is not None or quads is not Quads.keep):
        raise UsageError("--interfaces and --quads go with --improve, to which they are passed on")
    if steps is None and followers:
        raise UsageError("--rigid goes with --steps auto, which also holds the body on arrival")
    check_mesh_target(target)
    use_threads(threads)

    import torch

    from ..batches.file_improvement import open_mesh

    given = open_mesh(source, regions)
    if displacement is not None:
        given = given.separated()  # the field may differ from step to step
    goals = [motion.apply(of_mesh) for of_mesh in given.first_sources()]
    boundary, hold = (torch.cat(parts) for parts in zip(*goals, strict=True))
    if steps is not None:
        return _deform(given, boundary, hold, steps, target, fields.value, height.value, strict, quiet, followers)
    options = improve_options(interfaces=interfaces, quads=quads) if improve_too else None
    return _warp(given, boundary, hold, options, target, fields.value, height.value, strict, quiet)


def _list(path: Path, regions: str | None) -> int:
    """Prints the parts that can be moved, with what lies on them and the boxes that they fill."""
    from rich.text import Text

    from ..batches.file_improvement import open_mesh
    from ..files.parts import parts_of
    from ..mesh.file_axes import told, told_axes

    use_threads(1)
    source = open_mesh(path, regions).sources[0]
    mesh = source.mesh
    table = console.table()
    table.add_column("part")
    one, two = ("xyz"[axis] for axis in told_axes(mesh))
    for name in ("vertices", f"{one} from", f"{one} to", f"{two} from", f"{two} to", "length", "kind", "on it"):
        table.add_column(name, justify="left" if name in ("kind", "on it") else "right")
    for name, part in parts_of(source).items():
        seen = told(mesh, mesh.points[part.vertices])
        (x0, y0), (x1, y1) = seen.amin(0).tolist(), seen.amax(0).tolist()
        numbers = [f"{v:.6g}" for v in (x0, x1, y0, y1)]
        length = f"{part.length(mesh.points):.6g}" if len(part.edges) else ""
        table.add_row(Text(name), f"{len(part.vertices):,}", *numbers, length, part.kind, _on_it(part))
    console.stdout().print(table)
    return 0


def _on_it(part: "FilePart") -> str:
    """'12 triangles, 30 quads; 90 vertices of layers go along'"""
    found = [(part.triangles, "triangle"), (part.quads, "quad")]
    text = ", ".join(console.counted(count, noun) for count, noun in found if count)
    along = f"; {console.counted(len(part.layer), 'vertex', 'vertices')} of layers go along"
    return text + along * bool(len(part.layer))


def _warp(
    given: "Series",
    boundary: "Tensor",
    hold: "Tensor",
    improve_too: "ImproveOptions | None",
    target: Path,
    fields: "FieldChoice",
    height: "HeightChoice",
    strict: bool,
    quiet: bool,
) -> int:
    """Warps in one step, improves by the options given, if any, writes; returns the exit status."""
    from ..batches.file_improvement import curved_counts, curved_summary, improve_series, with_nodes
    from ..files.time_series import draft_series
    from ..mesh.batch import join
    from ..mesh.measure import quality
    from ..warping.femwarp import femwarp

    mesh = given.batch
    with _file_named(given):
        warped = femwarp(mesh, boundary, hold=hold)
    meshes, placed = with_nodes(given, warped.split(), None, mends=False)
    warped, curved = join(meshes), curved_summary(meshes, placed)
    after = quality(warped)
    columns = {
        "undeformed": console.record(mesh, quality(mesh), curved_counts(given)),
        "warped": console.record(warped, after, curved),
    }
    if improve_too is None:
        draft = draft_series(target, warped, given, height=height, placed=placed)
    else:
        with console.progress(quiet) as show:
            moved = replace(given, batch=warped)
            (improved,) = improve_series([moved], improve_too, fields=fields, height=height, progress=show)
        after = improved.report.quality
        curved = improved.curved
        columns["improved"] = console.record(join(improved.meshes), after, curved)
        draft = improved.draft(target)
    _save(draft, strict)
    if not quiet:
        console.print_comparison(str(target), columns)
        console.print_fields(draft.fields)
    if improve_too is not None:
        return console.verdict(f"in {target}", after, improved.message(), curved)
    inverted = console.inverted_text(after, curved)
    if inverted:
        console.say(f"{inverted} in {target}; to mend: torchmesh improve {target} OUT")
    return 0


def _deform(
    given: "Series",
    boundary: "Tensor",
    hold: "Tensor",
    steps: str,
    target: Path,
    fields: "FieldChoice",
    height: "HeightChoice",
    strict: bool,
    quiet: bool,
    followers: list[Follower],
) -> int:
    """Moves in steps that invert nothing, writes, and says how far the boundary got; returns the exit status."""
    import torch

    from ..batches.file_improvement import curved_counts, curved_summary, with_nodes
    from ..files.time_series import draft_series
    from ..improving.deformation import deform
    from ..mesh.batch import join
    from ..mesh.measure import quality
    from ..status import Status

    mesh = given.batch
    with console.progress(quiet) as show, _file_named(given):
        bodies = [torch.cat([f.vertices(source) for source in given.first_sources()]) for f in followers]
        rigid = torch.stack(bodies).any(0) if bodies else None
        count: Literal["auto"] | int = "auto" if steps == "auto" else int(steps)
        after, report = deform(mesh, boundary, count, progress=show, rigid=rigid, hold=hold, trail="apart")
    assert report.trail is not None
    ridden = [[(piece.before, piece.after) for piece in own if piece.end > piece.start] for own in report.trail]
    meshes, placed = with_nodes(given, _with_given_nodes(given, after, boundary, report.status).split(), None)
    after, curved = join(meshes), curved_summary(meshes, placed)
    draft = draft_series(target, after, given, fields=fields, height=height, placed=placed, steps=ridden)
    _save(draft, strict)
    if not quiet:
        columns = {
            "undeformed": console.record(mesh, quality(mesh), curved_counts(given)),
            "deformed": console.record(after, quality(after), curved),
        }
        console.print_comparison(f"{target}, {report.messages[0]}", columns)
        console.print_fields(draft.fields)
    stopped = (report.status != Status.VALID).nonzero().squeeze(1).tolist()
    if not stopped:
        return 0 if curved is None else console.verdict(f"in {target}", quality(after), curved=curved)
    which = f"{given.names()[stopped[0]]}: " if len(given) > 1 else ""
    console.say(f"not at the goal: {target} is valid, but {which}{report.messages[stopped[0]]}")
    return 1


def _with_given_nodes(given: "Series", after: "MeshBatch", boundary: "Tensor", status: "Tensor") -> "MeshBatch":
    """The meshes with mid-side nodes where the motion puts them; short of the goal, where they were."""
    import torch

    from ..status import Status

    points = after.points.clone()
    for m, source in enumerate(given.first_sources()):
        if source.middles is not None:
            there = boundary if int(status[m]) == Status.VALID else given.batch.points
            rows = torch.from_numpy(source.middles.nodes) + int(after.point_offsets[m])
            points[rows] = there[rows].to(points.dtype)
    return after.with_points(points)


def _save(draft: "SeriesDraft", strict: bool) -> None:
    """Writes a file; raises MeshIOError under `strict` if it would not hold everything."""
    if strict:
        draft.refuse()
    draft.tell()
    draft.save()


def _check_steps(steps: str, improve_too: bool) -> None:
    """Raises UsageError unless `steps` is auto or a number, and stands alone."""
    if steps != "auto" and not (steps.isascii() and steps.isdigit() and int(steps) > 0):
        raise UsageError(f"--steps {steps}: expected auto or a number of steps, at least 1")
    if improve_too:
        raise UsageError("--steps improves on arrival: leave --improve out")


@contextlib.contextmanager
def _file_named(given: "Series") -> Iterator[None]:
    """Inside, an InvalidMeshError says which file its mesh comes from."""
    from ..errors import InvalidMeshError

    try:
        yield
    except InvalidMeshError as error:
        raise InvalidMeshError(f"{given.sources[0].path}: {error}") from None
