"""`torchmesh report` and `torchmesh animate`: a page and a film of a mesh on its way.

Nothing here imports torch before it is needed.
"""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import console
from .motion_options import UsageError
from .shared_options import (
    BetaOption,
    Boundary,
    BoundaryOption,
    Method,
    MethodOption,
    QuietOption,
    Topology,
    TopologyOption,
    improve_options,
)

if TYPE_CHECKING:
    from ..improving.options import ImproveOptions
    from ..improving.report import Report
    from ..mesh.batch import MeshBatch

REPORT_EXAMPLES = (
    "torchmesh report tangled.vtu better.vtu report.html",
    "torchmesh report tangled.vtu better.vtu report.html --no-stages",
)


ANIMATE_EXAMPLES = ("torchmesh animate tangled.vtu untangling.gif --title 'A hole that moved'",)


# Vertices of OUT may be off by this part of the mesh's extent: some formats are of single precision.
_SAME_PLACE = 1e-6


_In = Annotated[Path, typer.Argument(metavar="IN", help="Mesh file before.", show_default=False)]


_Title = Annotated[str | None, typer.Option(help="The heading. Default: the name of IN.", show_default=False)]


def report(
    source: _In,
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Mesh file after; if there is none, improve makes it.", show_default=False),
    ],
    page: Annotated[Path, typer.Argument(metavar="PAGE.html", help="Page to write.", show_default=False)],
    stages: Annotated[
        bool, typer.Option(help="Repeat the improvement to show its stages; without, only before and after.")
    ] = True,
    title: _Title = None,
    method: MethodOption = Method.default,
    topology: TopologyOption = Topology.flip,
    boundary: BoundaryOption = Boundary.fixed,
    beta: BetaOption = None,
    quiet: QuietOption = False,
) -> int:
    """Write a web page that shows a mesh before and after.

    One file that needs no network: tables, histograms, and a picture of the mesh to move and zoom in, with every
    triangle's row and shape at a click and a slider over the stages of the improvement. For the stages IN is improved
    once more, with the options given; if that does not end at OUT, the page says so and shows before and after only.

    The exit status is 1 if OUT has inverted triangles.
    """
    from ..files.atomic import check_target
    from ..files.mesh_files import read, write
    from ..mesh.measure import quality
    from ..pictures.page import report_page

    options = improve_options(method, topology, beta, boundary)
    if page.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{page}: a page's name ends in .html")
    _check_different(source, target, page)
    check_target(page)
    before = read(source)
    note = None
    if target.exists():
        after = read(target)
        shown, result = [("before", before), ("after", after)], None
        if stages:
            seen, made, outcome = _observed(source, before, options, quiet)
            if _agree(made, after):
                shown, result = seen, outcome
                shown[-1] = (shown[-1][0], after)
            else:
                note = f"The stages between are not known: {target.name} is not what improve makes of {source.name}."
    else:
        from ..files.formats import format_of

        format_of(target)
        check_target(target)
        shown, after, result = _observed(source, before, options, quiet)
        if not stages:
            shown, result = [("before", before), ("after", after)], None
        write(target, after, like=source)
    report_page(page, shown, result, title=title or f"{source.name}: before and after", note=note)
    inverted = int(quality(after).inverted.sum())
    if not quiet:
        extent = console.counted(len(shown), "stage") if note is None else "before and after only"
        typer.echo(f"{page}: {extent}, {page.stat().st_size / 1e6:.1f} MB")
        if note is not None:
            console.say(note)
    if inverted:
        console.say(f"not valid: {console.counted(inverted, 'inverted triangle')} in {target}")
    return int(inverted > 0)


def animate(
    source: _In,
    film: Annotated[Path, typer.Argument(metavar="FILM", help="Film to write: .gif or .mp4.", show_default=False)],
    title: _Title = None,
    method: MethodOption = Method.default,
    topology: TopologyOption = Topology.flip,
    boundary: BoundaryOption = Boundary.fixed,
    beta: BetaOption = None,
    quiet: QuietOption = False,
) -> int:
    """Improve a mesh and write a film of it: the whole mesh and its worst place, stage by stage.

    Between two stages that differ in the vertices' places only, the vertices glide in straight lines. A gif needs
    matplotlib, an mp4 also imageio-ffmpeg (pip install 'torchmesh-untangle\\[video]'). No mesh is written.

    The exit status is 1 if the mesh ends with inverted triangles.
    """
    from ..files.mesh_files import read
    from ..pictures.films import animate as write_film
    from ..pictures.films import check_film_path

    options = improve_options(method, topology, beta, boundary)
    _check_different(source, film)
    check_film_path(film)
    before = read(source)
    seen, _, result = _observed(source, before, options, quiet)
    write_film(film, seen, title=title or source.name)
    if not quiet:
        typer.echo(f"{film}: {console.counted(len(seen), 'stage')}, {film.stat().st_size / 1e6:.1f} MB")
    inverted = int(result.quality.inverted.sum())
    if inverted:
        console.say(f"not valid: {console.counted(inverted, 'inverted triangle')} left ({result.messages[0]})")
    return int(inverted > 0)


def _observed(
    source: Path, before: "MeshBatch", options: "ImproveOptions", quiet: bool
) -> "tuple[list[tuple[str, MeshBatch]], MeshBatch, Report]":
    """The stages of the mesh's improvement, the mesh at its end, and the report."""
    import torch

    from ..files.mesh_files import held
    from ..improving.pipeline import improve

    # As `torchmesh improve` does, so that the same mesh comes out.
    torch.set_num_threads(1)
    seen: list[tuple[str, MeshBatch]] = []
    with console.progress(quiet) as show:
        after, result = improve(
            before,
            options,
            progress=show,
            observe=lambda stage, batch: seen.append((stage, batch)),
            hold=held(source) if options.slides else None,
        )
    return seen, after, result


def _agree(one: "MeshBatch", other: "MeshBatch") -> bool:
    """The same triangles at the same places, up to what a file's format may round off."""
    from ..mesh.batch import lift

    if one.triangles.shape != other.triangles.shape or one.points.shape != other.points.shape:
        return False
    if not bool((one.triangles == other.triangles).all()):
        return False
    extent = float((one.points.amax(0) - one.points.amin(0)).max())
    return float((lift(one) - lift(other)).abs().max()) <= _SAME_PLACE * extent


def _check_different(*paths: Path) -> None:
    taken: set[str] = set()
    for path in paths:
        real = os.path.realpath(path)
        if real in taken:
            raise UsageError(f"{path} is named twice: each file needs its own name")
        taken.add(real)
