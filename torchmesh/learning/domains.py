"""Meshes to try things on and to learn from: endless random domains in motion, and the three of Kim 2017.

    for batch in tm.domains.stream(["holes", "airfoil"], seed=1): ...

A *family* is a kind of domain with a kind of motion:

    circle   a small hole in a long rectangle, moved        gate    notches in the boundary, pushed in, bent
    bar      a thin hole, moved and turned                  jitter  boundary at rest, interior thrown about
    holes    one to five holes of any shape, moved, turned  letter  block letters, twisted and bent
    airfoil  a NACA profile in a graded mesh, turned        spiral  a wound strip, wound on or back
    onto     a disc laid onto the outline of a letter or a spiral

Every undeformed mesh is valid by exact signs; its inverse mean ratio is at most MAX_MEAN on average
and MAX_WORST anywhere.  The boundary of every deformed mesh is simple, so a valid mesh exists.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from ..errors import ConvergenceError
from ..files.documents import load
from ..files.mesh_files import read
from ..mesh.batch import MeshBatch, join
from ..mesh.measure import quality
from ..mesh.neighbourhoods import vertex_size
from ..mesh.triangle import corners, signed_area
from ..optimising.laplacian import cotangent_weights, harmonic_extension
from ..smoothing.smoothing import SmoothOptions, smooth
from ..triangulating.mesher import MeshingError, mesh_outline
from ..triangulating.polygon import why_not_simple
from ..warping.femwarp import femwarp
from .families import FAMILIES, Motion, Scene

MAX_MEAN = 1.06


MAX_WORST = 3.0


# Enough for the targets above; more gains some thousandths.
_SMOOTHING = SmoothOptions(ceiling=1.5, max_iterations=20)


# Domains drawn for one that can be meshed well, motions drawn for one that tangles or does not, as wished.
_DOMAIN_TRIES = 20


# After so many, a domain gets a fifth more triangles with each: narrow parts want them.
_DOMAIN_TRIES_AS_ASKED = 8


_MORE_TRIANGLES = 1.2


_MOTION_TRIES = 6


# Places along a motion's path that are looked at.
_LEVELS = 5


# What random numbers are for: the domain's shape, a motion.
_SHAPE, _MOTION = 1, 2


_GOLDEN = (5**0.5 - 1) / 2


# Domains meshed and smoothed together; no result depends on it.
_DOMAINS_AT_ONCE = 16


@dataclass(frozen=True)
class DomainOptions:
    """What `stream`, `pairs` and `generate` draw.

    families   names out of FAMILIES, taken in turn, domain by domain
    seed       whole number from 0; the same options and seed give the same meshes bit for bit (with the
               same versions of torch, numpy and scipy on the same processor)
    triangles  wanted for each mesh, met within some percent; domains whose smallest parts need more get more
    tangled    the share of meshes that the motion shall tangle, 0 to 1, met evenly along the stream but
               for the few motions that do not tangle however they are drawn: `Moved.inverted` tells
    motions    how many motions of each undeformed mesh follow one another; 1: every domain is new
    shard      (i, n): of all domains take every n-th from the i-th, for n workers that share the work
    """

    families: Sequence[str] = tuple(FAMILIES)
    seed: int = 0
    triangles: int = 2000
    tangled: float = 0.8
    motions: int = 8
    shard: tuple[int, int] = (0, 1)

    def __post_init__(self) -> None:
        if isinstance(self.families, str):
            object.__setattr__(self, "families", (self.families,))
        object.__setattr__(self, "families", tuple(self.families))
        unknown = [name for name in self.families if name not in FAMILIES]
        if unknown or not self.families:
            raise ValueError(f"families must be some of {sorted(FAMILIES)}, not {unknown or 'none'}")
        if self.seed < 0:
            raise ValueError(f"seed must not be negative, but is {self.seed}")
        if not 100 <= self.triangles <= 10_000_000:
            raise ValueError(f"triangles must be from 100 to 10,000,000, not {self.triangles}")
        if not 0 <= self.tangled <= 1:
            raise ValueError(f"tangled is a share from 0 to 1, not {self.tangled}")
        if self.motions < 1:
            raise ValueError(f"motions must be at least 1, not {self.motions}")
        index, count = self.shard
        if not 0 <= index < count:
            raise ValueError(f"shard must be (i, n) with 0 <= i < n, not {self.shard}")


@dataclass(frozen=True, eq=False)
class Moved:
    """B generated meshes before and after their motion; the triangles of both are the same.

    undeformed  valid meshes
    deformed    where FEMWARP or jitter took them: the boundary of each is simple
    inverted    (B,) int64 triangles of `deformed` that are not upright
    families    for each mesh its family
    """

    undeformed: MeshBatch
    deformed: MeshBatch
    inverted: Tensor
    families: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.undeformed)


def stream(families: Sequence[str] = tuple(FAMILIES), *, batch: int = 32, **options: Any) -> Iterator[MeshBatch]:
    """Tangled (and some untangled) meshes without end, `batch` of them at a time.

    options  the fields of `DomainOptions`: seed, triangles, tangled, motions, shard

    How the stream is cut into batches changes no mesh of it.
    """
    return (moved.deformed for moved in pairs(families, batch=batch, **options))


def pairs(families: Sequence[str] = tuple(FAMILIES), *, batch: int = 32, **options: Any) -> Iterator[Moved]:
    """As `stream`, with the undeformed meshes beside the deformed ones."""
    if batch < 1:
        raise ValueError(f"batch must be at least 1, not {batch}")
    return _batches(DomainOptions(families, **options), batch)


def generate(count: int, families: Sequence[str] = tuple(FAMILIES), **options: Any) -> Moved:
    """The first `count` meshes of `pairs`, as one batch."""
    if count < 1:
        raise ValueError(f"count must be at least 1, not {count}")
    return next(pairs(families, batch=count, **options))


def moving(name: Literal["circle", "bar", "gate"]) -> tuple[MeshBatch, MeshBatch]:
    """One of the paper's domains: its undeformed mesh, and that mesh after its boundary moved (FEMWARP).

    "circle" is a small hole in a long rectangle, moved by four of its diameters; "bar" a thin
    upright hole, moved; "gate" a notch in the outer boundary, pushed in.  The paper shows pictures
    only: the dimensions are ours (experiments/paper/make_meshes.py).
    """
    with resources.as_file(resources.files("torchmesh") / "data" / f"{name}.vtk") as path:
        mesh = read(path)
        displacement = np.asarray(load(path).mesh.point_data["displacement"], dtype=np.float64)[:, :2]
    return mesh, femwarp(mesh, mesh.points + torch.from_numpy(displacement).to(mesh.points))


def _batches(options: DomainOptions, size: int) -> Iterator[Moved]:
    """The meshes of the stream, cut into batches of `size`."""
    index, count = options.shard
    numbers = itertools.count(index, count)
    waiting: list[tuple[MeshBatch, MeshBatch, str]] = []
    while True:
        while len(waiting) < size:
            lacking = -(-(size - len(waiting)) // options.motions)
            some = list(itertools.islice(numbers, min(lacking, _DOMAINS_AT_ONCE)))
            for domain in _domains(options, some):
                waiting += [(domain.mesh, moved, domain.family) for moved in domain.moved(options)]
        undeformed, deformed, families = zip(*waiting[:size], strict=True)
        del waiting[:size]
        after = join(deformed)
        yield Moved(join(undeformed), after, quality(after).inverted, families)


@dataclass(frozen=True, eq=False)
class _Domain:
    """One domain of the stream: its number, undeformed mesh, and (Nb,) the loop of its first, boundary vertices."""

    number: int
    family: str
    scene: Scene
    mesh: MeshBatch
    loop: np.ndarray

    @classmethod
    def draw(cls, options: DomainOptions, number: int, attempt: int) -> "_Domain | None":
        """The domain before it is smoothed; None if what was drawn cannot be meshed."""
        family = options.families[number % len(options.families)]
        rng = _generator(options, number, _SHAPE, attempt)
        scene = FAMILIES[family](rng)
        try:
            more = _MORE_TRIANGLES ** max(0, attempt - _DOMAIN_TRIES_AS_ASKED)
            points, triangles, loop = mesh_outline(scene.outline, round(options.triangles * more), rng)
        except MeshingError:
            return None
        return cls(number, family, scene, MeshBatch.from_arrays(points, triangles), loop)

    def moved(self, options: DomainOptions) -> list[MeshBatch]:
        """The mesh after each of its motions."""
        out: dict[int, np.ndarray] = {}
        waiting = list(range(options.motions))
        for attempt in range(_MOTION_TRIES):
            rngs = [_generator(options, self.number, _MOTION, attempt, k) for k in waiting]
            wishes = [_wished(options, self.number * options.motions + k) for k in waiting]
            paths = [self._path(rng) for rng in rngs]
            for k, rng, wish, places in zip(waiting, rngs, wishes, self._carried(paths), strict=True):
                place, fits = self._chosen(rng, places, wish)
                if fits or (place is not None and k not in out):
                    out[k] = place  # type: ignore[assignment]
                if fits:
                    waiting = [other for other in waiting if other != k]
            if not waiting:
                break
        rest = self.mesh.points.numpy()
        return [self.mesh.with_points(torch.from_numpy(out.get(k, rest))) for k in range(options.motions)]

    def _path(self, rng: np.random.Generator) -> np.ndarray:
        """(_LEVELS, V, 2) where a motion takes the boundary, at some levels; the interior as far as it is thrown."""
        motion: Motion = self.scene.motion(rng)
        rest = self.mesh.points.numpy()
        levels = (np.arange(_LEVELS) + rng.random()) / _LEVELS
        path = np.broadcast_to(rest, (_LEVELS, *rest.shape)).copy()
        border = len(self.loop)
        for target, t in zip(path, levels, strict=True):
            target[:border] = motion(rest[:border], self.loop, float(t))
        if self.scene.jitter is not None:
            reach = rng.uniform(*self.scene.jitter) * vertex_size(self.mesh).numpy()[:, None]
            path[:, border:] += levels[:, None, None] * (reach * rng.standard_normal(rest.shape))[border:]
        return path

    def _carried(self, paths: list[np.ndarray]) -> np.ndarray:
        """(K, _LEVELS, V, 2) the paths with the interior carried along (FEMWARP: Shontz & Vavasis 2010)."""
        if self.scene.jitter is not None:
            return np.stack(paths)
        mesh = self.mesh
        columns = torch.from_numpy(np.stack(paths).transpose(2, 0, 1, 3).reshape(len(mesh.points), -1))
        weights = cotangent_weights(corners(mesh.points, mesh.triangles))
        carried = harmonic_extension(mesh.triangles, weights, mesh.fixed, columns, mesh.point_offsets)
        return carried.numpy().reshape(len(mesh.points), len(paths), _LEVELS, 2).transpose(1, 2, 0, 3)

    def _chosen(self, rng: np.random.Generator, places: np.ndarray, tangled: bool) -> tuple[np.ndarray | None, bool]:
        """One of the places (V, 2) of a motion with a simple boundary, and whether it is tangled as wished."""
        faces = self.mesh.triangles
        inverted = [
            bool((signed_area(corners(torch.from_numpy(np.ascontiguousarray(p)), faces)) <= 0).any()) for p in places
        ]
        order = rng.permutation(_LEVELS).tolist()
        ends = np.flatnonzero(np.diff(self.loop, prepend=-1, append=-2))
        loops = [np.arange(start, end) for start, end in itertools.pairwise(ends.tolist())]
        for level in sorted(order, key=lambda level: inverted[level] != tangled):
            if why_not_simple(places[level], loops) is None:
                return np.ascontiguousarray(places[level]), inverted[level] == tangled
        return None, False


def _wished(options: DomainOptions, mesh: int) -> bool:
    """Whether the mesh of this number in the stream shall be tangled.

    Multiples of the golden section, modulo one, fill [0, 1) so evenly that every stretch of the
    stream comes close to the share wished for.
    """
    return (options.seed + mesh * _GOLDEN) % 1.0 < options.tangled


def _generator(options: DomainOptions, number: int, purpose: int, attempt: int, motion: int = 0) -> np.random.Generator:
    """The random numbers for one purpose in one domain, which depend on nothing else."""
    return np.random.default_rng([options.seed, number, purpose, attempt, motion])


def _domains(options: DomainOptions, numbers: list[int]) -> list[_Domain]:
    """The domains of these numbers, meshed and smoothed, those drawn anew that did not come out well."""
    done: dict[int, _Domain] = {}
    for attempt in range(_DOMAIN_TRIES):
        drawn = [_Domain.draw(options, number, attempt) for number in numbers if number not in done]
        some = [domain for domain in drawn if domain is not None]
        if some:
            batch, _ = smooth(join([domain.mesh for domain in some]), _SMOOTHING)
            q = quality(batch)
            good = (q.inverted == 0) & (q.mean <= MAX_MEAN) & (q.max <= MAX_WORST)
            for domain, mesh, fits in zip(some, batch.split(), good.tolist(), strict=True):
                if fits:
                    done[domain.number] = replace(domain, mesh=mesh)
        if len(done) == len(numbers):
            return [done[number] for number in numbers]
    failed = next(number for number in numbers if number not in done)
    raise ConvergenceError(
        f"domain {failed} of the stream, family {options.families[failed % len(options.families)]!r}: "
        f"{_DOMAIN_TRIES} were drawn and none has a mesh of {options.triangles} triangles "
        f"with an inverse mean ratio of {MAX_MEAN} on average; ask for more triangles"
    )
