"""`torchmesh info`: what is in a mesh file, and what of it torchmesh understands.

Nothing here imports torch before it is needed.
"""

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from . import console
from .shared_options import InArgument, RegionsOption, use_threads

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from ..files.formats.format import Document
    from ..files.parts import Part
    from ..files.source import Source
    from ..files.time_series import Series

EXAMPLES = (
    "torchmesh info channel.msh",
    "torchmesh info run.xdmf --json",
)

# So many entries of a list are printed; --json has all.
_SHOWN = 12


def info(
    source: InArgument,
    regions: RegionsOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print a JSON document.")] = False,
) -> int:
    """Say what is in a mesh file: elements, regions, groups, fields, layers, units and problems.

    Regions are what no edge flips across, with the data that tells them; groups are what can be moved by name
    (torchmesh warp --list has their positions). A file of which no mesh can be made is described all the same, as far
    as it can be read. Of a time series, inverted elements and shapes are those of all steps, the rest is of the first.

    The exit status is 1 if an element is inverted, and 2 if no mesh can be made of the file.
    """
    from ..batches.file_improvement import open_mesh
    from ..errors import InvalidMeshError

    use_threads(1)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        try:
            given = open_mesh(source, regions)
        except InvalidMeshError as error:
            record, status = _unfit(source, str(error)), 2
        else:
            record, status = _record(given), 0
    record["problems"] = [str(w.message) for w in said] + record["problems"]
    record["file"] = console.told(str(source))
    if as_json:
        typer.echo(console.json_text(record), nl=False)
    else:
        _print(record)
    return status or int(record.get("inverted", 0) > 0)


def _unfit(path: Path, problem: str) -> dict[str, Any]:
    """What is known of a file of which no mesh can be made; raises MeshIOError if it cannot be read at all."""
    from ..files.documents import load

    return {**_of_document(load(path)), "problems": [problem]}


def _record(given: "Series") -> dict[str, Any]:
    """What is known of a file; of a time series, of its first step."""
    from ..batches.file_improvement import curved_counts
    from ..files.parts import parts_of
    from ..improving.layers import layers_in_words
    from ..mesh.batch import lift
    from ..mesh.measure import quality

    source = given.first_sources()[0]
    mesh, content = source.mesh, source.content
    parts = list(parts_of(source).values())
    figures = console.record(given.batch, quality(given.batch), curved_counts(given))
    space = lift(mesh)
    steps = {"steps": len(given), "times": given.times, "meshes": len(given.batch)} if len(given) > 1 else {}
    return {
        **_of_document(source.document),
        **steps,
        "extent": [space.amin(0).tolist(), space.amax(0).tolist()],
        "inverted": figures["inverted"] + figures.get("inverted_quads", 0),
        **{key: figures[key] for key in ("imr_average", "imr_maximum")},
        "regions": {
            "count": content.region_count,
            "kinds_alone": list(content.kinds_alone),
            "told_by": str(content.told_by) or None,
            "not_taken": list(content.told_by.others),
            "constrained_edges": len(mesh.constrained_edges),
        },
        "groups": [_of_part(part, mesh.points) for part in parts],
        "layers": "; ".join(
            filter(None, [layers_in_words(mesh, _walls(source)), *_layers_of_quads(mesh.points.double(), parts)])
        ),
        "problems": list(_problems(source)),
    }


def _of_part(part: Any, points: Any) -> dict[str, Any]:
    length = {"length": part.length(points)} if len(part.edges) else {}
    on_it = {"triangles": part.triangles, "quads": part.quads}
    return {"name": part.name, "kind": part.kind, "vertices": len(part.vertices), **length, **on_it}


def _layers_of_quads(points: "Tensor", parts: "list[Part]") -> Iterator[str]:
    """For each named wall, or else loop, on which layers of quads stand: how many, and how high the first one is."""
    told = set[int]()
    walls = [part for part in parts if part.kind in ("lines", "loop") and len(part.layer)]
    for part in sorted(walls, key=lambda part: part.kind != "lines"):
        if told & set(part.layer.tolist()):
            continue
        told |= set(part.layer.tolist())
        rows = int(part.base.bincount().max())
        away = (points[part.layer] - points[part.base]).norm(dim=1)
        first = away.new_full((len(points),), float("inf")).scatter_reduce(0, part.base, away, "amin")
        height = float(first[first.isfinite()].median())
        yield f"layer of {rows} of quads at wall {part.name!r}, first height {height:.2g}"


def _walls(source: "Source") -> dict[str, Any]:
    from ..files.walls import walls_of

    return dict(walls_of(source))


def _problems(source: "Source") -> Iterator[str]:
    """What is wrong with the mesh, or of its file was not read."""
    from ..diagnosing.diagnosis import diagnose

    for problem in diagnose(source.mesh):
        yield source.explained(problem.message)
    for name in source.document.skipped:
        if not name.startswith("the name "):  # it stays in a file that is changed in place
            yield f"not read: {name}"


def _of_document(document: "Document") -> dict[str, Any]:
    """Format, elements, fields and units of a file as it was read."""
    mesh = document.mesh
    elements: dict[str, int] = {}
    for block in mesh.cells:
        elements[block.type] = elements.get(block.type, 0) + len(block.data)
    fields = [_field("points", name, values) for name, values in mesh.point_data.items()]
    fields += [_field("cells", name, _joined(blocks)) for name, blocks in mesh.cell_data.items()]
    return {
        "format": document.format,
        "binary": document.binary,
        "points": len(mesh.points),
        "elements": {kind: count for kind, count in elements.items() if count},
        "fields": fields,
        "units": _units(document),
    }


def _joined(blocks: "list[np.ndarray]") -> "np.ndarray":
    import numpy as np

    return np.concatenate(blocks) if blocks else np.zeros(0)


def _field(where: str, name: str, values: "np.ndarray") -> dict[str, Any]:
    """The name, shape, type and range of a field, and how many of its values are NaN or infinite."""
    import numpy as np

    finite = values[np.isfinite(values)] if values.dtype.kind in "iufb" else values[:0]
    numbers = finite.size > 0 and values.dtype.kind in "iufb"
    return {
        "where": where,
        "name": name,
        "components": int(values[0].size) if len(values) else 0,
        "type": str(values.dtype),
        "minimum": float(finite.min()) if numbers else None,
        "maximum": float(finite.max()) if numbers else None,
        "not_finite": int(values.size - finite.size) if values.dtype.kind in "iufb" else 0,
    }


def _units(document: "Document") -> str | None:
    """The units that a file states, which few formats can; None if it states none."""
    if document.units:
        return document.units
    for name, value in document.mesh.field_data.items():
        if "unit" in str(name).lower():
            return f"{name}: {value}"
    return None


# --- printing ----------------------------------------------------------------------------------------


def _print(record: dict[str, Any]) -> None:
    """Lines first, then tables of groups and fields."""
    say = console.stdout().print
    for name, text in _lines(record):
        say(f"{name}: {console.told(text)}", soft_wrap=True)
    if record.get("groups"):
        _print_groups(record["groups"])
    if record["fields"]:
        _print_fields(record["fields"])
    for problem in record["problems"][:_SHOWN]:
        say(f"problem: {console.told(problem)}", soft_wrap=True)
    if len(record["problems"]) > _SHOWN:
        say(f"problem: and {len(record['problems']) - _SHOWN} more")


def _lines(record: dict[str, Any]) -> Iterator[tuple[str, str]]:
    style = {None: "", True: ", binary", False: ", text"}[record["binary"]]
    yield record["file"], f"{record['format']}{style}"
    kinds = ", ".join(f"{count:,} {kind}" for kind, count in record["elements"].items())
    yield "elements", f"{kinds or 'none'}; {console.counted(record['points'], 'point')}"
    if "steps" in record:
        times = f"time {record['times'][0]:g} to {record['times'][-1]:g}"
        yield "time series", f"{record['steps']} steps, {times}, {record['meshes']} different meshes; the first is told"
    if "extent" in record:
        low, high = record["extent"]
        ranges = (
            f"{axis} {a:.6g} to {b:.6g}" for axis, a, b in zip("xyz", low, high, strict=True) if axis != "z" or a != b
        )
        yield "extent", ", ".join(ranges)
        shapes = f"IMR average {console.number(record['imr_average'])}, maximum {console.number(record['imr_maximum'])}"
        yield "quality", f"{record['inverted']:,} inverted, {shapes}"
        told = record["regions"]
        by = f" by {told['told_by']}" if told["told_by"] else ""
        edges = (
            f", {console.counted(told['constrained_edges'], 'constrained edge')}" if told["constrained_edges"] else ""
        )
        alone = f"; {console.told_alone(told['kinds_alone'])}" if told["kinds_alone"] else ""
        yield "regions", f"{told['count']}{by}{edges}{alone}"
        if told["not_taken"]:
            yield "no regions by", f"cell data {', '.join(map(repr, told['not_taken']))} (--regions NAME takes it)"
        yield "layers", record["layers"] or "none found"
    yield "units", record["units"] or "the file states none"


def _print_groups(groups: list[dict[str, Any]]) -> None:
    from rich.text import Text

    table = console.table("groups, and what can be moved by name")
    for name in ("name", "kind", "vertices", "length", "triangles", "quads"):
        table.add_column(name, justify="left" if name in ("name", "kind") else "right")
    for g in groups[:_SHOWN]:
        length = f"{g['length']:.6g}" if "length" in g else ""
        table.add_row(
            Text(g["name"]), g["kind"], f"{g['vertices']:,}", length, f"{g['triangles']:,}", f"{g['quads']:,}"
        )
    if len(groups) > _SHOWN:
        table.add_row(f"and {len(groups) - _SHOWN} more")
    console.stdout().print(table)


def _print_fields(fields: list[dict[str, Any]]) -> None:
    from rich.text import Text

    table = console.table("fields")
    none = ("not finite",) if any(f["not_finite"] for f in fields[:_SHOWN]) else ()
    for name in ("name", "of", "type", "components", "from", "to", *none):
        table.add_column(name, justify="left" if name in ("name", "of", "type") else "right")
    for f in fields[:_SHOWN]:
        ends = ("" if f[k] is None else f"{f[k]:.6g}" for k in ("minimum", "maximum"))
        row = Text(f["name"]), f["where"], f["type"], str(f["components"]), *ends
        table.add_row(*row, *[f"{f['not_finite']:,}"] * len(none))
    if len(fields) > _SHOWN:
        table.add_row(f"and {len(fields) - _SHOWN} more")
    console.stdout().print(table)
