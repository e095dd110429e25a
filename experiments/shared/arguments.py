"""The parser of a script, and the options that several scripts have."""

from __future__ import annotations

import argparse
import csv
import inspect
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from experiments.shared import clocks, tables
from torchmesh.bench.provenance import provenance

# Where tables are kept unless a run says otherwise.
TABLES = Path("out/tables")


def parser(description: str | None) -> argparse.ArgumentParser:
    """A parser that shows the first line of `description`, a module's docstring, and the default of each option."""
    first = (description or "").strip().split("\n")[0]
    made = argparse.ArgumentParser(description=first, formatter_class=argparse.ArgumentDefaultsHelpFormatter)
    made.add_argument(
        "--csv",
        type=Path,
        default=TABLES,
        help="folder for tables as CSV and a record of the run: options, seed, versions, processor, commit",
    )
    return made


def add_cache(options: argparse.ArgumentParser) -> None:
    """--cache, the same for all scripts: their meshes have names that do not clash."""
    options.add_argument("--cache", type=Path, default=Path("out/cache"), help="folder where generated meshes are kept")


def add_out(options: argparse.ArgumentParser, name: str) -> None:
    """--out, the folder for what the script writes; out/NAME unless another is given."""
    options.add_argument("--out", type=Path, default=Path("out") / name, help="folder for tables, records and pictures")


def add_sizes(options: argparse.ArgumentParser, *default: int) -> None:
    """--triangles, one or several approximate numbers of triangles of a mesh."""
    options.add_argument(
        "--triangles", type=int, nargs="+", default=list(default), help="about so many triangles a mesh"
    )


def parse(options: argparse.ArgumentParser, argv: Sequence[str] | None) -> argparse.Namespace:
    """The arguments; from here on one thread works, which is how everything is measured, and tables are kept."""
    given = options.parse_args(argv)
    clocks.one_thread()
    tables.keep(given.csv, script(), record(given))
    return given


def script() -> str:
    """The last part of the name of the script that calls, as `python -m experiments` knows it."""
    frame = inspect.currentframe()
    while frame is not None:
        name = str(frame.f_globals.get("__name__", ""))
        spec = frame.f_globals.get("__spec__")
        name = spec.name if name == "__main__" and spec is not None else name
        parts = name.removesuffix(".__main__").split(".")
        if parts[0] == "experiments" and len(parts) > 2 and parts[1] != "shared":
            return parts[2] if len(parts) == 3 else "-".join(parts[2:])
        frame = frame.f_back
    return "experiment"


def record(given: argparse.Namespace) -> dict[str, object]:
    """Where a result comes from: options, seed, versions, processor, kernels, commit, and when."""
    seeds = {name: value for name, value in vars(given).items() if name in ("seed", "seeds")}
    return {
        "experiment": script(),
        "options": vars(given),
        "seed": next(iter(seeds.values()), "fixed in the script"),
        **provenance(),
        "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }


def sizes_and_cache(description: str | None, argv: Sequence[str] | None, *triangles: int) -> argparse.Namespace:
    """The arguments of a script that has no options but --triangles and --cache."""
    options = parser(description)
    add_sizes(options, *triangles)
    add_cache(options)
    return parse(options, argv)


def write_rows(given: argparse.Namespace, name: str, rows: Sequence[Mapping[str, object]]) -> None:
    """Write NAME.csv, the rows, and NAME.run.json, where they come from: options, versions, processor and commit.

    Both go to the folder `given.out`.  The columns are those of the first row.
    """
    given.out.mkdir(parents=True, exist_ok=True)
    with open(given.out / f"{name}.csv", "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, list(rows[0]) if rows else [], extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    text = json.dumps(record(given), indent=1, default=str) + "\n"
    (given.out / f"{name}.run.json").write_text(text, encoding="utf-8")
