"""How hard may a tangle be? Success, time and quality over families of ever harder tangles, ours, the paper's, others'.

    python experiments/never_give_up.py --triangles 300 --seeds 2
    python experiments/never_give_up.py --triangles 1000 --seeds 1
    python experiments/never_give_up.py --triangles 8000 --seeds 1 --ways ours

Ways: `improve` by default, with the triangles kept, the algorithm of Kim 2017 as printed, and, if installed, gmsh's
UntangleMeshGeometry and MFEM's TMOP; if named, `improve` with vertices that come and go, and foldover-free maps as
published, which is slow.  Each (case,
way) is one line of never_give_up.jsonl; a run that was stopped goes on where it was, and a run with other numbers adds
to it.  What is valid is decided by exact signs, independently of torchmesh (validity.py).  Draws, for each family,
success, quality and time against the number that makes it harder, over all sizes, gradings, angles and seeds of the
record, and writes the tables of docs/measured.md to never_give_up.md.  Exits 1 if a result of ours is not valid.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Literal

import torch
from tangles import FAMILIES, Tangle, simple, tangle
from validity import faults

import torchmesh as tm

Way = Callable[[tm.MeshBatch], tm.MeshBatch]
# What tells one case from another.
KEY = ("family", "value", "angle", "triangles", "grading", "seed")


def peer(name: str) -> Way:
    def run(mesh: tm.MeshBatch) -> tm.MeshBatch:
        import peers

        outcome = getattr(peers, name)(mesh.points.numpy(), mesh.triangles.numpy(), mesh.fixed.numpy())
        return mesh.with_points(torch.from_numpy(outcome.points))

    return run


def ours(topology: Literal["keep", "flip", "full"]) -> Way:
    return lambda mesh: tm.improve(mesh, tm.ImproveOptions(topology=topology, workers=1))[0]


WAYS: dict[str, Way] = {
    "ours": ours("flip"),
    "ours, full": ours("full"),
    "ours, triangles kept": ours("keep"),
    "Kim 2017": lambda mesh: tm.improve(mesh, tm.ImproveOptions.paper(untangle_rounds=10))[0],
    "gmsh": peer("gmsh"),
    "MFEM TMOP": peer("mfem"),
    "foldover-free maps": peer("foldover_free"),
}
# Run unless others are named; foldover-free maps takes half a minute for a graded mesh of 300 triangles.
USUAL = [way for way in WAYS if way not in ("ours, full", "foldover-free maps")]
# The ways that promise a valid mesh where the boundary allows one.
PROMISE = ("ours", "ours, full")
# Okabe & Ito's colours, told apart with any colour vision; shapes and lines tell them apart in print.
LOOKS = [
    ("o-", "#0072B2"), ("P-", "#000000"), ("D-", "#56B4E9"), ("s--", "#009E73"), ("^:", "#D55E00"), ("v:", "#CC79A7"),
    ("x--", "#E69F00"),
]  # fmt: skip


def cases(
    families: list[str], sizes: list[int], gradings: list[float], angles: list[float], seeds: range
) -> Iterator[tuple[str, float, float, int, float, int]]:
    for triangles in sizes:
        for grading in gradings:
            for seed in seeds:
                for name in families:
                    for value in FAMILIES[name].values:
                        for angle in angles if FAMILIES[name].turns else [0.0]:
                            yield name, value, angle, triangles, grading, seed


def measure(case: Tangle, way: str) -> dict:
    started = time.process_time()
    try:
        after = WAYS[way](case.tangled)
    except Exception as error:
        # A peer that is not there, or refuses, is a row like any other.
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


def draw(rows: list[dict], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = {name: family for name, family in FAMILIES.items() if any(r["family"] == name for r in rows)}
    ways = [way for way in WAYS if any(r["way"] == way for r in rows)]
    figure, axes = plt.subplots(
        3, len(shown), figsize=(3.6 * len(shown), 9), layout="constrained", sharey="row", squeeze=False
    )
    for column, (name, family) in enumerate(shown.items()):
        places = range(len(family.values))
        for (style, colour), way in zip(LOOKS, WAYS, strict=True):
            if way not in ways:
                continue
            groups = [
                [r for r in rows if r["family"] == name and r["way"] == way and r["value"] == v] for v in family.values
            ]
            rate = [mean(float(r["valid"]) for r in g) for g in groups]
            quality = [mean(r["mean"] for r in g if r["valid"]) for g in groups]
            pace = [mean(1000 * r["seconds"] / r["triangles"] for r in g if r["valid"]) for g in groups]
            for axis, heights in zip(axes[:, column], (rate, quality, pace), strict=True):
                axis.plot(places, heights, style, color=colour, label=way, alpha=0.8)
        axes[0, column].set(title=name, ylim=(-0.05, 1.05))
        axes[2, column].set(xlabel=family.unit)
        for axis in axes[:, column]:
            axis.set_xticks(places, [f"{v:g}" for v in family.values])
            axis.grid(alpha=0.3)
    axes[0, 0].set(ylabel="part that ends valid")
    # An axis without a point has no logarithm.
    scale = "log" if any(r["valid"] for r in rows) else "linear"
    axes[1, 0].set(ylabel="IMR average, of the valid", yscale=scale)
    axes[2, 0].set(ylabel="seconds for 1,000 triangles, of the valid", yscale=scale)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(ways))
    figure.suptitle("Where the paper's algorithm and other tools end and ours goes on")
    figure.savefig(path, dpi=80)


def mean(values: Iterable[float]) -> float:
    known = list(values)
    return sum(known) / len(known) if known else float("nan")


def tables(rows: list[dict]) -> str:
    """Markdown: each way over all cases that it had; how many of each family and size were valid."""
    ways = [way for way in WAYS if any(r["way"] == way for r in rows)]
    lines = [
        "| way | cases | valid | IMR average, mean of the valid | largest IMR average | seconds, mean | slowest |",
        "|---|---|---|---|---|---|---|",
    ]
    for way in ways:
        part = [r for r in rows if r["way"] == way]
        valid = [r for r in part if r["valid"]]
        times = [r["seconds"] for r in part if r["seconds"] is not None]
        cells = [way, str(len(part)), str(len(valid))]
        if valid:
            cells += [f"{mean(r['mean'] for r in valid):.3f}", f"{max(r['mean'] for r in valid):,.2f}"]
        else:
            cells += ["", ""]
        cells += [f"{mean(times):.2f}", f"{max(times):.1f}"] if times else ["", ""]
        lines.append("| " + " | ".join(cells) + " |")
    sizes = sorted({r["triangles"] for r in rows})
    columns = [(name, "family", name) for name in FAMILIES] + [(f"{n:,} triangles", "triangles", n) for n in sizes]
    lines += ["", "| valid | " + " | ".join(title for title, _, _ in columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for way in ways:
        cells = []
        for _, key, value in columns:
            part = [r for r in rows if r["way"] == way and r[key] == value]
            cells.append(f"{sum(r['valid'] for r in part)} of {len(part)}" if part else "")
        lines.append(f"| {way} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--triangles", type=int, nargs="+", default=[300])
    parser.add_argument("--grading", type=float, nargs="+", default=[0.3])
    parser.add_argument("--angles", type=float, nargs="+", default=[0.0, 180.0], help="of a hole that moves")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--families", nargs="+", choices=list(FAMILIES), default=list(FAMILIES))
    parser.add_argument("--ways", nargs="+", choices=list(WAYS), default=USUAL)
    parser.add_argument("--cache", type=Path, default=Path("out/cache"))
    parser.add_argument("--out", type=Path, default=Path("out/never"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    arguments.out.mkdir(parents=True, exist_ok=True)
    record = arguments.out / "never_give_up.jsonl"
    rows = [json.loads(line) for line in record.read_text().splitlines()] if record.exists() else []
    done = {(*(r[k] for k in KEY), r["way"]) for r in rows}
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    with record.open("a") as out:
        for key in cases(arguments.families, arguments.triangles, arguments.grading, arguments.angles, seeds):
            left = [way for way in arguments.ways if (*key, way) not in done]
            if not left:
                continue
            family, value, angle, triangles, grading, seed = key
            case = tangle(family, value, triangles, grading, seed, arguments.cache, angle)
            if not simple(case.tangled):
                # So few vertices cut the corners of a spiral that its turns cross: no valid mesh exists.
                print(f"left out, its boundary crosses itself: {case.name}")
                continue
            before = int(tm.quality(case.tangled).inverted)
            for way in left:
                row = {**dict(zip(KEY, key, strict=True)), "inverted before": before, **measure(case, way)}
                rows.append(row)
                out.write(json.dumps(row) + "\n")
                out.flush()
    draw(rows, arguments.out / "never_give_up.png")
    text = tables(rows)
    (arguments.out / "never_give_up.md").write_text(text, encoding="utf-8")
    print(text, end="")
    failed = [r for r in rows if r["way"] in PROMISE and not r["valid"]]
    for r in failed:
        print(f"not valid: {', '.join(str(r[k]) for k in KEY)}, {r['way']}: {r['note']}")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
