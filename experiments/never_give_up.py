"""How hard may a tangle be? Success, time and quality over families of ever harder tangles, ours, the paper's, others'.

    python experiments/never_give_up.py --out out/never

Ways: `improve` by default, with the triangles kept, the algorithm of Kim 2017 as printed, and, if
installed, gmsh's UntangleMeshGeometry and MFEM's TMOP.  Each (case, way) is one line of
never_give_up.jsonl; a run that was stopped goes on where it was.  Draws, for each family, success
and quality against the number that makes it harder.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import torch
from tangles import FAMILIES, Tangle, tangle

import torchmesh as tm

Way = Callable[[tm.MeshBatch], tm.MeshBatch]


def peer(name: str) -> Way:
    def run(mesh: tm.MeshBatch) -> tm.MeshBatch:
        import peers

        outcome = getattr(peers, name)(mesh.points.numpy(), mesh.triangles.numpy(), mesh.fixed.numpy())
        return mesh.with_points(torch.from_numpy(outcome.points))

    return run


WAYS: dict[str, Way] = {
    "ours": lambda mesh: tm.improve(mesh)[0],
    "ours, triangles kept": lambda mesh: tm.improve(mesh, tm.ImproveOptions(topology="keep"))[0],
    "Kim 2017": lambda mesh: tm.improve(mesh, tm.ImproveOptions.paper(untangle_rounds=20))[0],
    "gmsh": peer("gmsh"),
    "MFEM TMOP": peer("mfem"),
}


def cases(
    families: list[str], sizes: list[int], gradings: list[float], seeds: int
) -> Iterator[tuple[str, float, int, float, int]]:
    for triangles in sizes:
        for grading in gradings:
            for seed in range(seeds):
                for name in families:
                    for value in FAMILIES[name].values:
                        yield name, value, triangles, grading, seed


def measure(case: Tangle, way: str) -> dict:
    started = time.process_time()
    try:
        after = WAYS[way](case.tangled)
    except Exception as error:
        # A peer that is not there, or refuses, is a row like any other.
        return {"way": way, "valid": False, "note": f"{type(error).__name__}: {error}"[:200], "seconds": None}
    q = tm.quality(after)
    valid = int(q.inverted) == 0
    return {
        "way": way,
        "valid": valid,
        "inverted": int(q.inverted),
        "seconds": time.process_time() - started,
        "mean": float(q.mean) if valid else None,
        "max": float(q.max) if valid else None,
    }


def draw(rows: list[dict], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, len(FAMILIES), figsize=(4 * len(FAMILIES), 9), layout="constrained")
    # Okabe & Ito's colours, told apart with any colour vision; shapes and lines tell them apart in print.
    looks = [("o-", "#0072B2"), ("D-", "#56B4E9"), ("s--", "#009E73"), ("^:", "#D55E00"), ("v:", "#CC79A7")]
    for column, (name, family) in enumerate(FAMILIES.items()):
        places = range(len(family.values))
        for (style, colour), way in zip(looks, WAYS, strict=True):
            groups = [
                [r for r in rows if r["family"] == name and r["way"] == way and r["value"] == v] for v in family.values
            ]
            rate = [sum(r["valid"] for r in g) / len(g) if g else float("nan") for g in groups]
            axes[0, column].plot(places, rate, style, color=colour, label=way, alpha=0.8)
            for axis, key in ((axes[1, column], "mean"), (axes[2, column], "seconds")):
                means = []
                for group in groups:
                    known = [r[key] for r in group if r.get(key) is not None and r["valid"]]
                    means.append(sum(known) / len(known) if known else float("nan"))
                axis.plot(places, means, style, color=colour, alpha=0.8)
        axes[0, column].set(title=name, ylim=(-0.05, 1.05), ylabel="part that ends valid")
        axes[1, column].set(ylabel="IMR average, of the valid", yscale="log")
        axes[2, column].set(ylabel="seconds, of the valid", yscale="log", xlabel=family.unit)
        for axis in axes[:, column]:
            axis.set_xticks(places, [f"{v:g}" for v in family.values])
            axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize="small", loc="lower left")
    figure.suptitle("Where the paper's algorithm ends and ours goes on")
    figure.savefig(path, dpi=100)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--triangles", type=int, nargs="+", default=[600])
    parser.add_argument("--grading", type=float, nargs="+", default=[0.3])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--families", nargs="+", choices=list(FAMILIES), default=list(FAMILIES))
    parser.add_argument("--ways", nargs="+", choices=list(WAYS), default=list(WAYS))
    parser.add_argument("--cache", type=Path, default=Path("out/cache"))
    parser.add_argument("--out", type=Path, default=Path("out/never"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    arguments.out.mkdir(parents=True, exist_ok=True)
    record = arguments.out / "never_give_up.jsonl"
    rows = [json.loads(line) for line in record.read_text().splitlines()] if record.exists() else []
    keys = ("family", "value", "triangles", "grading", "seed")
    done = {(*(r[k] for k in keys), r["way"]) for r in rows}
    with record.open("a") as out:
        for key in cases(arguments.families, arguments.triangles, arguments.grading, arguments.seeds):
            left = [way for way in arguments.ways if (*key, way) not in done]
            if not left:
                continue
            case = tangle(*key, arguments.cache)
            before = int(tm.quality(case.tangled).inverted)
            for way in left:
                row = {**dict(zip(keys, key, strict=True)), "inverted before": before, **measure(case, way)}
                rows.append(row)
                out.write(json.dumps(row) + "\n")
                out.flush()
    draw(rows, arguments.out / "never_give_up.png")
    print("| way | cases | valid | IMR average of the valid | largest IMR | seconds, mean | slowest |")
    print("|---|---|---|---|---|---|---|")
    for way in arguments.ways:
        part = [r for r in rows if r["way"] == way]
        valid = [r for r in part if r["valid"]]
        times = [r["seconds"] for r in part if r["seconds"] is not None]
        if valid:
            mean, worst = sum(r["mean"] for r in valid) / len(valid), max(r["max"] for r in valid)
            print(
                f"| {way} | {len(part)} | {len(valid)} | {mean:.3f} | {worst:.1f} | "
                f"{sum(times) / len(times):.2f} | {max(times):.1f} |"
            )
        else:
            print(f"| {way} | {len(part)} | 0 | | | | |")
    return int(any(r["way"] == "ours" and not r["valid"] for r in rows))


if __name__ == "__main__":
    sys.exit(main())
