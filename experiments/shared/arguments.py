"""The parser of a script, and the options that several scripts have."""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from experiments.shared import clocks
from torchmesh.bench.provenance import provenance


def parser(description: str | None) -> argparse.ArgumentParser:
    """A parser that shows the first line of `description`, a module's docstring, and the default of each option."""
    first = (description or "").strip().split("\n")[0]
    return argparse.ArgumentParser(description=first, formatter_class=argparse.ArgumentDefaultsHelpFormatter)


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
    """The arguments; from here on one thread works, which is how everything is measured."""
    given = options.parse_args(argv)
    clocks.one_thread()
    return given


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
    record = {"options": vars(given), **provenance()}
    (given.out / f"{name}.run.json").write_text(json.dumps(record, indent=1, default=str) + "\n", encoding="utf-8")
