"""`torchmesh quality`: measure mesh files, as tables or as JSON.

Nothing here imports torch or rich before it is needed.
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import console
from .errors import UsageError
from .shared_options import use_threads

if TYPE_CHECKING:
    from torch import Tensor

    from ..files.source import Source
    from ..mesh.batch import MeshBatch
    from ..mesh.measure import Quality
    from ..remeshing.sizing import Sizes

# So many rows of inverted quads are printed; --json has all.
_SHOWN = 20

EXAMPLES = (
    "torchmesh quality tangled.vtu better.vtu",
    "torchmesh quality tangled.vtu --worst 3",
    "torchmesh quality better.vtu --metrics minimum_angle,scaled_jacobian,aspect_ratio",
    "torchmesh quality better.vtu --sizes boundary",
    "torchmesh quality better.vtu --json",
    "torchmesh quality run.xdmf --worst 0",
)


def quality(
    sources: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Mesh files.", show_default=False)],
    worst: Annotated[int, typer.Option(min=0, help="How many of the worst elements to list for each file.")] = 10,
    metrics: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="Also show how these metrics of the Verdict manual are spread: minimum, percentiles, maximum, mean. "
            "'all', or some of area, inverse_mean_ratio, mean_ratio, shape, scaled_jacobian, condition, aspect_ratio, "
            "radius_ratio, edge_ratio, minimum_angle, maximum_angle, equiangle_skew.",
            show_default=False,
        ),
    ] = None,
    sizes: Annotated[
        str | None,
        typer.Option(
            metavar="SIZES",
            help="Also show edge lengths over the lengths wanted: 'boundary' (the boundary's, continued inwards), "
            "'uniform', a number in the file's unit of length, or the name of a point field that holds them.",
            show_default=False,
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON list instead of tables; null stands for infinite.")
    ] = False,
) -> int:
    """Measure meshes: inverted triangles, shapes, and where the worst ones are.

    IMR is the inverse mean ratio, 1 for an equilateral triangle and for a square. Rows count a file's triangles, and
    its quads, from 0; elements are the file's own numbers. The worst are the inverted ones, largest first, then those
    of the highest IMR. A quad is inverted if one of its corners is not upright, a six-node triangle
    if its Jacobian is not positive everywhere on it; its scaled Jacobian is the least one over the largest. Of a time
    series (XDMF, .pvd) every mesh has a row. The exit status is 1 if any triangle or quad of any file is inverted (an
    area of zero included).
    """
    from ..batches.file_improvement import open_mesh
    from ..errors import MeshError

    names = _metric_names(metrics)
    use_threads(1)
    records, unread = [], 0
    for path in sources:
        try:
            given = open_mesh(path)
        except (MeshError, OSError) as error:
            console.say(f"error: {error}")
            unread += 1
            continue
        meshes = zip(given.first_sources(), given.names(), strict=True)
        for source, steps in meshes:
            records.append(_record(source, steps if len(given) > 1 else "", worst, names, sizes))
    if as_json:
        typer.echo(console.json_text(records), nl=False)
    elif records:
        _print(records)
    if unread:
        return 2
    return int(any(record["inverted"] + record.get("inverted_quads", 0) for record in records))


def _metric_names(option: str | None) -> list[str]:
    """The names that `--metrics` lists; raises UsageError for one that does not exist."""
    from ..mesh.metrics import METRICS, QUAD_METRICS

    known = {**METRICS, **QUAD_METRICS}
    names = [] if option is None else list(known) if option == "all" else option.split(",")
    for name in names:
        if name not in known:
            raise UsageError(f"--metrics: there is no {name!r}; there are all, {', '.join(known)}")
    return names


# --- measuring ---------------------------------------------------------------------------------------


def _record(source: "Source", steps: str, worst: int, names: list[str], sizes: str | None) -> dict[str, Any]:
    """All that was asked about one file, or about the mesh of these steps of it, as plain values."""
    import torch

    from ..files.curved import given
    from ..mesh.measure import quality as measure
    from ..mesh.metrics import evaluate, known_metrics

    mesh = source.mesh
    q = measure(mesh)
    upright, quads_upright = q.upright, q.quad_upright
    if source.middles is not None:
        placed = given(source)
        upright, quads_upright = torch.from_numpy(placed.upright), torch.from_numpy(placed.quads_upright)
    record = {
        "file": console.told(str(source.path)),
        **({"steps": steps} if steps else {}),
        **console.record(mesh, q, source.curved),
        "worst": _worst(source, q, torch.cat([upright, quads_upright]), worst),
    }
    if source.curved is not None:
        record["rows_of_inverted_curved"] = placed.inverted.nonzero()[0].tolist()
    if len(mesh.quads):
        record["rows_of_inverted_quads"] = (~quads_upright).nonzero().squeeze(1).tolist()
    if sizes is not None:
        record["edge_length_over_size"] = _size_record(mesh, _sizes_wanted(sizes, source))
    if names:
        has = known_metrics(mesh)
        wanted = [name for name in names if name in has]
        if len(wanted) < len(names) and not set(has) <= set(names):
            missing = next(name for name in names if name not in has)
            raise UsageError(
                f"--metrics: there is no {missing!r}; there are all, {', '.join(has)}, and {source.path} has no quads"
            )
        record["metrics"] = {name: s.records()[0] for name, s in evaluate(mesh, wanted).items()}
    return record


def _worst(source: "Source", q: "Quality", upright: "Tensor", count: int) -> list[dict[str, Any]]:
    """The `count` worst triangles and quads: inverted ones, largest first, then those of the highest IMR.

    upright  (T + Q,) bool, which triangles and quads are not inverted
    """
    import torch

    from ..files.own_numbers import quad_numbers, triangle_numbers
    from ..mesh.batch import lift

    mesh = source.mesh
    area, ratio = torch.cat([q.area, q.quad_area]), torch.cat([q.inverse_mean_ratio, q.quad_inverse_mean_ratio])
    # Inverted elements rank by their area, and far above all others, which rank by their shape.
    rank = torch.where(upright, -1 / ratio, 1 - area / area.abs().amax(0).clamp_min(1e-300))
    space, triangles = lift(mesh), len(mesh.triangles)
    flat = bool((mesh.frames[0, 0, 2] == 0) & (mesh.frames[0, 1:, 2] == 0).all())
    own = {"triangle": triangle_numbers(source.document), "quad": quad_numbers(source.document)}
    found = []
    for k in rank.argsort(descending=True, stable=True)[:count].tolist():
        kind, row = ("triangle", k) if k < triangles else ("quad", k - triangles)
        corners = mesh.triangles[row] if kind == "triangle" else mesh.quads[row]
        centroid = space[corners].mean(0).tolist()
        numbers = own[kind]
        found.append(
            {
                "row": row,
                **({"kind": kind} if len(mesh.quads) else {}),
                **({} if numbers is None else {"element": str(numbers[row])}),
                "inverted": not bool(upright[k]),
                "imr": float(ratio[k]),
                "area": float(area[k]),
                "centroid": centroid[:2] if flat else centroid,
            }
        )
    return found


def _size_record(mesh: "MeshBatch", sizes: "Sizes") -> dict[str, float]:
    """Edge lengths over the sizes wanted; 1 is what was asked for."""
    from ..remeshing.sizing import size_conformity

    found = size_conformity(mesh, sizes)
    return {"mean": float(found.mean[0]), "p5": float(found.low[0]), "p95": float(found.high[0])}


def _sizes_wanted(text: str, source: "Source") -> "Sizes":
    """The sizes that `--sizes` names for a file; raises UsageError."""
    import torch

    if text == "boundary":
        return "boundary"
    if text == "uniform":
        return "uniform"
    try:
        length = float(text)
    except ValueError:
        return _size_field(text, source)
    if not (math.isfinite(length) and length > 0):
        raise UsageError(f"--sizes must be a positive length, not {text}")
    return torch.full((len(source.mesh.points),), length, dtype=torch.float64)


def _size_field(name: str, source: "Source") -> "Sizes":
    import torch

    fields = source.document.mesh.point_data
    if name not in fields:
        known = f"it has {', '.join(map(repr, sorted(fields)))}" if fields else "it has none"
        raise UsageError(
            f"--sizes {name}: neither 'boundary', 'uniform', a number nor a point field of {source.path}; {known}"
        )
    return torch.as_tensor(fields[name]).reshape(len(fields[name]), -1)[:, 0]


# --- tables ------------------------------------------------------------------------------------------


def _print(records: list[dict[str, Any]]) -> None:
    """A table with a row for each file, then the tables of metrics, then the worst triangles of each file."""
    console.stdout().print(_files_table(records))
    for record in records:
        if record.get("metrics"):
            console.stdout().print(_metrics_table(record))
    for record in records:
        if record["worst"]:
            console.stdout().print(_worst_table(record))
    for record in records:
        if record.get("inverted_quads"):
            rows = record["rows_of_inverted_quads"]
            shown = ", ".join(map(str, rows[:_SHOWN])) + (", ..." if len(rows) > _SHOWN else "")
            console.stdout().print(f"inverted quads of {_called(record)}: rows {shown}", soft_wrap=True)


def _called(record: dict[str, Any]) -> str:
    """The file, and in a time series the steps."""
    return ", ".join(filter(None, [record["file"], record.get("steps")]))


def _files_table(records: list[dict[str, Any]]) -> Any:
    from rich.text import Text

    table = console.table()
    table.add_column("file", overflow="fold")
    for name in ("triangles", "inverted", "IMR average", "IMR maximum", "minimum angle"):
        table.add_column(name, justify="right")
    mixed = any("quads" in record for record in records)
    if mixed:
        table.add_column("quads", justify="right")
        table.add_column("inverted quads", justify="right")
    curved = any(console.CURVED in record for record in records)
    if curved:
        table.add_column("minimum scaled Jacobian", justify="right")
    sized = "edge_length_over_size" in records[0]
    if sized:
        table.add_column("edge length / size: mean (5 - 95 %)", justify="right")
    for r in records:
        numbers = (r[k] for k in ("triangles", "inverted", "imr_average", "imr_maximum", "minimum_angle"))
        cells = [console.number(value) for value in numbers]
        if mixed:
            cells += [console.number(r.get(key, 0)) for key in ("quads", "inverted_quads")]
        if curved:
            cells.append(console.number(r[console.CURVED]) if console.CURVED in r else "")
        if sized:
            mean, low, high = (f"{r['edge_length_over_size'][k]:.2f}" for k in ("mean", "p5", "p95"))
            cells.append(f"{mean} ({low} - {high})")
        table.add_row(Text(_called(r)), *cells, style="red" if r["inverted"] + r.get("inverted_quads", 0) else None)
    return table


def _metrics_table(record: dict[str, Any]) -> Any:
    """A row for each metric."""
    table = console.table(f"metrics of {_called(record)}")
    table.add_column("metric")
    percents = [name for name in next(iter(record["metrics"].values())) if name.startswith("p")]
    columns = ["min", *percents, "max", "mean"]
    for name in columns:
        table.add_column({"p50": "median"}.get(name, name), justify="right")
    for name, numbers in record["metrics"].items():
        table.add_row(name, *(console.number(numbers[column]) for column in columns))
    return table


def _worst_table(record: dict[str, Any]) -> Any:
    """A row for each of the worst triangles and quads."""
    mixed = "kind" in record["worst"][0]
    table = console.table(f"worst {'triangles and quads' if mixed else 'triangles'} of {_called(record)}")
    numbered = any("element" in w for w in record["worst"])
    if mixed:
        table.add_column("")
    axes = "xyz"[: len(record["worst"][0]["centroid"])]
    for name in ("row", *["element"] * numbered, "IMR", "area", *axes):
        table.add_column(name, justify="right")
    table.add_column("")
    for w in record["worst"]:
        centroid = (f"{c:.6g}" for c in w["centroid"])
        mark = "inverted" if w["inverted"] else ""
        own = [w.get("element", "")] if numbered else []
        kind = [w["kind"]] if mixed else []
        table.add_row(*kind, str(w["row"]), *own, console.number(w["imr"]), f"{w['area']:.4g}", *centroid, mark)
    return table
