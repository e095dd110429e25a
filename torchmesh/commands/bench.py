"""`torchmesh bench`: methods that untangle meshes, compared on seeded cases by an exact judge.

Nothing here imports torch before it is needed.
"""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import console
from .errors import UsageError
from .shared_options import QuietOption, use_threads

if TYPE_CHECKING:
    from ..bench.results import Row

WeightsOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="The weights of the network, mover.pt. Default: those of the checkout that torchmesh runs from.",
        show_default=False,
    ),
]

RUN_EXAMPLES = (
    "torchmesh bench run --families moved,jitter --limit 2 --out results",
    "torchmesh bench run --with my_method.py --families jitter --limit 3 --out results",
    "torchmesh bench run --methods ours-keep,ours-fast,rbf --families turned --limit 1 --out results",
)

LIST_EXAMPLES = ("torchmesh bench list",)


def run(
    file: Annotated[
        list[Path] | None,
        typer.Option(
            "--with",
            metavar="FILE.py",
            help="A file with functions under @bench.method; all of its methods run. May be given several times.",
            show_default=False,
        ),
    ] = None,
    methods: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME",
            help="Built-in methods, or all. Default: ours; see torchmesh bench list.",
            show_default=False,
        ),
    ] = None,
    families: Annotated[
        str | None,
        typer.Option(metavar="NAME,NAME", help="Families of cases. Default: all.", show_default=False),
    ] = None,
    limit: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Cases of each family. Default: all.", show_default=False)
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder for the results.")] = Path("bench-results"),
    seconds: Annotated[float, typer.Option(min=0.1, help="A method is stopped after so long on one case.")] = 120.0,
    weights: WeightsOption = None,
    quiet: QuietOption = False,
) -> int:
    """Run methods on the benchmark of tangled meshes, and judge what they make.

    DIR gets results.csv and results.parquet, a row for each case and method; index.html, a page with success and time
    against difficulty; and table.md. What is there already is not made again, so the same command goes on after a stop.
    The exit status is 0 however many results are valid.
    """
    _use_weights(weights)
    from ..bench import registry
    from ..bench.running import RunOptions
    from ..bench.running import run as run_all
    from ..errors import MissingDependencyError

    use_threads(1)
    clock = console.Clock()

    def progress(done: int, total: int, row: "Row") -> None:
        if not quiet and clock.due():
            console.say(f"{done:,} of {total:,}: {row['method']}, {row['family']} {row['case']}: {row['outcome']}")

    try:
        added = [name for path in file or [] for name in registry.methods_of(str(path))]
        asked = _names(methods) or ["ours"]
        options = RunOptions([*asked, *added], _names(families), limit, seconds)
        rows = run_all(out, options, say=console.say, progress=progress)
    except MissingDependencyError as error:
        raise UsageError(f"{error}; the other results are in {out}") from None
    except ValueError as error:
        raise UsageError(str(error)) from None
    _print_table(rows)
    for text in _errors(rows):
        console.say(text)
    if not quiet:
        console.say(f"{console.counted(len(rows), 'row')} in {out / 'results.csv'}; to look at: {out / 'index.html'}")
    return 0


def show(weights: WeightsOption = None) -> int:
    """List the methods, whether their libraries are installed, and the families of cases."""
    _use_weights(weights)
    from ..bench import registry
    from ..bench.catalogue import families

    table = console.table("methods")
    for head in ("name", "what it is", "can run"):
        table.add_column(head, overflow="fold")
    for name in registry.builtin_methods():
        method = registry.METHODS[name]
        table.add_row(name, registry.words(method), registry.why_not(method) or "yes")
    console.stdout().print(table)
    table = console.table("families")
    for head in ("name", "what the cases are", "harder by", "levels", "cases"):
        table.add_column(head, overflow="fold")
    for family in families().values():
        levels = ", ".join(f"{level:g}" for level in family.levels)
        table.add_row(family.name, family.words, family.unit, levels, f"{len(family):,}")
    console.stdout().print(table)
    return 0


def _names(text: str | None) -> list[str]:
    """The names of a list with commas."""
    return [name for name in (text or "").replace(" ", ",").split(",") if name]


def _use_weights(path: Path | None) -> None:
    """Make the network read its weights from that file."""
    if path is None:
        return
    if not path.is_file():
        raise UsageError(f"{path}: there is no such file of weights")
    from ..bench.weights import VARIABLE

    os.environ[VARIABLE] = str(path)


def _errors(rows: "list[Row]") -> list[str]:
    """For each method that raised errors: how often, and the first of them."""
    failed: dict[str, list[Row]] = {}
    for row in rows:
        if row["outcome"] == "error":
            failed.setdefault(row["method"], []).append(row)
    return [
        f"{name} raised {console.counted(len(own), 'error')}; the first, in {own[0]['family']} {own[0]['case']}: "
        f"{own[0]['fault']}"
        for name, own in failed.items()
    ]


def _print_table(rows: "list[Row]") -> None:
    from ..bench.summary import table as summary

    heads, lines = summary(rows)
    table = console.table()
    for i, head in enumerate(heads):
        table.add_column(head, justify="right" if i else "left")
    for line in lines:
        table.add_row(*line)
    console.stdout().print(table)
