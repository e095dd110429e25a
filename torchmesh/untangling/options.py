"""How `untangle` works: its options."""

from dataclasses import dataclass, replace
from typing import Literal


@dataclass(frozen=True)
class UntangleOptions:
    """How `untangle` works.

    method             "regularised": the foldover-free functional with a local size for each triangle's
                       target (Garanzha et al. 2021); "beta": Knupp's untangle-beta (Kim 2017, equation 2)
    beta               beta of "beta": the area below which a triangle is pushed, as a part of the
                       mesh's mean absolute area
    local              beta is a part of no more than twice the usual area nearby, for graded meshes
    absolute_beta      beta in the mesh's own unit of area instead, as printed in Kim 2017 (0.01 there)
    single             compute displacements of "beta" in single precision, which is faster
    reach              rings of vertices round the triangles that "beta" pushes which move; None: all move
    size_sweeps        how often the target sizes of "regularised" are averaged over neighbours: each in
                       turn until a mesh is valid, from where it was given
    max_iterations     L-BFGS steps tried at most, for "regularised" per value of epsilon
    max_continuations  values of epsilon tried at most; a mesh that no longer gets better ends before
    """

    method: Literal["regularised", "beta"] = "regularised"
    beta: float = 0.01
    local: bool = False
    absolute_beta: float | None = None
    reach: int | None = None
    single: bool = False
    size_sweeps: tuple[int, ...] = (100, 20, 1000)
    max_iterations: int = 500
    max_continuations: int = 200

    def __post_init__(self) -> None:
        if self.method not in ("regularised", "beta"):
            raise ValueError(f"UntangleOptions.method must be 'regularised' or 'beta', not {self.method!r}")
        for name in ("max_iterations", "max_continuations"):
            if getattr(self, name) < 1:
                raise ValueError(f"UntangleOptions.{name} must be at least 1, not {getattr(self, name)}")
        if not self.size_sweeps or min(self.size_sweeps) < 0:
            raise ValueError(f"UntangleOptions.size_sweeps must be numbers, none negative, not {self.size_sweeps!r}")
        if self.reach is not None and self.reach < 1:
            raise ValueError(f"UntangleOptions.reach must be at least 1, not {self.reach}")
        if self.local and self.absolute_beta is not None:
            raise ValueError("UntangleOptions.local and absolute_beta exclude each other")
        for name in ("beta", "absolute_beta"):
            value = getattr(self, name)
            if value is not None and not value >= 0:
                raise ValueError(f"UntangleOptions.{name} must not be negative, but is {value}")

    def up_to(self, iterations: int) -> "UntangleOptions":
        """The same with a smaller limit of iterations, if this one is smaller."""
        return replace(self, max_iterations=min(self.max_iterations, iterations))
