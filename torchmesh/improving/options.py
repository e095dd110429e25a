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
    relocate          whether vertices travel where shapes stay poor; where sizes are asked for, they do anyway
    untangle_rounds   outer iterations of flipping and untangling at most
    smooth_rounds     rounds of flipping and smoothing at most once the mesh is valid
    reference         the same meshes undeformed, with the same triangles, if the caller has them: tangled
                      interiors are first put where FEMWARP carries those of the reference, and the last
                      untangling has each triangle's undeformed shape and size as its target.  It is of
                      no use, and refused, once edges have flipped since
    boundary          "fixed": boundary and constrained edges stay; "slide": once the mesh is valid, their
                      vertices move along the given curves, corners excepted (`SmoothOptions.boundary`)
    excerpts          a mesh of more than 20,000 triangles that is tangled in a small part and excellent elsewhere is
                      worked on round the tangle only, if that does; the rest keeps its bits.  Not with sizes,
                      targets, reference, sliding or topology "full".  False: it is worked on as a whole
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
    boundary: Literal["fixed", "slide"] = "fixed"
    remesh: RemeshOptions = field(default_factory=RemeshOptions)
    polish: PolishOptions | None = field(default_factory=PolishOptions)
    relocate: bool = True
    reference: MeshBatch | None = None
    excerpts: bool = True
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
