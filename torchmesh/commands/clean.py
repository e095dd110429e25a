"""`torchmesh clean`: mend the arrays of a mesh file of which no mesh can be made.

Nothing here imports torch before it is needed.
"""

from pathlib import Path
from typing import Annotated

import typer

from . import console
from .errors import UsageError
from .shared_options import InArgument, InPlaceOption, QuietOption
from .targets import check_mesh_target, target_of

EXAMPLES = (
    "torchmesh clean scanned.vtk mesh.vtk",
    "torchmesh clean scanned.stl mesh.vtu --tolerance 1e-6",
    "torchmesh clean cracked.vtk whole.vtk --sew",
)


def clean(
    source: InArgument,
    target: Annotated[
        Path | None,
        typer.Argument(
            metavar="OUT", help="Mesh file to write; fields, groups and lines of IN come along.", show_default=False
        ),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option(
            min=0,
            metavar="LENGTH",
            help="Vertices no farther apart than this, in the file's unit, are in one position.",
        ),
    ] = 0.0,
    sew: Annotated[bool, typer.Option("--sew", help="Close slits, too: their two sides become one.")] = False,
    in_place: InPlaceOption = False,
    quiet: QuietOption = False,
) -> int:
    """Mend a mesh file: vertices and triangles that are there twice, hanging vertices, mixed winding.

    Vertices in one position become one, but not the two sides of a slit. Triangles and quads that are there twice or
    have a corner twice go, and flat triangles on the boundary. A vertex that hangs in the side of a triangle or quad
    divides it. Neighbours are wound alike, and counter-clockwise. Vertices of no cell are dropped. No vertex moves.
    Nodes of curved triangles and quads go along with their edges.

    It prints what it did, and the components of the mesh. Fields and groups keep the rows of what stays. Inverted
    triangles stay inverted: torchmesh improve mends them. The exit status is 0 also where there was nothing to mend.
    """
    import math

    import numpy as np

    from ..files.documents import load
    from ..files.drafts import Draft
    from ..files.formats.registry import FORMATS, format_of
    from ..files.wiped import wiped

    if not math.isfinite(tolerance):
        raise UsageError(f"--tolerance must be a length, not {tolerance}")
    target = target_of(source, target, in_place)
    check_mesh_target(target)
    document = load(source)
    mesh, log = wiped(document, source, tolerance, sew)
    if mesh.points.shape[1] == 2 and format_of(target, document).name != document.format:
        mesh.points = np.pad(mesh.points, ((0, 0), (0, 1)))
    lost = FORMATS[document.format].left_behind(document, format_of(target, document), not log.changed)
    made = Draft.of(target, mesh, document, not log.changed, source, tuple(lost))
    made.tell()
    made.save()
    if not quiet:
        for line in log:
            console.stdout().print(line, soft_wrap=True)
    return 0
