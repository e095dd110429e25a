"""The trail of a deformation: pieces on which the triangles stay, for solvers that step along with the mesh (ALE).

      piece                       piece                        piece
    before ----- after   -->    before ----- after   -->     before = after     the mesh that `deform` gives back
            w             |              w             |
       the solver steps   |                            +-- edges flipped, vertices moved: values are transferred
       with velocity w    +-- the same

Within a piece every vertex goes straight from `before` to `after`, no triangle inverts on the way, and nothing need be
interpolated: values stay with their vertices, and the solver knows how fast these move.

For values that belong to a material, which goes with the boundary, smoothing is no motion but a change at rest.  In
trails of this kind (`trail="apart"`) every step is a piece, and whatever changed after it shows as `previous`.
"""

from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch
from ..mesh.measure import upright
from ..mesh.ragged import segment_any
from ..mesh.typed import typed
from ..warping.boundary_path import first_flat

# Whether a trail is kept, and whether what changes at rest is kept apart from the motion in it.
Trail = bool | Literal["apart"]


@typed
def rewired(before: MeshBatch, after: MeshBatch) -> Tensor:
    """(T,) bool: the triangles of `after` that have not the same three corners, in this order round them, as before.

    Rows are compared with rows: values of the other triangles may stay in theirs.  Raises InvalidMeshError where the
    numbers of vertices or triangles differ, since rows then say nothing.
    """
    for name in ("point_offsets", "triangle_offsets"):
        if not torch.equal(getattr(before, name), getattr(after, name)):
            raise InvalidMeshError("rewired compares rows: give batches with as many vertices and triangles each")
    old, new = before.triangles, after.triangles
    same = torch.zeros(len(new), dtype=torch.bool, device=new.device)
    for k in range(3):
        same |= (old.roll(k, 1) == new).all(1)
    return ~same


def has_rewired(before: MeshBatch, after: MeshBatch) -> Tensor:
    """(B,) bool: some triangle of the mesh has other corners than before, or the mesh has more or fewer rows."""
    other = torch.zeros(len(after), dtype=torch.bool, device=after.points.device)
    if before.triangles is after.triangles or torch.equal(before.triangles, after.triangles):
        return other
    for name in ("point_offsets", "triangle_offsets"):
        other |= getattr(before, name).diff() != getattr(after, name).diff()
    if not bool(other.any()):
        return segment_any(rewired(before, after), after.triangle_offsets)
    pairs = zip(other.tolist(), before.split(), after.split(), strict=True)
    return torch.tensor([o or bool(rewired(a, b).any()) for o, a, b in pairs], device=other.device)


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of the motion of one mesh on which its triangles stay.

    before    the mesh at its beginning
    after     the mesh at its end, with the same triangles
    start     the part of the motion at which it begins, in [0, 1]
    end       and at which it ends; the same as `start` where the mesh was changed at rest
    previous  the mesh from which values are to be transferred to `before`; None: they stay as they are
    """

    before: MeshBatch
    after: MeshBatch
    start: float
    end: float
    previous: MeshBatch | None = None

    @property
    def rewired(self) -> Tensor:
        """(T,) bool: the triangles of `before` that are not those of `previous`; all where their number differs."""
        none = torch.zeros(len(self.before.triangles), dtype=torch.bool, device=self.before.triangles.device)
        if self.previous is None:
            return none
        same = len(self.previous.points) == len(self.before.points) and len(self.previous.triangles) == len(none)
        return rewired(self.previous, self.before) if same else ~none

    def velocity(self, duration: float) -> Tensor:
        """(V, 2) the velocity of the vertices, if the whole motion takes that time; 0 for a change at rest."""
        time = (self.end - self.start) * duration
        way = self.after.points - self.before.points
        return way / time if time > 0 else torch.zeros_like(way)


def longer(pieces: tuple[Piece, ...], step: Piece, after: MeshBatch, apart: bool = False) -> tuple[Piece, ...]:
    """The pieces with one more step, after which the mesh became `after` at rest.

    apart  what changes at rest is no part of the motion
    """
    known = None if not pieces or same(pieces[-1].after, step.before) else pieces[-1].after
    more = (*pieces, replace(step, previous=known))
    return more if apart else settled(more, after)


def settled(pieces: tuple[Piece, ...], after: MeshBatch, apart: bool = False) -> tuple[Piece, ...]:
    """The pieces after the mesh became `after` at rest.

    This is the end of the last piece if its triangles allow it; or, `apart`, a piece of its own.
    """
    last = pieces[-1]
    if same(last.after, after):
        return pieces
    if not apart and last.end > last.start and _straight(last.before, after):
        return (*pieces[:-1], replace(last, after=after))
    return (*pieces, Piece(after, after, last.end, last.end, last.after))


def same(a: MeshBatch, b: MeshBatch) -> bool:
    """Whether two meshes have the same positions and triangles, to the bit."""
    return torch.equal(a.points, b.points) and torch.equal(a.triangles, b.triangles)


def _straight(before: MeshBatch, after: MeshBatch) -> bool:
    """Whether the triangles are the same, and upright on the straight way between."""
    if before.triangles.shape != after.triangles.shape or not torch.equal(before.triangles, after.triangles):
        return False
    return bool(upright(after).all()) and bool((first_flat(before, after.points) > 1).all())
