"""One mesh on matplotlib axes: shapes in colour, inverted triangles marked.

matplotlib is the extra `plot` and is imported inside the functions; figures are made as objects, without pyplot, so
that nothing global is changed.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import MissingDependencyError
from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality
from . import palette
from .curves import Curves
from .places import Place
from .regions import Box, corner_points, of_elements, view_of

# Sizes in typographic points (1/72 inch).  Edges: their width as a part of a triangle's size, and its limits.
_EDGE_PART, _THINNEST, _THICKEST = 0.05, 0.03, 0.7
# Triangles smaller than this have edges of their own colour, and the colours say more than lines would.
_NO_EDGES_BELOW = 1.5
# Inverted triangles: a dark outline where triangles are larger than this, a dot where smaller than that; hatched.
_DARK_OUTLINE_ABOVE, _DOT_BELOW = 15.0, 3.0
_HATCHED_ABOVE = 6.0
_DOT_SMALLEST, _DOT_LARGEST = 0.8, 3.0
# The part of a picture that the dots may cover: the mesh must still be seen between them.
_COVERED = 0.2


def require_matplotlib() -> None:
    """Raise MissingDependencyError, which names the extra, if matplotlib is not installed."""
    try:
        import matplotlib.backends.backend_agg
        import matplotlib.figure  # noqa: F401
    except ImportError:
        raise MissingDependencyError("pictures need matplotlib: pip install 'torchmesh-untangle[plot]'") from None


def plot_mesh(
    ax: Any,
    mesh: MeshBatch,
    quality: Quality,
    region: Box | None = None,
    *,
    frame: Box | None = None,
    curves: Curves | None = None,
) -> Any:
    """Draw a mesh on matplotlib axes, triangles coloured by inverse mean ratio, inverted ones vermilion.

    quality  of `mesh`
    region   the part to show; None: all of it
    frame    a rectangle to draw on top, as where a close-up was taken
    curves   the curved sides of six-node triangles

    Returns the coloured collection, from which a colour bar can be made.
    """
    from matplotlib.patches import Rectangle

    shape = corner_points(mesh)
    low, high = shape.min(1), shape.max(1)
    view = view_of(mesh) if region is None else region
    ax.set_xlim(view[0], view[2])
    ax.set_ylim(view[1], view[3])
    ax.set_aspect("equal", adjustable="box")
    shown = ((high >= view[:2]) & (low <= view[2:])).all(1)
    _, ratio, upright = of_elements(quality)
    good, bad = shown & upright, shown & ~upright

    per_unit = _points_per_unit(ax, view)
    size = per_unit * (high - low).max(1)
    typical = float(np.median(size[shown])) if shown.any() else 1.0
    outlines = shape if curves is None else _Picked(curves.outlines(mesh, shape))
    fill = _fill(ax, outlines[good], ratio[good], typical)
    _draw_interfaces(ax, mesh, typical, curves)
    _mark_inverted(ax, outlines[bad], typical)
    small = bad & (size < _DOT_BELOW)
    if small.any():
        _mark_small(ax, shape[small].mean(1), per_unit**2 * (view[2] - view[0]) * (view[3] - view[1]))
    if frame is not None:
        corner, width, height = frame[:2], frame[2] - frame[0], frame[3] - frame[1]
        ax.add_patch(Rectangle(corner, width, height, fill=False, edgecolor=palette.FRAME, linewidth=1.4, zorder=5))
    return fill


class _Picked(list[np.ndarray]):
    """Outlines that a mask picks from, as from an array."""

    def __getitem__(self, mask: Any) -> Any:
        return [super(_Picked, self).__getitem__(k) for k in np.flatnonzero(mask).tolist()]


def _fill(ax: Any, shape: Any, ratio: np.ndarray, typical: float) -> Any:
    """Upright triangles (T, 3, 2) in the colours of their inverse mean ratios (T,); `typical` is their size."""
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import LinearSegmentedColormap, LogNorm, to_rgb

    # Edges fade out as triangles come down to the size of a dot.
    faint = (*to_rgb(palette.EDGE), float(np.clip(typical / 8, 0.15, 0.8)))
    fill = PolyCollection(
        shape,
        array=ratio.clip(1.0, palette.WORST_SHOWN),
        cmap=LinearSegmentedColormap.from_list("shapes", palette.SHAPES),
        norm=LogNorm(1.0, palette.WORST_SHOWN),
        edgecolors="face" if typical < _NO_EDGES_BELOW else faint,
        linewidths=_line_width(typical),
        rasterized=True,
    )
    ax.add_collection(fill, autolim=False)
    return fill


def _draw_interfaces(ax: Any, mesh: MeshBatch, typical: float, curves: Curves | None) -> None:
    """Constrained edges: dashes on a pale line, thinner where triangles of `typical` size leave less room."""
    from matplotlib.collections import LineCollection

    if not len(mesh.constrained_edges):
        return
    points, edges = mesh.points.detach().cpu().double().numpy(), mesh.constrained_edges.cpu().numpy()
    ends: Any = points[edges] if curves is None else curves.lines(points, edges)
    width = float(np.clip(typical / 8, 0.35, 1.3))
    for colour, factor, style in ((palette.INTERFACE_PALE, 2.0, "-"), (palette.INTERFACE, 1.0, (0, (3, 2)))):
        lines = LineCollection(ends, colors=colour, linewidths=factor * width, linestyles=[style], zorder=2.5)
        lines.set_rasterized(True)
        ax.add_collection(lines, autolim=False)


def mark_places(ax: Any, places: Sequence[Place]) -> None:
    """Red rings with numbers round the places at which something is left."""
    for number, place in enumerate(places, 1):
        for colour, width in (("white", 3.2), (palette.FRAME, 1.6)):
            ax.plot(*place.position, "o", markersize=13, markerfacecolor="none", markeredgecolor=colour,
                    markeredgewidth=width, zorder=6)  # fmt: skip
        ax.annotate(str(number), place.position, xytext=(0, 9), textcoords="offset points", ha="center", va="bottom",
                    color=palette.FRAME, fontsize=9, weight="bold", zorder=7, annotation_clip=True)  # fmt: skip


def _mark_inverted(ax: Any, shape: Any, typical: float) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.colors import to_rgb

    # Where there is room, the outline shows each triangle; where not, at least the line that a sliver is.
    outline = palette.INVERTED_OUTLINE if typical > _DARK_OUTLINE_ABOVE else palette.INVERTED
    # Hatched where there is room, which tells them in grey.
    marks = PolyCollection(
        shape,
        hatch="/////" if typical > _HATCHED_ABOVE else None,
        facecolors=(*to_rgb(palette.INVERTED), 0.75),
        edgecolors=outline,
        linewidths=max(0.8, _line_width(typical)),
        zorder=3,
        rasterized=True,
    )
    marks.set_hatch_linewidth(0.5)
    ax.add_collection(marks, autolim=False)


def _mark_small(ax: Any, centre: np.ndarray, room: float) -> None:
    """A dot at each centre (N, 2); dots are smaller where there are many in a picture of `room` square points."""
    size = float(np.clip(np.sqrt(_COVERED * room / len(centre)), _DOT_SMALLEST, _DOT_LARGEST))
    ax.plot(*centre.T, "o", markersize=size, color=palette.INVERTED, markeredgecolor=palette.INVERTED_OUTLINE,
            markeredgewidth=min(0.5, size / 4), zorder=4, rasterized=True)  # fmt: skip


def _line_width(typical: float) -> float:
    return float(np.clip(_EDGE_PART * typical, _THINNEST, _THICKEST))


def _points_per_unit(ax: Any, view: Box) -> float:
    """Typographic points to one length unit of the mesh."""
    room = ax.get_position().size * ax.figure.get_size_inches() * 72
    return float(min(room[0] / (view[2] - view[0]), room[1] / (view[3] - view[1])))
