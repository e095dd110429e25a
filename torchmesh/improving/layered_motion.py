"""Layers on the way of a moving boundary: they are carried along with their walls, as parts of the moving bodies."""

from dataclasses import dataclass, replace
from typing import Protocol

import torch
from torch import Tensor

from ..layering.following import follow_walls
from ..layering.layers import Layers, find_layers
from ..mesh.batch import MeshBatch, vertex_mesh
from ..mesh.connectivity import heads, tails


class Path(Protocol):
    """The way of the fixed vertices of a batch."""

    def at(self, t: Tensor) -> Tensor:
        """(V, 2) the positions at t (B,), one in [0, 1] for each mesh; the rows of free vertices do not count."""
        ...


@dataclass(frozen=True, eq=False)
class LayeredPath:
    """A path on which the vertices of layers go as their walls take them.

    walls   the path of the walls
    layers  the layers of the batch at the start
    start   (V, 2) the positions there
    """

    walls: Path
    layers: Layers
    start: Tensor

    def at(self, t: Tensor) -> Tensor:
        """(V, 2) the positions at t (B,), one in [0, 1] for each mesh."""
        return follow_walls(self.layers, self.start, self.walls.at(t))


def with_layers(batch: MeshBatch, walls: Path, along: Tensor | None = None) -> tuple[MeshBatch, Path, Tensor]:
    """The batch with its layers held, the path with them, and (B,) bool which meshes have layers.

    along  (V,) bool, the walls whose layers count: those of which both ends are named.  None: all walls
    """
    layers = find_layers(batch)
    if along is not None and len(layers):
        half = layers.wall
        ends = torch.stack([tails(batch.triangles)[half], heads(batch.triangles)[half]], 1)
        layers = layers.select(along[ends].all(1))
    has_layers = torch.zeros(len(batch), dtype=torch.bool, device=batch.points.device)
    if not len(layers):
        return batch, walls, has_layers
    has_layers[vertex_mesh(batch)[layers.corners[:, 0]]] = True
    held = replace(
        batch,
        fixed=batch.fixed | layers.vertices(len(batch.points)),
        constrained_edges=torch.cat([batch.constrained_edges, layers.loose_edges(batch)]),
    )
    return held, LayeredPath(walls, layers, batch.points), has_layers
