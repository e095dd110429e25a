"""The arguments and options that several commands share, and the `ImproveOptions` that they stand for.

Nothing here imports torch before it is needed.
"""

import math
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .errors import UsageError

if TYPE_CHECKING:
    from ..improving.options import ImproveOptions


InArgument = Annotated[Path, typer.Argument(metavar="IN", help="Mesh file to read.", show_default=False)]


BeforeArgument = Annotated[Path, typer.Argument(metavar="IN", help="Mesh file before.", show_default=False)]


TitleOption = Annotated[str | None, typer.Option(help="The heading. Default: the name of IN.", show_default=False)]


ThreadsOption = Annotated[int, typer.Option(min=1, help="Processor threads to use.")]


class Method(str, Enum):
    """How a mesh is untangled and smoothed."""

    default = "default"
    fast = "fast"
    paper = "paper"


class Topology(str, Enum):
    """Whether edges may flip, and vertices come and go."""

    flip = "flip"
    keep = "keep"
    full = "full"


class Boundary(str, Enum):
    """Whether boundary vertices may move along their curves."""

    fixed = "fixed"
    slide = "slide"


class Scope(str, Enum):
    """What of a mesh may be improved."""

    all = "all"
    damage = "damage"


class InterfaceChoice(str, Enum):
    """Whether vertices on the interfaces between regions may move."""

    fixed = "fixed"
    slide = "slide"
    free = "free"


class Shapes(str, Enum):
    """Which shapes triangles should have."""

    auto = "auto"
    equilateral = "equilateral"


class Quads(str, Enum):
    """What becomes of quads that come out inverted."""

    keep = "keep"
    split = "split"  # type: ignore[assignment]


class Fields(str, Enum):
    """What becomes of the fields of a file."""

    interpolate = "interpolate"
    carry = "carry"
    drop = "drop"


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
        help="Do the vertices of the boundary stay, or slide along their curves? Corners (turns of "
        "more than 40 degrees) stay, and so do vertices between boundary lines of different tags, "
        "and those that the point field 'fixed' marks, unless it marks the whole boundary. Curves keep their shape and "
        "the areas on both sides."
    ),
]


ScopeOption = Annotated[
    Scope,
    typer.Option(
        help="Improve every triangle, or only those that are inverted or much worse than the triangles around them, "
        "and as much round these as mending takes? With damage, all else keeps its bits, and a mesh that is stretched "
        "throughout stays so."
    ),
]


InterfacesOption = Annotated[
    InterfaceChoice | None,
    typer.Option(
        help="Do the vertices on interfaces between regions, and on lines inside, stay, slide along their curves as "
        "those of the boundary, or move like any other? With free, triangles stay in their regions, and regions change "
        "their areas; it also mends interfaces that came tangled. Default: as --boundary.",
        show_default=False,
    ),
]


ShapesOption = Annotated[
    Shapes,
    typer.Option(
        help="auto: layers are kept, that is rows of thin elements along a wall or an interface; elsewhere triangles "
        "should be equilateral. equilateral: everywhere, and layers go."
    ),
]


QuadsOption = Annotated[
    Quads,
    typer.Option(
        help="What becomes of quads that cannot be mended? keep: they stay quads, standard error names them, and the "
        "exit status is 1. split: they become two triangles each, both with the cell data of their quad."
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


StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="If OUT would not hold everything that is in IN, write nothing, name what is missing, and end with exit "
        "status 2. Without this, a warning names it.",
    ),
]


FieldsOption = Annotated[
    Fields,
    typer.Option(
        help="What becomes of fields of floats where vertices and triangles move. interpolate: point fields are read "
        "from the old mesh at the new positions, cell fields are averaged over the old triangles that a new one "
        "covers (integers in cells: the largest part decides). carry: values ride with their vertices, and cell "
        "fields of changed triangles go. drop: these fields are left out. Vectors of motion always ride: fields "
        "named displacement, displ, disp, deformation, motion, mesh_displacement, mesh_motion, point_displacement, "
        "node_displacement, nodal_displacement or total_displacement. So do integers at points, and region tags "
        "follow the interfaces."
    ),
]


StepOption = Annotated[
    int | None,
    typer.Option(
        min=0,
        metavar="N",
        help="Of a time series, the step to show, counted from 0. Default: the one with most inverted triangles.",
        show_default=False,
    ),
]


RegionsOption = Annotated[
    str | None,
    typer.Option(
        "--regions",
        metavar="NAME|none",
        help="Which cell data (whole numbers) or cell set tells the regions, across whose interfaces no edge flips. "
        "Default: cell sets, physical groups, blocks, and integers whose name has a word such as material, region, "
        "domain, zone, block, phase, group, attribute, label or tag; rank, part_id, level, flag and such tell none.",
        show_default=False,
    ),
]


class Height(str, Enum):
    """What becomes of the heights of a surface."""

    interpolate = "interpolate"
    keep = "keep"


HeightOption = Annotated[
    Height,
    typer.Option(
        help="For terrain and other surfaces, whose z is a field of x and y: where a vertex moves, z is read from the "
        "surface of the input there (interpolate), or rides with the vertex (keep)."
    ),
]


InPlaceOption = Annotated[
    bool,
    typer.Option("--in-place", help="OUT may be IN, which the result then replaces; OUT may also be left out."),
]


QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Print warnings and errors only.")]


def improve_options(
    method: Method = Method.default,
    topology: Topology = Topology.flip,
    beta: float | None = None,
    boundary: Boundary = Boundary.fixed,
    interfaces: InterfaceChoice | None = None,
    scope: Scope = Scope.all,
    shapes: Shapes = Shapes.auto,
    quads: Quads = Quads.keep,
) -> "ImproveOptions":
    """The options of `improve` that the options of a command stand for; raises UsageError."""
    from ..improving.options import ImproveOptions

    if beta is not None and method is not Method.paper:
        raise UsageError("--beta needs --method paper: the default method has no absolute beta")
    if beta is not None and not math.isfinite(beta):
        raise UsageError(f"--beta must be a finite number, not {beta}")
    chosen: dict[str, Any] = {
        "topology": topology.value,
        "boundary": boundary.value,
        "shapes": shapes.value,
        "interfaces": None if interfaces is None else interfaces.value,
        "scope": scope.value,
        "quads": quads.value,
    }
    try:
        if method is Method.paper:
            return ImproveOptions.paper(beta=beta, **chosen)
        make = ImproveOptions.fast if method is Method.fast else ImproveOptions
        return make(**chosen)
    except ValueError as error:
        raise UsageError(str(error)) from None


def use_threads(count: int) -> None:
    """Lets torch compute with this number of threads."""
    import torch

    torch.set_num_threads(count)
