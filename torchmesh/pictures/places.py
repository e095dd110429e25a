"""Where something is left in a mesh that could not be mended whole: places to mark in pictures and on the page.

inverted triangles that touch each other --> one place; its text is the fault's that was found there, or its count
"""

from dataclasses import dataclass

import numpy as np
import torch

from ..improving.faults import faults_of
from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality
from .regions import of_elements

# So many places are marked at most, those of most triangles.
_MOST = 50


@dataclass(frozen=True)
class Place:
    """A place at which something is left.

    position  (x, y) in the coordinates of the mesh
    size      how large it is, in the same unit; 0 for a point
    text      what is left there
    """

    position: tuple[float, float]
    size: float
    text: str


def places_left(mesh: MeshBatch, quality: Quality) -> list[Place]:
    """The places of a batch of one at which triangles are inverted; none in a valid mesh."""
    bad = np.flatnonzero(~of_elements(quality)[2])
    if not len(bad):
        return []
    points = mesh.points.detach().to("cpu", torch.float64).numpy()
    # Triangles end twice in their last corner, beside quads.
    corners = np.concatenate([mesh.triangles.cpu().numpy()[:, [0, 1, 2, 2]], mesh.quads.cpu().numpy()])[bad]
    quads = bad >= len(mesh.triangles)
    found: list[tuple[int, Place]] = []
    faults = [fault for fault in faults_of(mesh) if np.isfinite(fault.place).all()]
    told = np.zeros(len(faults), bool)
    for rows in _touching(corners):
        own = points[np.unique(corners[rows])]
        low, high = own.min(0), own.max(0)
        here = [
            i for i, f in enumerate(faults) if not told[i] and _within(f.place, f.vertices, corners[rows], low, high)
        ]
        told[here] = True
        count = len(rows)
        noun = "quad" if quads[rows].all() else "element" if quads[rows].any() else "triangle"
        text = f"{count:,} inverted {noun}{'' if count == 1 else 's'}"
        text += "".join(f"; {faults[i].message}" for i in here[:2])
        text += f"; and {len(here) - 2} more of the kind" if len(here) > 2 else ""
        # The triangle in the middle: the middle of a crescent lies beside it.
        centres = points[corners[rows]].mean(1)
        middle = centres[np.square(centres - (low + high) / 2).sum(1).argmin()]
        found.append((count, Place((float(middle[0]), float(middle[1])), float((high - low).max()), text)))
    found.sort(key=lambda one: -one[0])
    alone = [Place(f.place, 0.0, f.message) for f, known in zip(faults, told, strict=True) if not known]
    return [place for _, place in found][:_MOST] + alone[: max(0, _MOST - len(found))]


def _touching(corners: np.ndarray) -> list[np.ndarray]:
    """The rows of elements (K, 4) that touch each other in vertices, group by group."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    used, back = np.unique(corners, return_inverse=True)
    back = back.reshape(corners.shape)
    ends = np.concatenate([back[:, [k, k + 1]] for k in range(3)])
    graph = coo_matrix((np.ones(len(ends)), ends.T), shape=(len(used), len(used)))
    label = connected_components(graph, directed=False)[1][back[:, 0]]
    order = label.argsort(kind="stable")
    return np.split(order, np.flatnonzero(np.diff(label[order])) + 1)


def _within(
    place: tuple[float, float], vertices: tuple[int, ...], corners: np.ndarray, low: np.ndarray, high: np.ndarray
) -> bool:
    """Does a fault lie where these triangles are, or concern their vertices?"""
    margin = 0.5 * (high - low).max()
    at = np.asarray(place)
    return bool(np.isin(vertices, corners).any() or ((at >= low - margin) & (at <= high + margin)).all())
