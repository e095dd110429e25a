"""The picture and the tables of never_give_up.py."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from experiments.robustness.ways import WAYS
from experiments.shared import tables
from experiments.shared.tangles import FAMILIES

# Okabe & Ito's colours can be told apart with any colour vision; shapes and lines tell the ways apart in print.
LOOKS = [
    ("o-", "#0072B2"), ("P-", "#000000"), ("D-", "#56B4E9"), ("s--", "#009E73"), ("^:", "#D55E00"), ("v:", "#CC79A7"),
    ("x--", "#E69F00"),
]  # fmt: skip


def draw(rows: list[dict], path: Path) -> None:
    """For each family: the part that ends valid, the IMR average, and the seconds, against what makes it harder."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    shown = {name: family for name, family in FAMILIES.items() if any(r["family"] == name for r in rows)}
    ways = [way for way in WAYS if any(r["way"] == way for r in rows)]
    figure, axes = plt.subplots(
        3, len(shown), figsize=(3.6 * len(shown), 9), layout="constrained", sharey="row", squeeze=False
    )
    for column, (name, family) in enumerate(shown.items()):
        positions = range(len(family.values))
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
                axis.plot(positions, heights, style, color=colour, label=way, alpha=0.8)
        axes[0, column].set(title=name, ylim=(-0.05, 1.05))
        axes[2, column].set(xlabel=family.unit)
        for axis in axes[:, column]:
            axis.set_xticks(positions, [f"{v:g}" for v in family.values])
            axis.grid(alpha=0.3)
    axes[0, 0].set(ylabel="part that ends valid")
    # matplotlib cannot make an axis logarithmic that has no point.
    scale = "log" if any(r["valid"] for r in rows) else "linear"
    axes[1, 0].set(ylabel="IMR average, of the valid", yscale=scale)
    axes[2, 0].set(ylabel="seconds for 1,000 triangles, of the valid", yscale=scale)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=len(ways))
    figure.suptitle("Where the paper's algorithm and other tools end and ours goes on")
    figure.savefig(path, dpi=80)


def tables_of(rows: list[dict]) -> str:
    """Markdown: each way over all cases that it had; how many of each family and size ended valid."""
    ways = [way for way in WAYS if any(r["way"] == way for r in rows)]
    titles = (
        "way",
        "cases",
        "valid",
        "IMR average, mean of the valid",
        "largest IMR average",
        "seconds, mean",
        "slowest",
    )
    whole = tables.table(titles, [_summary(way, [r for r in rows if r["way"] == way]) for way in ways])
    sizes = sorted({r["triangles"] for r in rows})
    columns = [(name, "family", name) for name in FAMILIES] + [(f"{n:,} triangles", "triangles", n) for n in sizes]
    lines = []
    for way in ways:
        cells = []
        for _, key, value in columns:
            part = [r for r in rows if r["way"] == way and r[key] == value]
            cells.append(f"{sum(r['valid'] for r in part)} of {len(part)}" if part else "")
        lines.append([way, *cells])
    return f"{whole}\n\n{tables.table(('valid', *(title for title, _, _ in columns)), lines)}\n"


def _summary(way: str, part: list[dict]) -> list[str]:
    valid = [r for r in part if r["valid"]]
    times = [r["seconds"] for r in part if r["seconds"] is not None]
    means = [r["mean"] for r in valid]
    quality = [f"{mean(means):.3f}", f"{max(means):,.2f}"] if means else ["", ""]
    pace = [f"{mean(times):.2f}", f"{max(times):.1f}"] if times else ["", ""]
    return [way, str(len(part)), str(len(valid)), *quality, *pace]


def mean(values: Iterable[float]) -> float:
    """NaN of no values."""
    known = list(values)
    return sum(known) / len(known) if known else float("nan")
