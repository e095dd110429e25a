"""Step 3: move the free vertices of a valid mesh so that the inverse mean ratio becomes least."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.detached import without_autograd
from ..mesh.interfaces import Interfaces, check_interfaces, holding, released
from ..mesh.means import vertex_size
from ..mesh.measure import upright
from ..mesh.quads import halved, sampled
from ..mesh.ragged import segment_any, spread
from ..mesh.unfit import unfit_meshes
from ..optimising.blocks import BLOCK
from ..optimising.energies import Energy, InverseMeanRatio
from ..optimising.jacobian import select_rows
from ..optimising.lbfgs import minimise
from ..optimising.lbfgs_options import LbfgsOptions, LbfgsResult
from ..optimising.moves import Monitor, MoveInfo
from ..optimising.objective import MeshObjective, Packing, pack
from ..optimising.targets import TargetFunction, Targets, aim, as_targets, check, ideal, vertex_height
from ..status import Status

if TYPE_CHECKING:
    from ..mesh.curves import BoundaryCurves


# An energy beyond this belongs to a sliver that the minimiser cannot move.
_LARGEST = 1e100

# Where L-BFGS stalls in its first steps with a steeper root mean square slope, in units of one triangle's ideal energy
# by a mean edge length, it begins anew; so often at most.
_STEEP = 1e-2
_BEGINNINGS = 4


@dataclass(frozen=True)
class SmoothOptions:
    """How `smooth` minimises the sum of q^p, q the inverse mean ratio (Kim 2017, equation 4).

    power             p; the paper takes 2, a higher power gives the worst triangle more weight
    ceiling           a q that triangles should stay below: (q / ceiling)^8 is added; None: no such term
    max_iterations    number of L-BFGS steps after which smoothing stops
    energy_tolerance  a mesh is done when five steps together lower its energy by less than this part
    gradient_tolerance  or when the root mean square of its scaled gradient is below this
    first_step        root mean square length of the first step, in mean edge lengths of each vertex
    largest_step      no vertex moves further in one step, in mean edge lengths of each vertex; half an edge keeps most
                      steps from inverting a triangle
    boundary          "fixed": boundary edges stay; "slide": their vertices move along the curves they are on, which
                      keep their shape and the areas on both sides
    interfaces        what becomes of the vertices on constrained edges: "fixed" and "slide" as for the boundary, where
                      "slide" holds vertices of `fixed`; "free": they move like any interior vertex; None: as `boundary`
    targets           what triangles should look like: None: equilateral; a (T, 2, 2) tensor of target matrices,
                      one per triangle of the batch (`target_from`); a `MetricField` (`metric_from`,
                      `MetricField.stretched`); or a function from positions (N, 2) to target matrices (N, 2, 2),
                      which is converted to a field (`MetricField.from_targets`)
    quad_targets      (4Q, 2, 2) what the corners of quads should look like, four a quad in their order, with the edges
                      to the next corner and to the one before as columns (`quad_targets_from`); None: the corner of a
                      square.  No effect beside `targets`
    corner_angle      degrees; where a boundary curve turns by more, the vertex is a corner and stays
    single            compute displacements in single precision, which is faster and good for rough work on
                      triangles that are not slivers; has no effect with sliding or targets
    """

    power: int = 2
    ceiling: float | None = None
    max_iterations: int = 300
    energy_tolerance: float = 1e-5
    gradient_tolerance: float = 1e-6
    first_step: float = 0.05
    largest_step: float = 0.5
    boundary: Literal["fixed", "slide"] = "fixed"
    interfaces: Interfaces | None = None
    corner_angle: float = 40.0
    targets: Targets | TargetFunction | None = field(default=None, compare=False)
    single: bool = False
    quad_targets: Tensor | None = field(default=None, compare=False)

    @property
    def energy(self) -> Energy:
        """The energy of a triangle that is minimised."""
        return InverseMeanRatio(self.power, self.ceiling)

    def __post_init__(self) -> None:
        if self.power < 1:
            raise ValueError(f"SmoothOptions.power must be at least 1, not {self.power}")
        if self.ceiling is not None and not self.ceiling > 1:
            raise ValueError(f"SmoothOptions.ceiling must be above 1, the ideal, not {self.ceiling}")
        if self.max_iterations < 0:
            raise ValueError(f"SmoothOptions.max_iterations must not be negative, but is {self.max_iterations}")
        if self.boundary not in ("fixed", "slide"):
            raise ValueError(f"SmoothOptions.boundary must be 'fixed' or 'slide', not {self.boundary!r}")
        check_interfaces(self.interfaces, "SmoothOptions.interfaces")
        if not 0 <= self.corner_angle <= 180:
            raise ValueError(f"SmoothOptions.corner_angle must lie between 0 and 180 degrees, not {self.corner_angle}")
        object.__setattr__(self, "targets", as_targets(self.targets))
        if self.targets is not None:
            check(self.targets)
        for name in ("energy_tolerance", "gradient_tolerance"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"SmoothOptions.{name} must not be negative, but is {getattr(self, name)}")
        for name in ("first_step", "largest_step"):
            if not getattr(self, name) > 0:
                raise ValueError(f"SmoothOptions.{name} must be positive, not {getattr(self, name)}")

    @property
    def at_interfaces(self) -> Interfaces:
        """What becomes of the vertices on constrained edges."""
        return self.interfaces or self.boundary

    @property
    def slides(self) -> bool:
        """Do vertices slide along curves?"""
        return "slide" in (self.boundary, self.at_interfaces)


@without_autograd
def smooth(
    batch: MeshBatch,
    options: SmoothOptions | None = None,
    *,
    free: Tensor | None = None,
    monitor: Monitor | None = None,
    curves: "BoundaryCurves | None" = None,
    block: int = BLOCK,
) -> tuple[MeshBatch, MoveInfo]:
    """Improve the shapes of a valid batch by moving its free vertices; triangles and quads stay as they are.

    The corners of quads count as triangles do, and aim at the corner of a square.

    No triangle or quad is ever inverted.  A mesh that has inverted triangles comes back unmoved, with
    `Status.INVERTED`, one with a position that is not finite, or beyond 1e150, with `Status.NOT_FINITE`, and one for
    which no curves to slide along can be made with `Status.FAILED`.

    The result carries no gradient, whatever the points require; `nn`, `losses`, `metrics` and `femwarp` have one.

    free     (V,) bool: of the vertices that may move, move only these; None: all
    monitor  called with the iteration and the energies of the meshes still running
    curves   the curves to slide along, as an earlier call returned them (`info.curves`); None: those of
             the mesh as it is, if the options say "slide"
    block    coordinates of a mesh are padded to a multiple of this.  A small number is faster for meshes of few free
             vertices; has no effect with curves
    """
    options = options or SmoothOptions()
    given, batch = batch, halved(batch)
    unfit = unfit_meshes(batch)
    refused = segment_any(~upright(batch), batch.triangle_offsets) | unfit
    failed = torch.zeros_like(refused)
    if curves is None and options.slides:
        from .sliding import curves_or_errors

        curves, errors = curves_or_errors(
            batch, options.corner_angle, boundary=options.boundary, interfaces=options.at_interfaces
        )
        failed[list(errors)] = True
        refused |= failed
    batch = holding(batch, options.at_interfaces)
    stays = batch.fixed if curves is None else batch.fixed & ~curves.may_slide(batch.point_offsets)
    may_move = ~stays & ~spread(refused, batch.point_offsets)
    if free is not None:
        may_move &= free
    # Curves need the connectivity of halves; for all else quads are their corners from here on.
    connected, batch = batch, sampled(batch)
    single = options.single and curves is None and options.targets is None and options.quad_targets is None
    if curves is None:
        moved, result = _moved(batch, may_move, options, single, block, monitor)
        if options.max_iterations:
            moved, result = _begun_again(moved, result, may_move, options, single, block)
    else:
        from .sliding import Slide

        packing = _packed(batch, may_move, single, block)
        slide = Slide(connected, curves, packing)
        result = minimise(*slide.start(_objective(batch, packing, options)), _lbfgs(options), monitor)
        points, curves = slide.finish(result.unknowns)
        moved = batch.with_points(points)
    # Rounding to the caller's precision could flatten a sliver: such a mesh goes back where it was.
    worse = segment_any(~upright(moved), batch.triangle_offsets) & ~refused
    status = torch.where(refused, Status.INVERTED, torch.where(worse, Status.STALLED, result.status))
    status = torch.where(failed, int(Status.FAILED), status)
    status = torch.where(unfit, int(Status.NOT_FINITE), status)
    if bool(worse.any()):
        back = spread(worse, batch.point_offsets)[:, None]
        moved = batch.with_points(torch.where(back, batch.points, moved.points))
        if curves is not None:
            curves = curves.put(worse, slide.curves.select(worse))
    moved = released(moved if moved.triangles is given.triangles else given.with_points(moved.points), given)
    return moved, MoveInfo(result.energy, result.gradient, result.iterations, result.evaluations, status, curves)


def _packed(batch: MeshBatch, free: Tensor, single: bool, block: int) -> Packing:
    """The `free` (V,) part of the batch as the minimiser takes it."""
    return pack(batch.points, batch.triangles, free, batch.point_offsets, batch.triangle_offsets, single, block)


def _moved(
    batch: MeshBatch, free: Tensor, options: SmoothOptions, single: bool, block: int, monitor: Monitor | None = None
) -> tuple[MeshBatch, LbfgsResult]:
    """The batch with its `free` (V,) vertices moved to the minimum, and what the minimiser says of it."""
    packing = _packed(batch, free, single, block)
    result = minimise(_objective(batch, packing, options), packing.unknowns, _lbfgs(options), monitor)
    return batch.with_points(packing.unpack(result.unknowns, batch.points)), result


def _begun_again(
    batch: MeshBatch, result: LbfgsResult, free: Tensor, options: SmoothOptions, single: bool, block: int
) -> tuple[MeshBatch, LbfgsResult]:
    """The batch after meshes that slivers have stopped at once were smoothed again; `result` is of the first time.

    Where an energy is too large to compute with, slivers are raised first.  Where a sliver has opened in the first
    steps, L-BFGS still has its very large curvature in the history, and the next steps are too short to matter:
    then the minimiser begins anew, without a history, from where it came to.
    """
    last = result
    for turn in range(_BEGINNINGS):
        overflows = (last.iterations == 0) & ~(last.energy < _LARGEST) & (turn == 0)
        stopped = (last.status == Status.STALLED) & (last.gradient > _STEEP) & (not single)
        stopped &= (last.iterations > 0) & (last.iterations < LbfgsOptions().patience)
        again = overflows | stopped
        if not bool(again.any()):
            break
        from .raising import raised

        free = free & spread(again, batch.point_offsets)
        start = raised(batch, free, overflows) if bool(overflows.any()) else batch
        moved, last = _moved(start, free, options, single, block)
        better = again & (last.energy < _LARGEST)
        batch = batch.with_points(torch.where(spread(better, batch.point_offsets)[:, None], moved.points, batch.points))
        result = _later(result, last, better)
    return batch, result


def _later(result: LbfgsResult, last: LbfgsResult, better: Tensor) -> LbfgsResult:
    """The result of meshes that were smoothed again, where that was `better` (B,) bool; what it took is added up."""
    names = ("energy", "gradient", "status", "iterations", "evaluations")
    new = {name: getattr(last, name) for name in names}
    for name in names[3:]:
        new[name] = new[name] + getattr(result, name)
    return replace(result, **{name: torch.where(better, v, getattr(result, name)) for name, v in new.items()})


def _objective(batch: MeshBatch, packing: Packing, options: SmoothOptions) -> MeshObjective:
    """The energy of the options over the packed batch, with its targets if it has any."""
    shaped = options.quad_targets if options.targets is None and len(batch.quads) else None
    length = vertex_size(batch) if shaped is None else vertex_height(batch)
    objective = MeshObjective(
        options.energy,
        select_rows(ideal(batch, quads=shaped), packing.triangles),
        packing.rows,
        packing.anchored,
        packing.block_offsets,
        packing.triangle_offsets,
        packing.spread_vertices(length / spread(packing.unit, batch.point_offsets)),
        edges=packing.edges,
    )
    targets = as_targets(options.targets)
    return objective if targets is None else aim(objective, batch, packing, targets)


def _lbfgs(options: SmoothOptions) -> LbfgsOptions:
    """What L-BFGS takes of the options of smoothing."""
    return LbfgsOptions(
        max_iterations=options.max_iterations,
        gradient_tolerance=options.gradient_tolerance,
        energy_tolerance=options.energy_tolerance,
        first_step=options.first_step,
        largest_step=options.largest_step,
    )
