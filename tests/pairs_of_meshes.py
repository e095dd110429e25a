"""Pairs of batches between which values are transferred: a mesh before and one after, of the same domain or not."""

import numpy as np
from meshes import delaunay, disc, grid, jittered, ring
from scipy.spatial import Delaunay

from torchmesh import MeshBatch, join


def graded(seed: int) -> MeshBatch:
    """Points whose distances from one corner run over nine powers of ten."""
    rng = np.random.default_rng(seed)
    radius, angle = 10.0 ** rng.uniform(-9, 0, 300), rng.uniform(0, np.pi / 2, 300)
    points = np.concatenate([[[0, 0], [1, 0], [0, 1]], radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)])
    used, triangles = np.unique(Delaunay(points).simplices, return_inverse=True)
    return MeshBatch.from_arrays(points[used], triangles.reshape(-1, 3))


def pairs_of_meshes() -> dict[str, tuple[MeshBatch, MeshBatch]]:
    far = jittered(6, 5, 0.2, seed=1)
    return {
        "moved": (jittered(9, 8, 0.1), jittered(9, 8, 0.2, seed=5)),
        "tangled": (jittered(9, 8, 2.5), jittered(9, 8, 0.2, seed=5)),
        "the same": (grid(7, 5), grid(7, 5)),
        "graded": (graded(1), graded(2)),
        "far": (far.with_points(far.points * 1e9 + 1e12), far.with_points(far.points * 1e9 + 1e12 + 1e7)),
        "several": (join([disc(), ring(), delaunay(60, 2)]), join([disc(), jittered(5, 5, 0.2), delaunay(90, 3)])),
        "nothing in common": (grid(4, 4), grid(4, 4).with_points(grid(4, 4).points + 10)),
    }
