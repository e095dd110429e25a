"""`torchmesh example`: the files that the README and the help texts speak of, to try the commands on.

Nothing here imports torch before it is needed.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import console
from .errors import UsageError
from .shared_options import QuietOption, use_threads

if TYPE_CHECKING:
    import meshio

FolderArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write into; made if it is not there.")]

EXAMPLES = ("torchmesh example samples", "torchmesh example --force")


def example(
    folder: FolderArgument = Path("."),
    force: Annotated[bool, typer.Option("--force", help="Replace files of these names.")] = False,
    quiet: QuietOption = False,
) -> int:
    """Write the meshes that the README speaks of, small ones, to try the commands on.

    It prints what each is, and what to run first. Files that are there already are not replaced, unless with --force.
    """
    from ..errors import MeshIOError
    from ..files.atomic import check_target

    use_threads(1)
    existing = [folder / name for name in FILES if (folder / name).exists()]
    if existing and not force:
        raise UsageError(f"{existing[0]} is there already; --force replaces it, and another DIR leaves it alone")
    for name, (make, _) in FILES.items():
        path = folder / name
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise MeshIOError(f"{path.parent}: no folder can be made: {error.strerror or error}") from None
        make(check_target(path))
    if not quiet:
        table = console.table()
        table.add_column("file")
        table.add_column("what it is")
        for name, (_, text) in FILES.items():
            table.add_row(str(folder / name), text)
        console.stdout().print(table)
        inside = "" if folder == Path(".") else f"cd {folder} && "
        first = "torchmesh warp undeformed.vtk tangled.vtu --displacement displacement"
        console.stdout().print(f"first: {inside}{first}", soft_wrap=True)
    return 0


def _bar(path: Path) -> None:
    """The bar of Kim 2017 before its motion, with the motion as a field."""
    from importlib import resources

    path.write_bytes((resources.files("torchmesh") / "data" / "bar.vtk").read_bytes())


def _channel(path: Path) -> None:
    """A body in a channel with layers of quads on it; body and channel have names."""
    from ..files.drafts import Draft

    Draft.of(path, _channel_mesh()).save()


def _channel_mesh() -> "meshio.Mesh":
    import math

    import meshio
    import numpy as np

    around, layers, rings = 24, 3, 9
    # Rings round the body that grow from a circle into a square, in the ratio of a geometric series.
    angle = 2 * math.pi * np.arange(around) / around
    circle = np.stack([np.cos(angle), np.sin(angle)], 1)
    square = circle / np.abs(circle).max(1, keepdims=True)
    heights = np.concatenate([0.03 * np.arange(1, layers + 1), np.geomspace(0.16, 0.8, rings - layers)])
    parts = np.concatenate([[0.0], np.clip((heights - 0.09) / heights[-1], 0.0, None)])
    points = np.concatenate(
        [(0.2 + h) * ((1 - t) * circle + t * square) for h, t in zip([0.0, *heights], parts, strict=True)]
    )
    i = np.arange(around)
    j = (i + 1) % around
    cells = [np.stack([i, i + around, j + around, j], 1) + k * around for k in range(rings)]
    rest = np.concatenate(cells[layers:])
    blocks = [
        ("line", np.stack([i, j], 1)),
        ("line", np.stack([i, j], 1) + rings * around),
        ("triangle", np.concatenate([rest[:, [0, 1, 2]], rest[:, [0, 2, 3]]])),
        ("quad", np.concatenate(cells[:layers])),
    ]
    groups = [np.full(len(data), number) for (_, data), number in zip(blocks, (1, 2, 3, 3), strict=True)]
    return meshio.Mesh(
        np.pad(points, ((0, 0), (0, 1))),
        blocks,
        cell_data={"gmsh:physical": groups, "gmsh:geometrical": groups},
        field_data={"body": np.array([1, 1]), "channel": np.array([2, 1]), "fluid": np.array([3, 2])},
    )


def _moved(name: str) -> Callable[[Path], None]:
    def make(path: Path) -> None:
        from ..files.mesh_files import write
        from ..learning.domains import moving

        write(path, moving(name)[1])  # type: ignore[arg-type]

    return make


# What is written, and what each file is.
FILES: dict[str, tuple[Callable[[Path], None], str]] = {
    "undeformed.vtk": (_bar, "a bar in a channel, and as the point field 'displacement' where it is to go"),
    "channel.msh": (_channel, "a body with layers of quads on it, and groups: body, channel, fluid"),
    "in/circle.vtu": (_moved("circle"), "a hole that has moved: tangled"),
    "in/more/gate.vtu": (_moved("gate"), "a gate that has closed: tangled"),
}
