"""What the command line prints: tables on standard output, lines and progress on standard error, JSON for files.

Nothing here imports torch or rich before it is needed.
"""

import contextlib
import functools
import json
import math
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console
    from rich.table import Table

    from ..files.field_transfer import FieldSummary
    from ..files.placed import CurvedSummary
    from ..improving.report import Progress
    from ..mesh.batch import MeshBatch
    from ..mesh.measure import Quality

# Seconds between two lines of progress where standard error is not a terminal: enough to see life in a log.
_LOG_INTERVAL = 10.0

# Columns of a table that goes to a file or a pipe, where the terminal's width must not cut it.
_FILE_WIDTH = 140


def open_streams() -> None:
    """Gives the process a standard input, output and error where it was started without them, as daemons are.

    What is written to them is lost.  A file that the program opens could otherwise get the number of a stream, and
    what some library prints would end in it.  Names of files that are not UTF-8 are printed with escapes.
    """
    while True:
        opened = os.open(os.devnull, os.O_RDWR)
        if opened > 2:
            os.close(opened)
            break
    for name, number, mode in (("stdin", 0, "r"), ("stdout", 1, "w"), ("stderr", 2, "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", closefd=False))
    for stream in (sys.stdout, sys.stderr):
        if getattr(stream, "errors", "") in ("strict", "surrogateescape") and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")


def stdout() -> "Console":
    """The console that tables are printed on: standard output, unless a mesh flows there."""
    return _stderr() if _tables_away else _stdout()


@functools.cache
def _stdout() -> "Console":
    return _console(width=None if sys.stdout.isatty() else _FILE_WIDTH)


_tables_away: list[bool] = []


@contextlib.contextmanager
def tables_on_stderr() -> Iterator[None]:
    """Inside, tables go to standard error."""
    _tables_away.append(True)
    try:
        yield
    finally:
        _tables_away.pop()


# What files are called in lines and tables where that is not their path: `-` for a pipe.
_called: dict[str, str] = {}


def call_it(path: "Path", name: str) -> None:
    """From now on the path is told by this name."""
    _called[str(path)] = name


def told(text: str) -> str:
    """The text with the names of files as they are to be told."""
    for path, name in _called.items():
        text = text.replace(path, name)
    return text


@functools.cache
def _stderr() -> "Console":
    return _console(stderr=True)


def _console(**options: Any) -> "Console":
    from rich.console import Console

    class Plain(Console):
        def on_broken_pipe(self) -> None:
            raise  # rich would end the process with status 1, which means inverted triangles

    # Names may hold what would be markup: `a[1].vtu`, `torchmesh-untangle[bench,peers]`.
    return Plain(highlight=False, markup=False, emoji=False, **options)


def say(text: str) -> None:
    """Prints one line on standard error, if anybody reads that."""
    with contextlib.suppress(OSError):
        _stderr().print(" ".join(told(text).split()), soft_wrap=True)


@contextlib.contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Inside, every mesh warning becomes one line on standard error; a text that comes again is printed once."""
    from ..errors import MeshWarning

    said = set()

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        if str(message) not in said:
            said.add(str(message))
            say(f"warning: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("always", MeshWarning)
        warnings.showwarning = show
        yield


class Clock:
    """Measures a job, and says when the next line of progress is due."""

    def __init__(self) -> None:
        self._started = self._last = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Wall time since the start."""
        return time.perf_counter() - self._started

    def due(self) -> bool:
        """Whether ten seconds have passed since the start or since this was last true."""
        if time.perf_counter() - self._last < _LOG_INTERVAL:
            return False
        self._last = time.perf_counter()
        return True


@contextlib.contextmanager
def progress(quiet: bool) -> Iterator["Callable[[Progress], None] | None"]:
    """Gives what `improve` calls with its progress: a live line on a terminal, elsewhere a line every ten seconds.

    Gives None if `quiet`.
    """
    console, clock = _stderr(), Clock()
    if quiet:
        yield None
    elif console.is_terminal:
        with console.status("starting", spinner="line") as status:
            yield lambda at: status.update(_progress_text(at, clock.seconds))
    else:

        def show(at: "Progress") -> None:
            if clock.due():
                say(_progress_text(at, clock.seconds))

        yield show


def _progress_text(at: "Progress", seconds: float) -> str:
    energy = "" if at.energy is None else f", iteration {at.iteration}, energy {at.energy:.6g}"
    meshes = "" if at.meshes == 1 else f"{at.meshes} meshes, "
    return f"{seconds:.1f} s  {at.stage}: {meshes}{at.inverted:,} inverted{energy}"


@contextlib.contextmanager
def bar(total: int) -> Iterator["Callable[[int, str], None]"]:
    """A live bar on standard error; gives a function that takes how much of the total is done, and a text."""
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

    columns = (SpinnerColumn("line"), BarColumn(24), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=_stderr(), transient=True) as progress:
        task = progress.add_task("starting", total=total)
        yield lambda done, text: progress.update(task, completed=done, description=text)


def counted(count: int, noun: str, plural: str | None = None) -> str:
    """'1 triangle', '2,000 triangles'"""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {plural or noun + 's'}"


def version() -> str:
    """The version of the installed package."""
    from importlib.metadata import version

    return version("torchmesh-untangle")


# What a record calls the least scaled Jacobian of six-node triangles and of quads with mid-side nodes.
CURVED = "minimum_scaled_jacobian"


def inverted_text(q: "Quality", curved: "CurvedSummary | None" = None) -> str:
    """'3 inverted triangles and 1 inverted quad'; empty if there are none.

    curved  counts of curved elements, which are judged by their Jacobians; None: there are none
    """
    from ..files.placed import CurvedSummary

    quads = int((~q.quad_upright).sum())
    c = curved or CurvedSummary(0, 0, int(q.inverted.sum()) - quads, 1.0, 0, 0, quads)
    parts = (
        (c.inverted_linear, "inverted triangle"), (c.inverted, "inverted six-node triangle"),
        (c.inverted_linear_quads, "inverted quad"), (c.inverted_quads, "inverted curved quad"),
    )  # fmt: skip
    return " and ".join(counted(count, noun) for count, noun in parts if count)


def verdict(where: str, q: "Quality", message: str = "", curved: "CurvedSummary | None" = None) -> int:
    """Says it if a mesh has inverted triangles or quads, and returns the exit status: 1 if it has any, else 0.

    where    words that follow the count, as in "better.vtu"
    message  why the improvement ended, if that is known
    curved   counts of curved elements, which are judged by their Jacobians
    """
    inverted = inverted_text(q, curved)
    if inverted:
        reason = f" ({message})" if message else ""
        say(f"not valid: {inverted} {where}{reason}")
    return int(bool(inverted))


def record(mesh: "MeshBatch", q: "Quality", curved: "CurvedSummary | None" = None) -> dict[str, Any]:
    """Counts and quality of the meshes of a file, all together, as plain values.

    curved  counts of curved elements, which are inverted where their Jacobians are; None: there are none

    `inverted` counts triangles, and `inverted_quads` quads, where there are any.
    """
    from ..mesh.measure import minimum_angle

    straight = int((~q.quad_upright).sum())
    quads = straight if curved is None else curved.all_quads_inverted
    sizes = (mesh.triangle_offsets + mesh.quad_offsets).diff().double()
    return {
        "triangles": len(mesh.triangles),
        "vertices": len(mesh.points),
        "inverted": int(q.inverted.sum()) - straight if curved is None else curved.all_triangles_inverted,
        **({} if curved is None else curved.to_dict()),
        **({"quads": len(mesh.quads), "inverted_quads": quads} if len(mesh.quads) else {}),
        "imr_average": float(q.mean[0] if len(mesh) == 1 else q.mean.double() @ (sizes / sizes.sum())),
        "imr_maximum": float(q.max.max()),
        "minimum_angle": float(minimum_angle(mesh).min()),
    }


def table(title: str | None = None) -> "Table":
    """An empty table in the style of all tables; the title is taken as it is, without markup."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    plain = None if title is None else Text(told(title))
    return Table(title=plain, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD, pad_edge=False)


def print_comparison(title: str, columns: dict[str, dict[str, Any]]) -> None:
    """Prints a table with a column for each state of a mesh; `columns` has the `record` of each."""
    made = table(title)
    made.add_column("")
    for name in columns:
        made.add_column(name, justify="right")
    for label, key in (
        ("triangles", "triangles"),
        ("inverted", "inverted"),
        ("IMR average", "imr_average"),
        ("IMR maximum", "imr_maximum"),
        ("minimum angle (degrees)", "minimum_angle"),
    ):
        made.add_row(label, *(number(record[key]) for record in columns.values()))
        if key == "inverted" and any("quads" in record for record in columns.values()):
            for extra in ("quads", "inverted_quads"):
                made.add_row(extra.replace("_", " "), *(number(r.get(extra, 0)) for r in columns.values()))
        if key == "inverted" and any(CURVED in record for record in columns.values()):
            made.add_row("minimum scaled Jacobian", *(number(r[CURVED]) for r in columns.values()))
    stdout().print(made)


def told_alone(names: "Sequence[str]") -> str:
    """Says that cell data of these names tells triangles from quads, and what comes of it."""
    data = " and ".join(map(repr, names))
    return (
        f"{data} differ{'s' * (len(names) == 1)} between triangles and quads only, and vertices between them may move"
    )


def print_fields(summary: "FieldSummary") -> None:
    """Says what became of the fields of a file, if anything did."""
    if str(summary):
        stdout().print(f"fields: {summary}", soft_wrap=True)


def print_counts(title: str, counts: dict[str, int]) -> None:
    """Prints a table with a row for each count."""
    made = table(title)
    made.add_column("")
    made.add_column("", justify="right")
    for name, count in counts.items():
        made.add_row(name, f"{count:,}")
    stdout().print(made)


def number(value: float) -> str:
    """A number as tables show it: counts in full, others to a few digits."""
    from ..pictures.captions import short

    return f"{value:,}" if isinstance(value, int) else short(value)


def json_text(value: Any) -> str:
    """The value as a JSON document, with null for infinity and NaN."""
    return json.dumps(_finite(value), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    """The value with None for each number that JSON does not have: the IMR of a flat triangle is infinite."""
    if isinstance(value, dict):
        return {key: _finite(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
