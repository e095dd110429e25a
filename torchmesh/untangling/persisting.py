"""Second-order ways for the meshes that L-BFGS leaves tangled: triangles are kept, vertices move.

    pushed         areas are pushed above a bound, by Levenberg-Marquardt: strong turns, in a few dozen steps
    lifted         total lifted content with falling alpha (Du et al. 2020), by Newton's method: triangles may pass
                   through zero area.  What it leaves is pushed
    regularised    the functional with falling epsilon (Garanzha et al. 2021), by Newton's method: maps onto long and
                   narrow domains.  That epsilon comes down to zero is proved under the condition that each minimisation
                   lowers the energy enough (Garanzha, Kaporin, Kudryavtseva, Protais & Sokolov, Practical lowest
                   distortion mapping, arXiv 2201.12112, 2022), which L-BFGS misses where triangles have to shear much.
                   Now and then what is left is pushed
    weighted       areas are pushed in rounds, after each of which the triangles that are inverted still get more
                   weight.  A sum of squares rests where a few triangles pay for many; growing weights make that no
                   resting place (as in Morris, The breakout method for escaping from local minima, AAAI 1993)

Each mesh is worked on alone, from the Tutte embedding (`relax`), from a start by way of a circle (`overlay`), and from
where it was.  The first way that makes it valid ends the work; otherwise the positions with the fewest inverted
triangles count.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.measure import upright
from ..mesh.ragged import true_rows
from ..mesh.units import centre_and_unit_of_triangles
from ..optimising.energies import Regularised, TotalLiftedContent
from ..optimising.jacobian import Target, select_rows
from ..optimising.laplacian import harmonic_extension
from ..optimising.levenberg import LevenbergOptions, push_areas
from ..optimising.projected_newton import NewtonSystem, ProjectedOptions, minimise_by_projection
from ..optimising.targets import ideal
from .continuation import next_epsilon
from .local_size import local_size
from .options import NewtonWays
from .overlay import overlaid
from .overlay_of_rings import overlaid_rings

# The place of the rest shapes among the numbers of sweeps.
_REST = -1

# From scaled positions, with the targets of so many sweeps: are all triangles upright in the end?
_Way = Callable[["_Task", Tensor, int], bool]


@dataclass
class Best:
    """The positions of a mesh with the fewest inverted triangles so far.

    points      (V, 2) in the caller's unit
    inverted    their number, by exact signs
    iterations  the Newton steps of all tries
    """

    mesh: MeshBatch
    points: Tensor
    inverted: int
    iterations: int = 0

    def take(self, points: Tensor) -> bool:
        """Keep the points if they are better; are they valid?"""
        left = int((~upright(self.mesh.with_points(points))).sum())
        if left < self.inverted:
            self.points, self.inverted = points, left
        return left == 0


class _Task:
    """One mesh in a unit of its own, and the moves between both units.

    rest  the rest shapes as targets (T,), in the caller's unit, where they are known
    """

    def __init__(
        self, mesh: MeshBatch, free: Tensor, options: NewtonWays, best: Best, rest: Target | None = None
    ) -> None:
        self.mesh, self.free, self.options, self.best, self.rest = mesh, free, options, best, rest
        centre, unit = centre_and_unit_of_triangles(mesh.points, mesh.triangles, mesh.point_offsets)
        self.centre, self.unit = centre, unit
        self.systems: dict[int, tuple[NewtonSystem, Tensor]] = {}

    def scaled(self, points: Tensor) -> Tensor:
        return (points.to(torch.float64) - self.centre) / self.unit

    def give(self, points: Tensor) -> bool:
        """Take scaled points back to the caller's unit, and keep them if they are better; are they valid?"""
        there = (points * self.unit + self.centre).to(self.mesh.points)
        return self.best.take(torch.where(self.free[:, None], there, self.mesh.points))

    def system(self, sweeps: int) -> tuple[NewtonSystem, Tensor]:
        """The system with targets of the size field of so many sweeps, and their areas (T,) relative to the mean.

        With _REST sweeps the targets are the rest shapes.
        """
        if sweeps not in self.systems:
            if sweeps == _REST:
                assert self.rest is not None
                target = _scaled(self.rest, self.unit)
            else:
                target = ideal(self.mesh, local_size(self.mesh, sweeps)[self.mesh.triangles].mean(1) / self.unit)
            area = 1 / torch.as_tensor(target.m)
            system = NewtonSystem(self.scaled(self.mesh.points), self.mesh.triangles, self.free, target)
            self.systems[sweeps] = system, (area / area.mean())[self.free[self.mesh.triangles].any(1)]
        return self.systems[sweeps]


def _scaled(target: Target, unit: Tensor) -> Target:
    """The target in another unit of length."""
    g11, g12, g22, m = (torch.as_tensor(v).cpu() * unit.square() for v in target)
    return Target(g11, g12, g22, m)


def persist(
    batch: MeshBatch, may_move: Tensor, options: NewtonWays, at: Tensor, rest: Target | None = None
) -> tuple[MeshBatch, Tensor]:
    """Try all ways on the meshes `at` (B,) bool, each alone.

    may_move  (V,) bool
    rest      the rest shapes as targets (T,), where they are known

    Returns the batch, and the Newton steps of each mesh (B,).
    """
    steps = torch.zeros(len(batch), dtype=torch.int64)
    points = batch.points.clone()
    for b in true_rows(at).tolist():
        mesh = batch[b]
        rows = slice(int(batch.point_offsets[b]), int(batch.point_offsets[b + 1]))
        faces = slice(int(batch.triangle_offsets[b]), int(batch.triangle_offsets[b + 1]))
        best = _solve(mesh, may_move[rows], options, None if rest is None else select_rows(rest, faces))
        points[rows], steps[b] = best.points.to(points), best.iterations
    return batch.with_points(points), steps.to(batch.points.device)


def _solve(mesh: MeshBatch, free: Tensor, options: NewtonWays, rest: Target | None = None) -> Best:
    mesh, free = mesh.to("cpu"), free.cpu()
    best = Best(mesh, mesh.points, int((~upright(mesh)).sum()))
    embedded = _embedded(mesh, free)
    # The sizes of scrambled triangles tell nothing.
    sized = mesh.with_points(embedded)
    task = _Task(sized, free, options, best, rest)
    sizes = options.size_sweeps if rest is None else (_REST, *options.size_sweeps)
    if task.give(task.scaled(embedded)):
        return best
    over = list[Tensor]()
    if any(way(task, task.scaled(start), sweeps) for start, way, sweeps in _ways(mesh, free, embedded, sizes, over)):
        return best
    tries = options.weightings
    if rest is not None and tries:
        tries = ((_REST, *tries[0][1:]), *tries)
    any(_weighted(task, task.scaled(start), *each) for each in tries for start in (*over[:1], embedded))
    return best


def _ways(
    mesh: MeshBatch, free: Tensor, embedded: Tensor, sizes: tuple[int, ...], over: list[Tensor]
) -> Iterator[tuple[Tensor, _Way, int]]:
    """Where to start, what to do, and the sweeps of the size field, one after the other.

    embedded  the Tutte embedding
    over      is filled with the starts by way of a circle or a cylinder, once they are wanted
    """
    first, own = sizes[0], [sweeps for sweeps in sizes if sweeps != _REST][:2]
    yield embedded, _pushed, first
    disc = overlaid(mesh, free)
    if disc is not None:
        over.append(disc)
        for sweeps in own:
            yield disc, _pushed, sweeps
    yield embedded, _lifted, first
    for sweeps in sizes:
        yield embedded, _regularised, sweeps
    if disc is None:
        # Rings seldom need them.
        over += overlaid_rings(mesh, free)
        for start in over:
            for sweeps in own:
                yield start, _pushed, sweeps
    if not torch.equal(embedded, mesh.points):
        yield mesh.points, _pushed, first
        yield mesh.points, _regularised, first


def sizes_to_push(mesh: MeshBatch, options: NewtonWays) -> Tensor:
    """(V,) the sizes of one mesh for `pushed`, at the Tutte embedding; a few flips hardly change them."""
    return local_size(mesh.with_points(_embedded(mesh, ~mesh.fixed)), options.size_sweeps[0])


def pushed(
    mesh: MeshBatch,
    options: NewtonWays,
    size: Tensor,
    start: Tensor | None = None,
    order: list[np.ndarray] | None = None,
) -> tuple[Tensor, int, float]:
    """Push the areas of one mesh from the positions `start` (V, 2), in rounds with growing weights.

    options  its least bound, its `pushes` a round, and the rounds, the factor of the first of `weightings` and the
             decay of weights.  Three rounds without fewer inverted triangles than ever before are the last
    size     (V,) of the triangles around each vertex
    start    None: the Tutte embedding
    order    holds the order of unknowns of a mesh that some flips lead to this one, or nothing: then it is put in

    Returns the positions with the fewest inverted triangles, the number of those, and the sum of their negative areas,
    as a positive number in units of the mean area.
    """
    free = ~mesh.fixed
    start = (_embedded(mesh, free) if start is None else start).to(torch.float64)
    centre, unit = centre_and_unit_of_triangles(start, mesh.triangles, mesh.point_offsets)
    target = ideal(mesh, size[mesh.triangles].mean(1) / unit)
    points = best = (start - centre) / unit
    system = NewtonSystem(points, mesh.triangles, free, target)
    if order is not None:
        if not order:
            order.append(system.number)
        # A few flips hardly change how full the factors are; the order of another mesh is right, if not the best.
        system.number = order[0]
    settings = LevenbergOptions(max_iterations=options.pushes)
    factor = options.weightings[0][2] if options.weightings else 1.0
    fewest, lack, quiet = len(mesh.triangles) + 1, float("inf"), 0
    for _ in range(options.weight_rounds):
        found = push_areas(system, points, min(options.betas), settings)
        points, inverted = found.points, found.det <= 0
        count = int(inverted.sum())
        quiet = 0 if count < fewest else quiet + 1
        if count < fewest:
            best, fewest, lack = points, count, float((-found.det).clamp_min(0).sum())
        if not count or quiet >= 3:
            break
        system.weight = _heavier(system.weight, inverted, factor, options.weight_decay)
    there = torch.where(free[:, None], best * unit + centre, start).to(mesh.points)
    return there, int((~upright(mesh.with_points(there))).sum()), lack


def _embedded(mesh: MeshBatch, free: Tensor) -> Tensor:
    """(V, 2) every free vertex at the mean of its neighbours."""
    one = torch.ones(len(mesh.triangles), dtype=torch.float64)
    return harmonic_extension(mesh.triangles, (one, one, one), ~free, mesh.points, mesh.point_offsets)


def _pushed(task: _Task, points: Tensor, sweeps: int) -> bool:
    """Areas pushed above falling bounds; are the triangles upright in the end?"""
    options, (system, _) = task.options, task.system(sweeps)
    for least in options.betas:
        found = push_areas(system, points, least, LevenbergOptions(max_iterations=options.pushes))
        points = found.points
        task.best.iterations += found.iterations
        if bool((found.det > 0).all()):
            break
    return task.give(points)


def _weighted(task: _Task, points: Tensor, sweeps: int, least: float, factor: float) -> bool:
    """Areas pushed above a bound in rounds, with more weight on what is inverted; are all upright in the end?

    Often the rounds first leave more triangles inverted than pushing without weights, and then none.
    """
    options, (system, _) = task.options, task.system(sweeps)
    settings = LevenbergOptions(max_iterations=options.weight_pushes)
    weight = even = system.weight
    for _ in range(options.weight_rounds):
        system.weight = weight
        found = push_areas(system, points, least, settings)
        points, inverted = found.points, found.det <= 0
        task.best.iterations += found.iterations
        if not bool(inverted.any()):
            break
        weight = _heavier(weight, inverted, factor, options.weight_decay)
    system.weight = even
    return task.give(points)


def _heavier(weight: Tensor, inverted: Tensor, factor: float, decay: float) -> Tensor:
    """(T,) the weights of the next round, one on average."""
    weight = weight.pow(decay) * torch.where(inverted, factor, 1.0)
    return weight / weight.mean()


def _regularised(task: _Task, points: Tensor, sweeps: int) -> bool:
    """Falling epsilon; are the triangles upright in the end?"""
    options, (system, _) = task.options, task.system(sweeps)
    newton = ProjectedOptions(max_iterations=options.steps_per_epsilon)
    eps, push_at = 1.0, options.first_push
    lows, counts = list[float](), list[int]()
    for turn in range(options.max_continuations):
        found = minimise_by_projection(system, points, Regularised(eps), newton, enough=True)
        points, lowest = found.points, float(found.det.min())
        task.best.iterations += found.iterations
        lows.append(lowest)
        counts.append(int((found.det <= 0).sum()))
        if lowest > 0 or _stalls(lows, counts, eps, options):
            break
        new = _next(eps, lowest, found.start, found.energy)
        if found.iterations == 0 and new >= 0.999 * eps:
            break
        if turn + 1 == push_at:
            push_at *= 2
            if _pushed(task, points, sweeps):
                return True
        eps = min(eps, new)
    return task.give(points)


def _stalls(lows: list[float], counts: list[int], eps: float, options: NewtonWays) -> bool:
    """Whether nothing is gained, by the lowest determinants and the numbers of inverted triangles, one an epsilon.

    The rule is that of the first-order method (`UntangleOptions.stall_patience`).
    """
    if len(lows) <= options.stall_patience or lows[-1] >= -options.stall_depth * eps:
        return False
    before = -1 - options.stall_patience
    return lows[-1] < options.stall_ratio * lows[before] and counts[-1] >= options.stall_ratio * counts[before]


def _next(eps: float, lowest: float, before: float, after: float) -> float:
    """`next_epsilon` of one mesh."""
    return float(next_epsilon(*(torch.tensor([v], dtype=torch.float64) for v in (eps, lowest, before, after))))


def _lifted(task: _Task, points: Tensor, sweeps: int) -> bool:
    """Falling alpha; are the triangles upright in the end?"""
    options, (system, area) = task.options, task.system(sweeps)
    settings = ProjectedOptions(options.steps_per_alpha, 1e-9, 1e-10, floor=0.0, common_floor=1e-8)
    fewest = len(system.triangles) + 1.0
    for number, alpha in enumerate(options.alphas):
        system.weight = area
        found = minimise_by_projection(system, points, TotalLiftedContent(alpha), settings, enough=True)
        system.weight = torch.ones_like(area)
        points, count = found.points, int((found.det <= 0).sum())
        task.best.iterations += found.iterations
        if not count or (number >= options.least_alphas and count > options.stall_ratio * fewest):
            break
        fewest = min(fewest, count)
    return task.give(points) or _pushed(task, points, sweeps)
