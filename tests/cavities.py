"""Grids with and without constrained edges, to be re-triangulated."""

import numpy as np
import torch

from torchmesh import MeshBatch


def grid(columns, rows):
    """Points (V, 2) in the unit square and triangles (T, 3) of a structured grid."""
    x, y = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1), indexing="ij")
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3)
    return np.stack([x.ravel(), y.ravel()], 1), triangles


def make(points, triangles, **more):
    with np.errstate(all="ignore"):
        return MeshBatch.from_arrays(points, triangles, **more)


def whole(mesh):
    return torch.ones(len(mesh.triangles), dtype=torch.bool)


def edge_set(triangles):
    return {frozenset(e) for t in triangles.tolist() for e in zip(t, t[1:] + t[:1], strict=True)}


def region_mesh():
    """A 12 x 12 grid with a closed interface, a hole-like loop of constrained edges."""
    points, triangles = grid(12, 12)
    inner = ((points[triangles].mean(1) > 0.25) & (points[triangles].mean(1) < 0.75)).all(1)
    interface = edge_set(triangles[inner]) & edge_set(triangles[~inner])
    return points, triangles, inner, np.array(sorted(map(sorted, interface)))
