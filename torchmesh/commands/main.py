"""The command line: `torchmesh improve`, `batch`, `quality`, `warp`, `reproduce`.

Tables go to standard output, everything else (progress, warnings, errors) to standard error.
Exit status 0: every mesh valid; 1: some mesh has inverted triangles; 2: bad input or usage, in one
line that begins with `error:`; 130: interrupted.  A command that fails leaves no file behind.

Whatever takes long to import is imported inside the commands, so that `--help` is there at once.
"""

import contextlib
import inspect
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from . import batch as command_batch
from . import console
from . import generate as command_generate
from . import motion_options as motions
from . import report as command_report
from .shared_options import (
    BetaOption,
    Boundary,
    BoundaryOption,
    Method,
    MethodOption,
    QuietOption,
    SizesOption,
    Topology,
    TopologyOption,
    improve_options,
    sizes_wanted,
)

INTERRUPTED = 130


app = typer.Typer(
    name="torchmesh",
    help="Untangle planar triangle meshes and give their triangles good shapes.",
    epilog="[dim]Start here:[/]  torchmesh improve tangled.vtu better.vtu --plot picture.png"
    "\n\n[dim]Exit status:[/]  0 every mesh valid, 1 some mesh has inverted triangles, 2 bad input or usage",
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


# click's ClickException, the base of all that is wrong with a command line; see motions.UsageError.
_BadCommandLine: type[Exception] = typer.BadParameter.__mro__[2]


def _command(*examples: str) -> Callable[[Callable], Callable]:
    """Makes a function a command: its docstring is the help text, the examples stand below the options."""

    def register(function: Callable) -> Callable:
        paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
        # Typer's versions differ in what they do with line breaks inside a paragraph: here are none.
        text = "\n\n".join(" ".join(p.split()) for p in paragraphs)
        return app.command(help=text, epilog="\n\n".join(["[dim]Examples:[/]", *examples]))(function)

    return register


_In = Annotated[Path, typer.Argument(metavar="IN", help="Mesh file to read.", show_default=False)]


_Threads = Annotated[int, typer.Option(min=1, help="Processor threads to use.")]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        with console.warnings_as_lines():
            status = app(arguments or ["--help"], prog_name="torchmesh", standalone_mode=False)
        if status == INTERRUPTED:
            raise KeyboardInterrupt
        return (status or 0) if arguments else 2
    except (KeyboardInterrupt, typer.Abort):
        console.say("interrupted")
        return INTERRUPTED
    except _BadCommandLine as error:
        context = getattr(error, "ctx", None)
        hint = f" (see {context.command_path} --help)" if context else ""
        console.say(f"error: {error.format_message()}{hint}")  # type: ignore[attr-defined]
    except MemoryError:
        console.say("error: there is not enough memory for this mesh")
    except Exception as error:
        from ..errors import MeshError

        if not isinstance(error, MeshError | OSError):
            raise
        console.say(f"error: {error}")
    return 2


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"torchmesh {_version()}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


@_command(
    "torchmesh improve tangled.vtu better.vtu",
    "torchmesh improve tangled.msh better.vtu --plot picture.png --report report.json",
    "torchmesh improve tangled.vtk better.vtk --topology keep",
    "torchmesh improve tangled.vtk better.vtk --boundary slide",
    "torchmesh improve tangled.vtk better.vtk --method paper --beta 0.01",
)
def improve(
    source: _In,
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="Mesh file to write; fields, groups and lines of IN come along.", show_default=False
        ),
    ],
    method: MethodOption = Method.default,
    topology: TopologyOption = Topology.flip,
    boundary: BoundaryOption = Boundary.fixed,
    beta: BetaOption = None,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE.json", help="Write what was done, step by step.", show_default=False)
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.png", help="Draw before and after; also .pdf and .svg. Needs matplotlib.", show_default=False
        ),
    ] = None,
    threads: _Threads = 1,
    quiet: QuietOption = False,
) -> int:
    """Untangle a mesh and give its triangles good shapes.

    The boundary, region interfaces and vertices marked by the point field 'fixed' stay where they are, unless
    --boundary slide is given. OUT is written
    in any case, whole; if it still has inverted triangles, standard error says so and the exit status is 1.
    """
    from ..files.atomic import check_target, replacing
    from ..files.mesh_files import held, read, write
    from ..improving.pipeline import improve as run
    from ..mesh.measure import quality as measure
    from ..pictures.pictures import before_after, check_picture_path

    options = improve_options(method, topology, beta, boundary)
    _check_outputs(source, target, report, plot)
    _check_mesh_target(target)
    if report is not None:
        check_target(report)
    if plot is not None:
        check_picture_path(plot)
    _use_threads(threads)

    started = time.perf_counter()
    before = read(source)
    with console.progress(quiet) as show:
        after, result = run(before, options, progress=show, hold=held(source) if options.slides else None)
        seconds = time.perf_counter() - started
        columns = {"before": console.record(before, measure(before)), "after": console.record(after, result.quality)}
        # One block, so that all files appear or none.
        with contextlib.ExitStack() as files:
            if report is not None:
                document = {
                    "torchmesh": _version(),
                    "input": str(source),
                    "output": str(target),
                    "method": method.value,
                    "topology": topology.value,
                    "boundary": boundary.value,
                    "beta": beta,
                    "seconds": seconds,
                    **columns,
                    **{key: value for key, value in result.to_dict()[0].items() if key != "mesh"},
                }
                files.enter_context(replacing(report)).write_text(console.json_text(document), encoding="utf-8")
            if plot is not None:
                before_after(files.enter_context(replacing(plot)), before, after, f"{source.name}: before and after")
            write(target, after, like=source, vertex_map=result.vertex_map)
    if not quiet:
        console.print_comparison(f"{target}, {seconds:.2f} s", columns)
    return _verdict(target, int(result.quality.inverted.sum()), result.messages[0])


@_command(
    "torchmesh quality tangled.vtu better.vtu",
    "torchmesh quality tangled.vtu --worst 3",
    "torchmesh quality better.vtu --metrics minimum_angle,scaled_jacobian,aspect_ratio",
    "torchmesh quality better.vtu --sizes boundary",
    "torchmesh quality better.vtu --json",
)
def quality(
    sources: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Mesh files.", show_default=False)],
    worst: Annotated[int, typer.Option(min=0, help="How many of the worst triangles to list for each file.")] = 10,
    metrics: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="Also show how these metrics of the Verdict manual are spread: minimum, percentiles, maximum, mean. "
            "'all', or some of area, inverse_mean_ratio, mean_ratio, shape, scaled_jacobian, condition, aspect_ratio, "
            "radius_ratio, edge_ratio, minimum_angle, maximum_angle, equiangle_skew.",
            show_default=False,
        ),
    ] = None,
    sizes: SizesOption = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON list instead of tables; null stands for infinite.")
    ] = False,
) -> int:
    """Measure meshes: inverted triangles, shapes, and where the worst ones are.

    IMR is the inverse mean ratio, 1 for an equilateral triangle. Rows count a file's triangles from 0. The worst are
    the inverted triangles, largest first, then those of the highest IMR. The exit status is 1 if any triangle of any
    file is inverted (an area of zero included).
    """
    from ..errors import MeshError
    from ..files.mesh_files import read
    from ..mesh.measure import quality as measure
    from ..mesh.metrics import METRICS, evaluate

    names = [] if metrics is None else list(METRICS) if metrics == "all" else metrics.split(",")
    for name in names:
        if name not in METRICS:
            raise motions.UsageError(f"--metrics: there is no {name!r}; there are all, {', '.join(METRICS)}")
    _use_threads(1)
    records, unread = [], 0
    for source in sources:
        try:
            mesh = read(source)
        except (MeshError, OSError) as error:
            console.say(f"error: {error}")
            unread += 1
            continue
        q = measure(mesh)
        record = {"file": str(source), **console.record(mesh, q), "worst": console.worst(mesh, q, worst)}
        if sizes is not None:
            record["edge_length_over_size"] = console.size_record(mesh, sizes_wanted(sizes, mesh, source))
        if names:
            record["metrics"] = {name: s.records()[0] for name, s in evaluate(mesh, names).items()}
        records.append(record)
    if as_json:
        typer.echo(console.json_text(records), nl=False)
    elif records:
        console.print_qualities(records)
    if unread:
        return 2
    return int(any(record["inverted"] for record in records))


@_command(
    "torchmesh warp plate.msh --list",
    "torchmesh warp plate.msh moved.vtu --move hole:1:0.5,0",
    "torchmesh warp plate.msh turned.vtu --rotate hole:1:120 --improve",
    "torchmesh warp plate.msh turned.vtu --rotate hole:1:120 --steps auto",
    "torchmesh warp plate.msh bent.vtu --move 0,0,0.2,1:0,-0.1 --rotate hole:1:30:0.5,0.5",
    "torchmesh warp plate.vtu moved.vtu --displacement displacement",
)
def warp(
    source: _In,
    target: Annotated[
        Path | None, typer.Argument(metavar="OUT", help="Mesh file to write; none with --list.", show_default=False)
    ] = None,
    list_parts: Annotated[
        bool, typer.Option("--list", help="List the boundary's loops by name, with their places, and do nothing else.")
    ] = False,
    move: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PART:DX,DY", help="Move a part of the boundary; may be given several times.", show_default=False
        ),
    ] = None,
    rotate: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PART:DEG",
            help="Turn a part counter-clockwise about the middle of its bounding box, or, PART:DEG:X,Y, about a point.",
            show_default=False,
        ),
    ] = None,
    displacement: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Move the boundary by this point field of IN.", show_default=False),
    ] = None,
    improve_too: Annotated[
        bool, typer.Option("--improve", help="Improve the warped mesh at once, as torchmesh improve does.")
    ] = False,
    steps: Annotated[
        str | None,
        typer.Option(
            metavar="auto|N",
            help="Move in so many steps at least, each so small that nothing tangles; edges may flip.",
            show_default=False,
        ),
    ] = None,
    threads: _Threads = 1,
    quiet: QuietOption = False,
) -> int:
    """Move parts of a mesh's boundary and carry the interior along (FEMWARP).

    A PART is 'outer:N' or 'hole:N', a loop of the boundary as --list names it, or 'X0,Y0,X1,Y1', the boundary and
    other fixed vertices inside that box of the undeformed mesh. Turns come first, then all moves and the displacement
    field add up; what is not named stays.

    A large motion inverts triangles. That is no failure: the mesh is written and the count is said. With --steps none
    inverts on the way; a boundary that runs into itself stops there, standard error says where, and the exit status
    is 1.
    """
    from ..errors import InvalidMeshError
    from ..files.mesh_files import read, write
    from ..improving.pipeline import improve as run
    from ..mesh.measure import quality as measure
    from ..warping.femwarp import femwarp

    asked = bool(move or rotate or displacement)
    if list_parts:
        if target or asked or improve_too:
            raise motions.UsageError("--list goes with IN alone")
        _use_threads(1)
        mesh = read(source)
        console.print_parts(mesh, motions.loops(mesh))
        return 0
    if target is None:
        raise motions.UsageError("Missing argument 'OUT', the file to write")
    if not asked:
        raise motions.UsageError("nothing to move: give --move, --rotate or --displacement (--list names the parts)")
    turns = [motions.Turn.of(text) for text in rotate or []]
    shifts = [motions.Shift.of(text) for text in move or []]
    if steps is not None:
        motions.check_steps(steps, improve_too)
    _check_mesh_target(target)
    _use_threads(threads)

    mesh = read(source)
    if steps is not None:
        return motions.deform_file(
            mesh, motions.new_boundary(mesh, turns, shifts, source, displacement), steps, target, source, quiet
        )
    try:
        warped = femwarp(mesh, motions.new_boundary(mesh, turns, shifts, source, displacement))
    except InvalidMeshError as error:
        raise InvalidMeshError(f"{source}: {error}") from None
    q = measure(warped)
    columns = {"undeformed": console.record(mesh, measure(mesh)), "warped": console.record(warped, q)}
    message = ""
    if improve_too:
        with console.progress(quiet) as show:
            warped, result = run(warped, progress=show)
        q, message = result.quality, result.messages[0]
        columns["improved"] = console.record(warped, q)
    write(target, warped, like=source)
    if not quiet:
        console.print_comparison(str(target), columns)
    inverted = int(q.inverted.sum())
    if improve_too:
        return _verdict(target, inverted, message)
    if inverted:
        console.say(
            f"{console.counted(inverted, 'inverted triangle')} in {target}; to mend: torchmesh improve {target} OUT"
        )
    return 0


@_command("torchmesh reproduce", "torchmesh reproduce --out results --no-plots")
def reproduce(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for tables, meshes and pictures.")] = Path("out"),
    plots: Annotated[bool, typer.Option(help="Draw the paper's figures 4 to 18; needs matplotlib.")] = True,
    threads: _Threads = 1,
) -> int:
    """Run the three experiments of Kim 2017 and print our rows beside the paper's.

    Moving circle, moving bar and moving gate: undeformed, deformed, after the first edge flip, untangled, final; the
    paper's ablation without flips; and the default method. Less than a minute.
    """
    _use_threads(threads)
    from .reproduce import reproduce as run

    records = run(out, plots, console.stdout())
    failed = [r for r in records if r["stage"] in ("final", "default") and r["ours"]["inverted"]]
    for record in failed:
        console.say(f"not valid: {record['domain']}, {record['stage']}: {record['ours']['inverted']} inverted")
    return int(bool(failed))


_command(*command_batch.EXAMPLES)(command_batch.batch)


_command(*command_generate.EXAMPLES)(command_generate.generate)


_command(*command_report.REPORT_EXAMPLES)(command_report.report)


_command(*command_report.ANIMATE_EXAMPLES)(command_report.animate)


# --- around the work -------------------------------------------------------------------------------


def _verdict(target: Path, inverted: int, message: str) -> int:
    if inverted:
        console.say(f"not valid: {console.counted(inverted, 'inverted triangle')} in {target} ({message})")
    return int(inverted > 0)


def _check_mesh_target(target: Path) -> None:
    from ..files.atomic import check_target
    from ..files.formats import format_of

    format_of(target)
    check_target(target)


def _check_outputs(source: Path, target: Path, *others: Path | None) -> None:
    taken = [os.path.realpath(source), os.path.realpath(target)]
    for path in others:
        if path is not None:
            if os.path.realpath(path) in taken:
                raise motions.UsageError(f"{path} is named twice: each file needs its own name")
            taken.append(os.path.realpath(path))


def _use_threads(count: int) -> None:
    import torch

    torch.set_num_threads(count)


def _version() -> str:
    from importlib.metadata import version

    return version("torchmesh-untangle")
