"""Does a boundary layer keep its heights when its body turns?  Ours beside elasticity and radial basis functions.

    python -m experiments.quality.layers

A NACA 0012 airfoil with 20 layers, the first 1e-6 or 1e-4 chords high, in a disc of four chords, pitches by 5, 25 and
60 degrees in one step.  Each way gets the undeformed mesh and the turned boundary.  The table has the inverted
triangles, the share of the wall's first cells whose height is within a factor of 2.5 of what it was, the lowest and the
highest of these ratios, the least angle outside the layers, and seconds of processor time.

    improve     the turned wall alone is given; reference= the undeformed mesh
    deform      in steps, layers carried along
    femwarp     Shontz & Vavasis, BIT 50, 2010
    elasticity  linear, plane strain, Poisson's ratio 0.3, each element stiffer by a power of its area (Stein, Tezduyar
                & Benney, Mesh moving techniques for fluid-structure interactions with large displacements, Journal of
                Applied Mechanics 70, 2003; power 1)
    rbf         thin plate splines through the boundary (de Boer, van der Schoot & Bijl, Mesh deformation based on
                radial basis function interpolation, Computers & Structures 85, 2007)
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import numpy as np
import scipy.sparse as sparse
import torch
from scipy.interpolate import RBFInterpolator
from scipy.sparse.linalg import spsolve

import torchmesh as tm
from experiments.shared import arguments, clocks, tables

SIDES, ROWS, OUTER = 96, 20, 16
Way = Callable[[tm.MeshBatch, tm.MeshBatch], tm.MeshBatch]


def airfoil(first: float, growth: float = 1.4, rows: int | None = None) -> tm.MeshBatch:
    """The mesh; vertex j SIDES + i is in column i and row j, and the first SIDES vertices are the wall."""
    t = -2 * np.pi * np.arange(SIDES) / SIDES
    x = 0.5 * (1 + np.cos(t))
    half = 0.6 * (0.2969 * np.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
    wall = np.stack([x - 0.25, np.where(np.sin(t) >= 0, half, -half)], 1)
    along = np.roll(wall, -1, 0) - np.roll(wall, 1, 0)
    normal = np.stack([-along[:, 1], along[:, 0]], 1) / np.linalg.norm(along, axis=1)[:, None]
    heights = np.concatenate([[0.0], np.cumsum(first * growth ** np.arange(rows or ROWS))])
    rings = [wall + height * normal for height in heights]
    far = 4 * np.stack([np.cos(t), np.sin(t)], 1)
    last = rings[-1]
    step = np.linalg.norm(last - rings[-2], axis=1).mean() / np.linalg.norm(far - last, axis=1).mean()
    parts = np.geomspace(max(step, 2e-3), 1 + max(step, 2e-3), OUTER + 1) - max(step, 2e-3)
    rings += [last + part * (far - last) for part in parts[1:]]
    triangles = []
    for j in range(len(rings) - 1):
        for i in range(SIDES):
            u, w = j * SIDES + i, j * SIDES + (i + 1) % SIDES
            triangles += (
                [(u, w, w + SIDES), (u, w + SIDES, u + SIDES)]
                if i % 2
                else [
                    (u, w, u + SIDES),
                    (w, w + SIDES, u + SIDES),
                ]
            )
    return tm.MeshBatch.from_arrays(np.concatenate(rings), np.array(triangles))


def turned(mesh: tm.MeshBatch, degrees: float) -> tm.MeshBatch:
    """The mesh with its wall turned, nose up; all other vertices stay."""
    angle = -np.radians(degrees)
    turn = torch.tensor([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return mesh.with_points(torch.cat([mesh.points[:SIDES] @ turn, mesh.points[SIDES:]]))


def elasticity(mesh: tm.MeshBatch, moved: tm.MeshBatch) -> tm.MeshBatch:
    """The mesh at the elastic positions."""
    p, t = mesh.points.numpy(), mesh.triangles.numpy()
    a, b, c = (p[t[:, k]] for k in range(3))
    double = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    # Gradients of the shape functions; B maps nodal displacements to strains.
    slope = np.stack([np.stack([v[:, 1] - w[:, 1], w[:, 0] - v[:, 0]], 1) for v, w in ((b, c), (c, a), (a, b))], 1)
    slope /= double[:, None, None]
    strain = np.zeros((len(t), 3, 6))
    strain[:, 0, 0::2], strain[:, 1, 1::2] = slope[:, :, 0], slope[:, :, 1]
    strain[:, 2, 0::2], strain[:, 2, 1::2] = slope[:, :, 1], slope[:, :, 0]
    lame, shear = 0.3 / (1.3 * 0.4), 1 / 2.6
    law = np.array([[lame + 2 * shear, lame, 0], [lame, lame + 2 * shear, 0], [0, 0, shear]])
    # The integral has the element's area, and the stiffening divides it away again.
    local = np.einsum("tki,kl,tlj->tij", strain, law, strain) * np.median(double)
    dofs = np.stack([2 * t, 2 * t + 1], 2).reshape(len(t), 6)
    rows, columns = np.repeat(dofs, 6, 1).ravel(), np.tile(dofs, (1, 6)).ravel()
    whole = sparse.csr_matrix((local.ravel(), (rows, columns)), shape=(2 * len(p), 2 * len(p)))
    known = np.repeat(mesh.fixed.numpy(), 2)
    u = (moved.points.numpy() - p).ravel() * known
    u[~known] = spsolve(whole[~known][:, ~known].tocsc(), -(whole[~known][:, known] @ u[known]))
    return mesh.with_points(torch.from_numpy(p + u.reshape(-1, 2)))


def rbf(mesh: tm.MeshBatch, moved: tm.MeshBatch) -> tm.MeshBatch:
    """The mesh at the positions that thin plate splines through the boundary give."""
    p, fixed = mesh.points.numpy(), mesh.fixed.numpy()
    u = RBFInterpolator(p[fixed], (moved.points - mesh.points).numpy()[fixed], kernel="thin_plate_spline")(p)
    return mesh.with_points(torch.from_numpy(np.where(fixed[:, None], moved.points.numpy(), p + u)))


WAYS: dict[str, Way] = {
    "improve": lambda mesh, moved: tm.improve(moved, tm.ImproveOptions(reference=mesh))[0],
    "improve, keep": lambda mesh, moved: tm.improve(moved, tm.ImproveOptions(topology="keep", reference=mesh))[0],
    "deform": lambda mesh, moved: tm.deform(mesh, moved.points)[0],
    "femwarp": lambda mesh, moved: tm.femwarp(mesh, moved.points),
    "elasticity": elasticity,
    "rbf": rbf,
}


def first_heights(mesh: tm.MeshBatch) -> np.ndarray:
    """(SIDES,) the height over each edge of the wall of the triangle that stands on it, by the edge's first vertex."""
    on = mesh.triangles < SIDES
    rows = mesh.triangles[on.sum(1) == 2]
    heights = np.full(SIDES, np.nan)
    for row in rows.tolist():
        (u, w), top = [v for v in row if v < SIDES], next(v for v in row if v >= SIDES)
        p, q, r = (mesh.points[v].numpy() for v in (u, w, top))
        d, e = q - p, r - p
        first = u if (w - u) % SIDES == 1 else w
        heights[first] = abs(d[0] * e[1] - d[1] * e[0]) / np.hypot(*d)
    return heights


def row_of(
    first: float, degrees: float, name: str, mesh: tm.MeshBatch, seconds: float, after: tm.MeshBatch
) -> list[str]:
    """What the table says of one result."""
    ratio = first_heights(after) / first_heights(mesh)
    outside = (after.triangles >= ROWS * SIDES).any(1)
    angles = tm.metrics.measure(after, "minimum_angle")[outside]
    kept = 100 * float(np.mean((ratio > 0.4) & (ratio < 2.5)))
    spread = f"{np.nanmin(ratio):.3g} - {np.nanmax(ratio):.3g}"
    inverted = int(tm.quality(after).inverted[0])
    return [
        f"{first:.0e}",
        f"{degrees:g}",
        name,
        str(inverted),
        f"{kept:.0f} %",
        spread,
        f"{angles.min():.1f}",
        f"{seconds:.2f}",
    ]


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument(
        "--first", type=float, nargs="+", default=[1e-6, 1e-4], help="heights of the first row, in chords"
    )
    parser.add_argument("--degrees", type=float, nargs="+", default=[5.0, 25.0, 60.0], help="by how much it pitches")
    args = arguments.parse(parser, argv)
    rows = []
    for first in args.first:
        mesh = airfoil(first)
        for degrees in args.degrees:
            moved = turned(mesh, degrees)
            for name, way in WAYS.items():
                with clocks.Stopwatch() as watch:
                    after = way(mesh, moved)
                rows.append(row_of(first, degrees, name, mesh, watch.seconds.cpu, after))
    head = ["first row", "degrees", "way", "inverted", "heights kept", "ratios", "least angle", "seconds"]
    print(tables.table(head, rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
