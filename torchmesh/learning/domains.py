"""Meshes to try things on and to learn from: random domains in motion without end, and the three of Kim 2017.

    for batch in tm.domains.stream(["holes", "airfoil"], seed=1): ...

A *family* is a kind of domain with a kind of motion:

    circle   a small hole in a long rectangle, moved        gate    notches in the boundary, pushed in, bent
    bar      a thin hole, moved and turned                  jitter  boundary at rest, interior thrown about
    holes    one to five holes of any shape, moved, turned  letter  block letters, twisted and bent
    airfoil  a NACA profile in a graded mesh, turned        spiral  a wound strip, wound on or back
    onto     a disc laid onto the outline of a letter or a spiral

Every undeformed mesh is valid by exact signs; its inverse mean ratio is at most MAX_MEAN on average and MAX_WORST in
its worst triangle; with so few triangles that narrow parts are coarse, at most MAX_MEAN_COARSE on average.  The
boundary of every deformed mesh is simple, so a valid mesh exists.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any, Literal, get_args

import numpy as np
import torch
from torch import Tensor

from ..files.documents import load
from ..files.mesh_files import read
from ..mesh.batch import MeshBatch, join
from ..mesh.measure import quality
from ..warping.femwarp import femwarp
from .drawing import MAX_MEAN, MAX_MEAN_COARSE, MAX_WORST, DomainOptions, DrawOptions, draw_domains
from .families import FAMILIES

__all__ = [
    "FAMILIES",
    "MAX_MEAN",
    "MAX_MEAN_COARSE",
    "MAX_WORST",
    "DomainOptions",
    "DrawOptions",
    "Moved",
    "generate",
    "moving",
    "pairs",
    "stream",
]

# So many domains are meshed and smoothed together; no result depends on it.
_DOMAINS_AT_ONCE = 16

# The paper's domains.
_Moving = Literal["circle", "bar", "gate"]


def __dir__() -> list[str]:
    return __all__


@dataclass(frozen=True, eq=False)
class Moved:
    """B generated meshes before and after their motion; the triangles of both are the same.

    undeformed  valid meshes
    deformed    the meshes after their motion, by FEMWARP or jitter; the boundary of each is simple
    inverted    (B,) int64 triangles of `deformed` that are not upright
    families    the family of each mesh
    seeds       (B,) int64 the seed of the stream that each mesh is of
    numbers     (B,) int64 the number of its domain in the stream
    """

    undeformed: MeshBatch
    deformed: MeshBatch
    inverted: Tensor
    families: tuple[str, ...]
    seeds: Tensor
    numbers: Tensor

    def __len__(self) -> int:
        return len(self.undeformed)

    def first(self, count: int) -> "Moved":
        """The first `count` meshes."""
        families, part = self.families[:count], slice(0, count)
        tensors = (self.inverted[part], families, self.seeds[part], self.numbers[part])
        return Moved(self.undeformed[part], self.deformed[part], *tensors)

    @property
    def fields(self) -> dict[str, Any]:
        """What is known of each mesh, by the names under which files have it."""
        known = {"family": list(self.families), "seed": self.seeds, "domain": self.numbers}
        return known | {"inverted": self.inverted}


def stream(families: Sequence[str] = tuple(FAMILIES), *, batch: int = 32, **options: Any) -> Iterator[MeshBatch]:
    """Tangled (and some untangled) meshes without end, `batch` of them at a time.

    options  the fields of `DomainOptions`: seed, triangles, tangled, motions, shard, drawing

    The meshes do not depend on `batch`.  Raises ValueError, naming the option, for one out of its range, and
    ConvergenceError for a domain that cannot be meshed well with so few triangles.
    """
    return (moved.deformed for moved in pairs(families, batch=batch, **options))


def pairs(families: Sequence[str] = tuple(FAMILIES), *, batch: int = 32, **options: Any) -> Iterator[Moved]:
    """The meshes of `stream` with the undeformed meshes beside the deformed ones."""
    if batch < 1:
        raise ValueError(f"batch must be at least 1, not {batch}")
    return _batches(DomainOptions(families, **options), batch)


def generate(count: int, families: Sequence[str] = tuple(FAMILIES), **options: Any) -> Moved:
    """The first `count` meshes of `pairs`, as one batch."""
    if count < 1:
        raise ValueError(f"count must be at least 1, not {count}")
    return next(pairs(families, batch=count, **options))


def moving(name: _Moving) -> tuple[MeshBatch, MeshBatch]:
    """One of the paper's domains: its undeformed mesh, and that mesh after its boundary moved (FEMWARP).

    "circle" is a small hole in a long rectangle, moved by four of its diameters; "bar" a thin
    upright hole, moved; "gate" a notch in the outer boundary, pushed in.  The paper shows pictures
    only: the dimensions are ours (experiments/paper/make_meshes.py).
    """
    if name not in get_args(_Moving):
        raise ValueError(f"domains.moving knows {', '.join(map(repr, get_args(_Moving)))}, not {name!r}")
    with resources.as_file(resources.files("torchmesh") / "data" / f"{name}.vtk") as path:
        mesh = read(path)
        displacement = np.asarray(load(path).mesh.point_data["displacement"], dtype=np.float64)[:, :2]
    return mesh, femwarp(mesh, mesh.points + torch.from_numpy(displacement).to(mesh.points))


def _batches(options: DomainOptions, size: int) -> Iterator[Moved]:
    """The meshes of the stream, cut into batches of `size`."""
    index, count = options.shard
    numbers = itertools.count(index, count)
    waiting: list[tuple[MeshBatch, MeshBatch, str, int]] = []
    while True:
        while len(waiting) < size:
            lacking = -(-(size - len(waiting)) // options.motions)
            some = list(itertools.islice(numbers, min(lacking, _DOMAINS_AT_ONCE)))
            for domain in draw_domains(options, some):
                waiting += [(domain.mesh, moved, domain.family, domain.number) for moved in domain.moved(options)]
        undeformed, deformed, families, domains = zip(*waiting[:size], strict=True)
        del waiting[:size]
        after = join(deformed)
        seeds = torch.full((size,), options.seed)
        yield Moved(join(undeformed), after, quality(after).inverted, families, seeds, torch.tensor(domains))
