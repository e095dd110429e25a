"""How `improve` works: its options."""

from dataclasses import dataclass, field
from typing import Any, Literal

from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.interfaces import Interfaces, check_interfaces
from ..mesh.typed import check_records
from ..optimising.targets import check_topology
from ..remeshing.options import RemeshOptions
from ..smoothing.polishing import PolishOptions
from ..smoothing.smoothing import SmoothOptions
from ..untangling.options import UntangleOptions
from .checks import check_whole, is_number
from .step_options import Bound, Damage, LeastGain, LocalRepair, Refining, Rounds


@dataclass(frozen=True)
class ImproveOptions:
    """How `improve` works.

    method            "default": the best way known; "paper": Kim 2017, figure 2, as printed
    topology          "keep": the triangles stay; "flip": the number and order of vertices stay, and edges may change;
                      "full": vertices may be added and removed (`Report.vertex_map` says which), and tangled or poor
                      meshes are made anew inside their boundary where nothing else was asked for.  Quads stay quads: no
                      flip removes their edges, and under "full" their vertices stay where "flip" has brought them
    remesh            the sizes and limits of topology "full".  Under "flip", vertices travel from crowded to empty
                      regions towards these sizes, if shapes are poor or if sizes other than "boundary" are asked for.
                      The sizes "keep" are those of the `reference`, if there is one
    untangle          untangle-beta between the flips; method "default" tries other ways where it fails
    smooth            the smoothing steps
    polish            which triangles are worked on at the end, worst first, with their neighbourhoods; None means none.
                      Polishing is not done with topology "keep", targets, or method "paper"
    relocate          whether vertices travel far where shapes stay poor, or in large tangles of large meshes
                      (`Rounds.anew`): "auto" in meshes that came tangled, True also in valid ones, False nowhere.
                      If sizes, targets, a reference or topology "full" are asked for, vertices may travel far in any
                      case.  Otherwise no vertex of a valid mesh goes further than the mesh is wide there: the mean
                      length of the edges at the vertex as given
    untangle_rounds   the greatest number of rounds of flipping and untangling
    smooth_rounds     the greatest number of rounds of flipping and smoothing of a valid mesh; without a meaning under
                      topology "keep" and method "paper"
    rounds, refine    when these rounds end, and what they leave alone
    shapes            which shapes triangles should have.  "auto": equilateral ones, with two exceptions.  Layers, rows
                      of elements along a wall or interface whose heights are a small part of the wall's edges, keep
                      their heights and numbers, and follow their walls if a reference is given; and a valid mesh that
                      is stretched throughout aims at its own shapes.  "equilateral": no exceptions; so too where
                      targets are given, and with method "paper"
    reference         the same meshes undeformed, with the same triangles, if the caller has them.  Tangled interiors
                      are then first warped from those of the reference by FEMWARP, and the last untangling aims at each
                      triangle's undeformed shape and size.  Quads aim at their shapes in it throughout, under
                      shapes="auto".  A reference is refused if edges have flipped since
    boundary          "fixed": boundary edges stay; "slide": once the mesh is valid, their vertices move along the
                      given curves, corners excepted (`SmoothOptions.boundary`)
    interfaces        what becomes of the vertices on constrained edges, the interfaces between regions: "fixed" and
                      "slide" as for the boundary; "free": the edges stay edges, and their vertices move like any
                      interior vertex, also where the interface itself came tangled.  The regions then change their
                      areas, and `Report.regions` says by how much.  None: as `boundary`
    scope             "all": every triangle may be improved; "damage": only triangles that are inverted, or much worse
                      than the shape that is meant at their place, and as much round them as mending takes.  All else
                      keeps its bits.  The shape meant is that of targets or of the reference, and else the local
                      median shape
    damage            what is damage, and how far scope "damage" reaches round it
    local_repair      under scope "all", a mesh of more than 20,000 triangles that is tangled in a small part and
                      excellent elsewhere is worked on only round the tangle, if that is enough; the rest keeps its
                      bits.  This is not done with sizes, targets, reference, sliding, topology "full", or quads, for
                      which scope "damage" does it.  The record says what small, large and excellent mean; None: it is
                      never done
    quads             quads that come out inverted: "keep": they stay quads, and the message names their rows; "split":
                      they become two triangles each, and the work begins anew (`Report.split_quads`)
    when              only meshes beyond this bound are worked on, and under scope "damage" only places beyond it; the
                      others come back to the bit, in about the time of measuring them.  None: every mesh is
    least_gain        a mesh that came valid, and would gain less than this, comes back as it was given.  Not asked
                      under topology "full", method "paper", or where sizes are asked for; None: every change counts
    max_motion        no vertex moves further than so many local widths, the mean lengths of its edges as given.  In a
                      mesh that came tangled this holds from when it is valid; a vertex that is further away by then
                      comes no further, and the message says so.  Not for topology "full" or method "paper"; None: no
                      limit but that of `relocate`
    workers           how many processes share a large batch, on Linux, under topology "keep" or "flip"; None means as
                      many as torch has threads (`torch.set_num_threads`, OMP_NUM_THREADS), and 1 means this one only
    """

    method: Literal["default", "paper"] = "default"
    topology: Literal["keep", "flip", "full"] = "flip"
    untangle: UntangleOptions = field(
        default_factory=lambda: UntangleOptions("beta", beta=0.6, local=True, reach=6, max_iterations=25, single=True)
    )
    smooth: SmoothOptions = field(
        default_factory=lambda: SmoothOptions(ceiling=1.5, max_iterations=300, energy_tolerance=1e-3, single=True)
    )
    untangle_rounds: int = 3
    smooth_rounds: int = 15
    rounds: Rounds = field(default_factory=Rounds)
    refine: Refining = field(default_factory=Refining)
    boundary: Literal["fixed", "slide"] = "fixed"
    interfaces: Interfaces | None = None
    remesh: RemeshOptions = field(default_factory=RemeshOptions)
    polish: PolishOptions | None = field(default_factory=PolishOptions)
    relocate: Literal["auto"] | bool = "auto"
    shapes: Literal["auto", "equilateral"] = "auto"
    reference: MeshBatch | None = None
    scope: Literal["all", "damage"] = "all"
    damage: Damage = field(default_factory=Damage)
    local_repair: LocalRepair | None = field(default_factory=LocalRepair)
    quads: Literal["keep", "split"] = "keep"
    when: Bound | None = None
    least_gain: LeastGain | None = field(default_factory=LeastGain)
    max_motion: float | None = None
    workers: int | None = None

    def __post_init__(self) -> None:
        check_records(self)
        if self.method not in ("default", "paper"):
            raise ValueError(f"ImproveOptions.method must be 'default' or 'paper', not {self.method!r}")
        if self.topology not in ("keep", "flip", "full"):
            raise ValueError(f"ImproveOptions.topology must be 'keep', 'flip' or 'full', not {self.topology!r}")
        if self.topology == "full" and self.method == "paper":
            raise ValueError("ImproveOptions.topology='full' needs method 'default': the paper keeps every vertex")
        if self.quads not in ("keep", "split"):
            raise ValueError(f"ImproveOptions.quads must be 'keep' or 'split', not {self.quads!r}")
        if self.boundary not in ("fixed", "slide"):
            raise ValueError(f"ImproveOptions.boundary must be 'fixed' or 'slide', not {self.boundary!r}")
        check_interfaces(self.interfaces, "ImproveOptions.interfaces")
        if self.slides and self.topology == "full" and self.remesh.split_boundary:
            raise ValueError(
                "ImproveOptions.boundary='slide' and remesh.split_boundary exclude each other: a boundary edge is "
                "halved on its chord, beside the curve along which its ends slide. Let the one be done first, "
                "then the other"
            )
        if self.scope not in ("all", "damage"):
            raise ValueError(f"ImproveOptions.scope must be 'all' or 'damage', not {self.scope!r}")
        if self.scope == "damage" and self.topology == "full" and self.remesh.split_boundary:
            raise ValueError(
                "ImproveOptions.scope='damage' and remesh.split_boundary exclude each other: the boundary of what is "
                "worked on stays as it is"
            )
        if self.relocate not in ("auto", True, False):
            raise ValueError(f"ImproveOptions.relocate must be 'auto', True or False, not {self.relocate!r}")
        if self.shapes not in ("auto", "equilateral"):
            raise ValueError(f"ImproveOptions.shapes must be 'auto' or 'equilateral', not {self.shapes!r}")
        check_topology(self.smooth.targets, self.topology)
        self._check_motion()
        if self.workers is not None:
            check_whole(self, workers=1)
        check_whole(self, untangle_rounds=1, smooth_rounds=1)

    def _check_motion(self) -> None:
        if self.max_motion is None:
            return
        if not (is_number(self.max_motion) and self.max_motion > 0):
            raise ValueError(f"ImproveOptions.max_motion must be positive, not {self.max_motion!r}")
        if self.topology == "full" or self.method == "paper":
            raise ValueError(
                "ImproveOptions.max_motion needs topology 'keep' or 'flip' and method 'default': elsewhere vertices "
                "come and go, or move as the paper has it"
            )

    @property
    def at_boundary(self) -> Literal["fixed", "slide"]:
        """What becomes of the vertices on the boundary."""
        return "slide" if "slide" in (self.boundary, self.smooth.boundary) else "fixed"

    @property
    def at_interfaces(self) -> Interfaces:
        """What becomes of the vertices on constrained edges."""
        return self.interfaces or self.smooth.interfaces or self.at_boundary

    @property
    def slides(self) -> bool:
        """Whether boundary or interface vertices slide along their curves."""
        return "slide" in (self.at_boundary, self.at_interfaces)

    @property
    def may_flip(self) -> bool:
        """Whether edges may change."""
        return self.topology != "keep"

    @property
    def stays_near(self) -> bool:
        """Whether a vertex of a valid mesh stays within the width of the mesh there."""
        asked = self.remesh.sizes_asked or self.smooth.targets is not None or self.reference is not None
        far = self.relocate is True or asked or self.topology == "full"
        return self.max_motion is not None or (not far and self.method == "default")

    @property
    def tether(self) -> float:
        """How many local widths the vertices of a mesh may move that stays near."""
        return 1.0 if self.max_motion is None else self.max_motion

    @property
    def keeps_shapes(self) -> bool:
        """Whether layers, and meshes that are stretched throughout, keep their shapes."""
        return self.shapes == "auto" and self.method == "default" and self.smooth.targets is None

    @property
    def travels(self) -> bool:
        """Whether vertices may travel from crowded to empty regions where shapes are poor."""
        return self.may_flip and self.smooth.targets is None

    @property
    def starts_anew(self) -> bool:
        """Whether the free vertices of large tangled meshes may get new positions before anything else."""
        asked = self.remesh.sizes_asked or self.reference is not None or self.max_motion is not None
        moved = self.slides or self.at_interfaces == "free" or self.scope == "damage"
        usual = self.method == "default" and self.topology == "flip" and self.travels and self.relocate is not False
        return self.rounds.anew is not None and usual and not (asked or moved)

    @property
    def polishes(self) -> bool:
        """Whether the worst triangles may be worked on one by one."""
        return self.travels and self.topology != "full"

    @property
    def rounds_positions(self) -> bool:
        """Whether valid meshes are worked on at rounded positions; what slides is bound to its curve."""
        return not self.slides and self.topology != "full"

    @property
    def weighs_gains(self) -> bool:
        """Whether a mesh that came valid must gain enough to be changed."""
        return self.least_gain is not None and self.topology != "full" and not self.remesh.sizes_asked

    @property
    def separable(self) -> bool:
        """Whether the options are the same for each mesh of a batch, without tensors over its vertices."""
        shaped = self.smooth.targets is not None or self.smooth.quad_targets is not None
        shared = isinstance(self.remesh.sizes, Tensor) or shaped or self.reference is not None
        return self.topology != "full" and not shared

    @property
    def local(self) -> bool:
        """Whether a large mesh that is good but for a small tangle may be worked on only round the tangle."""
        usual = self.method == "default" and self.separable and not self.slides
        return self.local_repair is not None and usual and self.remesh.sizes == "boundary"

    @classmethod
    def fast(cls, **changes: Any) -> "ImproveOptions":
        """Options with which meshes become valid as usual and good on the whole, in two thirds of the time.

        No vertices travel, nothing is polished, and there are fewer rounds of flips and smoothing, so the worst few
        triangles are worse.
        """
        settings: dict[str, Any] = {"polish": None, "relocate": False, "smooth_rounds": 4}
        return cls(**(settings | changes))

    @classmethod
    def paper(cls, beta: float | None = None, **changes: Any) -> "ImproveOptions":
        """Kim 2017 as printed: a pass of flips, untangle-beta, both again until the mesh is valid, then smoothing once.

        The paper gives no limit for the iterations of step 2.  Here it takes at most 20 in the first round and three
        times as many in each further round, so that edges flip early.  With topology="keep" these are the steps 2 and 3
        alone, an experiment of the paper.

        beta  in the mesh's own unit of area (0.01 in the paper); None means 0.03 times the mean absolute area
        """
        settings: dict[str, Any] = {
            "method": "paper",
            "untangle": UntangleOptions(method="beta", beta=0.03, absolute_beta=beta, max_iterations=1000),
            "untangle_rounds": 50,
            "smooth": SmoothOptions(),
        }
        return cls(**(settings | changes))
