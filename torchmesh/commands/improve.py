"""`torchmesh improve`: untangle one mesh file and give its triangles good shapes.

Nothing here imports torch before it is needed.
"""

import contextlib
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from . import console
from .errors import UsageError
from .shared_options import (
    BetaOption,
    Boundary,
    BoundaryOption,
    Fields,
    FieldsOption,
    Height,
    HeightOption,
    InArgument,
    InPlaceOption,
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
    StrictOption,
    ThreadsOption,
    Topology,
    TopologyOption,
    improve_options,
    use_threads,
)
from .targets import check_distinct, check_mesh_target, target_of

if TYPE_CHECKING:
    from ..batches.file_improvement import ImprovedFile
    from ..files.source import Source
    from ..files.time_series import SeriesDraft
    from ..improving.options import ImproveOptions
    from ..improving.report import Report
    from ..mesh.batch import MeshBatch
    from ..mesh.measure import Quality
    from ..mesh.regions import RegionAreas
    from ..pictures.curves import Curves

EXAMPLES = (
    "torchmesh improve tangled.vtu better.vtu",
    "torchmesh improve tangled.msh better.vtu --plot picture.png --report report.json",
    "torchmesh improve tangled.vtk better.vtk --topology keep",
    "torchmesh improve tangled.vtk better.vtk --boundary slide",
    "torchmesh improve stretched.vtu better.vtu --scope damage",
    "torchmesh improve regions.msh better.msh --interfaces free",
    "torchmesh improve regions.msh better.msh --regions none",
    "torchmesh improve moved.vtu better.vtu --fields carry",
    "torchmesh improve moved.vtu better.vtu --reference undeformed.vtu",
    "torchmesh improve tangled.vtk better.vtk --method paper --beta 0.01",
    "torchmesh improve plate.inp better.inp --strict",
    "torchmesh improve run.xdmf better.xdmf",
    "torchmesh improve terrain.vtk better.vtk --height keep",
)


OutArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="OUT", help="Mesh file to write; fields, groups and lines of IN come along.", show_default=False
    ),
]
ReferenceOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="The mesh before it was deformed, with the same triangles in the same order. Its shapes and sizes are "
        "then the aim: layers follow their walls, and keep their heights.",
        show_default=False,
    ),
]
ReportOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.json",
        help="Write what was done, step by step, and proofs of what is impossible.",
        show_default=False,
    ),
]
PlotOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.png", help="Draw before and after; also .pdf and .svg. Needs matplotlib.", show_default=False
    ),
]


def improve(
    source: InArgument,
    target: OutArgument = None,
    method: MethodOption = Method.default,
    topology: TopologyOption = Topology.flip,
    boundary: BoundaryOption = Boundary.fixed,
    interfaces: InterfacesOption = None,
    scope: ScopeOption = Scope.all,
    shapes: ShapesOption = Shapes.auto,
    quads: QuadsOption = Quads.keep,
    reference: ReferenceOption = None,
    beta: BetaOption = None,
    regions: RegionsOption = None,
    fields: FieldsOption = Fields.interpolate,
    height: HeightOption = Height.interpolate,
    report: ReportOption = None,
    plot: PlotOption = None,
    strict: StrictOption = False,
    in_place: InPlaceOption = False,
    threads: ThreadsOption = 1,
    quiet: QuietOption = False,
) -> int:
    """Untangle a mesh and give its triangles good shapes.

    The boundary, region interfaces and vertices marked by the point field 'fixed' stay where they are, unless
    --boundary slide or --interfaces is given. OUT is written
    in any case, whole; if it still has inverted triangles, standard error says so and the exit status is 1.

    Decks of solvers (Abaqus and CalculiX .inp, Nastran .bdf, Kratos .mdpa, Exodus .e) are
    changed in place: moved nodes, flipped elements and the sides that loads act on are written anew, and every other
    line stays. What OUT cannot hold of IN is named on standard error. Of a time series (XDMF, .pvd) every step is
    improved.
    """
    from ..batches.file_improvement import improve_series, open_mesh
    from ..files.time_series import check_steps

    options = improve_options(method, topology, beta, boundary, interfaces, scope, shapes, quads)
    target = target_of(source, target, in_place)
    _check_targets(source, target, report, plot)
    use_threads(threads)

    started = time.perf_counter()
    given = open_mesh(source, regions)
    check_steps(target, len(given))
    if reference is not None:
        options = replace(options, reference=_in_the_same_plane(reference, given.batch))
    with console.progress(quiet) as show:
        (improved,) = improve_series([given], options, fields=fields.value, height=height.value, progress=show)
        seconds = time.perf_counter() - started
        draft = improved.draft(target)
        if strict:
            draft.refuse()
        columns = _columns(improved)
        document = {
            "torchmesh": console.version(),
            "input": console.told(str(source)),
            "output": console.told(str(target)),
            "method": method.value,
            "topology": topology.value,
            "boundary": boundary.value,
            "interfaces": options.at_interfaces,
            "scope": scope.value,
            "shapes": shapes.value,
            "quads": quads.value,
            "reference": None if reference is None else str(reference),
            "beta": beta,
            "height": height.value,
            "seconds": seconds,
        }
        document |= _of_the_file(improved, draft, fields.value) | columns | _outcome(improved)
        if report is not None:
            document |= _proofs(improved, options, source.name)
        _write(improved, draft, report, document, plot, source.name)
    if not quiet:
        console.print_comparison(f"{target}, {seconds:.2f} s", columns)
        if len(improved.meshes) > 1:
            _print_steps(improved)
        _print_notes(improved.report, draft)
        _print_told_by(improved.given.sources[0])
    return console.verdict(f"in {target}", improved.report.quality, improved.message(), improved.curved)


def _of_the_file(improved: "ImprovedFile", draft: "SeriesDraft", choice: str) -> dict[str, Any]:
    """Which array told the regions, and what became of the fields."""
    return {
        "regions_by": _told_by(improved.given.sources[0]),
        "fields": {"choice": choice, **draft.fields.to_dict()},
    }


def _columns(improved: "ImprovedFile") -> dict[str, dict[str, Any]]:
    """The figures of the meshes before and after, those of all steps together."""
    from ..batches.file_improvement import curved_counts
    from ..mesh.batch import join

    return {
        "before": console.record(improved.given.batch, improved.before, curved_counts(improved.given)),
        "after": console.record(join(improved.meshes), improved.report.quality, improved.curved),
    }


def _proofs(improved: "ImprovedFile", options: "ImproveOptions", name: str) -> dict[str, Any]:
    """Of meshes that were found impossible, as a whole or in part: why, as data that another program can check.

    experiments/robustness/check_certificates.py is such a program, and reads the report.
    """
    from ..diagnosing.certificates import certificates
    from ..diagnosing.diagnosis import diagnose
    from ..mesh.interfaces import holding
    from ..status import Status

    topology: Literal["keep", "flip"] = "flip" if options.may_flip else "keep"
    proofs = []
    for m, status in enumerate(improved.report.status.tolist()):
        if status not in (Status.INFEASIBLE, Status.PARTLY):
            continue
        mesh = holding(improved.given.batch[m], options.interfaces)
        found = certificates(mesh, diagnose(mesh, topology, thorough=True))
        if found["certificates"]:
            case = name if len(improved.meshes) == 1 else f"{name}, {improved.given.names()[m]}"
            proofs.append({"case": case, **found})
    return {"proofs": proofs} if proofs else {}


def _outcome(improved: "ImprovedFile") -> dict[str, Any]:
    """The record of the report on the one mesh; with inverted six-node triangles it is not valid.

    Of a time series: whether all are valid and certified, and the record of each mesh with its steps.
    """
    records = [{key: value for key, value in one.items() if key != "mesh"} for one in improved.report.to_dict()]
    record = records[0]
    if len(records) > 1:
        steps = [dict(zip(("time_steps", "times"), _steps_of(improved, m), strict=True)) for m in range(len(records))]
        record = {
            "valid": all(one["valid"] for one in records),
            "certified": all(one["certified"] for one in records),
            "message": improved.message(),
            "meshes": [one | own for one, own in zip(steps, records, strict=True)],
        }
    curved = improved.curved
    if curved is not None and curved.inverted + curved.inverted_quads:
        both = (curved.inverted, "inverted six-node triangle"), (curved.inverted_quads, "inverted curved quad")
        told = " and ".join(console.counted(count, noun) for count, noun in both if count)
        record |= {"valid": False, "certified": False, "message": f"{record['message']}; {told}"}
    return record


def _steps_of(improved: "ImprovedFile", mesh: int) -> tuple[list[int], list[float]]:
    """The steps that have this mesh, and their times."""
    steps = [step for step, of in enumerate(improved.given.mesh_of_step) if of == mesh]
    return steps, [improved.given.times[step] for step in steps]


def _print_steps(improved: "ImprovedFile") -> None:
    """A row for each mesh of a time series."""
    before, after = improved.before, improved.report.quality
    table = console.table("steps")
    for name in ("", "inverted before", "after", "IMR average before", "after", "IMR maximum before", "after"):
        table.add_column(name, justify="right" if name else "left")
    for m, name in enumerate(improved.given.names()):
        numbers = [f(q, m) for f in (_inverted, _average, _worst) for q in (before, after)]
        table.add_row(name, *(console.number(value) for value in numbers))
    console.stdout().print(table)


def _inverted(q: "Quality", m: int) -> float:
    return int(q.inverted[m])


def _average(q: "Quality", m: int) -> float:
    return float(q.mean[m])


def _worst(q: "Quality", m: int) -> float:
    return float(q.max[m])


def _in_the_same_plane(path: Path, batch: "MeshBatch") -> "MeshBatch":
    """The mesh in the file `path` in the plane of `batch`, once for each mesh; UsageError if it lies elsewhere."""
    import torch

    from ..files.mesh_files import read
    from ..mesh.batch import join, lift

    found = read(path)
    origin, *axes = batch.frames[0]
    step = lift(found).to(torch.float64) - origin
    flat = torch.stack([step @ axis for axis in axes], 1)
    beside = (step - flat @ torch.stack(axes)).abs().max()
    if float(beside) > 1e-6 * float(flat.abs().max()):
        raise UsageError(f"{path}: the reference lies in another plane than the mesh")
    # Where the planes are the same, the coordinates are, to the bit.
    flat = found.points if torch.equal(found.frames, batch.frames[:1]) else flat
    return join([replace(found.with_points(flat), frames=batch.frames[:1])] * len(batch))


def _print_notes(report: "Report", draft: "SeriesDraft") -> None:
    """Says what was found in the meshes, how regions have changed, and what became of the fields."""
    notes = dict.fromkeys(note for note, valid in zip(report.notes, report.valid.tolist(), strict=True) if valid)
    for note in filter(None, notes):  # of others the verdict says it
        console.stdout().print(f"found: {note}", soft_wrap=True)
    if report.regions is not None:
        _print_regions(report.regions)
    console.print_fields(draft.fields)


def _print_regions(regions: "RegionAreas") -> None:
    """Says how the areas of regions changed with the interfaces between them."""
    change = 100 * regions.change
    areas = f"{console.counted(len(change), 'region')}, areas changed by {change.min():+.3g} to {change.max():+.3g} %"
    console.stdout().print(f"interfaces: {areas}", soft_wrap=True)


def _told_by(source: "Source") -> dict[str, Any]:
    """What of the file tells its regions, how many there are, and what was passed over."""
    content = source.content
    return {
        "cell_data": list(content.told_by.data),
        "cell_sets": list(content.told_by.sets),
        "regions": content.region_count,
        "passed_over": list(content.told_by.others),
    }


def _print_told_by(source: "Source") -> None:
    """Says which cell data or sets were taken for regions, and which might have been."""
    content = source.content
    told, count, alone = content.told_by, content.region_count, content.kinds_alone
    parts = [f"{console.counted(count, 'region')} by {told}"] if str(told) else []
    if told.others:
        parts.append(f"no regions by cell data {', '.join(map(repr, told.others))} (--regions NAME takes it)")
    if alone:
        parts.append(console.told_alone(alone))
    if parts and (count > 1 or told.others or alone):
        console.stdout().print(f"regions: {'; '.join(parts)}", soft_wrap=True)


def _check_targets(source: Path, target: Path, report: Path | None, plot: Path | None) -> None:
    """Raises UsageError, MeshIOError or MissingDependencyError, before the work, for what cannot be written.

    `target` alone may be `source`.
    """
    from ..files.atomic import check_target
    from ..pictures.pictures import check_picture_path

    check_distinct(source, report, plot)
    check_distinct(target, report, plot)
    check_mesh_target(target)
    if report is not None:
        check_target(report)
    if plot is not None:
        check_picture_path(plot)


def _curves(improved: "ImprovedFile", mesh: int) -> "tuple[Curves | None, Curves | None]":
    """What is curved in one mesh before and after."""
    from ..files.placed import Placed
    from ..pictures.curves import Curves

    source = improved.given.first_sources()[mesh]
    if source.middles is None or improved.placed is None:
        return None, None
    given = Placed(improved.given.batch.split()[mesh], source.middles)
    return Curves.of(given), Curves.of(improved.placed[mesh])


def _write(
    improved: "ImprovedFile",
    draft: "SeriesDraft",
    report: Path | None,
    document: dict[str, Any],
    plot: Path | None,
    name: str,
) -> None:
    """Writes the mesh, its report and its picture: all files appear, or none does.

    Of a time series the picture shows the mesh that came with most inverted triangles.
    """
    from ..files.atomic import replacing
    from ..pictures.pictures import before_after

    with contextlib.ExitStack() as files:
        if report is not None:
            files.enter_context(replacing(report)).write_text(console.json_text(document), encoding="utf-8")
        if plot is not None:
            worst = int(improved.before.inverted.argmax())
            which = f", {improved.given.names()[worst]}" if len(improved.meshes) > 1 else ""
            given, made = improved.given.batch.split()[worst], improved.meshes[worst]
            title = f"{name}{which}: before and after"
            before_after(files.enter_context(replacing(plot)), given, made, title, _curves(improved, worst))
        draft.tell()
        draft.save()
