"""What the command line says: tables on standard output, lines and progress on standard error, JSON for files.

Nothing here imports torch or rich before it is needed.
"""

import contextlib
import functools
import json
import math
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console
    from torch import Tensor

    from ..improving.report import Progress
    from ..mesh.batch import MeshBatch
    from ..mesh.measure import Quality
    from ..remeshing.sizing import Sizes


@functools.cache
def stdout() -> "Console":
    """Where tables go."""
    from rich.console import Console

    # Tables sent to a file or a pipe are not cut to the width of a terminal.
    return Console(width=None if sys.stdout.isatty() else 140, highlight=False)


@functools.cache
def _stderr() -> "Console":
    from rich.console import Console

    return Console(stderr=True, highlight=False)


def say(text: str) -> None:
    """One line on standard error."""
    _stderr().print(" ".join(text.split()), markup=False, soft_wrap=True)


@contextlib.contextmanager
def warnings_as_lines() -> Iterator[None]:
    """Inside, every mesh warning is one line on standard error, and said once."""
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


@contextlib.contextmanager
def progress(quiet: bool) -> Iterator["Callable[[Progress], None] | None"]:
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
                say(_progress_text(at, started))

        yield show


def _progress_text(at: "Progress", started: float) -> str:
    energy = "" if at.energy is None else f", iteration {at.iteration}, energy {at.energy:.6g}"
    meshes = "" if at.meshes == 1 else f"{at.meshes} meshes, "
    return f"{time.perf_counter() - started:.1f} s  {at.stage}: {meshes}{at.inverted:,} inverted{energy}"


@contextlib.contextmanager
def bar(total: int) -> Iterator["Callable[[int, str], None]"]:
    """A live bar on standard error; call with what is done of the total, and words."""
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

    columns = (SpinnerColumn("line"), BarColumn(24), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=_stderr(), transient=True) as progress:
        task = progress.add_task("starting", total=total)
        yield lambda done, text: progress.update(task, completed=done, description=text)


def counted(count: int, noun: str, plural: str | None = None) -> str:
    """'1 triangle', '2,000 triangles'"""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {plural or noun + 's'}"


def record(mesh: "MeshBatch", q: "Quality") -> dict[str, Any]:
    """A mesh in numbers."""
    from ..mesh.measure import minimum_angle

    return {
        "triangles": len(mesh.triangles),
        "vertices": len(mesh.points),
        "inverted": int(q.inverted.sum()),
        "imr_average": float(q.mean[0]),
        "imr_maximum": float(q.max[0]),
        "minimum_angle": float(minimum_angle(mesh)[0]),
    }


def size_record(mesh: "MeshBatch", sizes: "Sizes") -> dict[str, float]:
    """How edge lengths compare with the sizes wanted: 1 is what was asked."""
    from ..remeshing.sizing import size_conformity

    found = size_conformity(mesh, sizes)
    return {"mean": float(found.mean[0]), "p5": float(found.low[0]), "p95": float(found.high[0])}


def worst(mesh: "MeshBatch", q: "Quality", count: int) -> list[dict[str, Any]]:
    """The `count` worst triangles: inverted ones, largest first, then those of the highest IMR."""
    import torch

    from ..mesh.batch import lift

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


def print_comparison(title: str, columns: dict[str, dict[str, Any]]) -> None:
    """A table with a column for each state of a mesh, from its `record`."""
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
    stdout().print(table)


def print_counts(title: str, counts: dict[str, int]) -> None:
    """A table of numbers with their names."""
    from rich.text import Text

    table = _table()
    table.title = Text(title)
    table.add_column("")
    table.add_column("", justify="right")
    for name, count in counts.items():
        table.add_row(name, f"{count:,}")
    stdout().print(table)


def print_qualities(records: list[dict[str, Any]]) -> None:
    """A table with a row for each file, then a table for the worst triangles of each."""
    from rich.text import Text

    table = _table()
    table.add_column("file", overflow="fold")
    for name in ("triangles", "inverted", "IMR average", "IMR maximum", "minimum angle"):
        table.add_column(name, justify="right")
    sized = "edge_length_over_size" in records[0]
    if sized:
        table.add_column("edge length / size: mean (5 - 95 %)", justify="right")
    for r in records:
        numbers = (r[k] for k in ("triangles", "inverted", "imr_average", "imr_maximum", "minimum_angle"))
        cells = [_number(value) for value in numbers]
        if sized:
            mean, low, high = (f"{r['edge_length_over_size'][k]:.2f}" for k in ("mean", "p5", "p95"))
            cells.append(f"{mean} ({low} - {high})")
        table.add_row(Text(r["file"]), *cells, style="red" if r["inverted"] else None)
    stdout().print(table)
    for r in records:
        _print_metrics(r)
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
        stdout().print(table)


def _print_metrics(record: dict[str, Any]) -> None:
    """A table with a row for each metric, if the record has any."""
    from rich.text import Text

    if not record.get("metrics"):
        return
    table = _table()
    table.title = Text(f"metrics of {record['file']}")
    table.add_column("metric")
    percents = [name for name in next(iter(record["metrics"].values())) if name.startswith("p")]
    columns = ["min", *percents, "max", "mean"]
    for name in columns:
        table.add_column({"p50": "median"}.get(name, name), justify="right")
    for name, numbers in record["metrics"].items():
        table.add_row(name, *(_number(numbers[column]) for column in columns))
    stdout().print(table)


def print_parts(mesh: "MeshBatch", loops: "dict[str, Tensor]") -> None:
    """A table of a boundary's loops (their vertices, by name) and the boxes they fill."""
    table = _table()
    table.add_column("part")
    for name in ("vertices", "x from", "x to", "y from", "y to"):
        table.add_column(name, justify="right")
    for name, loop in loops.items():
        (x0, y0), (x1, y1) = mesh.points[loop].amin(0).tolist(), mesh.points[loop].amax(0).tolist()
        table.add_row(name, f"{len(loop):,}", *(f"{v:.6g}" for v in (x0, x1, y0, y1)))
    stdout().print(table)


def _number(value: float) -> str:
    from ..pictures.captions import short

    return f"{value:,}" if isinstance(value, int) else short(value)


def json_text(value: Any) -> str:
    """The value as a JSON document, with null for infinity and NaN."""
    return json.dumps(_finite(value), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    """The value with null for what JSON has no number for: the IMR of a flat triangle is infinite."""
    if isinstance(value, dict):
        return {key: _finite(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
