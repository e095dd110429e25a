"""What the modules of the speed targets share: the setting, a row, and the judgement of a mesh."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import torchmesh as tm
from torchmesh.bench.stopwatch import Seconds

# The greatest IMR average and maximum that a target accepts of a mesh.
MEAN, MAXIMUM = 1.08, 2.5


@dataclass(frozen=True)
class Row:
    """One measured ratio.

    met  whether the ratio of wall times reaches the goal and the meshes are good enough; None: there is no goal
    """

    target: int
    what: str
    ratio: float | None
    cpu_ratio: float | None
    goal: float | None
    met: bool | None
    details: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Setting:
    """What all targets share.

    meshes  in the batch of T1
    small   triangles of the meshes of T1, T2 and T7
    medium  triangles in T3, and where T6 starts
    large   triangles in T5 and T6, half of those in T4
    full    whether T5 and T6 go on to 1,000,000 triangles
    """

    cache: Path
    repeats: int
    meshes: int
    small: int
    medium: int
    large: int
    full: bool

    @property
    def largest(self) -> int:
        """Triangles of the largest mesh that this run measures."""
        return 1_000_000 if self.full else self.large


def ratio_row(target: int, what: str, ratio: Seconds, goal: float, details: list[str], good: bool = True) -> Row:
    """A row whose goal is met if the wall ratio is at most the goal and the meshes are `good`."""
    return Row(target, what, ratio.wall, ratio.cpu, goal, good and ratio.wall <= goal, details)


def improve_into(result: list[tm.MeshBatch], mesh: tm.MeshBatch, options: tm.ImproveOptions | None = None) -> None:
    """A work for the clock: `result` then holds the improved mesh alone."""
    result[:] = [tm.improve(mesh, options)[0]]


def judge(mesh: tm.MeshBatch) -> tuple[str, bool]:
    """The quality in words, and whether every mesh is valid with an IMR that the targets accept."""
    q = tm.quality(mesh)
    bad = int((q.inverted > 0).sum())
    mean, worst = float(q.mean.max()), float(q.max.max())
    words = f"{int(q.inverted.sum())} inverted in {bad} of {len(mesh)} meshes, IMR at worst {mean:.3f} / {worst:.2f}"
    return words, bad == 0 and acceptable(mean, worst)


def acceptable(mean: float, maximum: float) -> bool:
    """Whether the targets accept this IMR average and maximum."""
    return mean <= MEAN and maximum <= MAXIMUM
