"""The ways to untangle that never_give_up.py compares: ours, the paper's, and those of other tools."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import torch

import torchmesh as tm
from experiments.shared.peers import PEERS

Way = Callable[[tm.MeshBatch], tm.MeshBatch]


def peer(name: str) -> Way:
    """The peer of that name, which keeps the triangles."""

    def run(mesh: tm.MeshBatch) -> tm.MeshBatch:
        outcome = PEERS[name](mesh.points.numpy(), mesh.triangles.numpy(), mesh.fixed.numpy())
        return mesh.with_points(torch.from_numpy(outcome.points))

    return run


def ours(topology: Literal["keep", "flip", "full"]) -> Way:
    """`improve` with a topology, in one process."""
    return lambda mesh: tm.improve(mesh, tm.ImproveOptions(topology=topology, workers=1))[0]


WAYS: dict[str, Way] = {
    "ours": ours("flip"),
    "ours, full": ours("full"),
    "ours, triangles kept": ours("keep"),
    "Kim 2017": lambda mesh: tm.improve(mesh, tm.ImproveOptions.paper(untangle_rounds=10))[0],
    "gmsh": peer("gmsh"),
    "MFEM TMOP": peer("MFEM TMOP"),
    "foldover-free maps": peer("foldover-free maps"),
}
# The ways that run unless others are named.  Foldover-free maps takes half a minute for a graded mesh of 300 triangles.
USUAL = [way for way in WAYS if way not in ("ours, full", "foldover-free maps")]
# The ways that promise a valid mesh where the boundary allows one.
PROMISE = ("ours", "ours, full")
