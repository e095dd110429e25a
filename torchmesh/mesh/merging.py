"""Vertices in one position that become one, and those that do not: the two sides of a slit."""

import numpy as np

from .clean_log import CleanLog
from .faces import Faces, components_of


def merged_vertices(work: Faces, tolerance: float, sew: bool, log: CleanLog) -> np.ndarray:
    """(V,) the vertex that each becomes, the first of those in its position.

    tolerance, sew  as those of `clean`

    Vertices of one component stay apart, unless `sew` says otherwise or a side on the boundary joins them.  So do those
    that would give a side more than two faces: sheets that lie over each other.
    """
    count = len(work.points)
    merged = np.arange(count)
    vertices = np.unique(np.concatenate([work.tri.ravel(), work.quad.ravel()]))
    position = _positions(work.points[vertices], tolerance)
    if len(vertices) == 0 or int(position.max()) + 1 == len(vertices):
        return merged
    component = np.zeros(count, np.int64)
    if not sew:
        for faces, label in zip((work.tri, work.quad), work.components(), strict=True):
            component[faces] = label[:, None]
    at = np.full(count, -1)
    at[vertices] = position
    edges, _ = work.boundary()
    short = edges[at[edges[:, 0]] == at[edges[:, 1]]]
    wanted = np.concatenate([_alike(vertices, position, component[vertices], together=sew), short])
    while True:
        merged = _least_of_each(count, wanted)
        crowded = work.renamed(merged).crowded_vertices()
        left = wanted[~np.isin(merged[wanted], crowded).any(1)]
        if len(left) == len(wanted):
            break
        wanted = left
    done = int((merged != np.arange(count)).sum())
    texts = "vertex was merged with another in its position", "vertices were merged with others in their position"
    log.did(done, *texts)
    apart = len(np.unique(merged[vertices])) - (int(position.max()) + 1)
    if apart:
        log.lines.append(
            f"{apart:,} more share the position of another and stay: they are on two sides of a slit, or on sheets "
            "that lie over each other (sew closes slits)"
        )
    return merged


def _alike(vertices: np.ndarray, position: np.ndarray, component: np.ndarray, together: bool) -> np.ndarray:
    """(P, 2) pairs of `vertices` (N,) in one position that become one: the k-th ones of the components there.

    position, component  (N,) int64
    together             do all vertices in a position become one
    """
    order = np.lexsort((vertices, component, position))
    here, of = position[order], component[order]
    begins = np.concatenate([[True], (here[1:] != here[:-1]) | (of[1:] != of[:-1])])
    first = np.maximum.accumulate(np.where(begins, np.arange(len(order)), 0))
    rank = np.zeros(len(order), np.int64) if together else np.arange(len(order)) - first
    slot = here * (int(rank.max()) + 1) + rank
    by_slot = slot.argsort(kind="stable")
    same = slot[by_slot][1:] == slot[by_slot][:-1]
    sorted_vertices = vertices[order][by_slot]
    return np.stack([sorted_vertices[:-1][same], sorted_vertices[1:][same]], 1)


def _positions(points: np.ndarray, tolerance: float) -> np.ndarray:
    """(N,) a number for each point (N, d), the same for those in one position."""
    if tolerance == 0:
        return np.unique(points + 0.0, axis=0, return_inverse=True)[1].reshape(-1)
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    return np.unique(_least_of_each(len(points), pairs), return_inverse=True)[1].reshape(-1)


def _least_of_each(count: int, pairs: np.ndarray) -> np.ndarray:
    """(count,) the least number that the `pairs` (P, 2) join each number to."""
    label = components_of(count, pairs)
    least = np.full(int(label.max(initial=-1)) + 1, count)
    np.minimum.at(least, label, np.arange(count))
    return least[label]
