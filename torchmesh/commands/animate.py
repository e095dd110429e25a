"""`torchmesh animate`: a film of a mesh during its improvement.

Nothing here imports torch before it is needed.
"""

from pathlib import Path
from typing import Annotated

import typer

from . import console
from .observation import improve_all, observe, step_to_show
from .shared_options import (
    BeforeArgument,
    BetaOption,
    Boundary,
    BoundaryOption,
    InterfacesOption,
    Method,
    MethodOption,
    Quads,
    QuadsOption,
    QuietOption,
    RegionsOption,
    Scope,
    ScopeOption,
    Shapes,
    ShapesOption,
    StepOption,
    TitleOption,
    Topology,
    TopologyOption,
    improve_options,
)
from .targets import check_distinct

EXAMPLES = ("torchmesh animate tangled.vtu untangling.gif --title 'A hole that moved'",)


def animate(
    source: BeforeArgument,
    film: Annotated[Path, typer.Argument(metavar="FILM", help="Film to write: .gif or .mp4.", show_default=False)],
    title: TitleOption = None,
    method: MethodOption = Method.default,
    topology: TopologyOption = Topology.flip,
    boundary: BoundaryOption = Boundary.fixed,
    interfaces: InterfacesOption = None,
    scope: ScopeOption = Scope.all,
    shapes: ShapesOption = Shapes.auto,
    quads: QuadsOption = Quads.keep,
    beta: BetaOption = None,
    regions: RegionsOption = None,
    step: StepOption = None,
    quiet: QuietOption = False,
) -> int:
    """Improve a mesh and write a film of it: the whole mesh and its worst place, stage by stage.

    Of a time series (XDMF, .pvd) the film shows the improved steps one after another, or, with --step, the stages of
    one. Between two stages that differ in the vertices' positions only, the vertices glide in straight lines. A gif
    needs matplotlib, an mp4 also imageio-ffmpeg, which brings ffmpeg under the GPL. No mesh is written.

    The exit status is 1 if the mesh ends with inverted triangles.
    """
    from ..batches.file_improvement import open_mesh, with_given_nodes
    from ..pictures.curves import Curves
    from ..pictures.films import animate as write_film
    from ..pictures.films import check_film_path

    options = improve_options(method, topology, beta, boundary, interfaces, scope, shapes, quads)
    check_distinct(source, film)
    check_film_path(film)
    given = open_mesh(source, regions)
    if len(given) > 1 and step is None:
        improved, noun = improve_all(given, options, quiet), "step"
        names = [f"time {time:g}" for time in given.times]
        shown = [(name, improved.meshes[m]) for name, m in zip(names, given.mesh_of_step, strict=True)]
        placed = improved.placed or [None] * len(improved.meshes)
        curves = [Curves.of(placed[m]) for m in given.mesh_of_step]
    else:
        one = given.only(step_to_show(given, step))
        observed, noun = observe(one, options, quiet), "stage"
        improved, shown = observed.improved, observed.stages
        ends = [Curves.of(nodes[0]) if nodes else None for nodes in (with_given_nodes(one), improved.placed)]
        curves = [ends[0], *[None] * (len(shown) - 2), ends[1]] if len(shown) > 1 else ends[:1]
    write_film(film, shown, title=title or source.name, curves=curves)
    if not quiet:
        typer.echo(f"{film}: {console.counted(len(shown), noun)}, {film.stat().st_size / 1e6:.1f} MB")
    return console.verdict("left", improved.report.quality, improved.message(), curved=improved.curved)
