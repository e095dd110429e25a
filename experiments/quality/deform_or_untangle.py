"""Move a boundary in steps so that nothing tangles, or all at once and untangle: which is better, and at what price?

    python -m experiments.quality.deform_or_untangle

A hole is moved through a channel and an airfoil is turned in its far field, further and further, each by `deform` and
by FEMWARP with `improve`.  Writes a record and a plot: seconds of the processor, the average and the largest inverse
mean ratio, and how well sizes are kept, which is the root mean square of the logarithm of the edge length at the moved
boundary over what it was there before.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import torch

import torchmesh as tm
from experiments.shared import arguments
from experiments.shared.tangles import FAMILIES, Tangle, tangle
from torchmesh.mesh import connectivity

FAMILY_NAMES = ("moved", "turned")
WAYS = ("deform", "untangle")


def size_kept(before: tm.MeshBatch, after: tm.MeshBatch) -> float:
    """The root mean square of log(mean edge length after / before) over the moved boundary vertices."""
    moved = before.fixed & (before.points != after.points).any(1)

    def mean_length(mesh: tm.MeshBatch) -> torch.Tensor:
        edges = connectivity.edges(mesh.triangles, mesh.twin)
        length = (mesh.points[edges[:, 0]] - mesh.points[edges[:, 1]]).norm(dim=1)
        total = torch.zeros(len(mesh.points), dtype=length.dtype).index_add_(
            0, edges.reshape(-1), length.repeat_interleave(2)
        )
        return total / torch.bincount(edges.reshape(-1), minlength=len(mesh.points)).clamp_min(1)

    ratio = (mean_length(after) / mean_length(before))[moved].log()
    return float(ratio.square().mean().sqrt())


def measure(case: Tangle, way: str) -> dict:
    """One case one way."""
    started = time.process_time()
    if way == "deform":
        after, report = tm.deform(case.undeformed, case.tangled.points)
        steps, done = int(report.steps), bool((report.status == tm.Status.VALID).all())
    else:
        after, result = tm.improve(case.tangled)
        steps, done = 1, bool(result.valid.all())
    seconds = time.process_time() - started
    q = tm.quality(after)
    return {
        "way": way,
        "done": done,
        "inverted before": int(tm.quality(case.tangled).inverted) if way == "untangle" else 0,
        "steps": steps,
        "seconds": seconds,
        "mean": float(q.mean),
        "max": float(q.max),
        "size": size_kept(case.undeformed, after),
    }


def rows(triangles: int, grading: float, cache: Path) -> list[dict]:
    """Every case both ways; each is printed when it is done."""
    found = []
    for family in FAMILY_NAMES:
        for value in FAMILIES[family].values:
            case = tangle(family, value, triangles, grading, 0, cache)
            for way in WAYS:
                r = {"family": family, "value": value, **measure(case, way)}
                found.append(r)
                print(
                    f"{family:8} {value:5g} {way:9} {'valid' if r['done'] else 'NOT':5} {r['steps']:4} steps "
                    f"{r['seconds']:6.2f} s  IMR {r['mean']:.3f} / {r['max']:.2f}  size {r['size']:.3f}",
                    flush=True,
                )
    return found


def draw(found: list[dict], path: Path) -> None:
    """Each measure against how far the boundary moves."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = (
        ("seconds", "seconds"),
        ("mean", "IMR, average"),
        ("max", "IMR, maximum"),
        ("size", "edge lengths at the body:\nlog deviation from before"),
    )
    figure, axes = plt.subplots(len(FAMILY_NAMES), len(columns), figsize=(15, 6.5), layout="constrained")
    for row, family in zip(axes, FAMILY_NAMES, strict=True):
        for axis, (name, label) in zip(row, columns, strict=True):
            for way, style in zip(WAYS, ("o-", "s--"), strict=True):
                part = [r for r in found if r["family"] == family and r["way"] == way]
                axis.plot([r["value"] for r in part], [r[name] for r in part], style, label=way)
            axis.set(xlabel=FAMILIES[family].unit, ylabel=label)
            axis.set_ylim(bottom=1.0 if name in ("mean", "max") else 0.0)
            axis.grid(alpha=0.3)
    axes[0, 0].legend()
    figure.suptitle("In steps that never tangle (deform), or at once and untangled (improve)")
    figure.savefig(path, dpi=110)


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--triangles", type=int, default=2200, help="triangles of a mesh, about")
    parser.add_argument("--grading", type=float, default=0.3, help="mesh size at the body as a part of that far away")
    arguments.add_cache(parser)
    arguments.add_out(parser, "deform")
    given = arguments.parse(parser, argv)
    given.out.mkdir(parents=True, exist_ok=True)
    found = rows(given.triangles, given.grading, given.cache)
    arguments.write_rows(given, "deform_or_untangle", found)
    draw(found, given.out / "deform_or_untangle.png")
    for way in WAYS:
        part = [r for r in found if r["way"] == way]
        geometric = {
            n: math.exp(sum(math.log(max(r[n], 1e-9)) for r in part) / len(part)) for n in ("seconds", "mean", "size")
        }
        print(f"{way}: {sum(r['done'] for r in part)} of {len(part)} done, geometric means", geometric)
    return int(not all(r["done"] for r in found))


if __name__ == "__main__":
    sys.exit(main())
