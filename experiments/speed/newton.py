"""Truncated Newton against L-BFGS: iterations, passes over the triangles and seconds to the same energy.

    python -m experiments.speed.newton

Smoothing is the sum of q^2 on a valid, rough mesh.  Untangling is the regularised functional with epsilon 1 and 0.1 on
the tangled mesh.  Newton's Hessians are those of the triangles, each made positive semidefinite: eigenvalues are cut
off at zero (Teran, Sifakis, Irving & Fedkiw, Robust quasistatic finite elements and flesh simulation, 2005).
`optimising.conjugate_gradients.solve` solves its systems with the diagonal as preconditioner, and no more exactly than
the gradient asks for (Eisenstat & Walker, Choosing the forcing terms in an inexact Newton method, 1996).  Steps are
halved until the energy falls.  L-BFGS is `optimising.lbfgs.minimise` as `smooth` and `untangle` call it.  A pass is an
energy with its gradient, or a product with the Hessian.  The lowest energy is that of a long run.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch

import torchmesh as tm
from experiments.shared import arguments, tables
from experiments.shared.tangles import tangle
from torchmesh.mesh.means import vertex_size
from torchmesh.mesh.ragged import spread
from torchmesh.optimising.conjugate_gradients import solve
from torchmesh.optimising.energies import InverseMeanRatio, Regularised
from torchmesh.optimising.hessian import Hessian
from torchmesh.optimising.jacobian import equilateral, select_rows
from torchmesh.optimising.lbfgs import minimise
from torchmesh.optimising.lbfgs_options import LbfgsOptions
from torchmesh.optimising.objective import MeshObjective, pack
from torchmesh.untangling.local_size import local_size

Tensor = torch.Tensor
# (seconds, iterations, passes, energy) after each iteration.
Trace = list[tuple[float, int, int, float]]


class ElementHessian:
    """The Hessian with the part of each triangle made positive semidefinite, as an operator for `solve`."""

    def __init__(self, hessian: Hessian) -> None:
        h = self.of = hessian
        self.size = h.size
        e1x, e1y, e2x, e2y = h.edges.view(4, -1).unbind(0)
        g11, g12, g22, m = (torch.as_tensor(v).to(e1x).expand_as(e1x) for v in h.target)
        stretch = 2 * torch.stack(
            [g11 * e1x + g12 * e2x, g11 * e1y + g12 * e2y, g12 * e1x + g22 * e2x, g12 * e1y + g22 * e2y], 1
        )
        det = m[:, None] * torch.stack([e2y, -e2x, -e1y, e1x], 1)
        ss, sd, dd = (c[:, None, None] for c in h.curvatures)
        cross = stretch[:, :, None] * det[:, None, :]
        blocks = ss * stretch[:, :, None] * stretch[:, None, :] + sd * (cross + cross.mT)
        blocks += dd * det[:, :, None] * det[:, None, :]
        by_s, by_d = 2 * h.slopes[0], m * h.slopes[1]
        for i in (0, 1):
            blocks[:, i, i] += by_s * g11
            blocks[:, i + 2, i + 2] += by_s * g22
            blocks[:, i, i + 2] += by_s * g12
            blocks[:, i + 2, i] += by_s * g12
        for i, j, sign in ((0, 3, 1), (3, 0, 1), (1, 2, -1), (2, 1, -1)):
            blocks[:, i, j] += sign * by_d
        values, vectors = torch.linalg.eigh(blocks)
        self.blocks = (vectors * values.clamp_min(0)[:, None, :]) @ vectors.mT

    def __matmul__(self, u: Tensor) -> Tensor:
        ax, ay, bx, by, cx, cy = u[self.of.rows]
        edges = torch.stack([bx - ax, by - ay, cx - ax, cy - ay], 1)
        f = torch.bmm(self.blocks, edges[:, :, None]).squeeze(2).unbind(1)
        return self._scattered(-f[0] - f[2], -f[1] - f[3], *f)

    def diagonal(self) -> Tensor:
        """(N,) its diagonal."""
        b = self.blocks
        x, y = (b[:, i, i] + b[:, i + 2, i + 2] + 2 * b[:, i, i + 2] for i in (0, 1))
        return self._scattered(x, y, *(b[:, i, i] for i in range(4)))

    def _scattered(self, *values: Tensor) -> Tensor:
        out = values[0].new_zeros(self.size)
        for row, value in zip(self.of.rows, values, strict=True):
            out.index_add_(0, row, value)
        return out


def newton(objective: MeshObjective, start: Tensor, iterations: int) -> Trace:
    """Truncated Newton; it ends after `iterations`, where no step helps, or where a step gains next to nothing."""
    started, passes, x = time.process_time(), 1, start
    energy, gradient, _ = objective(x)
    first = gradient.norm()
    offsets = objective.block_offsets * 128
    trace = [(0.0, 0, passes, float(energy))]
    for iteration in range(1, iterations + 1):
        at = Hessian.at(torch.cat([x, objective.anchored]), objective.rows, objective.energy, objective.target)
        tolerance = float((gradient.norm() / first).sqrt().clamp(1e-3, 0.5))
        found = solve(ElementHessian(at), -gradient, offsets, tolerance=tolerance, max_iterations=200)
        passes += 1 + int(found.iterations)
        step, slope = 1.0, float(gradient @ found.x)
        while step > 1e-10:
            after, change, _ = objective(x + step * found.x)
            passes += 1
            upright = isinstance(objective.energy, Regularised) or bool((objective.det(x + step * found.x) > 0).all())
            if upright and float(after) <= float(energy) + 1e-4 * step * slope:
                break
            step /= 2
        else:
            break
        x, energy, gradient = x + step * found.x, after, change
        trace.append((time.process_time() - started, iteration, passes, float(energy)))
        if -slope < 1e-12 * abs(float(energy)):
            break
    return trace


def lbfgs(objective: MeshObjective, start: Tensor, iterations: int, first_step: float, largest: float) -> Trace:
    """L-BFGS; it ends after `iterations` or where a step gains next to nothing."""
    started, trace = time.process_time(), []

    def monitor(iteration: int, energy: Tensor) -> None:
        trace.append((time.process_time() - started, iteration, iteration + 1, float(energy.sum())))

    minimise(
        objective, start, LbfgsOptions(iterations, 0.0, 1e-13, first_step=first_step, largest_step=largest), monitor
    )
    return trace


def problems(triangles: int, cache: Path) -> dict[str, tuple[MeshObjective, Tensor, float, float]]:
    """Objectives, where they start, and the first and largest step of L-BFGS."""
    tangled = tangle("moved", 6, triangles, 0.3, 0, cache).tangled
    rough = tm.improve(tangled, tm.ImproveOptions(smooth_rounds=1, smooth=tm.SmoothOptions(max_iterations=0)))[0]
    smoothing, start = packed(rough, vertex_size(rough), alike=True)
    made = {f"smooth, {triangles:,} triangles": (smoothing, start, 0.05, 0.5)}
    untangling, start = packed(tangled, local_size(tangled), alike=False)
    for eps in (1.0, 0.1):
        objective = replace(untangling, energy=Regularised(eps))
        made[f"untangle, {triangles:,} triangles, epsilon {eps:g}"] = (objective, start, 0.1, 2.0)
    return made


def packed(mesh: tm.MeshBatch, length: Tensor, alike: bool) -> tuple[MeshObjective, Tensor]:
    """The objective of a mesh and its unknowns; targets are `alike`, or each of the size of its triangle."""
    packing = pack(mesh.points, mesh.triangles, ~mesh.fixed, mesh.point_offsets, mesh.triangle_offsets)
    size = length / spread(packing.unit, mesh.point_offsets)
    local = select_rows(equilateral(size[mesh.triangles].mean(1)), packing.triangles)
    objective = MeshObjective(
        InverseMeanRatio(2), equilateral() if alike else local, packing.rows, packing.anchored,
        packing.block_offsets, packing.triangle_offsets, packing.spread_vertices(size),
    )  # fmt: skip
    return objective, packing.unknowns


def main(argv: Sequence[str] | None = None) -> int:
    given = arguments.sizes_and_cache(__doc__, argv, 2000, 16000)
    titles = ("problem", "method", "above the lowest energy by", "iterations", "passes", "seconds")
    print(tables.head(titles))
    for triangles in given.triangles:
        for name, (objective, start, first, largest) in problems(triangles, given.cache).items():
            traces = {
                "L-BFGS": lbfgs(objective, start, 3000, first, largest),
                "truncated Newton": newton(objective, start, 60),
            }
            lowest = min(energy for trace in traces.values() for *_, energy in trace)
            for part in (1e-2, 1e-3, 1e-5):
                for method, trace in traces.items():
                    there = [row for row in trace if row[3] <= (1 + part) * lowest]
                    numbers = [f"{there[0][1]}", f"{there[0][2]}", f"{there[0][0]:.2f}"] if there else []
                    cells = numbers or ["-", "-", "not reached"]
                    print(tables.line([name, method, f"{part:g}", *cells]), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
