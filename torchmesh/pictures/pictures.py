"""Pictures of meshes: shapes in colour, inverted triangles marked, before beside after.

matplotlib is the extra `plot` and is imported inside the functions; figures are made as objects,
without pyplot, so that nothing global is touched.  One scale serves every picture: the inverse
mean ratio from 1 (equilateral, pale) to 3 and beyond (dark blue), logarithmic; inverted triangles
are vermilion, which readers with any colour vision tell from blue.
"""

import os
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..errors import MeshIOError, MissingDependencyError
from ..files.atomic import check_target, replacing
from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality, signed_minimum_angles
from ..mesh.measure import quality as measure

PICTURE_EXTENSIONS = (".png", ".pdf", ".svg")


# A rectangle in the mesh's length unit: lowest x and y, highest x and y.
Box = tuple[float, float, float, float]


_INVERTED, _INVERTED_DARK = "#D55E00", "#7F3200"


_BEFORE, _AFTER = "#8C8C8C", "#0072B2"


_FRAME = "#CC0000"


_COLOURS = "YlGnBu"


_WORST_SHOWN = 3.0


# The part of a picture that the marks of tiny inverted triangles may cover.
_MARKED = 0.2


# The mean width of a character of a panel's title, in inches.
_CHARACTER = 0.073


_TICKS = (1, 1.25, 1.5, 2, 2.5, 3)


_UNIT = "length units of the file"


_DPI = 150


def check_picture_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a picture can be written there; to be asked before long work.

    Raises MeshIOError for an unknown extension, a directory, or one that does not exist, and
    MissingDependencyError without matplotlib.
    """
    path = Path(path)
    if path.suffix.lower() not in PICTURE_EXTENSIONS:
        what = f"the extension {path.suffix!r} is no picture's" if path.suffix else "it has no extension"
        raise MeshIOError(f"{path}: {what}; use one of {' '.join(PICTURE_EXTENSIONS)}")
    check_target(path)
    require_matplotlib()
    return path


def require_matplotlib() -> None:
    """Raises MissingDependencyError, naming the extra, without matplotlib."""
    try:
        import matplotlib.backends.backend_agg
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise MissingDependencyError("pictures need matplotlib: pip install 'torchmesh-untangle[plot]'") from None


def plot_mesh(
    ax: Any, mesh: MeshBatch, quality: Quality, region: Box | None = None, *, frame: Box | None = None
) -> Any:
    """Draw a mesh on matplotlib axes, triangles coloured by inverse mean ratio, inverted ones vermilion.

    quality  of `mesh`
    region   the part to show; None: all of it
    frame    a rectangle to draw on top, as where a close-up was taken

    Returns the coloured collection, from which a colour bar can be made.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import LogNorm
    from matplotlib.patches import Rectangle

    shape = _corner_points(mesh)
    low, high = shape.min(1), shape.max(1)
    view = view_of(mesh) if region is None else region
    ax.set_xlim(view[0], view[2])
    ax.set_ylim(view[1], view[3])
    ax.set_aspect("equal", adjustable="box")
    shown = ((high >= view[:2]) & (low <= view[2:])).all(1)
    upright = quality.upright.cpu().numpy()
    ratio = quality.inverse_mean_ratio.cpu().numpy().clip(1.0, _WORST_SHOWN)

    per_unit = _points_per_unit(ax, view)
    good, bad = shown & upright, shown & ~upright
    edge = per_unit * float(np.median((high - low).max(1)[shown])) if shown.any() else 1.0
    # Lines fade out as triangles come down to the size of a dot: there the colours say more.
    width = float(np.clip(0.05 * edge, 0.03, 0.7))
    fill = PolyCollection(
        shape[good],
        array=ratio[good],
        cmap=_COLOURS,
        norm=LogNorm(1.0, _WORST_SHOWN),
        edgecolors="face" if edge < 1.5 else (0.25, 0.3, 0.35, float(np.clip(edge / 8, 0.15, 0.8))),
        linewidths=width,
        rasterized=True,
    )
    ax.add_collection(fill, autolim=False)
    marks = PolyCollection(
        shape[bad],
        facecolors=(*_rgb(_INVERTED), 0.75),
        # Where there is room, one sees each; where not, at least the line that a sliver is.
        edgecolors=_INVERTED_DARK if edge > 15 else _INVERTED,
        linewidths=max(0.8, width),
        zorder=3,
        rasterized=True,
    )
    ax.add_collection(marks, autolim=False)
    small = bad & (per_unit * (high - low).max(1) < 3)
    if small.any():
        centre = shape[small].mean(1)
        # Where very many are inverted, smaller marks: the mesh must still be seen between them.
        room = per_unit**2 * (view[2] - view[0]) * (view[3] - view[1])
        size = float(np.clip(np.sqrt(_MARKED * room / len(centre)), 0.8, 3.0))
        ax.plot(*centre.T, "o", markersize=size, color=_INVERTED, markeredgewidth=0, zorder=4, rasterized=True)
    if frame is not None:
        x, y = frame[0], frame[1]
        ax.add_patch(
            Rectangle((x, y), frame[2] - x, frame[3] - y, fill=False, edgecolor=_FRAME, linewidth=1.4, zorder=5)
        )
    return fill


def before_after(path: str | os.PathLike[str], before: MeshBatch, after: MeshBatch, title: str | None = None) -> None:
    """Write a picture of a mesh before and after: whole, close-up of the worst place before, histograms.

    path  .png, .pdf or .svg; written to a temporary file first, so that it is there whole or not

    Raises MeshIOError, and MissingDependencyError without matplotlib.
    """
    path = check_picture_path(path)
    view = view_of(before, after)
    sheet = Sheet(view, rows=2, title=title, histograms=True)
    measured = [measure(before), measure(after)]
    close_up = within(worst_place(before, measured[0], sheet.heights[1] / sheet.panel[0]), view)
    fill = None
    for column, (name, mesh, q) in enumerate(zip(("before", "after"), (before, after), measured, strict=True)):
        ax = sheet.axes(0, column)
        fill = plot_mesh(ax, mesh, q, view, frame=close_up)
        ax.set_title(summary(f"{name}:", mesh, q, sheet.panel[0]), fontsize=10)
        ax = sheet.axes(1, column)
        plot_mesh(ax, mesh, q, close_up)
        ax.set_title(f"{name}, close-up (red rectangle)", fontsize=10)
    sheet.colour_bar(fill)
    _ratio_histogram(sheet.axes(2, 0), *measured)
    _angle_histogram(sheet.axes(2, 1), before, after, *measured)
    sheet.save(path)


def with_close_up(path: str | os.PathLike[str], mesh: MeshBatch, close_up: Box, title: str) -> None:
    """Write a picture of a mesh, whole on the left and the rectangle `close_up` of it on the right.

    Raises as `before_after`.
    """
    path = check_picture_path(path)
    view = view_of(mesh)
    sheet = Sheet(view, rows=1, title=title)
    q = measure(mesh)
    close_up = within(_shaped(close_up, _aspect(sheet.panel)), view)
    ax = sheet.axes(0, 0)
    fill = plot_mesh(ax, mesh, q, view, frame=close_up)
    ax.set_title(summary("(a)", mesh, q, sheet.panel[0]), fontsize=10)
    ax = sheet.axes(0, 1)
    plot_mesh(ax, mesh, q, close_up)
    ax.set_title("(b) close-up of the red rectangle", fontsize=10)
    sheet.colour_bar(fill)
    sheet.save(path)


def worst_place(mesh: MeshBatch, quality: Quality, aspect: float = 1.0) -> Box:
    """Where to look first: a rectangle round the densest cluster of inverted, or else worst, triangles.

    aspect  the rectangle's height over its width
    """
    from scipy.spatial import cKDTree

    shape = _corner_points(mesh)
    ratio = quality.inverse_mean_ratio.cpu().numpy()
    bad = np.flatnonzero(~quality.upright.cpu().numpy())
    if not len(bad):
        bad = np.argsort(-ratio, kind="stable")[:5]
    bad = bad[np.argsort(-ratio[bad], kind="stable")][:5000]
    extent = _extent(mesh)
    across = float(np.hypot(extent[2] - extent[0], extent[3] - extent[1])) or 1.0
    centre = shape[bad].mean(1)
    reach = 0.05 * across
    tree = cKDTree(centre)
    neighbours = tree.query_ball_point(centre, reach, return_length=True)
    cluster = centre[tree.query_ball_point(centre[int(np.argmax(neighbours))], reach)]
    low, high = cluster.min(0), cluster.max(0)
    # At least some ten triangles high, so that one sees where one is.
    near = shape.mean(1)
    middle = (low + high) / 2
    near = (np.abs(near - middle) <= np.maximum(high - low, reach)).all(1)
    size = 1.5 * float(np.sqrt(np.median(quality.area.abs().cpu().numpy()[near])))
    least = float(np.clip(5 * size, 0.01 * across, 0.25 * across))
    half = np.maximum(0.75 * (high - low), least * np.array([1 / max(aspect, 1.0), 1.0]))
    return _shaped((*(middle - half).tolist(), *(middle + half).tolist()), aspect)


class Sheet:
    """A figure of two columns of equal panels, a colour bar at their right, and perhaps histograms below."""

    def __init__(self, view: Box, rows: int, title: str | None, histograms: bool = False) -> None:
        from matplotlib.figure import Figure

        ratio = _aspect((view[2] - view[0], view[3] - view[1]))
        width = float(np.clip(5.0 / ratio, 3.2, 6.2))
        self.panel = (width, float(np.clip(width * ratio, 2.0, 6.5)))
        self.left, self.right, self.bottom, self.gap_x, self.gap_y = 0.75, 1.25, 0.65, 0.75, 0.95
        self.top = 0.95 if title else 0.5
        # A close-up below may be less tall than a tall domain.
        heights = [self.panel[1]] + [min(self.panel[1], 1.1 * width)] * (rows - 1) + ([2.2] if histograms else [])
        self.size = (
            self.left + 2 * width + self.gap_x + self.right,
            self.bottom + sum(heights) + self.gap_y * (len(heights) - 1) + self.top,
        )
        self.heights, self.rows = heights, rows
        self.figure = Figure(figsize=self.size, dpi=_DPI, facecolor="white")
        if title:
            self.figure.text(0.5, 1 - 0.35 / self.size[1], title, ha="center", va="center", fontsize=13, weight="bold")

    def axes(self, row: int, column: int) -> Any:
        """The axes of one panel; a row past the last one is that of the histograms."""
        left = self.left + column * (self.panel[0] + self.gap_x)
        ax = self._add(left, self._floor(row), self.panel[0], self.heights[row])
        ax.tick_params(labelsize=8)
        ax.set_xlabel(f"x ({_UNIT})", fontsize=9)
        ax.set_ylabel(f"y ({_UNIT})" if column == 0 else "y", fontsize=9)
        return ax

    def colour_bar(self, fill: Any) -> None:
        from matplotlib.lines import Line2D

        low, high = self._floor(self.rows - 1), self._floor(0) + self.panel[1]
        height = min(high - low, 6.0)
        key = 0.55  # room for the mark of inverted triangles above the bar
        left = self.size[0] - self.right + 0.25
        cax = self._add(left, (low + high - height) / 2, 0.18, height - key)
        bar = self.figure.colorbar(fill, cax=cax, extend="max", ticks=_TICKS)
        bar.ax.minorticks_off()
        bar.ax.set_yticklabels([f"{t:g}" for t in _TICKS], fontsize=8)
        bar.set_label("inverse mean ratio", fontsize=9)
        mark = Line2D([], [], marker="^", linestyle="none", markersize=9, color=_INVERTED, label="inverted")
        place = ((left - 0.12) / self.size[0], ((low + high + height) / 2 + 0.05) / self.size[1])
        self.figure.legend(handles=[mark], loc="upper left", bbox_to_anchor=place, frameon=False, fontsize=9,
                           handletextpad=0.1, borderpad=0, borderaxespad=0)  # fmt: skip

    def save(self, path: Path) -> None:
        with replacing(path) as whole:
            self.figure.savefig(whole, format=path.suffix[1:].lower(), dpi=_DPI)

    def _floor(self, row: int) -> float:
        return self.bottom + sum(self.heights[row + 1 :]) + self.gap_y * (len(self.heights) - 1 - row)

    def _add(self, left: float, bottom: float, width: float, height: float) -> Any:
        across, up = self.size
        return self.figure.add_axes((left / across, bottom / up, width / across, height / up))


def _ratio_histogram(ax: Any, before: Quality, after: Quality) -> None:
    top = 10.0
    bins = np.geomspace(1.0, top, 47)
    for q, style in ((before, _style_before()), (after, _style_after())):
        ratio = q.inverse_mean_ratio.cpu().numpy().clip(1.0, top * (1 - 1e-9))
        ax.hist(ratio, bins, log=True, **style)
    ticks = (1, 1.5, 2, 3, 5, 10)
    ax.set_xscale("log")
    ax.minorticks_off()
    ax.set_xticks(ticks, [*(f"{t:g}" for t in ticks[:-1]), "10 or more"])
    ax.set_xlim(1.0, top)
    ax.set_title("inverse mean ratio, all triangles", fontsize=10)
    _label_histogram(ax, "inverse mean ratio (1: equilateral)")
    ax.legend(fontsize=9, frameon=False, loc="upper right")


def _angle_histogram(ax: Any, before: MeshBatch, after: MeshBatch, before_q: Quality, after_q: Quality) -> None:
    pairs = ((before, before_q, _style_before()), (after, after_q, _style_after()))
    values = [signed_minimum_angles(mesh, q) for mesh, q, _ in pairs]
    floor = -60.0 if min(float(v.min()) for v in values) < 0 else 0.0
    for value, (_, _, style) in zip(values, pairs, strict=True):
        ax.hist(value, np.arange(floor, 60.1, 2.0), log=True, **style)
    if floor < 0:
        ax.axvspan(floor, 0, color=_INVERTED, alpha=0.12, linewidth=0)
        ax.text(0.02, 0.94, "inverted", color="#A34700", transform=ax.transAxes, fontsize=9, va="top")
    ax.set_xlim(floor, 60)
    ax.set_xticks(np.arange(floor, 61, 20 if floor < 0 else 10))
    ax.set_title("smallest angle of each triangle" + (", inverted ones below zero" if floor < 0 else ""), fontsize=10)
    _label_histogram(ax, "smallest angle (degrees; 60: equilateral)")


def _label_histogram(ax: Any, name: str) -> None:
    ax.set_xlabel(name, fontsize=9)
    ax.set_ylabel("triangles", fontsize=9)
    ax.set_ylim(bottom=0.7)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def _style_before() -> dict[str, Any]:
    return {"color": _BEFORE, "alpha": 0.55, "label": "before"}


def _style_after() -> dict[str, Any]:
    return {"histtype": "step", "color": _AFTER, "linewidth": 1.6, "label": "after"}


def _corner_points(mesh: MeshBatch) -> np.ndarray:
    """(T, 3, 2) the corners of every triangle."""
    return mesh.points.detach().to("cpu", torch.float64).numpy()[mesh.triangles.cpu().numpy()]


def _extent(mesh: MeshBatch) -> Box:
    shape = _corner_points(mesh).reshape(-1, 2)
    return (*shape.min(0).tolist(), *shape.max(0).tolist())


def view_of(*meshes: MeshBatch) -> Box:
    """All of the meshes, with a narrow margin."""
    low_x, low_y, high_x, high_y = zip(*map(_extent, meshes), strict=True)
    return _grown((min(low_x), min(low_y), max(high_x), max(high_y)), 0.02)


def _grown(box: Box, part: float) -> Box:
    margin = part * (max(box[2] - box[0], box[3] - box[1]) or 1.0)
    return box[0] - margin, box[1] - margin, box[2] + margin, box[3] + margin


def _shaped(box: Box, aspect: float) -> Box:
    """The least box about the same middle that holds `box` and is `aspect` times as high as wide."""
    x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    width = max(box[2] - box[0], (box[3] - box[1]) / aspect)
    return x - width / 2, y - width * aspect / 2, x + width / 2, y + width * aspect / 2


def within(box: Box, view: Box) -> Box:
    """The box moved into the view, as far as it fits there."""
    dx = max(view[0] - box[0], 0.0) + min(view[2] - box[2], 0.0)
    dy = max(view[1] - box[1], 0.0) + min(view[3] - box[3], 0.0)
    return box[0] + dx, box[1] + dy, box[2] + dx, box[3] + dy


def _aspect(size: tuple[float, float]) -> float:
    return size[1] / size[0]


def _points_per_unit(ax: Any, view: Box) -> float:
    """Typographic points (1/72 inch) to one length unit of the mesh."""
    room = ax.get_position().size * ax.figure.get_size_inches() * 72
    return float(min(room[0] / (view[2] - view[0]), room[1] / (view[3] - view[1])))


def _rgb(colour: str) -> tuple[float, float, float]:
    from matplotlib.colors import to_rgb

    return to_rgb(colour)


def summary(name: str, mesh: MeshBatch, q: Quality, inches: float) -> str:
    """A name and a mesh in numbers, in one line, or in two where one is too long for so many inches."""
    ratio, count = q.inverse_mean_ratio, len(mesh.triangles)
    numbers = f"{name} {count:,} triangle{'' if count == 1 else 's'}, {int(q.inverted.sum()):,} inverted,"
    shapes = f"IMR average {short(float(ratio.mean()))}, maximum {short(float(ratio.max()))}"
    fits = _CHARACTER * (len(numbers) + len(shapes) + 1) <= inches
    return f"{numbers}{' ' if fits else chr(10)}{shapes}"


def short(value: float) -> str:
    """A quality as people write it: 1.042, 4,944, 1.3e+06."""
    if not np.isfinite(value):
        return "inf"
    return f"{value:.3f}" if value < 1000 else f"{value:,.0f}" if value < 1e6 else f"{value:.1e}"
