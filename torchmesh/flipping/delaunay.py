"""Step 1: edge flips towards a Delaunay mesh, over a batch."""

from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.detached import without_autograd
from ..mesh.kept_edges import constrained_half_edges
from ..mesh.quads import quads_as_halves
from ..mesh.ragged import owner_of, spread
from ..mesh.unfit import unfit_meshes
from ..mesh.units import centre_and_unit_of_triangles
from ..optimising.metric_field import MetricField
from .metric_rule import MetricRule
from .rounds import flip_rounds
from .rules import RULES, RuleName


@dataclass(frozen=True)
class FlipOptions:
    """How `flip_to_delaunay` flips.

    rule        "safe": flips lower the sum of |area|, and between upright triangles they make the edge Delaunay.
                They never add inverted area or inverted triangles.
                "kim": the opposite angles sum to more than pi and both new triangles are upright
                (Kim 2017, Step 1).
                "shape": flips between upright triangles lower the sum of squared inverse mean ratios
    once        an edge that a flip made is not flipped again in this call (one pass of Kim 2017)
    max_rounds  number of rounds after which flipping stops.  Every rule ends by itself, so this limit is a
                safeguard; a round flips any number of edges
    """

    rule: RuleName = "safe"
    once: bool = False
    max_rounds: int = 10_000

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise ValueError(f"FlipOptions.rule must be one of {sorted(RULES)}, not {self.rule!r}")
        if self.max_rounds < 1:
            raise ValueError(f"FlipOptions.max_rounds must be at least 1, not {self.max_rounds}")

    @classmethod
    def paper(cls) -> "FlipOptions":
        """One pass of Kim 2017's Step 1."""
        return cls(rule="kim", once=True)


@dataclass(frozen=True, eq=False)
class FlipInfo:
    """What `flip_to_delaunay` did.

    flips  (B,) int64 number of edges flipped in each mesh
    """

    flips: Tensor


@without_autograd
@quads_as_halves
def flip_to_delaunay(
    batch: MeshBatch,
    options: FlipOptions | None = None,
    *,
    around: Tensor | None = None,
    metric: MetricField | None = None,
) -> tuple[MeshBatch, FlipInfo]:
    """Flip edges until every interior, unconstrained edge between upright triangles is Delaunay.

    Whether an edge is Delaunay is decided by exact in-circle signs.  Edges whose four points lie on one circle are
    not flipped.  Vertices, boundary edges, constrained edges and edges of quads stay, and so does the number of
    triangles.  A mesh with a position that is not finite, or beyond 1e150, comes back as it is.

    The result carries no gradient, whatever the points require; `nn`, `losses`, `metrics` and `femwarp` have one.

    around  (T,) bool: start from the edges of these triangles only
    metric  flip towards triangles that are equilateral in this metric; replaces the rule of the options
    """
    options = options or FlipOptions()
    constrained = constrained_half_edges(batch)
    unfit = unfit_meshes(batch)
    if bool(unfit.any()):
        constrained = constrained | spread(unfit, 3 * batch.triangle_offsets)
    # A power of two changes no sign and keeps every product of the rules in range.
    unit = centre_and_unit_of_triangles(batch.points, batch.triangles, batch.point_offsets)[1]
    triangles, twin, log = flip_rounds(
        batch.points.to(torch.float64) / spread(unit, batch.point_offsets)[:, None],
        batch.triangles,
        batch.twin,
        constrained,
        RULES[options.rule] if metric is None else MetricRule(metric.at_vertices(batch)),
        once=options.once,
        max_rounds=options.max_rounds,
        around=around,
    )
    owner = owner_of(log, batch.triangle_offsets)
    return batch.with_triangles(triangles, twin), FlipInfo(torch.bincount(owner, minlength=len(batch)))
