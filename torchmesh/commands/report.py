"""`torchmesh report`: a web page of a mesh before and after its improvement, and of the stages between.

Nothing here imports torch before it is needed.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import console
from .errors import UsageError
from .observation import observe
from .shared_options import (
    BeforeArgument,
    BetaOption,
    Boundary,
    BoundaryOption,
    InterfacesOption,
    Method,
    MethodOption,
    QuietOption,
    RegionsOption,
    Scope,
    ScopeOption,
    Shapes,
    ShapesOption,
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
    beta: BetaOption = None,
    regions: RegionsOption = None,
    quiet: QuietOption = False,
) -> int:
    """Write a web page that shows a mesh before and after.

    One file that needs no network: tables, histograms, and a picture of the mesh to move and zoom in, with every
    triangle's row and shape at a click and a slider over the stages of the improvement. For the stages IN is improved
    once more, with the options given; if that does not end at OUT, the page says so and shows before and after only.

    The exit status is 1 if OUT has inverted triangles.
    """
    from ..batches.file_improvement import open_mesh
    from ..files.atomic import check_target
    from ..mesh.measure import quality
    from ..pictures.page import report_page

    options = improve_options(method, topology, beta, boundary, interfaces, scope, shapes)
    if page.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"{page}: a page's name ends in .html")
    check_distinct(source, target, page)
    check_target(page)
    given = open_mesh(source, regions)
    if target.exists():
        shown, after, result, note = _compare(given, target, options, stages, quiet)
    else:
        shown, after, result = _make(given, target, options, stages, quiet)
        note = None
    report_page(page, shown, result, title=title or f"{source.name}: before and after", note=note)
    if not quiet:
        extent = console.counted(len(shown), "stage") if note is None else "before and after only"
        typer.echo(f"{page}: {extent}, {page.stat().st_size / 1e6:.1f} MB")
        if note is not None:
            console.say(note)
    quads = len(given.sources[0].inverted_quads(after.points)) if len(after.points) >= len(given.batch.points) else 0
    return console.verdict(f"in {target}", quality(after), quads=quads)


def _make(
    given: "Series", target: Path, options: "ImproveOptions", stages: bool, quiet: bool
) -> "tuple[list[tuple[str, MeshBatch]], MeshBatch, Report | None]":
    """Improves the mesh and writes it; what the page shows, the mesh at the end, and the report for the page."""
    check_mesh_target(target)
    observed = observe(given, options, quiet)
    observed.improved.write(target)
    if stages:
        return observed.stages, observed.after, observed.report
    return [("before", given.batch), ("after", observed.after)], observed.after, None


def _compare(
    given: "Series", target: Path, options: "ImproveOptions", stages: bool, quiet: bool
) -> "tuple[list[tuple[str, MeshBatch]], MeshBatch, Report | None, str | None]":
    """What the page shows of a mesh that was improved before: its stages, if the same improvement leads to it.

    The last entry is a note for the page where it does not.
    """
    from ..files.mesh_files import read

    after = read(target)
    both: list[tuple[str, MeshBatch]] = [("before", given.batch), ("after", after)]
    if not stages:
        return both, after, None, None
    observed = observe(given, options, quiet)
    if not _agree(observed.after, after):
        name = given.sources[0].path.name
        note = f"The stages between are not known: {target.name} is not what improve makes of {name}."
        return both, after, None, note
    *between, (last, _) = observed.stages
    return [*between, (last, after)], after, observed.report, None


def _agree(one: "MeshBatch", other: "MeshBatch") -> bool:
    """Whether two meshes have the same triangles at the same positions, up to what a file format may round off.

    A format may begin a triangle at another corner, and list triangles and vertices in another order.
    """
    import numpy as np
    import torch
    from scipy.spatial import cKDTree

    from ..mesh.batch import lift

    if one.triangles.shape != other.triangles.shape or one.points.shape != other.points.shape:
        return False
    extent = float((one.points.amax(0) - one.points.amin(0)).max())
    here, there = lift(one).double(), lift(other).double()
    row = torch.arange(len(here))
    if float((here - there).abs().max()) > _SAME_POSITION * extent:
        away, nearest = cKDTree(here.numpy()).query(there.numpy())
        row = torch.from_numpy(nearest)
        if float(np.max(away)) > 2 * _SAME_POSITION * extent or len(row.unique()) < len(row):
            return False

    def in_order(triangles: "Tensor") -> "Tensor":
        turn = (triangles.argmin(1)[:, None] + torch.arange(3)) % 3
        return torch.unique(triangles.gather(1, turn), dim=0)

    return torch.equal(in_order(one.triangles), in_order(row[other.triangles]))
