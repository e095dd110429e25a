"""The picture of docs/cost.png: seconds against triangles for every tool."""

from __future__ import annotations

from pathlib import Path

# Okabe & Ito's colours can be told apart with any colour vision, and the shapes of the markers in print.
_LOOKS = [
    ("#0072B2", "o"), ("#D55E00", "s"), ("#009E73", "^"), ("#CC79A7", "v"), ("#E69F00", "D"), ("#56B4E9", "P"),
    ("#000000", "X"),
]  # fmt: skip


def plot(rows: list, tools: list[str], path: Path) -> None:
    """Both axes logarithmic; the first tool is ours; markers are hollow where inverted triangles are left."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    figure = Figure(figsize=(7, 5), layout="constrained")
    axes = figure.add_subplot()
    for tool, (colour, marker) in zip(tools, _LOOKS, strict=True):
        done = sorted((r for r in rows if r.tool == tool and r.seconds and "batch" not in r.domain),
                      key=lambda r: r.triangles)  # fmt: skip
        for kind in sorted({r.domain for r in done}):
            line = [r for r in done if r.domain == kind]
            axes.plot([r.triangles for r in line], [r.seconds for r in line], color=colour, linewidth=1)
        for valid, face in ((True, colour), (False, "none")):
            some = [r for r in done if (r.inverted_left == 0) == valid]
            axes.scatter([r.triangles for r in some], [r.seconds for r in some], marker=marker, facecolors=face,
                         edgecolors=colour)  # fmt: skip
        if done:
            axes.plot([], [], color=colour, marker=marker, label=tool)
    each = [r for r in rows if "batch" in r.domain]
    if each:
        axes.scatter([r.triangles for r in each], [r.seconds for r in each], marker="*", s=120, color="black",
                     label=f"{tools[0]}, {each[0].domain}")  # fmt: skip
    axes.set(xscale="log", yscale="log", xlabel="triangles", ylabel="time [s], one thread")
    # At most five marks along the axis, as plain numbers: those of all decades would write over each other.
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5), numticks=5))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_title("Untangling circle, bar and gate; hollow: inverted triangles are left", fontsize=10)
    axes.grid(True, which="both", alpha=0.25)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8)
    figure.savefig(path, dpi=150)
