"""Which cases of the Locally Injective Mappings benchmark come out valid, with the triangles kept?

    python -m experiments.robustness.injective_maps FOLDER

FOLDER holds the data set (https://doi.org/10.5281/zenodo.3827969), or any part of it; how its files are read is said in
experiments/shared/injective_cases.py.  Each case goes through `improve` with topology="keep", the handles fixed, and
the shapes on the surface as targets.  Exact signs, computed without torchmesh's own checks, decide what is valid.

Each case is one line of injective_maps.jsonl, as soon as it is done; a run that was stopped goes on where it was.
injective_maps.md holds the table: a row for each folder below FOLDER, and one for all.  The exit status is 1 if a case
is not valid.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

if not __package__:  # run by its path: what the scripts share is found from the root
    sys.path.insert(0, str(Path(__file__).parents[2]))

import torchmesh as tm
from experiments.shared import arguments, tables
from experiments.shared.injective_cases import InjectiveCase, NoCase, case_files, read_case
from torchmesh.bench import exact_check


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("folder", type=Path, help="folder of the data set")
    parser.add_argument("--limit", type=int, default=None, help="so many cases at most in this run")
    arguments.add_out(parser, "injective_maps")
    given = arguments.parse(parser, argv)
    given.out.mkdir(parents=True, exist_ok=True)
    record = given.out / "injective_maps.jsonl"
    # A line that a kill has cut short is worked on again.
    rows = [row for line in record.read_text().splitlines() if (row := _row(line))] if record.exists() else []
    record.write_text("".join(json.dumps(row) + "\n" for row in rows))
    done, left = {row["case"] for row in rows}, given.limit
    with record.open("a") as out:
        for path in case_files(given.folder):
            name = path.relative_to(given.folder).as_posix()
            if name in done:
                continue
            if left == 0:
                break
            row = {"case": name, **measure(path)}
            rows.append(row)
            out.write(json.dumps(row) + "\n")
            out.flush()
            left = None if left is None else left - 1
    text = table_of(rows)
    (given.out / "injective_maps.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    failed = [row for row in rows if row["valid"] is False]
    for row in failed:
        print(f"not valid: {row['case']}: {row['note']}")
    for row in rows:
        if row["valid"] is None:
            print(f"left out: {row['case']}: {row['note']}")
    return int(bool(failed))


def _row(line: str) -> dict | None:
    try:
        row: dict = json.loads(line)
    except ValueError:
        return None
    return row


def measure(path: Path) -> dict:
    """What becomes of the case of a file; `valid` is None for files that hold no mesh of triangles."""
    try:
        case = read_case(path)
    except (NoCase, tm.MeshError, OSError) as error:
        return {"valid": None, "note": str(error)}
    before = exact_check.inverted(case.mesh.points.numpy(), case.mesh.triangles.numpy())
    started = time.process_time()
    after, report = untangled(case)
    seconds = time.process_time() - started
    wrong = exact_check.faults(case.mesh, after)
    towards = tm.target_quality(after, case.targets)
    return {
        "valid": not wrong,
        "note": "; ".join([*wrong, *(report.messages if wrong else [])]),
        "triangles": len(case.mesh.triangles),
        "inverted before": before,
        "seconds": round(seconds, 3),
        "mean": None if wrong else float(towards.mean()),
        "max": None if wrong else float(towards.max()),
    }


def untangled(case: InjectiveCase) -> tuple[tm.MeshBatch, tm.Report]:
    """The case with its triangles kept, smoothed towards the shapes of the surface."""
    smooth = tm.SmoothOptions(targets=case.targets)
    return tm.improve(case.mesh, tm.ImproveOptions(topology="keep", smooth=smooth, workers=1))


def table_of(rows: list[dict]) -> str:
    """Markdown: how many cases of each folder end valid, and in what time."""
    known = [row for row in rows if row["valid"] is not None]
    groups: dict[str, list[dict]] = {}
    for row in known:
        groups.setdefault(row["case"].rpartition("/")[0].split("/")[0] or ".", []).append(row)
    titles = ("folder", "cases", "valid", "tangled before", "seconds, median", "slowest", "IMR to the surface, median",
              "largest triangle count")  # fmt: skip
    lines = [_line(name, group) for name, group in sorted(groups.items())]
    return tables.table(titles, [*lines, *([_line("all", known)] if known else [])])


def _line(name: str, rows: list[dict]) -> list[str]:
    seconds = [row["seconds"] for row in rows]
    means = [row["mean"] for row in rows if row["mean"] is not None]
    return [
        name, f"{len(rows):,}", f"{sum(row['valid'] for row in rows):,}",
        f"{sum(row['inverted before'] > 0 for row in rows):,}", f"{np.median(seconds):.2f}", f"{max(seconds):.1f}",
        f"{np.median(means):.3f}" if means else "", f"{max(row['triangles'] for row in rows):,}",
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
