"""The energy of every triangle of a mesh and the gradient of their sum: the one kernel of all minimisations.

It gathers the edges of the triangles, asks the energy for phi and its two slopes, and scatters the forces to the
corners.  What is meant by a good shape enters before that: a `Target` for each triangle, an `EdgeMap`, or both.
"""

import itertools
from typing import NamedTuple

import torch
from torch import Tensor

from ..mesh.ragged import take
from .energies import Energy
from .jacobian import (
    EdgeMap,
    Target,
    add_area_slope,
    area_slope,
    double_area,
    four_rows,
    half_stretch_slope,
    inner,
    select_rows,
)


class Chunk(NamedTuple):
    """T triangles that are worked on at a time, with what belongs to them.

    rows      (6 T,) int64, where all ax, then all ay, bx, by, cx and cy stand in the vector of coordinates
    energy, target  theirs
    edges     (2, 2, T) x and y of e1 and of e2 where all coordinates are zero; None: zero
    edge_map  through which their edges are seen; None: as they are
    """

    rows: Tensor
    energy: Energy
    target: Target
    edges: Tensor | None = None
    edge_map: EdgeMap | None = None

    def edges_at(self, coordinates: Tensor) -> Tensor:
        """(2, 2, T) x and y of e1 and of e2, as they are seen."""
        corner = take(coordinates, self.rows).view(3, 2, -1)
        edges = corner[1:] - corner[0]
        if self.edges is not None:
            edges.add_(self.edges)
        return edges if self.edge_map is None else self.edge_map.edges(edges)


def chunks_of(
    rows: Tensor,
    energy: Energy,
    target: Target,
    offsets: list[int] | None = None,
    edges: Tensor | None = None,
    edge_map: EdgeMap | None = None,
) -> list[Chunk]:
    """Cut triangles into chunks for `energy_and_forces`.

    rows      (6, T) where the corner coordinates ax, ay, bx, by, cx, cy stand in the vector of coordinates
    offsets   where chunks begin and end, from `chunk_offsets`; None: those of one mesh
    edges     (4, T) the x and y of e1 and of e2 where all coordinates are zero, which then are
              displacements; None: zero
    edge_map  through which the edges are seen; None: as they are
    """
    chunks = []
    for start, end in itertools.pairwise(chunk_offsets([0, rows.shape[1]]) if offsets is None else offsets):
        here = slice(start, end)
        chunks.append(
            Chunk(
                rows[:, here].reshape(-1).to(torch.int64),
                select_rows(energy, here),
                select_rows(target, here),
                None if edges is None else edges[:, here].reshape(2, 2, -1),
                None if edge_map is None else select_rows(edge_map, here),
            )
        )
    return chunks


# The numbers that one chunk needs stay in the cache.
_CHUNK_TRIANGLES = 32768


def chunk_offsets(offsets: list[int]) -> list[int]:
    """Where to cut the triangles of several meshes, whose own are told apart by `offsets` (B+1,).

    Forces on a vertex are summed chunk by chunk.  So a mesh is cut, if at all, at the same of its own triangles
    whatever else is in the batch, and its sums keep their bits.
    """
    cuts = [0]
    for start, end in itertools.pairwise(offsets):
        if end - cuts[-1] > _CHUNK_TRIANGLES and start > cuts[-1]:
            cuts.append(start)
        while end - cuts[-1] > _CHUNK_TRIANGLES:
            cuts.append(cuts[-1] + _CHUNK_TRIANGLES)
    return [*cuts, offsets[-1]] if offsets[-1] > cuts[-1] else cuts


def energy_and_forces(coordinates: Tensor, chunks: list[Chunk]) -> tuple[Tensor, Tensor, Tensor]:
    """The energy of every triangle and the gradient of their sum, by hand-derived slopes.

    coordinates  (N,) all coordinates in one vector, in any order

    Returns phi (T,), the gradient (N,) and det J (T,).
    """
    gradient = torch.zeros_like(coordinates)
    parts = [_add_forces(chunk, coordinates, gradient) for chunk in chunks]
    if not parts:
        return coordinates[:0], gradient, coordinates[:0]
    phi, det = parts[0] if len(parts) == 1 else (torch.cat(part) for part in zip(*parts, strict=True))
    return phi, gradient, det


def _add_forces(chunk: Chunk, coordinates: Tensor, gradient: Tensor) -> tuple[Tensor, Tensor]:
    """phi and det of the triangles of a chunk; their forces are added to `gradient`."""
    e, target = chunk.edges_at(coordinates), chunk.target
    rows = four_rows(e)
    det = double_area(rows).mul_(target.m)
    # On a, and on b and c, which are the derivatives by e1 and e2.
    every = e.new_empty((3, *e.shape[1:]))
    forces = every[1:]
    if chunk.energy.stretches:
        half_stretch_slope(e, target, out=forces)
        force_rows = four_rows(forces)
        phi, by_stretch, by_det = chunk.energy.value_and_slopes(inner(force_rows, rows), det)
        by_area = by_det * target.m
        forces.mul_(2 * by_stretch)
        add_area_slope(rows, by_area, to=force_rows)
    else:
        phi, _, by_det = chunk.energy.value_and_slopes(det, det)
        area_slope(rows, by_det * target.m, out=four_rows(forces))
    if chunk.edge_map is not None:
        forces.copy_(chunk.edge_map.edges(forces))
    torch.add(forces[0], forces[1], out=every[0])
    every[0].neg_()
    gradient.scatter_add_(0, chunk.rows, every.view(-1))
    return phi, det
