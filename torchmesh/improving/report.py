"""What `improve` says about its work: a row for each stage, a report on each batch, and progress on the way."""

import math
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from ..errors import ConvergenceError
from ..mesh.measure import Quality
from ..mesh.ragged import true_rows
from ..remeshing.sizing import SizeConformity
from ..status import Status

if TYPE_CHECKING:
    from ..mesh.regions import RegionAreas
    from ..mesh.vertex_map import VertexMap
    from ..remeshing.remeshing import RemeshInfo


@dataclass(frozen=True)
class Step:
    """One row of the paper's tables for one mesh: its state after a stage, and the work of the stage.

    stage       the name of the stage
    mean, max   of the inverse mean ratio over the triangles
    inverted    the number of inverted triangles
    flips       the edges flipped
    iterations  the steps of the minimiser
    seconds     the wall time of the stage, which all the meshes that took it share
    cavities    the cavities that were re-triangulated
    kept        false if the stage was an attempt that did not lower the number of inverted triangles, so that the mesh
                was put back
    """

    stage: str
    mean: float
    max: float
    inverted: int
    flips: int
    iterations: int
    seconds: float
    cavities: int = 0
    kept: bool = True


@dataclass(frozen=True, eq=False)
class Travel:
    """How far the vertices of each mesh are from where they were given, in local widths; (B,) float64.

    The local width at a vertex is the mean length of its edges in the mesh as given.  Only vertices that may move
    count; under topology "full" those that are still there.  0 for a mesh without such vertices.
    """

    median: Tensor
    p95: Tensor
    max: Tensor

    def record(self, b: int) -> dict[str, float]:
        """The figures of mesh `b` by name."""
        return {f.name: float(getattr(self, f.name)[b]) for f in fields(self)}


@dataclass(frozen=True, eq=False)
class Report:
    """What `improve` did, per mesh (B,).

    status     int64 `Status`
    valid      bool, every triangle, and every corner of a quad, is upright by its exact sign
    certified  bool, the mesh is valid, its boundary edges, constrained edges and Euler number are those given, and no
               fixed vertex has moved except those that slide
    quality    the `Quality` at the end
    steps      for each mesh its rows of the paper's tables, in order
    messages   for each mesh, why it ended
    notes      for each mesh what its message says besides: the layers that were found, what was put in order
    moved      int64, the number of given vertices that are still there but at another position
    travel     `Travel`: how far vertices are from where they were given, in local widths
    remeshed   under topology "full", what splits and collapses did, with the `VertexMap` from given to returned
               vertices; None under the other topologies
    sizes      how well edges follow the sizes wanted, NaN for meshes that are not valid; None if no sizes were asked
               for and the number of vertices stays.  Under "flip", sizes that were given by vertex have travelled with
               the vertices, and are scaled so that they fit the number of vertices
    rewired    bool, some triangle has other corners than in the mesh given; `tm.rewired(before, after)` says which
    split_quads  (Q,) bool, the quads given that became two triangles each (`ImproveOptions.quads`); these follow the
               triangles of their mesh.  None where there was no quad
    regions    the areas of the regions between interfaces, before and after; None unless interfaces moved freely
    lost       for each mesh, names for what its file held and the written one does not; it is filled when a file is
               written, and empty for meshes that come from no file
    """

    status: Tensor
    valid: Tensor
    certified: Tensor
    quality: Quality
    steps: list[list[Step]]
    messages: list[str]
    moved: Tensor
    remeshed: "RemeshInfo | None" = None
    sizes: SizeConformity | None = None
    lost: list[list[str]] = field(default_factory=list)
    travel: Travel | None = None
    regions: "RegionAreas | None" = None
    notes: list[str] = field(default_factory=list)
    rewired: Tensor | None = None
    split_quads: Tensor | None = None

    def __post_init__(self) -> None:
        self.lost.extend([] for _ in range(len(self.messages) - len(self.lost)))

    @property
    def vertex_map(self) -> "VertexMap | None":
        """Which returned vertices come from which given ones; None if they are the same."""
        return None if self.remeshed is None else self.remeshed.vertex_map

    @property
    def flipped(self) -> Tensor:
        """(B,) int64, the edges flipped in all stages together."""
        return self._total("flips")

    @property
    def flips(self) -> Tensor:
        """The same as `flipped`, by the name that it has in the report of `deform`."""
        return self.flipped

    @property
    def cavities(self) -> Tensor:
        """(B,) int64, the cavities that were re-triangulated in all stages together."""
        return self._total("cavities")

    @property
    def worked(self) -> list[str]:
        """For each mesh, the first stage that left no inverted triangle: "initial" if none was, "" if no stage did."""
        return [next((step.stage for step in steps if step.inverted == 0), "") for steps in self.steps]

    def _size_record(self, b: int) -> dict[str, Any]:
        """How well the edges of mesh `b` follow the sizes, for JSON."""
        assert self.sizes is not None
        rows = {"mean": self.sizes.mean, "p5": self.sizes.low, "p95": self.sizes.high}
        return {name: _plain(float(values[b])) for name, values in rows.items()}

    def _total(self, name: str) -> Tensor:
        """(B,) int64, the sum of a column over the steps of each mesh."""
        sums = [sum(getattr(step, name) for step in steps) for steps in self.steps]
        return torch.tensor(sums, dtype=torch.int64, device=self.status.device)

    def check(self) -> "Report":
        """Return the report if every mesh is valid; otherwise raise ConvergenceError, which names the meshes."""
        failed = true_rows(~self.valid).tolist()
        if failed:
            shown = "; ".join(
                f"mesh {b}: {int(self.quality.inverted[b])} inverted, {self.messages[b]}" for b in failed[:10]
            )
            more = f"; and {len(failed) - 10} more" if len(failed) > 10 else ""
            raise ConvergenceError(f"{len(failed)} of {len(self.valid)} meshes are not valid: {shown}{more}")
        return self

    def to_dict(self) -> list[dict[str, Any]]:
        """One record for each mesh, for JSON; None stands for numbers that are not finite."""
        worked, flipped, cavities = self.worked, self.flipped.tolist(), self.cavities.tolist()
        return [
            {
                "mesh": b,
                "status": Status(int(self.status[b])).name.lower(),
                "message": self.messages[b],
                "valid": bool(self.valid[b]),
                "certified": bool(self.certified[b]),
                "tried": list(dict.fromkeys(step.stage for step in self.steps[b][1:])),
                "worked": worked[b],
                "moved": int(self.moved[b]),
                **({} if self.travel is None else {"travel": self.travel.record(b)}),
                **({} if self.regions is None else {"regions": self.regions.record(b)}),
                "flipped": flipped[b],
                **({} if self.rewired is None else {"rewired": bool(self.rewired[b])}),
                "cavities": cavities[b],
                "lost": self.lost[b],
                **({} if self.sizes is None else {"edge_length_over_size": self._size_record(b)}),
                "steps": [{name: _plain(value) for name, value in vars(step).items()} for step in self.steps[b]],
            }
            for b in range(len(self.valid))
        ]


@dataclass(frozen=True)
class Progress:
    """How far `improve` has come.

    stage      the name of the stage
    meshes     the number of meshes that take it
    inverted   the number of their inverted triangles
    iteration  the iteration of the minimisation, within one
    energy     its total energy
    """

    stage: str
    meshes: int
    inverted: int
    iteration: int = 0
    energy: float | None = None


def triangles_left(count: int) -> str:
    """'1 inverted triangle is left', '3 inverted triangles are left'"""
    return f"{count} inverted triangle is left" if count == 1 else f"{count} inverted triangles are left"


def left_over(why: str, steps: list[Step], keep: bool) -> str:
    """The message of a mesh that ended tangled: why, what is left, what was tried, and if triangles stay, a hint."""
    tried = dict.fromkeys(step.stage for step in steps[1:])
    text = f"{why}; {triangles_left(steps[-1].inverted)} after {', '.join(tried)}"
    hint = ": these triangles may have no valid places"
    if "newton" in tried:
        hint += " (neither such places nor a proof that there are none were found)"
    return f"{text}{hint}; topology 'flip' may change their edges" if keep else text


def _plain(value: Any) -> Any:
    """`value`, or None for a number that is not finite, which JSON does not have."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
