"""A run of the benchmark: every method on every case, in a process of their own, with results on disk as they come."""

import functools
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import MeshIOError
from . import registry, results
from .answers import Missing
from .case import Case, Family
from .catalogue import chosen as chosen_families
from .catalogue import families
from .provenance import provenance
from .registry import Method
from .results import Row
from .weights import weights_file
from .worker import Worker


@dataclass(frozen=True)
class RunOptions:
    """What a run does.

    methods   names of methods; "all": every built-in one
    families  names of families; none: all
    limit     so many cases of each family, the first ones; None: all
    seconds   a method is stopped after so many seconds of wall time on one case
    """

    methods: Sequence[str] = ("ours",)
    families: Sequence[str] = ()
    limit: int | None = None
    seconds: float = 120.0

    def __post_init__(self) -> None:
        if self.limit is not None and self.limit < 1:
            raise ValueError(f"RunOptions.limit must be at least 1, not {self.limit}")
        if not self.seconds > 0:
            raise ValueError(f"RunOptions.seconds must be positive, not {self.seconds}")


def run(
    folder: Path | str,
    options: RunOptions | None = None,
    *,
    say: Callable[[str], None] = lambda text: None,
    progress: Callable[[int, int, Row], None] = lambda done, total, row: None,
) -> list[Row]:
    """Run the benchmark; the folder gets `results.csv`, `results.parquet`, `table.md` and `index.html`.

    say       is called with what a user should know: methods and families that are left out
    progress  is called after each new row with the number of rows done, of all, and the row

    Rows that the folder has already are not made again, so a run that was stopped goes on.  Methods and families whose
    libraries or weights are not there are left out.  Returns the rows of the chosen methods and cases.

    Raises ValueError for unknown names and where nothing is left, MeshIOError, and MissingDependencyError for the
    Parquet file.
    """
    options = options or RunOptions()
    folder = Path(folder)
    methods = _present(registry.chosen(list(options.methods)), say)
    some = _drawable(chosen_families(options.families), say)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MeshIOError(f"{folder}: no folder can be made: {error.strerror}") from None
    known = results.load(folder)
    jobs = [(f, n) for f in some for n in range(len(f) if options.limit is None else min(options.limit, len(f)))]
    wanted = [(m.name, f.name, n) for f, n in jobs for m in methods]
    done = sum(k in known for k in wanted)
    with Worker(_row) as worker:
        try:
            for family, number in jobs:
                for method in methods:
                    if (method.name, family.name, number) in known:
                        continue
                    row = _made(worker, options, method, family.name, number)
                    results.append(folder, row)
                    known[results.key(row)] = row
                    done += 1
                    progress(done, len(wanted), row)
        finally:
            _write(folder, list(known.values()))
    return [known[k] for k in wanted]


def _present(methods: list[Method], say: Callable[[str], None]) -> list[Method]:
    """The methods whose libraries are installed; the others are named.  Raises ValueError if there are none."""
    found = []
    for method in methods:
        try:
            method.check()
        except Missing as why:
            say(f"left out, {why}")
        else:
            found.append(method)
    if not found:
        raise ValueError("no method is left to run")
    return found


def _drawable(listed: list[Family], say: Callable[[str], None]) -> list[Family]:
    """The families whose weights are there; the others are named.  Raises ValueError if there are none."""
    found = []
    for family in listed:
        try:
            if family.needs == "weights":
                weights_file()
        except Missing as why:
            say(f"left out, family {family.name}: {why}")
        else:
            found.append(family)
    if not found:
        raise ValueError("no family is left to run")
    return found


def _made(worker: Worker, options: RunOptions, method: Method, family: str, number: int) -> Row:
    """One row; what the worker could not finish is an error with its reason."""
    row = worker.call(options.seconds, method.name, family, number)
    if "method" in row:
        return row
    made = _case(family, number)
    return _head(method, made) | {"valid": False, "outcome": "error"} | row | _tail()


@functools.lru_cache(maxsize=2)
def _case(family: str, number: int) -> Case:
    """The case; the last ones are kept, since all methods are asked for one case after another."""
    return families()[family].case(number)


def _row(name: str, family: str, number: int) -> Row:
    """One row, made in the worker."""
    import torch

    from .solving import solve

    torch.set_num_threads(1)
    method, case = registry.METHODS[name], _case(family, number)
    return _head(method, case) | solve(case, method) | _tail()


def _head(method: Method, case: Case) -> Row:
    """The columns that tell the method and the case."""
    return {
        "method": method.name,
        "family": case.family,
        "case": case.number,
        "level": float(case.level),
        "unit": families()[case.family].unit,
        "triangles": len(case.mesh.triangles),
        "vertices": len(case.mesh.points),
        "inverted_before": case.inverted,
        "seed": case.number,
        "details": json.dumps(case.details, sort_keys=True),
        "digest": case.digest,
    }


def _tail() -> dict[str, Any]:
    """The columns that tell where the row comes from."""
    return {k: v if isinstance(v, str) else json.dumps(v) for k, v in provenance().items()} | {
        "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    }


def _write(folder: Path, rows: list[Row]) -> None:
    """The tables and the page of all rows that the folder has."""
    from .page import page
    from .summary import markdown

    if not rows:
        return
    (folder / "table.md").write_text(markdown(rows), encoding="utf-8")
    (folder / "index.html").write_text(page(rows), encoding="utf-8")
    results.write_tables(folder, rows)
