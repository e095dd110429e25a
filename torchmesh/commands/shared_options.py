"""The options that several commands of the command line share.  Nothing here imports torch before it is needed."""

import contextlib
import math
from enum import Enum
from typing import TYPE_CHECKING, Annotated

import typer

from .motion_options import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from ..improving.options import ImproveOptions
    from ..mesh.batch import MeshBatch
    from ..remeshing.sizing import Sizes


class Method(str, Enum):
    default = "default"
    fast = "fast"
    paper = "paper"


class Topology(str, Enum):
    flip = "flip"
    keep = "keep"
    full = "full"


class Boundary(str, Enum):
    fixed = "fixed"
    slide = "slide"


MethodOption = Annotated[
    Method,
    typer.Option(
        help="The best way known; the same without what only the few worst triangles gain from, in two thirds of the "
        "time; or Kim 2017 (An Iterative Mesh Untangling Algorithm) as printed."
    ),
]


TopologyOption = Annotated[
    Topology,
    typer.Option(
        help="May edges flip, or do the triangles stay? Vertices keep their order either way. With full, vertices may "
        "also be added and removed: better shapes, and sizes that follow the boundary."
    ),
]


BoundaryOption = Annotated[
    Boundary,
    typer.Option(
        help="Do the vertices of boundary and region interfaces stay, or slide along their curves? Corners (turns of "
        "more than 40 degrees) stay, and so do vertices of quads, vertices between boundary lines of different tags, "
        "and those that the point field 'fixed' marks, unless it marks the whole boundary. Curves keep their shape and "
        "the areas on both sides."
    ),
]


BetaOption = Annotated[
    float | None,
    typer.Option(
        help="Area below which untangle-beta pushes a triangle, in the file's unit of area; needs --method paper. "
        "The paper has 0.01 in its own unit. Default: 0.03 of the mesh's mean absolute area.",
        show_default=False,
    ),
]


SizesOption = Annotated[
    str | None,
    typer.Option(
        metavar="SIZES",
        help="Also show edge lengths over the lengths wanted: 'boundary' (the boundary's, continued inwards), "
        "'uniform', a number in the file's unit of length, or the name of a point field that holds them.",
        show_default=False,
    ),
]


QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print warnings and errors only.")]


def sizes_wanted(text: str, mesh: "MeshBatch", source: "Path") -> "Sizes":
    """The sizes that `SizesOption` names for the mesh read from `source`; raises UsageError."""
    import torch

    from ..files.formats import load

    if text == "boundary":
        return "boundary"
    if text == "uniform":
        return "uniform"
    with contextlib.suppress(ValueError):
        length = float(text)
        if not (math.isfinite(length) and length > 0):
            raise UsageError(f"--sizes must be a positive length, not {text}")
        return torch.full((len(mesh.points),), length, dtype=torch.float64)
    fields = load(source).mesh.point_data
    if text not in fields:
        known = f"it has {', '.join(map(repr, sorted(fields)))}" if fields else "it has none"
        raise UsageError(
            f"--sizes {text}: neither 'boundary', 'uniform', a number nor a point field of {source}; {known}"
        )
    return torch.as_tensor(fields[text]).reshape(len(fields[text]), -1)[:, 0]


def improve_options(
    method: Method, topology: Topology, beta: float | None, boundary: Boundary = Boundary.fixed
) -> "ImproveOptions":
    """The options of `improve` that a command line asks for; raises UsageError."""
    from ..improving.options import ImproveOptions

    if beta is not None and method is not Method.paper:
        raise UsageError("--beta needs --method paper: the default method has no absolute beta")
    if beta is not None and not math.isfinite(beta):
        raise UsageError(f"--beta must be a finite number, not {beta}")
    try:
        if method is Method.paper:
            return ImproveOptions.paper(beta=beta, topology=topology.value, boundary=boundary.value)
        make = ImproveOptions.fast if method is Method.fast else ImproveOptions
        return make(topology=topology.value, boundary=boundary.value)
    except ValueError as error:
        raise UsageError(str(error)) from None
