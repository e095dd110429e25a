"""Incompressible flow in NGSolve, with velocities of the mesh (ALE): Taylor-Hood elements, implicit Euler, linearised.

In each step, with the velocity u0 and the positions before, and w the velocity of the mesh,

    (u - u0) / dt + ((u0 - w) . grad) u  =  div(2 nu eps(u)) - grad p + f,      div u = 0

is solved on the positions after (Donea et al., Arbitrary Lagrangian-Eulerian methods, Encyclopedia of Computational
Mechanics, 2004).  The force on the body is the residual of this equation, tested with functions that are 1 on the body:
the boundary integral of the stress, by integration by parts (John, Higher order finite element methods and multigrid
solvers in a benchmark problem for the 3D Navier-Stokes equations, International Journal for Numerical Methods in
Fluids 40, 2002).
"""

from __future__ import annotations

from dataclasses import dataclass

import netgen.meshing as netgen
import ngsolve as ng
import numpy as np
from netgen.csg import Pnt

import torchmesh as tm

VISCOSITY = 0.01

# The hierarchical basis function of an edge, at its middle.
_AT_THE_MIDDLE = -0.125


@dataclass
class Flow:
    """The spaces on a mesh and the velocity and pressure there.

    state  the values; velocities x and y, then the pressure
    """

    mesh: ng.Mesh
    space: ng.FESpace
    state: ng.GridFunction

    @classmethod
    def on(cls, mesh: tm.MeshBatch, body: np.ndarray, values: np.ndarray | None = None) -> Flow:
        """On a mesh whose boundary edges between two vertices of `body` (V,) bool are the body's.

        values  those of a flow on a mesh with the same triangles; None: zero
        """
        made = netgen.Mesh(dim=2)
        for x, y in mesh.points.tolist():
            made.Add(netgen.MeshPoint(Pnt(x, y, 0)))
        fluid = made.AddRegion("fluid", dim=2)
        for row in (mesh.triangles + 1).tolist():
            made.Add(netgen.Element2D(fluid, row))
        sides = {name: made.AddRegion(name, dim=1) for name in ("body", "stream", "outlet")}
        right = float(mesh.points[:, 0].max())
        half = (mesh.twin < 0).nonzero().squeeze(1)
        ends = np.stack([mesh.triangles.reshape(-1)[half], mesh.triangles.roll(-1, 1).reshape(-1)[half]], 1)
        x = mesh.points[:, 0].numpy()
        for a, b in ends.tolist():
            name = "body" if body[a] and body[b] else "outlet" if min(x[a], x[b]) > right - 1e-9 else "stream"
            made.Add(netgen.Element1D([a + 1, b + 1], index=sides[name]))
        there = ng.Mesh(made)
        velocity = ng.H1(there, order=2, dirichlet="body|stream")
        space = velocity * velocity * ng.H1(there, order=1)
        state = ng.GridFunction(space)
        state.vec.FV().NumPy()[:] = 0.0 if values is None else values
        return cls(there, space, state)

    @property
    def values(self) -> np.ndarray:
        """All values, for a flow on a mesh with the same triangles."""
        return np.array(self.state.vec.FV().NumPy())

    def seen_on(self, mesh: tm.MeshBatch, body: np.ndarray) -> Flow:
        """The flow on another mesh of the same domain: its velocity in the vertices and the middles of edges there."""
        flow = Flow.on(mesh, body)
        p = mesh.points.numpy()
        ends = np.array([[v.nr for v in edge.vertices] for edge in flow.mesh.edges])
        middle = p[ends].mean(1)
        for component in range(2):
            old, new = self.state.components[component], flow.state.components[component]
            # The middle of an edge of a curved wall may lie beside the mesh before: its ends then say enough.
            at = np.array([old(self.mesh(x, y)) for x, y in p])
            mean = at[ends].mean(1)
            inside = [self.mesh.Contains(x, y) for x, y in middle]
            mid = np.array(
                [old(self.mesh(x, y)) if i else m for (x, y), i, m in zip(middle, inside, mean, strict=True)]
            )
            new.vec.FV().NumPy()[: len(p)] = at
            new.vec.FV().NumPy()[len(p) :] = (mid - mean) / _AT_THE_MIDDLE
        flow.state.components[2].vec.FV().NumPy()[:] = [self.state.components[2](self.mesh(x, y)) for x, y in p]
        return flow

    def step(
        self,
        time: float,
        stream: tuple[float, float],
        body: tuple[float, float],
        mesh_velocity: np.ndarray,
        force: float = 0.0,
    ) -> tuple[float, float]:
        """Go on by a time; the values are those before, on the positions after.  Returns the force on the body.

        stream, body   the velocity far away and that of the body
        mesh_velocity  (V, 2) of the vertices
        force          upwards, on the fluid
        """
        (u, v, p), (a, b, q) = self.space.TnT()
        old = ng.CoefficientFunction(tuple(self.state.components[:2]))
        linear = ng.H1(self.mesh, order=1)
        moving = ng.GridFunction(linear * linear)
        for k in range(2):
            moving.components[k].vec.FV().NumPy()[:] = mesh_velocity[:, k]
        wind = old - ng.CoefficientFunction(moving.components)
        stress = 2 * ng.grad(u)[0] * ng.grad(a)[0] + 2 * ng.grad(v)[1] * ng.grad(b)[1]
        stress += (ng.grad(u)[1] + ng.grad(v)[0]) * (ng.grad(a)[1] + ng.grad(b)[0])
        form = ng.BilinearForm(self.space)
        form += (
            (u * a + v * b) / time
            + (wind * ng.grad(u)) * a
            + (wind * ng.grad(v)) * b
            + VISCOSITY * stress
            - p * (ng.grad(a)[0] + ng.grad(b)[1])
            - q * (ng.grad(u)[0] + ng.grad(v)[1])
        ) * ng.dx
        load = ng.LinearForm(self.space)
        load += (old[0] * a / time + (old[1] / time + force) * b) * ng.dx
        form.Assemble()
        load.Assemble()
        known = ng.GridFunction(self.space)
        for k in range(2):
            there = self.mesh.BoundaryCF({"body": body[k]}, default=stream[k])
            known.components[k].Set(there, definedon=self.mesh.Boundaries("body|stream"))
        free = self.space.FreeDofs()
        rest = load.vec.CreateVector()
        rest.data = load.vec - form.mat * known.vec
        known.vec.data += form.mat.Inverse(free, inverse="umfpack") * rest
        self.state.vec.data = known.vec
        rest.data = load.vec - form.mat * self.state.vec
        # The basis functions of the vertices add up to 1 on the body.
        on_body = sorted({v.nr for e in self.mesh.Elements(ng.BND) if e.mat == "body" for v in e.vertices})
        size, parts = self.space.components[0].ndof, rest.FV().NumPy()
        return float(parts[on_body].sum()), float(parts[[size + n for n in on_body]].sum())
