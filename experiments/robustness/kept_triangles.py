"""Does every mesh come out valid with the triangles kept, where a solution is known, and what becomes of the others?

    python -m experiments.robustness.kept_triangles --count 1000 --triangles 500
    python -m experiments.robustness.kept_triangles --count 0 --hard 300 1000
    python -m experiments.robustness.kept_triangles --count 0 --hard 300 --radii 0.45 0.8 --degrees 100 170

The first `--count` cases are feasible by construction (experiments/shared/feasible.py): valid meshes of letters,
spirals, combs, annuli, turned annuli, bent domains and rectangles with holes, whose free vertices were then put at the
means of their neighbours, in one point, or anywhere.  The `--hard` cases, of about so many triangles, are rings whose
inner circle turns by 60 to 180 degrees, and squares mapped onto letters and wound onto spirals; of these nobody knows
beforehand whether a solution exists.

Each case is one line of kept_triangles.jsonl; a run that was stopped goes on where it was.  kept_triangles.md holds the
table: valid; impossible, with a certificate; and undecided.  kept_triangles.certificates.jsonl holds the certificates,
for `python experiments/robustness/check_certificates.py FILE`.  The exit status is 1 if a feasible case is not valid.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch

import torchmesh as tm
from experiments.shared import arguments, feasible, tables
from experiments.shared.tangles import FAMILIES, tangle
from torchmesh.bench import exact_check
from torchmesh.diagnosing.certificates import certificates

RADII, DEGREES = (0.3, 0.5, 0.6, 0.7), (60, 120, 150, 180)


def hard_names(triangles: int, radii: Sequence[float] = RADII, degrees: Sequence[int] = DEGREES) -> Iterator[str]:
    """The names of the hard cases of about so many triangles: rings of these inner radii and turns, and the others."""
    for inner in radii:
        for turn in degrees:
            yield f"ring {inner:g}-{triangles}-{turn}"
    for family in ("mapped", "wound"):
        for value in FAMILIES[family].values:
            for seed in (0, 1):
                yield f"{family}-{triangles}-{value:g}-{seed}"


def hard(name: str, cache: Path) -> tm.MeshBatch:
    """The tangled mesh of that name."""
    kind, triangles, *rest = name.split("-")
    if kind.startswith("ring"):
        inner = float(kind.split()[1])
        mesh = feasible.meshed(feasible.ring(inner), np.random.default_rng(int(triangles)), int(triangles))
        turned = feasible.twisted(mesh.points.numpy(), inner, math.radians(float(rest[0])))
        return tm.relax(mesh.with_points(torch.from_numpy(turned)))
    return tangle(kind, float(rest[0]), int(triangles), 0.3, int(rest[1]), cache).tangled


def measure(tangled: tm.MeshBatch) -> dict:
    """What becomes of one mesh."""
    started = time.process_time()
    after, report = tm.improve(tangled, tm.ImproveOptions(topology="keep", workers=1))
    seconds = time.process_time() - started
    wrong = exact_check.faults(tangled, after)
    # Where something is proved and yet fewer triangles are inverted than before, a mesh ends as partly mended.
    impossible = bool(wrong) and int(report.status[0]) in (tm.Status.INFEASIBLE, tm.Status.PARTLY)
    return {
        "triangles": len(tangled.triangles),
        "inverted before": exact_check.inverted(tangled.points.numpy(), tangled.triangles.numpy()),
        "valid": not wrong,
        "impossible": impossible,
        "ways": [step.stage for step in report.steps[0]],
        "note": "; ".join([*wrong, *report.messages]) if wrong else "",
        "seconds": round(seconds, 3),
    }


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--count", type=int, default=1000, help="number of cases that are feasible by construction")
    parser.add_argument("--hard", type=int, nargs="*", default=[], help="triangles of the hard cases, about")
    parser.add_argument("--radii", type=float, nargs="+", default=RADII, help="inner radii of the rings of --hard")
    parser.add_argument("--degrees", type=int, nargs="+", default=DEGREES, help="degrees by which they turn")
    arguments.add_sizes(parser, 500)
    arguments.add_cache(parser)
    arguments.add_out(parser, "kept_triangles")
    given = arguments.parse(parser, argv)
    given.out.mkdir(parents=True, exist_ok=True)
    record = given.out / "kept_triangles.jsonl"
    rows = [json.loads(line) for line in record.read_text().splitlines()] if record.exists() else []
    done, known = {row["case"] for row in rows}, set[str]()
    work: list[tuple[str, Callable[[str], tm.MeshBatch]]] = []
    for triangles in given.triangles:
        names = list(feasible.names(given.count, triangles))
        work += [(name, lambda n: feasible.case(n).tangled) for name in names]
        known |= set(names)
    for triangles in given.hard:
        work += [(name, lambda n: hard(n, given.cache)) for name in hard_names(triangles, given.radii, given.degrees)]
    with record.open("a") as out:
        for name, made in work:
            if name in done:
                continue
            mesh = made(name)
            if name.startswith("wound") and not exact_check.boundary_is_simple(mesh):
                continue  # with so few vertices the turns of the spiral cross
            row = {"case": name, "kind": name.split("-")[0], "feasible": name in known, **measure(mesh)}
            if row["impossible"]:
                proved = {"case": name, **certificates(mesh, tm.diagnose(mesh, "keep", thorough=True))}
                with (given.out / "kept_triangles.certificates.jsonl").open("a") as file:
                    file.write(json.dumps(proved) + "\n")
            rows.append(row)
            out.write(json.dumps(row) + "\n")
            out.flush()
    text = table_of(rows)
    (given.out / "kept_triangles.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    failed = [row for row in rows if row["feasible"] and not row["valid"]]
    for row in rows:
        if not row["valid"]:
            print(f"not valid: {row['case']}: {row['note']}")
    return int(bool(failed))


def table_of(rows: list[dict]) -> str:
    """Markdown: of each kind how many are valid, impossible and undecided, and the seconds."""
    titles = ("cases", "number", "tangled before", "valid", "impossible, certified", "undecided", "second-order ways",
              "seconds, median", "slowest")  # fmt: skip
    groups: dict[str, list[dict]] = {}
    for row in rows:
        groups.setdefault(("" if row["feasible"] else "hard: ") + row["kind"].split()[0], []).append(row)
    lines = [_line(name, group) for name, group in groups.items()]
    return tables.table(titles, [*lines, *([_line("all", rows)] if rows else [])])


def _line(name: str, rows: list[dict]) -> list[str]:
    seconds = [row["seconds"] for row in rows]
    valid, impossible = sum(row["valid"] for row in rows), sum(row["impossible"] for row in rows)
    counts = [len(rows), sum(row["inverted before"] > 0 for row in rows), valid, impossible]
    counts += [len(rows) - valid - impossible, sum("newton" in row["ways"] for row in rows)]
    return [name, *(f"{n:,}" for n in counts), f"{np.median(seconds):.2f}", f"{max(seconds):.1f}"]


if __name__ == "__main__":
    sys.exit(main())
