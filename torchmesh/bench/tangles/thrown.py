"""Interiors thrown about inside a boundary at rest; some with an interface between two regions, which stays."""

import numpy as np
import torch

from ...mesh.batch import MeshBatch
from ...mesh.connectivity import heads, tails
from ...mesh.interfaces import holding
from ...mesh.means import vertex_size
from ..case import Drawn, Family
from .with_bodies import LENGTH, channel


def jitter(rng: np.random.Generator, lengths: float) -> Drawn | None:
    """Free vertices thrown by a normal deviate of so many local edge lengths; every third mesh has two regions."""
    made = channel(rng)
    if made is None:
        return None
    mesh, _, details = made
    regions = 1
    if rng.integers(3) == 0:
        mesh, regions = with_interface(mesh, rng.uniform(0.4, 0.7) * LENGTH), 2
    throw = rng.standard_normal(tuple(mesh.points.shape)) * lengths * vertex_size(mesh).numpy()[:, None]
    free = ~holding(mesh).fixed[:, None]
    points = torch.where(free, mesh.points + torch.from_numpy(throw), mesh.points)
    return Drawn(mesh, points, details=details | {"regions": regions})


def with_interface(mesh: MeshBatch, x: float) -> MeshBatch:
    """The mesh with an interface along the edges between the triangles left of x and those right of it."""
    right = mesh.points[mesh.triangles].mean(1)[:, 0] > x
    h = torch.arange(len(mesh.twin))
    between = (h < mesh.twin) & (right[h // 3] != right[mesh.twin.clamp_min(0) // 3])
    edge = torch.stack([tails(mesh.triangles), heads(mesh.triangles)], 1)
    return MeshBatch.from_arrays(mesh.points, mesh.triangles, mesh.fixed, edge[between])


FAMILIES = (
    Family("jitter", jitter, (0.25, 0.4, 0.6, 1, 2, 4), "edge lengths thrown", "interior vertices thrown about"),
)
