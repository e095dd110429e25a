"""`torchmesh report`: a web page of a mesh before and after its improvement, and of the stages between.

Nothing here imports torch before it is needed.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import console
from .errors import UsageError
from .observation import improve_all, observe, step_to_show
from .shared_options import (
    BeforeArgument,
    BetaOption,
    Boundary,
    BoundaryOption,
    Height,
    HeightOption,
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
from .targets import check_distinct, check_mesh_target

if TYPE_CHECKING:
    from torch import Tensor

    from ..files.time_series import Series
    from ..improving.options import ImproveOptions
    from ..improving.report import Report
    from ..mesh.batch import MeshBatch
    from ..mesh.measure import Quality

EXAMPLES = (
    "torchmesh report tangled.vtu better.vtu report.html",
    "torchmesh report tangled.vtu better.vtu report.html --no-stages",
)

# OUT is what improve makes of IN if no vertex is off by more than this part of the mesh's extent: some file formats
# have single precision only.
_SAME_POSITION = 1e-6


def report(
    source: BeforeArgument,
    target: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Mesh file after; if there is none, improve makes it.", show_default=False),
    ],
    page: Annotated[Path, typer.Argument(metavar="PAGE.html", help="Page to write.", show_default=False)],
    stages: Annotated[
        bool, typer.Option(help="Repeat the improvement to show its stages; without, only before and after.")
    ] = True,
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
    height: HeightOption = Height.interpolate,
    step: StepOption = None,
    quiet: QuietOption = False,
) -> int:
    """Write a web page that shows a mesh before and after.

    One file that needs no network: tables, histograms, and a picture of the mesh to move and zoom in, with every
    triangle's row and shape at a click and a slider over the stages of the improvement. For the stages IN is improved
    once more, with the options given; if that does not end at OUT, the page says so and shows before and after only.
    Of a time series (XDMF, .pvd) one step is shown, beside a table of all.

    The exit status is 1 if OUT has inverted triangles.
    """
    from ..batches.file_improvement import curved_counts, open_mesh, with_given_nodes
    from ..files.atomic import check_target
    from ..files.time_series import check_steps
    from ..mesh.batch import join
    from ..mesh.measure import quality
    from ..pictures.curves import Curves
    from ..pictures.page import report_page

    options = improve_options(method, topology, beta, boundary, interfaces, scope, shapes, quads)
    if page.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{page}: a page's name ends in .html")
    check_distinct(source, target, page)
    check_target(page)
    given = open_mesh(source, regions)
    if not target.exists():
        check_mesh_target(target)
        check_steps(target, len(given))
        improved = improve_all(given, options, quiet, height.value)
        improved.write(target)
        after = replace(given, batch=join(improved.meshes))
        placed, counts = improved.placed, improved.curved
    else:
        after = open_mesh(target)
        placed, counts = with_given_nodes(after), curved_counts(after)
    at = _step_shown(given, after, target, step)
    shown, result, note = _stages(given.only(at), after.only(at), target, options, stages, quiet)
    series = _series_table(given, after, at) if len(given) > 1 else None
    pairs = ((with_given_nodes(given), given), (placed, after))
    ends = [None if one is None else Curves.of(one[of.mesh_of_step[at]]) for one, of in pairs]
    curves = [ends[0], *[None] * (len(shown) - 2), ends[1]]
    title = title or f"{source.name}: before and after"
    report_page(page, shown, result, title=title, note=note, series=series, curves=curves)
    if not quiet:
        extent = console.counted(len(shown), "stage") if note is None else "before and after only"
        which = f" of step {at}" if len(given) > 1 else ""
        typer.echo(f"{page}: {extent}{which}, {page.stat().st_size / 1e6:.1f} MB")
        if note is not None:
            console.say(note)
    return console.verdict(f"in {target}", quality(after.batch), curved=counts)


def _step_shown(given: "Series", after: "Series", target: Path, step: int | None) -> int:
    """The step of a time series to show; raises UsageError if OUT has other steps or `step` does not exist."""
    if len(after) != len(given):
        raise UsageError(f"{target} has {len(after)} steps, and {given.sources[0].path} has {len(given)}")
    return step_to_show(given, step)


def _stages(
    given: "Series", after: "Series", target: Path, options: "ImproveOptions", stages: bool, quiet: bool
) -> "tuple[list[tuple[str, MeshBatch]], Report | None, str | None]":
    """What the page shows of one mesh: its stages, if the same improvement leads to the mesh after.

    The last entry is a note for the page where it does not.
    """
    both: list[tuple[str, MeshBatch]] = [("before", given.batch), ("after", after.batch)]
    if not stages:
        return both, None, None
    observed = observe(given, options, quiet)
    if not _agree(observed.after, after.batch):
        name = given.sources[0].path.name
        return both, None, f"The stages between are not known: {target.name} is not what improve makes of {name}."
    *between, (last, _) = observed.stages
    return [*between, (last, after.batch)], observed.report, None


def _series_table(given: "Series", after: "Series", shown: int) -> "list[tuple[str, Quality, Quality, bool]]":
    """For each step its name, the mesh before and after in numbers, and whether it is the one that is shown."""
    from ..mesh.measure import quality

    before, now = ([quality(mesh) for mesh in one.batch.split()] for one in (given, after))
    return [
        (f"step {k}, time {time:g}", before[given.mesh_of_step[k]], now[after.mesh_of_step[k]], k == shown)
        for k, time in enumerate(given.times)
    ]


def _agree(one: "MeshBatch", other: "MeshBatch") -> bool:
    """Whether two meshes have the same elements at the same positions, up to what a file format may round off.

    A format may begin an element at another corner, and list elements and vertices in another order.
    """
    import numpy as np
    import torch
    from scipy.spatial import cKDTree

    from ..mesh.batch import lift

    for here, there in ((one.triangles, other.triangles), (one.quads, other.quads), (one.points, other.points)):
        if here.shape != there.shape:
            return False
    extent = float((one.points.amax(0) - one.points.amin(0)).max())
    here, there = lift(one).double(), lift(other).double()
    row = torch.arange(len(here))
    if float((here - there).abs().max()) > _SAME_POSITION * extent:
        away, nearest = cKDTree(here.numpy()).query(there.numpy())
        row = torch.from_numpy(nearest)
        if float(np.max(away)) > 2 * _SAME_POSITION * extent or len(row.unique()) < len(row):
            return False

    def in_order(faces: "Tensor") -> "Tensor":
        corners = faces.shape[1]
        turn = (faces.argmin(1)[:, None] + torch.arange(corners)) % corners
        return torch.unique(faces.gather(1, turn), dim=0)

    pairs = ((one.triangles, other.triangles), (one.quads, other.quads))
    return all(torch.equal(in_order(a), in_order(row[b])) for a, b in pairs if len(a))
