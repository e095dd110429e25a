"""Hessians at the result of a forward pass: their factors serve its backward pass, and the next pass that starts there.

    forward 1  ->  result 1  ---- factors of the Hessian there ---->  backward 1, every forward pass from result 1
    forward 2  ->  result 2  ---- ...

The factors are preconditioners: they change how many steps the solution of a linear system takes, and the solution
itself by rounding only.  They depend on the result alone, so that it does not matter whether they were remembered or
are made anew.
"""

import functools
from dataclasses import dataclass

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.means import vertex_size
from ..mesh.ragged import spread
from ..optimising.blocks import BLOCK
from ..optimising.energies import Energy
from ..optimising.jacobian import Target, equilateral
from ..optimising.newton import BlockFactors, NewtonProblem, Orders
from ..optimising.objective import Packing, pack


@dataclass(frozen=True, eq=False)
class Posed:
    """What is minimised over the meshes of a batch.

    energy        of a triangle
    coefficients  (4, T) of its target, without a gradient; None: equilateral
    """

    energy: Energy
    coefficients: Tensor | None

    def over(self, mesh: MeshBatch, packing: Packing, moves: bool = True) -> NewtonProblem:
        """The energy over the packed meshes; without `moves` nobody asks for the size of a move."""
        target = equilateral()
        if self.coefficients is not None:
            unit = spread(packing.unit, packing.triangle_offsets)
            target = Target(*(self.coefficients[:, packing.triangles] * unit * unit))
        size = packing.unknowns
        if moves:
            size = packing.spread_vertices(vertex_size(mesh) / spread(packing.unit, mesh.point_offsets))
            size = torch.where(size > 0, size, 1.0)
        return NewtonProblem(packing, self.energy, target, size, packing.block_offsets * BLOCK)

    def same_as(self, other: "Posed") -> bool:
        """Whether the energy of each triangle is the same."""
        one, two = self.coefficients, other.coefficients
        if one is None or two is None:
            return self.energy == other.energy and one is two
        return self.energy == other.energy and one.shape == two.shape and torch.equal(one, two)


@dataclass(frozen=True, eq=False)
class Nearby:
    """The Hessians of the meshes `which` (B,) bool of a batch where it is now.

    orders  in which vertices are eliminated, perhaps of other meshes of the batch; None where torch does the work
    """

    mesh: MeshBatch
    which: Tensor
    posed: Posed
    orders: Orders | None

    @functools.cached_property
    def factors(self) -> BlockFactors | None:
        """Of the Hessians; None where torch does the work."""
        if self.orders is None:
            return None
        packing = packed(self.mesh, self.which)
        problem = self.posed.over(self.mesh, packing, moves=False)
        return problem.factors(packing.unknowns, self.which, problem.orders(self.orders))

    def is_at(self, mesh: MeshBatch, which: Tensor, posed: Posed) -> bool:
        """Whether the Hessians of the meshes `which` of `mesh` are these."""
        own = self.mesh
        return (
            own.points.dtype == mesh.points.dtype
            and all(_equal(getattr(own, name), getattr(mesh, name)) for name in ("points", "triangles", "fixed"))
            and _equal(own.point_offsets, mesh.point_offsets)
            and _equal(self.which, which)
            and self.posed.same_as(posed)
        )


def _equal(one: Tensor, two: Tensor) -> bool:
    return one is two or (one.shape == two.shape and one.device == two.device and torch.equal(one, two))


def packed(mesh: MeshBatch, which: Tensor, points: Tensor | None = None) -> Packing:
    """The free vertices of the meshes `which` (B,) as unknowns, at `points` (V, 2) or where they are."""
    free = ~mesh.fixed & spread(which, mesh.point_offsets)
    points = mesh.points if points is None else points
    return pack(points, mesh.triangles, free, mesh.point_offsets, mesh.triangle_offsets)
