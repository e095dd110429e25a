"""One domain of the stream of `tm.domains`: drawn, meshed, smoothed and moved.

    number --family--> scene --mesher--> mesh --smooth--> undeformed mesh --motions, FEMWARP--> deformed meshes

What is drawn for a domain depends on the seed and on its number alone, so that every worker draws the same one.
"""

import itertools
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from ..errors import ConvergenceError, MeshWarning
from ..mesh.batch import MeshBatch, join
from ..mesh.means import vertex_size
from ..mesh.measure import quality
from ..mesh.triangle import corners, signed_area
from ..optimising.laplacian import cotangent_weights, harmonic_extension
from ..smoothing.smoothing import SmoothOptions, smooth
from ..triangulating.mesher import MeshingError
from ..triangulating.polygon import why_not_simple
from .coarse import WITHIN, mesh_as_asked
from .families import FAMILIES, Motion, Scene

# The limits of the inverse mean ratio of undeformed meshes: on average, and of the worst triangle.
MAX_MEAN = 1.06
MAX_WORST = 3.0

# Instead of MAX_MEAN, where narrow parts have fewer triangles than they should, because so few are asked for.
MAX_MEAN_COARSE = 1.25

# The purposes that random numbers are drawn for: the domain's shape, a motion.
_SHAPE, _MOTION = 1, 2

_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class DrawOptions:
    """How often domains and motions are drawn anew until they are as wanted.

    domain_tries           domains drawn at most for one that can be meshed within the limits
    domain_tries_as_asked  so many have the triangles asked for; narrow parts may need more
    more_triangles         the factor of the number of triangles with each try after those
    motion_tries           motions drawn at most for one that tangles, or does not tangle, as wished
    levels                 positions along a motion's path that are looked at
    smoothing              of the undeformed mesh; a higher ceiling or more iterations gain some thousandths
    """

    domain_tries: int = 20
    domain_tries_as_asked: int = 8
    more_triangles: float = 1.2
    motion_tries: int = 6
    levels: int = 5
    smoothing: SmoothOptions = field(default_factory=lambda: SmoothOptions(ceiling=1.5, max_iterations=20))

    def __post_init__(self) -> None:
        for name in ("domain_tries", "motion_tries", "levels"):
            if getattr(self, name) < 1:
                raise ValueError(f"DrawOptions.{name} must be at least 1, not {getattr(self, name)}")


@dataclass(frozen=True)
class DomainOptions:
    """The meshes that `stream`, `pairs` and `generate` draw.

    families   names out of FAMILIES, taken in turn, domain by domain
    seed       whole number from 0; the same options and seed give the same meshes bit for bit (with the same versions
               of torch, numpy and scipy on the same processor)
    triangles  wanted for each mesh, met within 10 percent; what is further off is told in a `MeshWarning`.  Where the
               smallest parts of a domain would need more, its mesh is coarser there, and its mean inverse mean ratio at
               most MAX_MEAN_COARSE
    tangled    the share of meshes that the motion shall tangle, 0 to 1, met evenly along the stream except for the
               few motions that do not tangle however they are drawn: `Moved.inverted` tells
    motions    how many motions of each undeformed mesh follow one another; 1: every domain is new
    shard      (i, n): of all domains take every n-th from the i-th, for n workers that share the work
    drawing    how often to draw anew
    """

    families: Sequence[str] = tuple(FAMILIES)
    seed: int = 0
    triangles: int = 2000
    tangled: float = 0.8
    motions: int = 8
    shard: tuple[int, int] = (0, 1)
    drawing: DrawOptions = DrawOptions()

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
class Domain:
    """One domain of the stream.

    number, family  where it stands in the stream, and what it is
    scene           the outline, and how it moves
    mesh            at rest; its first Nb vertices lie on the outline
    loop            (Nb,) the loop of the outline that each of these vertices lies on
    coarse          whether it has fewer triangles in narrow parts than it should
    """

    number: int
    family: str
    scene: Scene
    mesh: MeshBatch
    loop: np.ndarray
    coarse: bool = False

    @classmethod
    def draw(cls, options: DomainOptions, number: int, attempt: int) -> "Domain | None":
        """The domain before it is smoothed; None if what was drawn cannot be meshed."""
        family = options.families[number % len(options.families)]
        rng = _generator(options, number, _SHAPE, attempt)
        scene = FAMILIES[family](rng)
        try:
            how = options.drawing
            more = how.more_triangles ** max(0, attempt - how.domain_tries_as_asked)
            (points, triangles, loop), coarse = mesh_as_asked(scene.outline, round(options.triangles * more), rng)
        except MeshingError:
            return None
        return cls(number, family, scene, MeshBatch.from_arrays(points, triangles), loop, coarse)

    def moved(self, options: DomainOptions) -> list[MeshBatch]:
        """The mesh after each of its motions; a motion that does not come out as wished is drawn anew."""
        found: dict[int, np.ndarray] = {}
        waiting = list(range(options.motions))
        for attempt in range(options.drawing.motion_tries):
            rngs = [_generator(options, self.number, _MOTION, attempt, k) for k in waiting]
            paths = self._carried([self._path(rng, options.drawing.levels) for rng in rngs])
            as_wished = set()
            for k, rng, path in zip(waiting, rngs, paths, strict=True):
                points, fits = self._chosen(rng, path, _wished(options, self.number * options.motions + k))
                if points is not None and (fits or k not in found):
                    found[k] = points
                if fits:
                    as_wished.add(k)
            waiting = [k for k in waiting if k not in as_wished]
            if not waiting:
                break
        rest = self.mesh.points.numpy()
        return [self.mesh.with_points(torch.from_numpy(found.get(k, rest))) for k in range(options.motions)]

    def _path(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """(count, V, 2) where a motion takes the boundary at `count` levels; the interior is only thrown, or stays."""
        motion: Motion = self.scene.motion(rng)
        rest = self.mesh.points.numpy()
        levels = (np.arange(count) + rng.random()) / count
        path = np.broadcast_to(rest, (count, *rest.shape)).copy()
        outer = len(self.loop)
        for target, t in zip(path, levels, strict=True):
            target[:outer] = motion(rest[:outer], self.loop, float(t))
        if self.scene.jitter is not None:
            reach = rng.uniform(*self.scene.jitter) * vertex_size(self.mesh).numpy()[:, None]
            path[:, outer:] += levels[:, None, None] * (reach * rng.standard_normal(rest.shape))[outer:]
        return path

    def _carried(self, paths: list[np.ndarray]) -> np.ndarray:
        """(K, levels, V, 2) the paths with the interior carried along (FEMWARP: Shontz & Vavasis 2010)."""
        if self.scene.jitter is not None:
            return np.stack(paths)
        mesh, levels = self.mesh, len(paths[0])
        columns = torch.from_numpy(np.stack(paths).transpose(2, 0, 1, 3).reshape(len(mesh.points), -1))
        weights = cotangent_weights(corners(mesh.points, mesh.triangles))
        carried = harmonic_extension(mesh.triangles, weights, mesh.fixed, columns, mesh.point_offsets)
        return carried.numpy().reshape(len(mesh.points), len(paths), levels, 2).transpose(1, 2, 0, 3)

    def _chosen(self, rng: np.random.Generator, path: np.ndarray, tangled: bool) -> tuple[np.ndarray | None, bool]:
        """Points (V, 2) at one level of a path where the boundary is simple, and whether they tangle as wished.

        None where the boundary is simple at no level.
        """
        faces = self.mesh.triangles
        inverted = [
            bool((signed_area(corners(torch.from_numpy(np.ascontiguousarray(p)), faces)) <= 0).any()) for p in path
        ]
        order = rng.permutation(len(path)).tolist()
        ends = np.flatnonzero(np.diff(self.loop, prepend=-1, append=-2))
        loops = [np.arange(start, end) for start, end in itertools.pairwise(ends.tolist())]
        for level in sorted(order, key=lambda level: inverted[level] != tangled):
            if why_not_simple(path[level], loops) is None:
                return np.ascontiguousarray(path[level]), inverted[level] == tangled
        return None, False


def draw_domains(options: DomainOptions, numbers: list[int]) -> list[Domain]:
    """The domains of these numbers, meshed and smoothed; a domain whose mesh is not good enough is drawn anew.

    Raises ConvergenceError, naming the domain, if none of its tries has a good mesh.
    """
    how = options.drawing
    done: dict[int, Domain] = {}
    for attempt in range(how.domain_tries):
        drawn = [Domain.draw(options, number, attempt) for number in numbers if number not in done]
        some = [domain for domain in drawn if domain is not None]
        if some:
            batch, _ = smooth(join([domain.mesh for domain in some]), how.smoothing)
            q = quality(batch)
            limit = q.mean.new_tensor([MAX_MEAN_COARSE if domain.coarse else MAX_MEAN for domain in some])
            good = (q.inverted == 0) & (q.mean <= limit) & (q.max <= MAX_WORST)
            for domain, mesh, fits in zip(some, batch.split(), good.tolist(), strict=True):
                if fits:
                    done[domain.number] = replace(domain, mesh=mesh)
        if len(done) == len(numbers):
            _tell(options, list(done.values()))
            return [done[number] for number in numbers]
    failed = next(number for number in numbers if number not in done)
    raise ConvergenceError(
        f"domain {failed} of the stream, family {options.families[failed % len(options.families)]!r}: "
        f"{how.domain_tries} were drawn and none has a mesh of {options.triangles} triangles "
        f"with an inverse mean ratio of {MAX_MEAN} on average; ask for more triangles"
    )


def _tell(options: DomainOptions, domains: list[Domain]) -> None:
    """Warn of domains that have another number of triangles than was asked for."""
    for domain in domains:
        count = len(domain.mesh.triangles)
        if abs(count / options.triangles - 1) > WITHIN:
            text = f"domain {domain.number}, family {domain.family!r}, has {count:,} triangles"
            warnings.warn(MeshWarning(f"{text}; {options.triangles:,} were asked for"), stacklevel=2)


def _wished(options: DomainOptions, mesh: int) -> bool:
    """Whether the mesh of this number in the stream shall be tangled.

    Multiples of the golden section, modulo one, fill [0, 1) so evenly that every stretch of the stream comes close to
    the share wished for.
    """
    return (options.seed + mesh * _GOLDEN) % 1.0 < options.tangled


def _generator(options: DomainOptions, number: int, purpose: int, attempt: int, motion: int = 0) -> np.random.Generator:
    """The random numbers for one purpose in one domain, which depend on nothing else."""
    return np.random.default_rng([options.seed, number, purpose, attempt, motion])
