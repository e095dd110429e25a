"""`torchmesh warp`: move parts of a mesh's boundary, and the interior with it.

Nothing here imports torch or rich before it is needed.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import console
from .errors import UsageError
from .motion_options import Follower, Motion
from .shared_options import (
    InArgument,
    InPlaceOption,
    QuietOption,
    RegionsOption,
    StrictOption,
    ThreadsOption,
    use_threads,
)
from .targets import check_mesh_target, target_of

if TYPE_CHECKING:
    from torch import Tensor

    from ..files.time_series import Series, SeriesDraft

EXAMPLES = (
    "torchmesh warp plate.msh --list",
    "torchmesh warp plate.msh moved.vtu --move hole:1:0.5,0",
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
    typer.Option("--list", help="List the boundary's loops by name, with their positions, and do nothing else."),
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
    displacement: DisplacementOption = None,
    improve_too: ImproveOption = False,
    steps: StepsOption = None,
    rigid: RigidOption = None,
    regions: RegionsOption = None,
    strict: StrictOption = False,
    in_place: InPlaceOption = False,
    threads: ThreadsOption = 1,
    quiet: QuietOption = False,
) -> int:
    """Move parts of a mesh's boundary and carry the interior along (FEMWARP).

    A PART is 'outer:N' or 'hole:N', a loop of the boundary as --list names it, or 'X0,Y0,X1,Y1', the boundary and
    other fixed vertices inside that box of the undeformed mesh. Turns come first, then all moves and the displacement
    field add up; what is not named stays. Coordinates and vectors are those of the file: X and Z of a mesh in the x-z
    plane; in a tilted plane the two that --list shows, or all three. Interfaces between regions follow as the rest of
    the interior does, unless the point field 'fixed' marks them.

    A large motion inverts triangles. That is no failure: the mesh is written and the count is said. With --steps none
    inverts on the way; a boundary that runs into itself stops there, standard error says where, and the exit status
    is 1.
    """
    asked = bool(move or rotate or displacement)
    followers = [Follower.of(text) for text in rigid or []]
    if list_parts:
        if target or asked or improve_too or followers:
            raise UsageError("--list goes with IN alone")
        return _list(source)
    target = target_of(source, target, in_place)
    if not asked:
        raise UsageError("nothing to move: give --move, --rotate or --displacement (--list names the parts)")
    motion = Motion.of(rotate or [], move or [], displacement)
    if steps is not None:
        _check_steps(steps, improve_too)
    elif followers:
        raise UsageError("--rigid goes with --steps auto, which also holds the body on arrival")
    check_mesh_target(target)
    use_threads(threads)

    from ..batches.file_improvement import open_mesh

    given = open_mesh(source, regions)
    boundary = motion.apply(given.sources[0])
    if steps is not None:
        return _deform(given, boundary, steps, target, strict, quiet, followers)
    return _warp(given, boundary, improve_too, target, strict, quiet)


def _list(path: Path) -> int:
    """Prints the loops of the boundary and the boxes that they fill."""
    from ..files.mesh_files import read
    from ..mesh.boundary_parts import boundary_parts
    from ..mesh.file_axes import told, told_axes

    use_threads(1)
    mesh = read(path)
    table = console.table()
    table.add_column("part")
    one, two = ("xyz"[axis] for axis in told_axes(mesh))
    for name in ("vertices", f"{one} from", f"{one} to", f"{two} from", f"{two} to"):
        table.add_column(name, justify="right")
    for name, loop in boundary_parts(mesh).items():
        seen = told(mesh, mesh.points[loop])
        (x0, y0), (x1, y1) = seen.amin(0).tolist(), seen.amax(0).tolist()
        table.add_row(name, f"{len(loop):,}", *(f"{v:.6g}" for v in (x0, x1, y0, y1)))
    console.stdout().print(table)
    return 0


def _warp(given: "Series", boundary: "Tensor", improve_too: bool, target: Path, strict: bool, quiet: bool) -> int:
    """Warps in one step, improves if asked, writes; returns the exit status."""
    from ..batches.file_improvement import improve_series
    from ..files.time_series import draft_series
    from ..improving.options import ImproveOptions
    from ..mesh.measure import quality
    from ..warping.femwarp import femwarp

    mesh = given.batch
    with _file_named(given):
        warped = femwarp(mesh, boundary)
    after, source = quality(warped), given.sources[0]
    quads = len(source.inverted_quads(warped.points))
    columns = {
        "undeformed": console.record(mesh, quality(mesh), (len(source.quads), len(source.inverted_quads()))),
        "warped": console.record(warped, after, (len(source.quads), quads)),
    }
    if not improve_too:
        _save(draft_series(target, warped, given), strict)
    else:
        with console.progress(quiet) as show:
            (improved,) = improve_series([replace(given, batch=warped)], ImproveOptions(), progress=show)
        after = improved.report.quality
        quads = improved.inverted_quads()
        columns["improved"] = console.record(improved.meshes[0], after, (len(source.quads), quads))
        _save(improved.draft(target), strict)
    if not quiet:
        console.print_comparison(str(target), columns)
    if improve_too:
        return console.verdict(f"in {target}", after, improved.report.messages[0], quads)
    if quads:
        console.say(f"{console.counted(quads, 'inverted quad')} in {target}; {console.QUADS_STAY} by improve")
    inverted = int(after.inverted.sum())
    if inverted:
        console.say(
            f"{console.counted(inverted, 'inverted triangle')} in {target}; to mend: torchmesh improve {target} OUT"
        )
    return 0


def _deform(
    given: "Series",
    boundary: "Tensor",
    steps: str,
    target: Path,
    strict: bool,
    quiet: bool,
    followers: list[Follower],
) -> int:
    """Moves in steps that invert nothing, writes, and says how far the boundary got; returns the exit status."""
    import torch

    from ..files.time_series import draft_series
    from ..improving.deformation import deform
    from ..mesh.measure import quality
    from ..status import Status

    mesh = given.batch
    with console.progress(quiet) as show, _file_named(given):
        bodies = [follower.vertices(mesh) for follower in followers]
        rigid = torch.stack(bodies).any(0) if bodies else None
        after, report = deform(mesh, boundary, "auto" if steps == "auto" else int(steps), progress=show, rigid=rigid)
    _save(draft_series(target, after, given), strict)
    if not quiet:
        columns = {"undeformed": console.record(mesh, quality(mesh)), "deformed": console.record(after, quality(after))}
        console.print_comparison(f"{target}, {report.messages[0]}", columns)
    if int(report.status[0]) == Status.VALID:
        return 0
    console.say(f"not at the goal: {target} is valid, but {report.messages[0]}")
    return 1


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
