"""How `improve` works: its options."""

from dataclasses import dataclass, field
from typing import Any, Literal

from torch import Tensor

from ..mesh.batch import MeshBatch
from ..optimising.targets import check_topology
from ..remeshing.options import RemeshOptions
from ..smoothing.polishing import PolishOptions
from ..smoothing.smoothing import SmoothOptions
from ..untangling.options import UntangleOptions


@dataclass(frozen=True)
class Rounds:
    """How steps 1 and 2 of Kim 2017 alternate, and when they have come to a standstill.

    flip_rounds          rounds of flips between two goes of untangling: the first flips do most, and the later ones
                         have only tangles to guide them
    progress, patience   a mesh goes on while the number of its inverted triangles falls to this part at least once in
                         so many rounds
    patience_with_flips  the paper's own loop goes on for so many rounds in which that number does not fall
    quiet                the paper's own loop stops after so many rounds in a row without a flip in which L-BFGS stopped
                         at its least number of steps
    """

    flip_rounds: int = 2
    progress: float = 0.75
    patience: int = 2
    patience_with_flips: int = 10
    quiet: int = 4


@dataclass(frozen=True)
class Refining:
    """How flips and smoothing alternate on a valid mesh; ratios are inverse mean ratios.

    first_flip_rounds      rounds of flips before the first smoothing
    rest                   a vertex that moves less than this part of its edges in a round rests in the next one
    little_gain            a round that lowers the mean by less is the last of a mesh without poor triangles
    least_gain             and of any mesh, if the maximum falls by less than `least_gain_of_maximum` of itself, too
    sliver                 a triangle with a higher ratio is so flat that flips and q^2 would not see the others for it
    coarse                 meshes with a higher maximum are smoothed in double precision, whatever was asked
    """

    first_flip_rounds: int = 4
    rest: float = 0.02
    little_gain: float = 3e-3
    least_gain: float = 1e-4
    least_gain_of_maximum: float = 1e-3
    sliver: float = 1e4
    coarse: float = 100.0


@dataclass(frozen=True)
class LocalRepair:
    """Which meshes are worked on round their damage only; ratios are inverse mean ratios.

    large           meshes with no more triangles are worked on as a whole: a submesh would not save much
    poor            triangles with a higher ratio are damage, as inverted ones are
    excellent       the mean ratio outside the submesh is at most this: what flips and smoothing of the whole mesh could
                    better is left to them
    share           the submesh is at most this part of the mesh
    rings           rings of vertices round the damage that are taken along
    rings_by_width  and so many more times the root of the number of damaged triangles: a tangle of n triangles is about
                    0.7 sqrt(n) edges across, and needs that room again to come to good shapes
    """

    large: int = 20_000
    poor: float = 1.5
    excellent: float = 1.03
    share: float = 0.1
    rings: int = 8
    rings_by_width: float = 0.7


@dataclass(frozen=True)
class ImproveOptions:
    """How `improve` works.

    method            "default": the best way known; "paper": Kim 2017, figure 2, as printed
    topology          "keep": the triangles stay; "flip": vertices keep number and order, edges may change;
                      "full": vertices may be added and removed (`Report.vertex_map` tells which)
    remesh            sizes and limits of "full"; under "flip", vertices travel from crowded to empty regions by
                      them where shapes are poor or sizes other than "boundary" are asked for.  Sizes "keep"
                      are those of the `reference`, if there is one
    untangle          untangle-beta between the flips; "default" tries other ways where it fails
    smooth            the smoothing steps
    polish            which triangles are worked on at the end, worst first, with their neighbourhoods; None: none.
                      Not with topology "keep", targets, or method "paper"
    relocate          whether vertices travel far where shapes stay poor: "auto", in meshes that came tangled; True,
                      also in valid ones; False, nowhere.  Sizes that were asked for, targets, a reference, sliding and
                      topology "full" may take vertices far in any case.  Otherwise no vertex of a valid mesh goes
                      further than the mesh is wide there: the mean length of its edges at the vertex as given
    untangle_rounds   outer iterations of flipping and untangling at most
    smooth_rounds     rounds of flipping and smoothing at most once the mesh is valid
    rounds, refine    when these rounds end, and what they leave alone
    reference         the same meshes undeformed, with the same triangles, if the caller has them: tangled
                      interiors are first put where FEMWARP carries those of the reference, and the last
                      untangling has each triangle's undeformed shape and size as its target.  It is of
                      no use, and refused, once edges have flipped since
    boundary          "fixed": boundary and constrained edges stay; "slide": once the mesh is valid, their
                      vertices move along the given curves, corners excepted (`SmoothOptions.boundary`)
    excerpts          a mesh of more than 20,000 triangles that is tangled in a small part and excellent elsewhere is
                      worked on round the tangle only, if that does; the rest keeps its bits.  Not with sizes,
                      targets, reference, sliding or topology "full".  False: it is worked on as a whole
    local_repair      what is small, large and excellent in that sense
    workers           processes that share a large batch, on Linux, under topology "keep" or "flip"; None: as
                      many as torch has threads (`torch.set_num_threads`, OMP_NUM_THREADS); 1: this one only
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
    remesh: RemeshOptions = field(default_factory=RemeshOptions)
    polish: PolishOptions | None = field(default_factory=PolishOptions)
    relocate: Literal["auto"] | bool = "auto"
    reference: MeshBatch | None = None
    excerpts: bool = True
    local_repair: LocalRepair = field(default_factory=LocalRepair)
    workers: int | None = None

    def __post_init__(self) -> None:
        if self.method not in ("default", "paper"):
            raise ValueError(f"ImproveOptions.method must be 'default' or 'paper', not {self.method!r}")
        if self.topology not in ("keep", "flip", "full"):
            raise ValueError(f"ImproveOptions.topology must be 'keep', 'flip' or 'full', not {self.topology!r}")
        if self.topology == "full" and self.method == "paper":
            raise ValueError("ImproveOptions.topology='full' needs method 'default': the paper keeps every vertex")
        if self.boundary not in ("fixed", "slide"):
            raise ValueError(f"ImproveOptions.boundary must be 'fixed' or 'slide', not {self.boundary!r}")
        if self.slides and self.topology == "full" and self.remesh.split_boundary:
            raise ValueError(
                "ImproveOptions.boundary='slide' and remesh.split_boundary exclude each other: a boundary edge is "
                "halved on its chord, beside the curve along which its ends slide. Let the one be done first, "
                "then the other"
            )
        if self.relocate not in ("auto", True, False):
            raise ValueError(f"ImproveOptions.relocate must be 'auto', True or False, not {self.relocate!r}")
        check_topology(self.smooth.targets, self.topology)
        if self.workers is not None and self.workers < 1:
            raise ValueError(f"ImproveOptions.workers must be at least 1, not {self.workers}")
        for name in ("untangle_rounds", "smooth_rounds"):
            if getattr(self, name) < 1:
                raise ValueError(f"ImproveOptions.{name} must be at least 1, not {getattr(self, name)}")

    @property
    def slides(self) -> bool:
        """Do boundary and interface vertices slide along their curves?"""
        return "slide" in (self.boundary, self.smooth.boundary)

    @property
    def may_flip(self) -> bool:
        """May edges change?"""
        return self.topology != "keep"

    @property
    def stays_near(self) -> bool:
        """Does a vertex of a valid mesh stay within the width of the mesh there?"""
        asked = self.remesh.sizes_asked or self.smooth.targets is not None or self.reference is not None
        far = self.relocate is True or asked or self.slides or self.topology == "full"
        return not far and self.method == "default"

    @property
    def travels(self) -> bool:
        """May vertices travel from crowded to empty regions, where shapes ask for it?"""
        return self.may_flip and self.smooth.targets is None

    @property
    def polishes(self) -> bool:
        """Are the worst triangles worked on one by one, before vertices come and go?"""
        return self.travels and self.topology != "full"

    @property
    def separable(self) -> bool:
        """Do these options mean the same for each mesh of a batch, with no tensor over its vertices in them?"""
        shared = isinstance(self.remesh.sizes, Tensor) or self.smooth.targets is not None or self.reference is not None
        return self.topology != "full" and not shared

    @property
    def local(self) -> bool:
        """May a large mesh that is good but for a small tangle be worked on round the tangle only?"""
        usual = self.method == "default" and self.separable and not self.slides
        return self.excerpts and usual and self.remesh.sizes == "boundary"

    @classmethod
    def fast(cls, **changes: Any) -> "ImproveOptions":
        """Valid always and good on the whole, in two thirds of the time: the few worst triangles stay as they come.

        No vertices travel and nothing is polished; half the rounds of flips and smoothing.
        """
        settings: dict[str, Any] = {"polish": None, "relocate": False, "smooth_rounds": 4}
        return cls(**(settings | changes))

    @classmethod
    def paper(cls, beta: float | None = None, **changes: Any) -> "ImproveOptions":
        """Kim 2017 as printed: one flip pass, untangle-beta, repeat until valid, smooth once.

        The paper names no limit of its iterations: here step 2 takes 20 at most in the first round and
        three times as many in each further one, so that edges flip early.

        beta  0.01 in the mesh's own unit of area in the paper; None: 0.03 of the mean absolute area
        topology="keep" gives the paper's ablation, steps 2 and 3 only.
        """
        settings: dict[str, Any] = {
            "method": "paper",
            "untangle": UntangleOptions(method="beta", beta=0.03, absolute_beta=beta, max_iterations=1000),
            "untangle_rounds": 50,
            "smooth": SmoothOptions(),
        }
        return cls(**(settings | changes))
