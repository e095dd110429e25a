"""Pictures of meshes in files: before beside after, and a whole mesh beside a close-up."""

import os
from pathlib import Path

from ..errors import MeshIOError
from ..files.atomic import check_target
from ..mesh.batch import MeshBatch
from ..mesh.measure import quality as measure
from . import histograms
from .captions import panel_title
from .curves import Curves
from .mesh_plot import mark_places, plot_mesh, require_matplotlib
from .places import places_left
from .regions import Box, shaped, view_of, within, worst_region
from .sheet import Sheet

PICTURE_EXTENSIONS = (".png", ".pdf", ".svg")


def check_picture_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a picture can be written there.  Callers ask before long work.

    Raises MeshIOError for an unknown extension, a directory, or a path in a directory that does not exist, and
    MissingDependencyError without matplotlib.
    """
    path = Path(path)
    if path.suffix.lower() not in PICTURE_EXTENSIONS:
        what = f"the extension {path.suffix!r} is no picture's" if path.suffix else "it has no extension"
        raise MeshIOError(f"{path}: {what}; use one of {' '.join(PICTURE_EXTENSIONS)}")
    check_target(path)
    require_matplotlib()
    return path


def before_after(
    path: str | os.PathLike[str],
    before: MeshBatch,
    after: MeshBatch,
    title: str | None = None,
    curves: tuple[Curves | None, Curves | None] = (None, None),
) -> None:
    """Write a picture of one mesh before and after: whole, a close-up of the worst region before, histograms.

    path    .png, .pdf or .svg; written to a temporary file first, so that it is there whole or not at all
    curves  the curved sides of six-node triangles before and after

    Raises MeshIOError, and MissingDependencyError without matplotlib.
    """
    path = check_picture_path(path)
    view = view_of(before, after, more=[c.nodes for c in curves if c is not None])
    sheet = Sheet(view, rows=2, title=title, histograms=True)
    measured = [m if c is None else c.judged(m) for m, c in zip((measure(before), measure(after)), curves, strict=True)]
    places = places_left(after, measured[1])
    close_up = within(worst_region(before, measured[0], sheet.heights[1] / sheet.panel[0]), view)
    fill = None
    for column, (name, mesh, q) in enumerate(zip(("before", "after"), (before, after), measured, strict=True)):
        ax = sheet.axes(0, column)
        fill = plot_mesh(ax, mesh, q, view, frame=close_up, curves=curves[column])
        ax.set_title(panel_title(f"{name}:", q, sheet.panel[0]), fontsize=10)
        if column:
            mark_places(ax, places)
        ax = sheet.axes(1, column)
        plot_mesh(ax, mesh, q, close_up, curves=curves[column])
        ax.set_title(f"{name}, close-up (red rectangle)", fontsize=10)
        if column:
            mark_places(ax, places)
    sheet.colour_bar(fill)
    histograms.draw(sheet.axes(2, 0), histograms.shapes(*measured), legend=True)
    histograms.draw(sheet.axes(2, 1), histograms.angles(before, after, *measured))
    sheet.save(path)


def with_close_up(path: str | os.PathLike[str], mesh: MeshBatch, close_up: Box, title: str) -> None:
    """Write a picture of one mesh, whole on the left and the rectangle `close_up` of it on the right.

    Raises as `before_after`.
    """
    path = check_picture_path(path)
    view = view_of(mesh)
    sheet = Sheet(view, rows=1, title=title)
    q = measure(mesh)
    close_up = within(shaped(close_up, sheet.panel[1] / sheet.panel[0]), view)
    ax = sheet.axes(0, 0)
    fill = plot_mesh(ax, mesh, q, view, frame=close_up)
    ax.set_title(panel_title("(a)", q, sheet.panel[0]), fontsize=10)
    ax = sheet.axes(0, 1)
    plot_mesh(ax, mesh, q, close_up)
    ax.set_title("(b) close-up of the red rectangle", fontsize=10)
    sheet.colour_bar(fill)
    sheet.save(path)
