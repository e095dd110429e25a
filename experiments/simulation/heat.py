"""Diffusion of heat round a body that moves, in scikit-fem: conservative, in coordinates that move with the mesh (ALE).

The test functions v move with the mesh, so that for all of them (Donea et al., Arbitrary Lagrangian-Eulerian methods,
Encyclopedia of Computational Mechanics, 2004)

    d/dt integral of u v  =  - integral of  kappa grad u . grad v  +  u w . grad v

where w is the velocity of the mesh.  Nothing goes through walls.  With v = 1 the heat stays what it was, whatever the
mesh does.  One step of implicit Euler takes the matrices in the middle of the way, where the areas that the edges
sweep are exact in the plane (the geometric conservation law).
"""

from __future__ import annotations

import numpy as np
import skfem as fem
import torch
from skfem.helpers import dot, grad

import torchmesh as tm

KAPPA = 0.02


@fem.BilinearForm
def mass(u, v, w):
    return u * v


@fem.BilinearForm
def transport(u, v, w):
    return KAPPA * dot(grad(u), grad(v)) + u * dot(w["velocity"], grad(v))


def elements(mesh: tm.MeshBatch) -> fem.MeshTri:
    """The mesh in scikit-fem."""
    return fem.MeshTri(np.ascontiguousarray(mesh.points.numpy().T), np.ascontiguousarray(mesh.triangles.numpy().T))


def step(before: tm.MeshBatch, after: tm.MeshBatch, u: torch.Tensor, time: float) -> torch.Tensor:
    """The values (V,) after the time in which the vertices go straight from `before` to `after`."""
    first, last = (fem.Basis(elements(mesh), fem.ElementTriP1()) for mesh in (before, after))
    middle = fem.Basis(elements(before.with_points((before.points + after.points) / 2)), fem.ElementTriP1())
    vectors = middle.with_element(fem.ElementVector(fem.ElementTriP1()))
    velocity = vectors.interpolate(((after.points - before.points) / time).numpy().reshape(-1))
    matrix = mass.assemble(last) + time * transport.assemble(middle, velocity=velocity)
    return torch.from_numpy(fem.solve(matrix, mass.assemble(first) @ u.numpy()))


def heat(mesh: tm.MeshBatch, u: torch.Tensor) -> float:
    """The integral of the values."""
    q = tm.quality(mesh).area
    return float((q * u[mesh.triangles].mean(1)).sum())
