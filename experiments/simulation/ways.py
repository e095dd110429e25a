"""The ways to move the mesh of the channel by one step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

import torchmesh as tm
from experiments.quality import layers
from torchmesh.bench.methods import gmsh_mesher
from torchmesh.mesh.boundary_parts import boundary_parts
from torchmesh.transferring.transfer import Method

RADIUS, LENGTH, HEIGHT = 0.25, 6.0, 2.0
BOUND = tm.Bound(angle=10.0)

# What a way does in a step: the pieces (mesh to transfer from or None, before, after, part of the step), and the mesh.
Piece = tuple["tm.MeshBatch | None", tm.MeshBatch, tm.MeshBatch, float]
Way = Callable[[tm.MeshBatch, torch.Tensor], "tuple[list[Piece], tm.MeshBatch]"]


def channel(size: float) -> tm.MeshBatch:
    """The channel round the disc at its start; `size` is the length of edges at the walls, half of it at the disc."""
    angle = np.arange(0, 2 * np.pi, 0.5 * size / RADIUS)
    disc = np.stack([1 + RADIUS * np.cos(angle), 1 + RADIUS * np.sin(angle), np.full_like(angle, size / 2)], 1)
    walls = np.array([(0, 0, size), (LENGTH, 0, size), (LENGTH, HEIGHT, size), (0, HEIGHT, size)], float)
    return tm.MeshBatch.from_arrays(*gmsh_mesher.triangulate([walls, disc]))


def on_disc(mesh: tm.MeshBatch) -> torch.Tensor:
    """(V,) bool: the vertices of the disc."""
    mask = torch.zeros_like(mesh.fixed)
    mask[boundary_parts(mesh)["hole:1"]] = True
    return mask


def meshed_anew(mesh: tm.MeshBatch) -> tm.MeshBatch:
    """gmsh's mesh inside the same boundary edges."""
    loops = []
    for loop in boundary_parts(mesh).values():
        p = mesh.points[loop].numpy()
        size = 0.5 * (np.linalg.norm(p - np.roll(p, 1, 0), axis=1) + np.linalg.norm(p - np.roll(p, -1, 0), axis=1))
        loops.append(np.concatenate([p, size[:, None]], 1))
    return tm.MeshBatch.from_arrays(*gmsh_mesher.triangulate(loops, unsplit=range(len(loops))))


def deforming(options: tm.DeformOptions) -> Way:
    def way(now: tm.MeshBatch, goal: torch.Tensor) -> tuple[list[Piece], tm.MeshBatch]:
        after, report = tm.deform(now, goal, options=options, trail=True)
        report.check()
        assert report.trail is not None
        return [(p.previous, p.before, p.after, p.end - p.start) for p in report.trail[0]], after

    return way


def warping(mend: Callable[[tm.MeshBatch], tm.MeshBatch]) -> Way:
    """FEMWARP, and where `mend` gives back another mesh, a transfer to it."""

    def way(now: tm.MeshBatch, goal: torch.Tensor) -> tuple[list[Piece], tm.MeshBatch]:
        warped = tm.femwarp(now, goal)
        after = mend(warped)
        pieces: list[Piece] = [(None, now, warped, 1.0)]
        return pieces if after is warped else [*pieces, (warped, after, after, 0.0)], after

    return way


def improved(mesh: tm.MeshBatch) -> tm.MeshBatch:
    after, report = tm.improve(mesh, tm.ImproveOptions(when=BOUND))
    return after if int(report.moved[0]) or bool(report.rewired[0]) else mesh


def moving(move: Callable[[tm.MeshBatch, tm.MeshBatch], tm.MeshBatch]) -> Way:
    def way(now: tm.MeshBatch, goal: torch.Tensor) -> tuple[list[Piece], tm.MeshBatch]:
        after = move(now, now.with_points(goal))
        return [(None, now, after, 1.0)], after

    return way


def left(way: Way) -> Way:
    """As if nothing had moved but the solution with its vertices."""

    def moved(now: tm.MeshBatch, goal: torch.Tensor) -> tuple[list[Piece], tm.MeshBatch]:
        _, after = way(now, goal)
        return [(None, after, after, 1.0)], after

    return moved


# A way that changes no triangles transfers nothing, whatever its method.
WAYS: dict[str, tuple[Way, Method]] = {
    "deform, when, L2": (deforming(tm.DeformOptions(when=BOUND)), "conservative"),
    "deform, L2": (deforming(tm.DeformOptions()), "conservative"),
    "deform, interpolation": (deforming(tm.DeformOptions()), "linear"),
    "deform, left": (left(deforming(tm.DeformOptions())), "linear"),
    "deform, keep": (deforming(tm.DeformOptions(topology="keep")), "linear"),
    "femwarp, improve, L2": (warping(improved), "conservative"),
    "femwarp, gmsh, L2": (
        warping(lambda mesh: meshed_anew(mesh) if float(tm.minimum_angle(mesh)[0]) < BOUND.angle else mesh),
        "conservative",
    ),
    "elasticity": (moving(layers.elasticity), "linear"),
    "rbf": (moving(layers.rbf), "linear"),
}
