"""Vertices pulled along from crowded to empty regions: as many splits as collapses, in the same rows.

A collapse sets a vertex free, a split elsewhere takes it up again.  So number and order of vertices
and triangles stay, as with flips; a vertex, and whatever field hangs on it, may travel far.
"""

import dataclasses

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch, put, triangle_mesh
from ..mesh.measure import Quality
from ..mesh.ragged import counts_from_offsets, segment_sum, spread
from ..mesh.triangle import SQRT3, corners, signed_area
from ..mesh.units import centre_and_unit
from ..smoothing.smoothing import SmoothOptions
from .collapses import collapse_rounds
from .mutable import Editable
from .options import RemeshOptions
from .remeshing import Remeshing, editable
from .splits import Room, split_rounds

# An edge of its size is not worth a vertex that was long in coming.
_WORTH = 1.2


# A mesh of good shapes, of which no sizes were asked, is done when fewer than one edge changes for so many triangles.
_FEW = 30


# How often a mesh may try to exchange fewer vertices.
_TRIES = 4


class Relocation(Remeshing):
    """`Remeshing` that keeps every row, and goes no further than pays: after the third cut, little changes in most.

    waits   what fewer collapses than this part of a cut's do in a round waits for the next cut
    looser  the last smoothing ends at so many times its tolerance
    """

    rough = 1.06
    shakes = ((0.9, 1.3),)
    # Edges of 0.7 to 1.4 times their sizes are left alone: better sizes are not worth loading scipy for.
    accuracy = 1e-3
    waits = 0.15
    looser = 5
    rest = SmoothOptions(max_iterations=8, energy_tolerance=1e-3, single=True)

    def __init__(self, batch: MeshBatch, options: RemeshOptions) -> None:
        # A boundary vertex more would be a vertex more.
        super().__init__(batch, dataclasses.replace(options, split_boundary=False))

    def _cut(self, going: Tensor, short: float, long: float) -> Tensor:
        assert self.size is not None
        changed = torch.zeros_like(self.splits)
        most: Tensor | None = None
        for _ in range(_TRIES):
            if not bool(going.any()):
                break
            splits, collapses = self._exchange_vertices(going, short, long, most)
            whole = splits == collapses
            changed[going] = torch.where(whole, 2 * splits, 0)
            # A mesh that found no room for all its freed vertices frees fewer.
            going, most = _part(going, ~whole & (splits > 0)), (splits // 2)[~whole & (splits > 0)]
        self.splits += changed // 2
        self.collapses += changed // 2
        return changed

    def _few(self, changed: Tensor, now: Quality) -> Tensor:
        few = super()._few(changed, now)
        if self.options.sizes_asked:
            return few
        return few | ((now.mean <= self.rough) & (_FEW * changed <= counts_from_offsets(self.batch.triangle_offsets)))

    def _exchange_vertices(
        self, going: Tensor, short: float, long: float, most: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Collapse and split, `most` (B',) times at most, in those of the meshes `going` (B,) where both numbers agree.

        Returns the splits and collapses (B',) that each found.
        """
        assert self.size is not None
        part, rows = self.batch.select(going), spread(going, self.batch.point_offsets)
        e = editable(part, self.size[rows], self.names, self.names.of[rows])
        edge = e.edges()
        wanted = e.per_mesh(edge[e.relative_length(edge) > long])
        wanted = wanted if most is None else torch.minimum(wanted, most)
        collapses = collapse_rounds(e, self._too_short(e, short), self._harmless, budget=wanted, worth=self.waits)
        splits = split_rounds(e, self._too_long(e, _WORTH), budget=collapses, room=_freed_rows(triangle_mesh(part)))
        whole = splits == collapses
        unit = spread(centre_and_unit(part.points, part.point_offsets)[1], part.point_offsets)
        points = (torch.stack([e.x, e.y], 1) * unit[:, None]).to(part.points)
        done = dataclasses.replace(part, points=points, triangles=e.triangles)
        size = self.size.clone()
        size[rows] = torch.where(spread(whole, part.point_offsets), e.size * unit, self.size[rows])
        self.batch, self.size = put(self.batch, going, put(part, whole, done.select(whole))), size
        return splits, collapses

    def _polish(self, going: Tensor) -> None:
        if bool(going.any()):
            smoothing = self.options.smooth
            self._settle(
                going, dataclasses.replace(smoothing, energy_tolerance=self.looser * smoothing.energy_tolerance)
            )

    def _renew(self, going: Tensor, before: MeshBatch, after: MeshBatch) -> None:
        # Vertices take their sizes along: to ask for them anew would cost more than it betters.
        self.batch = put(self.batch, going, after)

    def _scaled(self, part: MeshBatch, size: Tensor) -> Tensor:
        """The sizes times what makes the number of equilateral triangles that fill each mesh the one there is."""
        per_triangle = size[part.triangles].mean(1)
        share = signed_area(corners(part.points.to(torch.float64), part.triangles)) / per_triangle / per_triangle
        fitting = segment_sum(share, part.triangle_offsets) * (4 / SQRT3)
        factor = (fitting / counts_from_offsets(part.triangle_offsets)).sqrt()
        return size * spread(factor, part.point_offsets)


def _part(at: Tensor, keep: Tensor) -> Tensor:
    """(B,) bool: those of the meshes `at` (B,) whose `keep` (one for each that is) is true."""
    rest = torch.zeros_like(at)
    rest[at] = keep
    return rest


def _freed_rows(face_mesh: Tensor) -> Room:
    """Room in the dead rows of the same mesh; face_mesh (T,) says whose each row of triangles is."""

    def room(e: Editable, h: Tensor) -> tuple[Tensor, Tensor]:
        owner = e.mesh[e.vertex[h]]
        order = owner.argsort(stable=True)
        counts = torch.bincount(owner, minlength=e.meshes)
        place = torch.empty_like(order)
        place[order] = torch.arange(len(h), device=h.device) - (counts.cumsum(0) - counts)[owner[order]]
        vertices = (~e.alive).nonzero().squeeze(1)
        faces = (e.triangles[:, 0] < 0).nonzero().squeeze(1)
        first_vertex = torch.searchsorted(e.mesh[vertices].contiguous(), owner)
        first_face = torch.searchsorted(face_mesh[faces].contiguous(), owner)
        pair = first_face + 2 * place
        return vertices[first_vertex + place], torch.stack([faces[pair], faces[pair + 1]])

    return room
