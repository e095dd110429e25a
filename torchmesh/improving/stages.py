"""A batch on its way through `improve`: the stages, which meshes take them, and the log.

Every mesh goes down its own road; the meshes on one stretch of road travel as one batch.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from ..diagnosing.diagnosis import diagnose
from ..flipping.delaunay import FlipOptions, flip_to_delaunay
from ..mesh.batch import MeshBatch, put
from ..mesh.certificate import same_frame
from ..mesh.measure import quality
from ..mesh.neighbourhoods import corners_of, rewired, touching, vertex_size
from ..mesh.ragged import segment_any, segment_count, spread
from ..optimising.lbfgs import LbfgsOptions
from ..optimising.metric_field import MetricField
from ..optimising.targets import as_targets, narrow
from ..remeshing.criteria import crowded
from ..remeshing.options import RemeshOptions
from ..remeshing.sizing import SizeConformity, size_conformity, size_field
from ..smoothing.polishing import bad_triangles, polish
from ..smoothing.smoothing import SmoothOptions, smooth
from ..status import Status
from ..untangling.averaging import average
from ..untangling.options import UntangleOptions
from ..untangling.untangling import untangle
from ..warping.femwarp import femwarp
from .options import ImproveOptions
from .report import Progress, Report, Step, left_over

# What few meshes come to is loaded where one does: relocation, remeshing, sliding, pockets.
if TYPE_CHECKING:
    from ..mesh.curves import BoundaryCurves
    from ..remeshing.remeshing import RemeshInfo

# Rounds of flips between two goes of untangling: the first flips do most, the last ones have tangles
# as their only guide.
_FLIP_ROUNDS = 2


# The paper's loop stands still after so many rounds without a flip whose minimisation ended in the fewest
# iterations there are.
_QUIET_ROUNDS, _AT_REST = 4, LbfgsOptions().patience


# Rounds of flips before a valid mesh is smoothed for the first time.
_FIRST_ROUNDS = 4


# A vertex that moves less than this part of its edges in a round of smoothing rests in the next one.
_STILL = 0.02


# A round that lowers the mean of a mesh without poor triangles by less is its last.
_LITTLE = 3e-3


# The inverse mean ratio of a triangle so flat that flips and q^2 would not see the others for it.
_SLIVER = 1e4


# The worst inverse mean ratio of a mesh whose energies are left to single precision.
_COARSE = 100.0


class Job:
    """A batch on its way, with the log of what happened to each mesh."""

    def __init__(
        self,
        batch: MeshBatch,
        options: ImproveOptions,
        progress: Callable[[Progress], None] | None,
        observe: Callable[[str, MeshBatch], None] | None = None,
        hold: Tensor | None = None,
    ) -> None:
        self.given = self.batch = batch
        if options.topology != "keep":
            # Computed once: selections, flips and `put` hand them on.
            batch.twin  # noqa: B018
        self.curves: BoundaryCurves | None = None
        if options.slides:
            from ..smoothing.sliding import curves_of

            self.curves = curves_of(batch, options.smooth.corner_angle, hold)
        # (V,) bool: the fixed vertices that do not slide either.
        self.stays = batch.fixed if self.curves is None else batch.fixed & ~self.curves.may_slide(batch.point_offsets)
        self.options, self.progress, self.observe = options, progress, observe
        self.targets = as_targets(options.smooth.targets)
        self.quality = quality(batch)
        self.remeshed: RemeshInfo | None = None
        # (V,) the sizes that were asked for and have travelled with the vertices of the valid meshes.
        self.relocated_sizes: Tensor | None = None
        self.status = torch.full((len(batch),), Status.RUNNING, device=batch.points.device)
        self.messages: dict[int, str] = {}
        self.obstacles: dict[int, str] = {}
        self.steps: list[list[Step]] = [[] for _ in range(len(batch))]
        everything = torch.ones(len(batch), dtype=torch.bool, device=batch.points.device)
        none = torch.zeros(len(batch), dtype=torch.int64, device=batch.points.device)
        self._log("initial", everything, 0.0, none, none, none, everything)

    @property
    def tangled(self) -> Tensor:
        """(B,) bool: the mesh has a triangle that is not upright, and there is still hope for it."""
        return (self.quality.inverted > 0) & (self.status == Status.RUNNING)

    def paper(self) -> None:
        """Kim 2017, figure 2."""
        best = self.quality.inverted
        since, quiet = torch.zeros_like(best), torch.zeros_like(best)
        # Flips may open a way where minimising alone stood still; without them nothing would change.
        patience = 10 if self.options.topology != "keep" else 1
        for turn in range(self.options.untangle_rounds):
            if not bool(self.tangled.any()):
                break
            flips = torch.zeros_like(best)
            if self.options.topology != "keep":
                flips = self._flip("flip", self.tangled, FlipOptions.paper())
            iterations = self._untangle("untangle-beta", self.tangled, self._turn(turn))
            # No flip, and a minimum already: once more would be the same again.
            quiet = torch.where((flips == 0) & (iterations <= _AT_REST), quiet + 1, 0)
            short = self._turn(turn).max_iterations < self.options.untangle.max_iterations
            since = torch.where((self.quality.inverted < best) | short, 0, since + 1)
            best = torch.minimum(best, self.quality.inverted)
            self.status[self.tangled & ((since >= patience) | (quiet >= _QUIET_ROUNDS))] = Status.STALLED
        self.status[self.tangled] = Status.ITERATION_LIMIT
        self._smooth("smooth", self.quality.inverted == 0, self.options.smooth)
        self.status[self.status == Status.RUNNING] = Status.SETTLED

    def _turn(self, turn: int) -> UntangleOptions:
        """Step 2 of an outer iteration: short at first, so that edges flip early, then ever longer."""
        options = self.options.untangle
        return replace(options, max_iterations=min(options.max_iterations, 20 * 3**turn))

    def diagnose(self) -> None:
        """Tell the meshes that no method can help, before any work on them."""
        at = self.tangled
        if not bool(at.any()):
            return
        meshes = at.nonzero().squeeze(1).tolist()
        found: dict[int, list[str]] = {}
        may_change: Literal["keep", "flip"] = "keep" if self.options.topology == "keep" else "flip"
        for problem in diagnose(self.batch.select(at), may_change):
            found.setdefault(meshes[problem.mesh], []).append(problem.message)
        for b, texts in found.items():
            self.status[b] = Status.INFEASIBLE
            more = f"; and {len(texts) - 5} more of the kind" if len(texts) > 5 else ""
            self.messages[b] = "; ".join(texts[:5]) + more

    def untangle(self) -> None:
        """Every way that is left, in order of cost, for the meshes that are still tangled."""
        may_flip = self.options.topology != "keep"
        reference = self.options.reference
        if reference is not None:
            known = reference.select(self.tangled)
            self._try(
                "femwarp", self.given, lambda part: (femwarp(replace(known, fixed=part.fixed), part.points), None)
            )
        self._try("relax", self.given, lambda part: (average(part), None))
        relaxed = self.batch
        if may_flip:
            best, since = self.quality.inverted, torch.zeros_like(self.quality.inverted)
            for _ in range(self.options.untangle_rounds):
                going = self.tangled & (since < 2)
                self._flip("flip", going, FlipOptions(max_rounds=_FLIP_ROUNDS))
                self._untangle("untangle-beta", going & self.tangled, self.options.untangle)
                since = torch.where(self.quality.inverted <= 0.75 * best, 0, since + 1)
                best = torch.minimum(best, self.quality.inverted)
            if bool(self.tangled.any()):
                from ..untangling.retriangulation import retriangulate_cavities

                self._try("pockets", self.batch, retriangulate_cavities)
        self._regularised(self.given, UntangleOptions())
        elsewhere = segment_any((relaxed.points != self.given.points).any(1), self.given.point_offsets)
        self._regularised(relaxed, UntangleOptions(size_sweeps=(100,)), elsewhere)
        self.status[self.tangled] = Status.STALLED

    def refine(self) -> None:
        """Flips and smoothing in turn on the valid meshes, then smoothing that cares for the worst triangles."""
        going = self.quality.inverted == 0
        # A few triangles that are all but flat drown the others in q^2, and more so in its ceiling.
        slivers = SmoothOptions(power=1, max_iterations=200, energy_tolerance=1e-3)
        self._smooth("smooth", going & (self.quality.max > _SLIVER), slivers)
        rough = SmoothOptions(power=self.options.smooth.power, max_iterations=10, energy_tolerance=1e-3, single=True)
        if self.options.topology != "keep":
            size = vertex_size(self.batch)
            lively = torch.ones_like(self.batch.fixed)
            for turn in range(self.options.smooth_rounds):
                mean, worst, before = self.quality.mean, self.quality.max, self.batch
                # At first one flip calls for the next, and smoothing for others.
                most = FlipOptions().max_rounds if turn else _FIRST_ROUNDS
                flips = self._flip("flip", going, FlipOptions(rule="shape", max_rounds=most), lively)
                if turn > 1:
                    lively = corners_of(self.batch, touching(self.batch, lively | rewired(before, self.batch)))
                self._smooth("smooth", going, rough, lively)
                if turn:
                    lively = (self.batch.points - before.points).square().sum(1) > (_STILL * size).square()
                gain = mean - self.quality.mean
                settled = (gain < 1e-4) & (worst - self.quality.max < 1e-3 * worst)
                # Where no triangle is poor, the last smoothing does the rest.
                settled |= (gain < _LITTLE) & (self.quality.max < (self.options.smooth.ceiling or 1.0))
                # Towards targets that are not equilateral the quality known here may even fall.
                if turn and self.options.smooth.targets is None:
                    going = going & ~settled
                going = going & (flips > 0)
        self._smooth("smooth", self.quality.inverted == 0, self.options.smooth)
        self.status[self.status == Status.RUNNING] = Status.SETTLED

    def smooth_again(self) -> None:
        """Slide along after vertices have travelled from crowded to empty regions."""
        travelled = [bool(steps) and steps[-1].stage == "relocate" for steps in self.steps]
        at = torch.tensor(travelled, device=self.status.device) & (self.quality.inverted == 0)
        self._smooth("smooth", at, self.options.smooth)

    def count_moved(self) -> None:
        """How many vertices are not where they were given."""
        elsewhere = (self.batch.points != self.given.points).any(1)
        self.moved = segment_count(elsewhere, self.given.point_offsets)

    def relocate(self) -> None:
        """Splits and collapses in pairs, so that every row stays, where shapes are poor or sizes were asked for."""
        # Where vertices may also come and go, that is the way to sizes.
        asked = RemeshOptions() if self.options.topology == "full" else self.options.remesh
        at = crowded(self.quality, asked, self.batch.triangle_offsets)
        if not (self.options.relocate or asked.sizes_asked):
            at = torch.zeros_like(at)
        if bool(at.any()):
            from ..remeshing.condensation import gather
            from ..remeshing.relocation import Relocation

            with self._stage("relocate", at) as done:
                work = Relocation(self.batch.select(at), self._sized(at))
                work.improve(torch.ones_like(at[at]))
                part, flips = gather(work.batch, work.options)
                if asked.sizes_asked:
                    self.relocated_sizes = work.size
                done(part, flips=work.flips + flips)

    def polish(self) -> None:
        """Better the worst triangles of the valid meshes, where there are any beyond what is asked."""
        options = self.options.polish
        if options is None:
            return
        at = segment_any(bad_triangles(self.batch, self.quality, options), self.batch.triangle_offsets)
        if bool(at.any()):
            with self._stage("polish", at) as done:
                part, info = polish(self.batch.select(at), options)
                done(part, flips=info.flips)

    def remesh(self) -> None:
        """Splits and collapses where they better the valid meshes."""
        at = self.quality.inverted == 0
        from ..remeshing.remeshing import Remeshing

        work = Remeshing(self.batch, self._sized(torch.ones_like(at)))
        stuck = ~at & (self.status == Status.STALLED)
        if bool(stuck.any()):
            from ..remeshing.vertex_removal import untangle_by_surgery

            with self._stage("surgery", stuck) as done:
                pockets = untangle_by_surgery(work, stuck)
                done(work.batch, pockets=pockets[stuck])
            at = self.quality.inverted == 0
            self.status[stuck & at] = Status.SETTLED
        if bool(at.any()):
            with self._stage("remesh", at) as done:
                work.improve(at)
                done(work.batch, flips=work.flips[at])
            if work.metric is not None:
                self.targets = MetricField(work.metric)
            if self.curves is not None:
                new_row = work.names.vertex_map().old_to_new
                self.curves = self.curves.renumbered(new_row, self.given.point_offsets, self.batch.point_offsets)
                self._smooth("smooth", at, self.options.smooth)
                self._flip("flip", at, FlipOptions(rule="shape"))
                self._smooth("smooth", at, self.options.smooth)
            if self.targets is None:
                self.polish()
            work.batch = self.batch
        self.remeshed = work.info()

    def _sized(self, at: Tensor) -> RemeshOptions:
        """What was asked of remeshing, with the sizes at the vertices of the meshes `at` (B,) bool."""
        options, reference = self.options.remesh, self.options.reference
        if self.targets is not None:
            options = replace(options, smooth=replace(options.smooth, targets=narrow(self.targets, self.batch, at)))
        if reference is not None and isinstance(options.sizes, str) and options.sizes == "keep":
            options = replace(options, sizes=size_field(reference, "keep"))
        if isinstance(options.sizes, Tensor):
            options = replace(options, sizes=options.sizes[spread(at, self.given.point_offsets)])
        return options

    def report(self) -> Report:
        """The certificate and the log."""
        valid = self.quality.inverted == 0
        messages = [self._message(b, Status(status)) for b, status in enumerate(self.status.tolist())]
        certified = valid & same_frame(
            self.given, self.batch, self.stays, None if self.remeshed is None else self.remeshed.vertex_map,
        )  # fmt: skip
        return Report(
            self.status, valid, certified, self.quality, self.steps, messages, self.moved, self.remeshed,
            self._conformity(),
        )  # fmt: skip

    def _conformity(self) -> SizeConformity | None:
        """How well edges follow the sizes wanted, where any were; NaN for meshes that are not valid."""
        sizes, valid = self.options.remesh.sizes, self.quality.inverted == 0
        if self.remeshed is not None:
            found = self.remeshed.conformity
            return SizeConformity(*(torch.where(valid, getattr(found, f.name), torch.nan) for f in fields(found)))
        if self.relocated_sizes is None:
            return None
        asked = sizes if callable(sizes) or (isinstance(sizes, str) and sizes == "uniform") else self.relocated_sizes
        found = size_conformity(self.batch.select(valid), asked)
        nothing = torch.full_like(self.quality.mean, torch.nan)
        return SizeConformity(*(nothing.masked_scatter(valid, getattr(found, f.name)) for f in fields(found)))

    def _message(self, b: int, status: Status) -> str:
        """Why mesh `b` ended."""
        text = self.messages.get(b, status.message)
        if status in (Status.STALLED, Status.ITERATION_LIMIT) and self.steps[b][-1].inverted:
            return left_over(self.obstacles.get(b) or text, self.steps[b], self.options.topology == "keep")
        return text

    def _flip(self, stage: str, at: Tensor, options: FlipOptions, near: Tensor | None = None) -> Tensor:
        """Flip in the meshes `at`, at the vertices `near` (V,) bool to begin with; returns the flips (B,)."""
        flips = torch.zeros_like(self.status)
        if bool(at.any()):
            with self._stage(stage, at) as done:
                part = self.batch.select(at)
                around = None if near is None else touching(part, near[spread(at, self.batch.point_offsets)])
                targets = narrow(self.targets, self.batch, at) if options.rule == "shape" else None
                metric = targets if isinstance(targets, MetricField) else None
                part, info = flip_to_delaunay(part, options, around=around, metric=metric)
                flips[at] = info.flips
                done(part, flips=info.flips)
        return flips

    def _untangle(self, stage: str, at: Tensor, options: UntangleOptions) -> Tensor:
        """Move the vertices of the meshes `at`; returns the iterations (B,)."""
        iterations = torch.zeros_like(self.status)
        if bool(at.any()):
            with self._stage(stage, at) as done:
                part = self.batch.select(at)
                part, info = untangle(part, options, monitor=self._monitor(stage, at))
                iterations[at] = info.iterations
                done(part, iterations=info.iterations)
        return iterations

    def _smooth(self, stage: str, at: Tensor, options: SmoothOptions, near: Tensor | None = None) -> None:
        """Smooth the meshes `at`; only the vertices `near` (V,) bool move."""
        if options.single:
            # In eighth powers, slivers leave the range of single precision.
            slivers = at & (self.quality.max > _COARSE)
            self._smooth(stage, slivers, replace(options, single=False), near)
            at = at & ~slivers
        if bool(at.any()):
            with self._stage(stage, at) as done:
                part = self.batch.select(at)
                free = None if near is None or self.curves is not None else near[spread(at, self.batch.point_offsets)]
                options = replace(options, targets=narrow(self.targets, self.batch, at))
                curves = None if self.curves is None else self.curves.select(at)
                part, info = smooth(part, options, free=free, monitor=self._monitor(stage, at), curves=curves)
                if self.curves is not None and info.curves is not None:
                    self.curves = self.curves.put(at, info.curves)
                done(part, iterations=info.iterations)

    def _try(
        self, stage: str, given: MeshBatch, way: Callable[[MeshBatch], tuple], among: Tensor | None = None
    ) -> None:
        """Take the tangled meshes `among` (B,) some `way` from `given`; keep what has fewer inverted triangles."""
        at = self.tangled if among is None else self.tangled & among
        if not bool(at.any()):
            return
        with self._stage(stage, at) as done:
            part, info = way(given.select(at))
            better = quality(part).inverted < self.quality.inverted[at]
            self.obstacles.update(zip(at.nonzero().squeeze(1).tolist(), getattr(info, "reasons", ()), strict=False))
            now = self.batch.select(at)
            part = put(now, better, part.select(better)) if bool(better.any()) else now
            iterations, pockets = (getattr(info, name, None) for name in ("iterations", "cavities"))
            done(part, iterations=iterations, pockets=pockets, kept=better)

    def _regularised(self, origin: MeshBatch, options: UntangleOptions, among: Tensor | None = None) -> None:
        reference = self.options.reference
        at = self.tangled if among is None else self.tangled & among
        known = None if reference is None else reference.select(at)
        self._try("regularised", origin, lambda part: untangle(part, options, reference=known), at)

    @contextmanager
    def _stage(self, stage: str, at: Tensor) -> Iterator[Callable[..., None]]:
        started = time.perf_counter()
        if self.progress is not None:
            self.progress(Progress(stage, int(at.sum()), int(self.quality.inverted[at].sum())))
        none = torch.zeros(int(at.sum()), dtype=torch.int64, device=at.device)

        def done(
            part: MeshBatch,
            flips: Tensor | None = None,
            iterations: Tensor | None = None,
            pockets: Tensor | None = None,
            kept: Tensor | None = None,
        ) -> None:
            before, self.batch = self.batch, put(self.batch, at, part)
            self.quality = quality(self.batch, known=(before, self.quality))
            seconds = time.perf_counter() - started
            every = torch.ones_like(none, dtype=torch.bool)
            counts = [none if c is None else c for c in (flips, iterations, pockets)]
            self._log(stage, at, seconds, *counts, every if kept is None else kept)

        yield done

    def _log(self, stage: str, at: Tensor, seconds: float, *columns: Tensor) -> None:
        """`columns`: flips, iterations, pockets and kept of the meshes `at`."""
        q = self.quality
        rows = zip(
            *(c.tolist() for c in (at.nonzero().squeeze(1), q.mean[at], q.max[at], q.inverted[at], *columns)),
            strict=True,
        )
        for b, mean, worst, inverted, flips, iterations, pockets, kept in rows:
            self.steps[b].append(Step(stage, mean, worst, inverted, flips, iterations, seconds, pockets, kept))
        if self.observe is not None:
            self.observe(stage, self.batch)

    def _monitor(self, stage: str, at: Tensor) -> Callable[[int, Tensor], None] | None:
        if self.progress is None:
            return None
        report, meshes, inverted = self.progress, int(at.sum()), int(self.quality.inverted[at].sum())

        def monitor(iteration: int, energy: Tensor) -> None:
            if iteration % 10 == 0:
                report(Progress(stage, meshes, inverted, iteration, float(energy.sum())))

        return monitor
