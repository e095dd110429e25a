"""`torchmesh batch`: many mesh files at once, with progress, a manifest, and resumption.

Nothing here imports torch before it is needed.
"""

import contextlib
import sys
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import console
from .errors import UsageError
from .shared_options import (
    BetaOption,
    Boundary,
    BoundaryOption,
    Fields,
    FieldsOption,
    Height,
    HeightOption,
    InterfacesOption,
    Method,
    MethodOption,
    Quads,
    QuadsOption,
    QuietOption,
    RegionsOption,
    Scope,
    ScopeOption,
    Shapes,
    ShapesOption,
    StrictOption,
    Topology,
    TopologyOption,
    improve_options,
)

if TYPE_CHECKING:
    from ..batches.manifest import FileResult
    from ..batches.runs import Run

EXAMPLES = (
    "torchmesh batch 'in/**/*.vtu' --out results",
    "torchmesh batch in plate.msh --out results --format vtu --workers 2 --budget 20000",
)


# How many failures standard error tells; the manifest has all of them.
_SHOWN = 10


class Engine(str, Enum):
    """Where a run computes."""

    local = "local"
    ray = "ray"


def batch(
    sources: Annotated[
        list[str],
        typer.Argument(
            metavar="IN...",
            help="Mesh files, folders (every mesh file below them that is not hidden) or patterns in quotes, ** for "
            "any folders.",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            metavar="DIR", help="Folder for the results; the inputs' folders come again below it.", show_default=False
        ),
    ],
    engine: Annotated[
        Engine, typer.Option(help="Processes of this machine, or a Ray cluster (RAY_ADDRESS, or a local one).")
    ] = Engine.local,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Processes, of one thread each. Default: one a processor.", show_default=False),
    ] = None,
    budget: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="VERTICES", help="Vertices in one batch at most. Default: 30000.", show_default=False
        ),
    ] = None,
    method: MethodOption = Method.default,
    topology: TopologyOption = Topology.flip,
    beta: BetaOption = None,
    boundary: BoundaryOption = Boundary.fixed,
    interfaces: InterfacesOption = None,
    scope: ScopeOption = Scope.all,
    shapes: ShapesOption = Shapes.auto,
    quads: QuadsOption = Quads.keep,
    regions: RegionsOption = None,
    fields: FieldsOption = Fields.interpolate,
    height: HeightOption = Height.interpolate,
    suffix: Annotated[
        str | None,
        typer.Option("--format", metavar="EXT", help="Extension of the results, as vtu.", show_default=False),
    ] = None,
    redo: Annotated[bool, typer.Option("--redo", help="Begin anew, whatever DIR holds from earlier runs.")] = False,
    strict: StrictOption = False,
    quiet: QuietOption = False,
) -> int:
    """Improve many mesh files, as torchmesh improve does, on all processors.

    Files in a folder that are of no mesh format are skipped, and named. Hidden files and folders (names that begin with
    a dot) are left out. A link that leads nowhere is an error. Of a time series (XDMF, .pvd) every step is improved.

    DIR/manifest.jsonl gets a line for each mesh as soon as it is done: file, output, status, inverted triangles and
    IMR before and after, what became of its fields, seconds, error; DIR/manifest.parquet is the same table, written at
    the end. A file that cannot be read is an error in the manifest, and the rest goes on.

    After an interrupt, a kill or a crash the same command goes on where the last one stopped. Files that have changed
    since, and errors, are done again.

    The exit status is 1 if any mesh is an error or still has inverted triangles, and 2 if --strict kept one from being
    written.
    """
    from ..batches.runs import BUDGET, Run

    options = improve_options(method, topology, beta, boundary, interfaces, scope, shapes, quads)
    try:
        run = Run.plan(
            sources, out, options, engine.value, workers, budget or BUDGET, suffix, redo, strict, fields.value, regions,
            height.value,
        )  # fmt: skip
    except ValueError as error:
        raise UsageError(str(error)) from None
    if run.skipped and not quiet:
        names = ", ".join(run.skipped[:_SHOWN]) + (", ..." if len(run.skipped) > _SHOWN else "")
        console.say(f"skipped: {console.counted(len(run.skipped), 'file')} of no mesh format: {names}")
    for reason, count in run.changed.items():
        console.say(f"done again: {console.counted(count, 'mesh', 'meshes')} ({reason})")
    return _run(run, quiet)


def _run(run: "Run", quiet: bool) -> int:
    """Does the work and returns the exit status."""
    clock = console.Clock()
    tally = Tally(len(run.kept) + len(run.jobs), len(run.kept), sum(max(job.size, 1) for job in run.jobs))
    sizes = {job.name: max(job.size, 1) for job in run.jobs}
    try:
        with _progress(tally, quiet) as show:
            for result in run.results():
                tally.add(result, sizes.get(result.name, 0))
                show(result)
    except KeyboardInterrupt:
        console.say(f"{tally.done:,} of {tally.total:,} meshes are done; the same command goes on from there")
        raise
    if not quiet:
        console.print_counts(f"{run.out}, {clock.seconds:.1f} s", tally.counts())
    if tally.failed:
        hidden = tally.failed - _SHOWN
        more = f"; {hidden:,} more in the manifest" if hidden > 0 else ""
        console.say(f"{tally.verdict()}: {run.out / 'manifest.jsonl'}{more}")
    return 2 if tally.refused else int(tally.failed > 0)


class Tally:
    """Counts the results of a run, and estimates from the bytes of the files done how long the rest will take.

    total  meshes of the run
    kept   how many of them an earlier run did
    size   bytes of the files that are left to do
    """

    def __init__(self, total: int, kept: int, size: int) -> None:
        self.total, self.kept, self.size = total, kept, size
        self.done = self.tangled = self.errors = self.refused = self.inverted_before = self.inverted_after = (
            self.bytes
        ) = 0

    def add(self, result: "FileResult", size: int) -> None:
        """Counts one result, whose file has `size` bytes."""
        self.done += 1
        self.bytes += size
        self.errors += result.error is not None
        self.refused += (result.error or "").endswith("(strict)")
        self.tangled += result.error is None and not result.valid
        self.inverted_before += result.inverted_before or 0
        self.inverted_after += result.inverted_after or 0

    @property
    def failed(self) -> int:
        """Meshes that are errors or still have inverted triangles."""
        return self.tangled + self.errors

    def verdict(self) -> str:
        """'not valid: 1 of 12 meshes still has inverted elements, 2 are errors', or 'errors: 1 of 1 file'"""
        verb = "is an error" if self.errors == 1 else "are errors"
        if not self.tangled:
            return f"errors: {self.errors:,} of {console.counted(self.total, 'file')}"
        have = "has" if self.tangled == 1 else "have"
        told = f"{self.tangled:,} of {console.counted(self.total, 'mesh', 'meshes')} still {have} inverted elements"
        return f"not valid: {told}" + (f", {self.errors:,} {verb}" if self.errors else "")

    def counts(self) -> dict[str, int]:
        """The rows of the table at the end of a run."""
        return {
            "meshes": self.total,
            "of an earlier run": self.kept,
            "valid": self.total - self.failed,
            "not valid": self.tangled,
            "errors": self.errors,
            "inverted elements before": self.inverted_before,
            "inverted elements after": self.inverted_after,
        }

    def text(self, seconds: float) -> str:
        """'120 of 400 meshes, 1 failed, 25.3 a second, 0:00:11 left'"""
        made = self.done - self.kept
        words = [f"{self.done:,} of {self.total:,} meshes"]
        words += [f"{self.failed:,} failed"] if self.failed else []
        if made > 0 and seconds > 0:
            left = seconds * (self.size - self.bytes) / self.bytes
            words += [f"{made / seconds:.3g} a second", f"{hours(left)} left"]
        return ", ".join(words)


def hours(seconds: float) -> str:
    """'1:02:03'"""
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"


@contextlib.contextmanager
def _progress(tally: Tally, quiet: bool) -> Iterator["Callable[[FileResult], None]"]:
    """Gives what is called with each result: it tells the first failures, and how far the run is.

    That is a live bar on a terminal, and a line every ten seconds elsewhere.
    """
    told, clock = 0, console.Clock()

    def tell(result: "FileResult") -> None:
        nonlocal told
        if result.valid or told == _SHOWN:
            return
        told += 1
        if result.error is not None:
            console.say(f"error: {result.error}")
        else:
            inverted = console.counted(result.inverted_after or 0, "inverted element")
            console.say(f"not valid: {inverted} in {result.output} ({result.message})")

    if quiet or not sys.stderr.isatty():

        def show(result: "FileResult") -> None:
            tell(result)
            if not quiet and clock.due():
                console.say(tally.text(clock.seconds))

        yield show
        return
    with console.bar(tally.total) as advance:

        def show_bar(result: "FileResult") -> None:
            tell(result)
            advance(tally.done, tally.text(clock.seconds))

        yield show_bar
