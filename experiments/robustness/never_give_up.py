"""How hard may a tangle be?  Success, time and quality over ever harder tangles: ours, the paper's way, other tools.

    python -m experiments.robustness.never_give_up --triangles 300 --seeds 2
    python -m experiments.robustness.never_give_up --triangles 1000 --seeds 1
    python -m experiments.robustness.never_give_up --triangles 8000 --seeds 1 --ways ours

The usual ways are `improve` by default and with the triangles kept, the algorithm of Kim 2017 as printed, and, if they
are installed, gmsh's UntangleMeshGeometry and MFEM's TMOP.  Only if named: `improve` with vertices that come and go,
and foldover-free maps as published, which is slow.

Each case and way is one line of never_give_up.jsonl.  A run that was stopped continues where it was, and a run with
other numbers adds to the record.  Exact signs decide what is valid, by counting and not by torchmesh's own checks
(torchmesh/bench/exact_check.py).  The picture shows success, quality and time of each family against the number that
makes it harder, over all sizes, gradings, angles and seeds of the record; never_give_up.md holds the tables of
docs/measured.md.  The exit status is 1 if a result of ours is not valid.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence

import torchmesh as tm
from experiments.robustness.success import draw, tables_of
from experiments.robustness.ways import PROMISE, USUAL, WAYS
from experiments.shared import arguments
from experiments.shared.tangles import FAMILIES, Tangle, tangle
from torchmesh.bench.exact_check import boundary_is_simple, faults

# What tells one case from another.
KEY = ("family", "value", "angle", "triangles", "grading", "seed")


def cases(
    families: list[str], sizes: list[int], gradings: list[float], angles: list[float], seeds: range
) -> Iterator[tuple[str, float, float, int, float, int]]:
    """The KEYs of all cases."""
    for triangles in sizes:
        for grading in gradings:
            for seed in seeds:
                for name in families:
                    for value in FAMILIES[name].values:
                        for angle in angles if FAMILIES[name].turns else [0.0]:
                            yield name, value, angle, triangles, grading, seed


def measure(case: Tangle, way: str) -> dict:
    """What a way makes of a case."""
    started = time.process_time()
    try:
        after = WAYS[way](case.tangled)
    except Exception as error:
        # A peer that is not installed, or refuses the mesh, has a row like any other.
        return {"way": way, "valid": False, "note": f"{type(error).__name__}: {error}"[:200], "seconds": None}
    seconds = time.process_time() - started
    wrong = faults(case.tangled, after)
    q = tm.quality(after)
    return {
        "way": way,
        "valid": not wrong,
        "note": "; ".join(wrong),
        "seconds": seconds,
        "mean": None if wrong else float(q.mean),
        "max": None if wrong else float(q.max),
    }


def options() -> argparse.ArgumentParser:
    parser = arguments.parser(__doc__)
    arguments.add_sizes(parser, 300)
    parser.add_argument(
        "--grading", type=float, nargs="+", default=[0.3], help="mesh size at the body as a part of that far away"
    )
    parser.add_argument(
        "--angles", type=float, nargs="+", default=[0.0, 180.0], help="degrees by which a moved hole turns"
    )
    parser.add_argument("--seeds", type=int, default=2, help="number of seeds")
    parser.add_argument("--first-seed", type=int, default=0, help="the first of them")
    parser.add_argument("--families", nargs="+", choices=list(FAMILIES), default=list(FAMILIES), help="ways to tangle")
    parser.add_argument("--ways", nargs="+", choices=list(WAYS), default=USUAL, help="ways to untangle")
    arguments.add_cache(parser)
    arguments.add_out(parser, "never")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    given = arguments.parse(options(), argv)
    given.out.mkdir(parents=True, exist_ok=True)
    record = given.out / "never_give_up.jsonl"
    rows = [json.loads(line) for line in record.read_text().splitlines()] if record.exists() else []
    done = {(*(r[k] for k in KEY), r["way"]) for r in rows}
    seeds = range(given.first_seed, given.first_seed + given.seeds)
    with record.open("a") as out:
        for key in cases(given.families, given.triangles, given.grading, given.angles, seeds):
            left = [way for way in given.ways if (*key, way) not in done]
            if not left:
                continue
            family, value, angle, triangles, grading, seed = key
            case = tangle(family, value, triangles, grading, seed, given.cache, angle)
            if not boundary_is_simple(case.tangled):
                # With so few vertices a spiral loses its corners and its turns cross, so no valid mesh exists.
                print(f"left out, its boundary crosses itself: {case.name}")
                continue
            before = int(tm.quality(case.tangled).inverted)
            for way in left:
                row = {**dict(zip(KEY, key, strict=True)), "inverted before": before, **measure(case, way)}
                rows.append(row)
                out.write(json.dumps(row) + "\n")
                out.flush()
    draw(rows, given.out / "never_give_up.png")
    text = tables_of(rows)
    (given.out / "never_give_up.md").write_text(text, encoding="utf-8")
    print(text, end="")
    failed = [r for r in rows if r["way"] in PROMISE and not r["valid"]]
    for r in failed:
        print(f"not valid: {', '.join(str(r[k]) for k in KEY)}, {r['way']}: {r['note']}")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
