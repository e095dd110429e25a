"""The command line: `torchmesh improve`, `quality`, `warp`, `reproduce`.

Tables go to standard output, everything else (progress, warnings, errors) to standard error.
Exit status 0: every mesh valid; 1: some mesh has inverted triangles; 2: bad input or usage, in one
line that begins with `error:`; 130: interrupted.  A command that fails leaves no file behind.

Whatever takes long to import is imported inside the commands, so that `--help` is there at once.
"""

import contextlib
import functools
import inspect
import json
import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from rich.console import Console
    from torch import Tensor

    from .mesh import MeshBatch
    from .pipeline import Progress
    from .quality import Quality

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

# Typer carries click inside itself or imports it, depending on its version; either way this is
# click's UsageError, and ClickException, the base of all that is wrong with a command line.
_UsageError: type[Exception] = typer.BadParameter.__mro__[1]
_BadCommandLine: type[Exception] = typer.BadParameter.__mro__[2]


def _command(*examples: str) -> Callable[[Callable], Callable]:
    """Makes a function a command: its docstring is the help text, the examples stand below the options."""

    def register(function: Callable) -> Callable:
        paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
        # Typer's versions differ in what they do with line breaks inside a paragraph: here are none.
        text = "\n\n".join(" ".join(p.split()) for p in paragraphs)
        return app.command(help=text, epilog="\n\n".join(["[dim]Examples:[/]", *examples]))(function)

    return register


class Method(str, Enum):
    default = "default"
    paper = "paper"


class Topology(str, Enum):
    flip = "flip"
    keep = "keep"


_In = Annotated[Path, typer.Argument(metavar="IN", help="Mesh file to read.", show_default=False)]
_Threads = Annotated[int, typer.Option(min=1, help="Processor threads to use.")]
_Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print warnings and errors only.")]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        with _warnings_as_lines():
            status = app(arguments or ["--help"], prog_name="torchmesh", standalone_mode=False)
        if status == INTERRUPTED:
            raise KeyboardInterrupt
        return (status or 0) if arguments else 2
    except (KeyboardInterrupt, typer.Abort):
        _say("interrupted")
        return INTERRUPTED
    except _BadCommandLine as error:
        context = getattr(error, "ctx", None)
        hint = f" (see {context.command_path} --help)" if context else ""
        _say(f"error: {error.format_message()}{hint}")  # type: ignore[attr-defined]
    except MemoryError:
        _say("error: there is not enough memory for this mesh")
    except Exception as error:
        from .errors import MeshError

        if not isinstance(error, MeshError | OSError):
            raise
        _say(f"error: {error}")
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
    method: Annotated[
        Method,
        typer.Option(help="The best way known, or Kim 2017 (An Iterative Mesh Untangling Algorithm) as printed."),
    ] = Method.default,
    topology: Annotated[
        Topology, typer.Option(help="May edges flip, or do the triangles stay? Vertices keep their order either way.")
    ] = Topology.flip,
    beta: Annotated[
        float | None,
        typer.Option(
            help="Area below which untangle-beta pushes a triangle, in the file's unit of area; needs --method paper. "
            "The paper has 0.01 in its own unit. Default: 0.03 of the mesh's mean absolute area.",
            show_default=False,
        ),
    ] = None,
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
    quiet: _Quiet = False,
) -> int:
    """Untangle a mesh and give its triangles good shapes.

    The boundary, region interfaces and vertices marked by the point field 'fixed' stay where they are. OUT is written
    in any case, whole; if it still has inverted triangles, standard error says so and the exit status is 1.
    """
    from .io import read, write
    from .pipeline import ImproveOptions
    from .pipeline import improve as run
    from .plotting import before_after, check_picture_path, check_target, replacing
    from .quality import quality as measure

    if beta is not None and method is not Method.paper:
        raise _UsageError("--beta needs --method paper: the default method has no absolute beta")
    if beta is not None and not math.isfinite(beta):
        raise _UsageError(f"--beta must be a finite number, not {beta}")
    try:
        if method is Method.paper:
            options = ImproveOptions.paper(beta=beta, topology=topology.value)
        else:
            options = ImproveOptions(topology=topology.value)
    except ValueError as error:
        raise _UsageError(str(error)) from None
    _check_outputs(source, target, report, plot)
    _check_mesh_target(target)
    if report is not None:
        check_target(report)
    if plot is not None:
        check_picture_path(plot)
    _use_threads(threads)

    started = time.perf_counter()
    before = read(source)
    with _progress(quiet) as show:
        after, result = run(before, options, progress=show)
        seconds = time.perf_counter() - started
        columns = {"before": _record(before, measure(before)), "after": _record(after, result.quality)}
        # One block, so that all files appear or none.
        with contextlib.ExitStack() as files:
            if report is not None:
                document = {
                    "torchmesh": _version(),
                    "input": str(source),
                    "output": str(target),
                    "method": method.value,
                    "topology": topology.value,
                    "beta": beta,
                    "seconds": seconds,
                    **columns,
                    **{key: value for key, value in result.to_dict()[0].items() if key != "mesh"},
                }
                files.enter_context(replacing(report)).write_text(_json(document), encoding="utf-8")
            if plot is not None:
                before_after(files.enter_context(replacing(plot)), before, after, f"{source.name}: before and after")
            write(target, after, like=source)
    if not quiet:
        _print_comparison(f"{target}, {seconds:.2f} s", columns)
    return _verdict(target, int(result.quality.inverted.sum()), result.messages[0])


@_command(
    "torchmesh quality tangled.vtu better.vtu",
    "torchmesh quality tangled.vtu --worst 3",
    "torchmesh quality better.vtu --json",
)
def quality(
    sources: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Mesh files.", show_default=False)],
    worst: Annotated[int, typer.Option(min=0, help="How many of the worst triangles to list for each file.")] = 10,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON list instead of tables; null stands for infinite.")
    ] = False,
) -> int:
    """Measure meshes: inverted triangles, shapes, and where the worst ones are.

    IMR is the inverse mean ratio, 1 for an equilateral triangle. Rows count a file's triangles from 0. The worst are
    the inverted triangles, largest first, then those of the highest IMR. The exit status is 1 if any triangle of any
    file is inverted (an area of zero included).
    """
    from .errors import MeshError
    from .io import read
    from .quality import quality as measure

    _use_threads(1)
    records, unread = [], 0
    for source in sources:
        try:
            mesh = read(source)
        except (MeshError, OSError) as error:
            _say(f"error: {error}")
            unread += 1
            continue
        q = measure(mesh)
        records.append({"file": str(source), **_record(mesh, q), "worst": _worst(mesh, q, worst)})
    if as_json:
        typer.echo(_json(records), nl=False)
    elif records:
        _print_qualities(records)
    if unread:
        return 2
    return int(any(record["inverted"] for record in records))


@_command(
    "torchmesh warp plate.msh --list",
    "torchmesh warp plate.msh moved.vtu --move hole:1:0.5,0",
    "torchmesh warp plate.msh turned.vtu --rotate hole:1:120 --improve",
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
    threads: _Threads = 1,
    quiet: _Quiet = False,
) -> int:
    """Move parts of a mesh's boundary and carry the interior along (FEMWARP).

    A PART is 'outer:N' or 'hole:N', a loop of the boundary as --list names it, or 'X0,Y0,X1,Y1', the boundary and
    other fixed vertices inside that box of the undeformed mesh. Turns come first, then all moves and the displacement
    field add up; what is not named stays.

    A large motion inverts triangles. That is no failure: the mesh is written and the count is said.
    """
    from .errors import InvalidMeshError
    from .io import read, write
    from .pipeline import improve as run
    from .quality import quality as measure
    from .warping import femwarp

    asked = bool(move or rotate or displacement)
    if list_parts:
        if target or asked or improve_too:
            raise _UsageError("--list goes with IN alone")
        _use_threads(1)
        _print_parts(read(source))
        return 0
    if target is None:
        raise _UsageError("Missing argument 'OUT', the file to write")
    if not asked:
        raise _UsageError("nothing to move: give --move, --rotate or --displacement (--list names the parts)")
    turns = [_Turn.of(text) for text in rotate or []]
    shifts = [_Shift.of(text) for text in move or []]
    _check_mesh_target(target)
    _use_threads(threads)

    mesh = read(source)
    try:
        warped = femwarp(mesh, _new_boundary(mesh, turns, shifts, source, displacement))
    except InvalidMeshError as error:
        raise InvalidMeshError(f"{source}: {error}") from None
    q = measure(warped)
    columns = {"undeformed": _record(mesh, measure(mesh)), "warped": _record(warped, q)}
    message = ""
    if improve_too:
        with _progress(quiet) as show:
            warped, result = run(warped, progress=show)
        q, message = result.quality, result.messages[0]
        columns["improved"] = _record(warped, q)
    write(target, warped, like=source)
    if not quiet:
        _print_comparison(str(target), columns)
    inverted = int(q.inverted.sum())
    if improve_too:
        return _verdict(target, inverted, message)
    if inverted:
        _say(f"{_counted(inverted, 'inverted triangle')} in {target}; to mend: torchmesh improve {target} OUT")
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
    from .reproduction import reproduce as run

    records = run(out, plots, _stdout())
    failed = [r for r in records if r["stage"] in ("final", "default") and r["ours"]["inverted"]]
    for record in failed:
        _say(f"not valid: {record['domain']}, {record['stage']}: {record['ours']['inverted']} inverted")
    return int(bool(failed))


# --- moving the boundary ---------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """A part of the boundary: the loop of that name, or without one what lies in the box.

    option  as given on the command line, for messages
    """

    option: str
    loop: str
    box: tuple[float, ...]

    @classmethod
    def of(cls, option: str, words: list[str]) -> "_Part":
        if words[0] in ("outer", "hole"):
            return cls(option, ":".join(words), ())
        return cls(option, "", _numbers(option, words[0], 4))

    def vertices(self, mesh: "MeshBatch") -> "Tensor":
        """(V,) bool"""
        import torch

        inside = torch.zeros(len(mesh.points), dtype=torch.bool)
        if self.loop:
            loops = _loops(mesh)
            if self.loop not in loops:
                raise _UsageError(f"{self.option}: there is no {self.loop}, only {', '.join(loops)}")
            inside[loops[self.loop]] = True
            return inside
        x0, y0, x1, y1 = self.box
        box = torch.tensor([[min(x0, x1), min(y0, y1)], [max(x0, x1), max(y0, y1)]], dtype=torch.float64)
        slack = 1e-9 * float(mesh.points.amax(0).sub(mesh.points.amin(0)).max())
        inside = mesh.fixed & ((mesh.points >= box[0] - slack) & (mesh.points <= box[1] + slack)).all(1)
        if not bool(inside.any()):
            raise _UsageError(f"{self.option}: no boundary vertex lies in that box")
        return inside


@dataclass(frozen=True)
class _Shift:
    """`--move PART:DX,DY`"""

    part: _Part
    by: tuple[float, ...]

    @classmethod
    def of(cls, text: str) -> "_Shift":
        option = f"--move {text}"
        words = text.split(":")
        if len(words) != (3 if words[0] in ("outer", "hole") else 2):
            raise _UsageError(f"{option}: expected hole:N:DX,DY or outer:N:DX,DY or X0,Y0,X1,Y1:DX,DY")
        return cls(_Part.of(option, words[:-1]), _numbers(option, words[-1], 2))


@dataclass(frozen=True)
class _Turn:
    """`--rotate PART:DEG`, or `--rotate PART:DEG:X,Y` with a centre."""

    part: _Part
    degrees: float
    centre: tuple[float, ...] | None

    @classmethod
    def of(cls, text: str) -> "_Turn":
        option = f"--rotate {text}"
        words = text.split(":")
        named = 2 if words[0] in ("outer", "hole") else 1
        if len(words) - named not in (1, 2):
            raise _UsageError(
                f"{option}: expected hole:N:DEG or outer:N:DEG or X0,Y0,X1,Y1:DEG, and :X,Y for another centre"
            )
        centre = _numbers(option, words[named + 1], 2) if len(words) > named + 1 else None
        return cls(_Part.of(option, words[:named]), _numbers(option, words[named], 1)[0], centre)

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
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count or not all(math.isfinite(v) for v in values):
        what = "a number" if count == 1 else f"{count} numbers with commas between"
        raise _UsageError(f"{option}: {text!r} is not {what}")
    return values


def _new_boundary(
    mesh: "MeshBatch", turns: list[_Turn], shifts: list[_Shift], source: Path, displacement: str | None
) -> "Tensor":
    """(V, 2) where the boundary goes."""
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

    from .errors import InvalidMeshError
    from .formats import load

    fields = load(source).mesh.point_data
    if name not in fields:
        known = f"it has {', '.join(map(repr, sorted(fields)))}" if fields else "it has none"
        raise _UsageError(f"--displacement {name}: {source} has no such point field; {known}")
    values = np.asarray(fields[name], dtype=np.float64)
    if values.ndim != 2 or values.shape[1] not in (2, 3):
        raise _UsageError(f"--displacement {name}: it has shape {values.shape}, not a vector for every point")
    vectors = torch.from_numpy(np.pad(values, ((0, 0), (0, 3 - values.shape[1]))))
    axes = mesh.frames[0, 1:]
    flat = vectors @ axes.T
    away = (vectors - flat @ axes).abs().amax(1)
    off = mesh.fixed & (away > 1e-6 * vectors.abs().amax(1))
    if bool(off.any()):
        row = int(off.nonzero()[0, 0])
        raise InvalidMeshError(f"point field {name!r} row {row} is {values[row].tolist()}: it leaves the plane")
    return flat.to(mesh.points)


def _loops(mesh: "MeshBatch") -> dict[str, "Tensor"]:
    """The boundary's closed loops by name: outer ones, largest first, and holes, from left to right."""
    from . import connectivity

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


# --- what is said, and where -----------------------------------------------------------------------


@functools.cache
def _stdout() -> "Console":
    from rich.console import Console

    # Tables sent to a file or a pipe are not cut to the width of a terminal.
    return Console(width=None if sys.stdout.isatty() else 140, highlight=False)


@functools.cache
def _stderr() -> "Console":
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def _say(text: str) -> None:
    """One line on standard error."""
    _stderr().print(" ".join(text.split()), markup=False, soft_wrap=True)


@contextlib.contextmanager
def _warnings_as_lines() -> Iterator[None]:
    from .errors import MeshWarning

    said = set()

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        if str(message) not in said:
            said.add(str(message))
            _say(f"warning: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("always", MeshWarning)
        warnings.showwarning = show
        yield


@contextlib.contextmanager
def _progress(quiet: bool) -> Iterator["Callable[[Progress], None] | None"]:
    """Live progress on a terminal; elsewhere a line every ten seconds, so that a log shows life."""
    console = _stderr()
    started = time.perf_counter()
    if quiet:
        yield None
    elif console.is_terminal:
        with console.status("starting", spinner="line") as status:
            yield lambda at: status.update(_progress_text(at, started))
    else:
        last = started

        def show(at: "Progress") -> None:
            nonlocal last
            if time.perf_counter() - last >= 10:
                last = time.perf_counter()
                _say(_progress_text(at, started))

        yield show


def _progress_text(at: "Progress", started: float) -> str:
    energy = "" if at.energy is None else f", iteration {at.iteration}, energy {at.energy:.6g}"
    meshes = "" if at.meshes == 1 else f"{at.meshes} meshes, "
    return f"{time.perf_counter() - started:.1f} s  {at.stage}: {meshes}{at.inverted:,} inverted{energy}"


def _verdict(target: Path, inverted: int, message: str) -> int:
    if inverted:
        _say(f"not valid: {_counted(inverted, 'inverted triangle')} in {target} ({message})")
    return int(inverted > 0)


def _counted(count: int, noun: str) -> str:
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def _record(mesh: "MeshBatch", q: "Quality") -> dict[str, Any]:
    """A mesh in numbers."""
    from .quality import minimum_angle

    return {
        "triangles": len(mesh.triangles),
        "vertices": len(mesh.points),
        "inverted": int(q.inverted.sum()),
        "imr_average": float(q.mean[0]),
        "imr_maximum": float(q.max[0]),
        "minimum_angle": float(minimum_angle(mesh)[0]),
    }


def _worst(mesh: "MeshBatch", q: "Quality", count: int) -> list[dict[str, Any]]:
    import torch

    from .mesh import lift

    # Inverted ones rank by their area, far above all others, which rank by their shape.
    size = -q.area / q.area.abs().max().clamp_min(1e-300)
    rank = torch.where(q.upright, -1 / q.inverse_mean_ratio, 1 + size)
    rows = rank.argsort(descending=True, stable=True)[:count]
    places = lift(mesh)[mesh.triangles[rows]].mean(1)
    flat = bool((mesh.frames[0, 0, 2] == 0) & (mesh.frames[0, 1:, 2] == 0).all())
    return [
        {
            "row": row,
            "inverted": not bool(q.upright[row]),
            "imr": float(q.inverse_mean_ratio[row]),
            "area": float(q.area[row]),
            "centroid": place[:2] if flat else place,
        }
        for row, place in zip(rows.tolist(), places.tolist(), strict=True)
    ]


def _table(title: str | None = None) -> Any:
    from rich import box
    from rich.table import Table

    return Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)


def _print_comparison(title: str, columns: dict[str, dict[str, Any]]) -> None:
    from rich.text import Text

    table = _table()
    table.title = Text(title)
    table.add_column("")
    for name in columns:
        table.add_column(name, justify="right")
    for label, key in (
        ("triangles", "triangles"),
        ("inverted", "inverted"),
        ("IMR average", "imr_average"),
        ("IMR maximum", "imr_maximum"),
        ("minimum angle (degrees)", "minimum_angle"),
    ):
        table.add_row(label, *(_number(record[key]) for record in columns.values()))
    _stdout().print(table)


def _print_qualities(records: list[dict[str, Any]]) -> None:
    from rich.text import Text

    table = _table()
    table.add_column("file", overflow="fold")
    for name in ("triangles", "inverted", "IMR average", "IMR maximum", "minimum angle"):
        table.add_column(name, justify="right")
    for r in records:
        numbers = (r[k] for k in ("triangles", "inverted", "imr_average", "imr_maximum", "minimum_angle"))
        table.add_row(Text(r["file"]), *map(_number, numbers), style="red" if r["inverted"] else None)
    _stdout().print(table)
    for r in records:
        if not r["worst"]:
            continue
        table = _table()
        table.title = Text(f"worst triangles of {r['file']}")
        for name in ("row", "IMR", "area", *"xyz"[: len(r["worst"][0]["centroid"])]):
            table.add_column(name, justify="right")
        table.add_column("")
        for w in r["worst"]:
            place = (f"{c:.6g}" for c in w["centroid"])
            mark = "inverted" if w["inverted"] else ""
            table.add_row(str(w["row"]), _number(w["imr"]), f"{w['area']:.4g}", *place, mark)
        _stdout().print(table)


def _print_parts(mesh: "MeshBatch") -> None:
    table = _table()
    table.add_column("part")
    for name in ("vertices", "x from", "x to", "y from", "y to"):
        table.add_column(name, justify="right")
    for name, loop in _loops(mesh).items():
        (x0, y0), (x1, y1) = mesh.points[loop].amin(0).tolist(), mesh.points[loop].amax(0).tolist()
        table.add_row(name, f"{len(loop):,}", *(f"{v:.6g}" for v in (x0, x1, y0, y1)))
    _stdout().print(table)


def _number(value: float) -> str:
    from .plotting import short

    return f"{value:,}" if isinstance(value, int) else short(value)


def _json(value: Any) -> str:
    return json.dumps(_finite(value), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    """The value with null for what JSON has no number for: the IMR of a flat triangle is infinite."""
    if isinstance(value, dict):
        return {key: _finite(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


# --- before the work -------------------------------------------------------------------------------


def _check_mesh_target(target: Path) -> None:
    from .formats import format_of
    from .plotting import check_target

    format_of(target)
    check_target(target)


def _check_outputs(source: Path, target: Path, *others: Path | None) -> None:
    taken = [os.path.realpath(source), os.path.realpath(target)]
    for path in others:
        if path is not None:
            if os.path.realpath(path) in taken:
                raise _UsageError(f"{path} is named twice: each file needs its own name")
            taken.append(os.path.realpath(path))


def _use_threads(count: int) -> None:
    import torch

    torch.set_num_threads(count)


def _version() -> str:
    from importlib.metadata import version

    return version("torchmesh-untangle")
