"""`torchmesh generate`: writes random meshes in motion, into one compressed file or a folder of mesh files.

Nothing here imports torch before it is needed.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from . import console
from .errors import UsageError
from .shared_options import QuietOption, use_threads

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ..learning.domains import Moved

EXAMPLES = (
    "torchmesh generate meshes.h5 --count 1000",
    "torchmesh generate wings.h5 --count 5000 --family airfoil --family bar --triangles 4000 --seed 7",
    "torchmesh generate folder --count 100 --format vtu",
)


# How many meshes are made and written at a time.
_AT_ONCE = 64


_SUFFIXES = (".h5", ".hdf5")


def generate(
    target: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="A file ending in .h5 for all meshes, or, with --format, a folder.", show_default=False
        ),
    ],
    count: Annotated[int, typer.Option(min=1, metavar="N", help="How many meshes.", show_default=False)],
    family: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="circle, bar, holes, airfoil, gate, jitter, letter, spiral or onto; may be given several times. "
            "Default: all in turn.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed and options give the same meshes.")] = 0,
    triangles: Annotated[
        int, typer.Option(min=100, help="Triangles of each mesh, met within 10 percent, or a warning says so.")
    ] = 2000,
    tangled: Annotated[
        float, typer.Option(min=0, max=1, help="The share of meshes that are to have inverted triangles.")
    ] = 0.8,
    motions: Annotated[int, typer.Option(min=1, help="Motions of each undeformed mesh, one after another.")] = 8,
    suffix: Annotated[
        str | None,
        typer.Option(
            "--format", metavar="EXT", help="One mesh file each, of this extension, as vtu.", show_default=False
        ),
    ] = None,
    quiet: QuietOption = False,
) -> int:
    """Generate random domains in motion: valid meshes whose boundary has moved, most of them tangled.

    OUT.h5 holds the deformed meshes, the undeformed points as point field 'undeformed', and for each mesh its family,
    seed, number of domain and number of inverted triangles (in Python: torchmesh.load_batch, load_fields,
    datasets.MeshDataset). A folder gets files named by number and family, the deformed mesh in each. The exit status is
    0 however many are tangled.
    """
    from ..learning.domains import FAMILIES, pairs

    _check_name(target, suffix)
    use_threads(1)
    try:
        some = pairs(
            family or tuple(FAMILIES),
            batch=min(_AT_ONCE, count),
            seed=seed,
            triangles=triangles,
            tangled=tangled,
            motions=motions,
        )
    except ValueError as error:
        raise UsageError(str(error)) from None
    log = _Log(count, quiet)
    batches = _first(some, count, log)
    if suffix is None:
        _into_one(target, batches)
    else:
        _into_folder(target, suffix, batches)
    if not quiet:
        seconds = log.clock.seconds
        console.say(
            f"{console.counted(count, 'mesh', 'meshes')} in {target}: {log.triangles:,} triangles, "
            f"{log.tangled:,} meshes tangled, {log.inverted:,} triangles inverted; "
            f"{seconds:.1f} s, {60 * count / seconds:,.0f} a minute"
        )
    return 0


def _check_name(target: Path, suffix: str | None) -> None:
    """Raises UsageError unless the name is that of an HDF5 file, or with a suffix that of a folder."""
    if suffix is None and target.suffix.lower() not in _SUFFIXES:
        raise UsageError(f"{target}: the name of a file of meshes ends in .h5; for a folder of files give --format")
    if suffix is not None and target.suffix.lower() in _SUFFIXES:
        raise UsageError(f"{target}: with --format the meshes go into a folder, not into an .h5 file")


class _Log:
    """Counts what has been made, and says it every ten seconds."""

    def __init__(self, count: int, quiet: bool) -> None:
        self.count, self.quiet, self.clock = count, quiet, console.Clock()
        self.meshes = self.triangles = self.tangled = self.inverted = 0

    def add(self, moved: "Moved") -> None:
        self.meshes += len(moved)
        self.triangles += len(moved.deformed.triangles)
        self.tangled += int((moved.inverted > 0).sum())
        self.inverted += int(moved.inverted.sum())
        if not self.quiet and self.clock.due():
            console.say(f"{self.meshes:,} of {self.count:,} meshes")


def _first(stream: "Iterator[Moved]", count: int, log: _Log) -> "Iterator[Moved]":
    """The first `count` meshes of an endless stream of batches."""
    for moved in stream:
        surplus = log.meshes + len(moved) - count
        if surplus > 0:
            moved = moved.first(len(moved) - surplus)
        log.add(moved)
        yield moved
        if log.meshes == count:
            return


def _into_one(target: Path, batches: "Iterator[Moved]") -> None:
    """Writes all meshes into one HDF5 file."""
    from ..files.hdf5 import BatchWriter

    with BatchWriter(target) as writer:
        for moved in batches:
            writer.append(
                moved.deformed,
                point_fields={"undeformed": moved.undeformed.points},
                mesh_fields=moved.fields,
            )


def _into_folder(target: Path, suffix: str, batches: "Iterator[Moved]") -> None:
    """Writes each deformed mesh into a file of its own; raises MeshIOError."""
    from ..errors import MeshIOError
    from ..files.formats.registry import format_of
    from ..files.mesh_files import write

    ending = "." + suffix.lstrip(".")
    format_of(target / f"mesh{ending}")
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise MeshIOError(f"{target}: no folder can be made: {error.strerror}") from None
    number = 0
    for moved in batches:
        for mesh, family in zip(moved.deformed.split(), moved.families, strict=True):
            write(target / f"{number:06d}-{family}{ending}", mesh)
            number += 1
