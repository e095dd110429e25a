"""Does the boundary's spacing set the limit of maps onto letters and spirals? A Markdown table.

    python experiments/boundary_spacing.py

fewest  the lowest mean of the inverse mean ratio of any triangulation of the boundary without a vertex inside, which
        is all that there is room for where boundary edges are longer than an arm is wide.  By dynamic programming
        over the polygon's intervals (Klincsek, Minimal triangulations of polygonal domains, 1980); triangles that
        are all upright and fill a simple polygon are a triangulation of it.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np
import torch
from tangles import tangle

import torchmesh as tm
from torchmesh.mesh import connectivity

CASES = [("mapped", 3), ("mapped", 4), ("mapped", 6), ("mapped", 8), ("wound", 1), ("wound", 2)]


def least_mean(polygon: np.ndarray) -> float:
    """Of all triangulations of the simple polygon (N, 2), counter-clockwise, without further vertices."""
    count = len(polygon)
    least = np.full((count, count), np.inf)
    least[np.arange(count - 1), np.arange(1, count)] = 0.0
    for width in range(2, count):
        for i in range(count - width):
            j = i + width
            k = np.arange(i + 1, j)
            a, b, c = polygon[i], polygon[k], polygon[j]
            det = (b - a)[:, 0] * (c - a)[1] - (b - a)[:, 1] * (c - a)[0]
            squares = ((b - a) ** 2).sum(1) + ((c - b) ** 2).sum(1) + ((c - a) ** 2).sum()
            upright = det > 0
            ratio = np.where(upright, squares / (2 * math.sqrt(3) * np.where(upright, det, 1.0)), np.inf)
            least[i, j] = (least[i, k] + least[k, j] + ratio).min()
    return float(least[0, -1]) / (count - 2)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--triangles", type=int, nargs="+", default=[300, 2000])
    parser.add_argument("--cache", type=Path, default=Path("out/cache"))
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    print(
        "| map | triangles | boundary edges | fewest | IMR average, flip | maximum | full | maximum | vertices, full |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for triangles in arguments.triangles:
        for family, value in CASES:
            mesh = tangle(family, value, triangles, 0.3, 0, arguments.cache).tangled
            rim = connectivity.boundary_edges(mesh.triangles, connectivity.twins(mesh.triangles))
            fewest = least_mean(mesh.points[connectivity.boundary_loops(rim)[0]].numpy())
            cells = [f"{family} {value}", f"{len(mesh.triangles):,}", str(len(rim)), f"{fewest:.3f}"]
            for topology in ("flip", "full"):
                after, report = tm.improve(mesh, tm.ImproveOptions(topology=topology, workers=1))
                cells += [f"{float(report.quality.mean):.3f}", f"{float(report.quality.max):.2f}"]
            print("| " + " | ".join([*cells, f"{len(after.points):,}"]) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
