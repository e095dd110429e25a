r"""A few flips after which a mesh can be untangled with its triangles kept, where without any it was not.

       c              c         Inverted triangles are flipped with those neighbours with which both become least
      / \            /|\        inverted.  Areas are pushed up (`persisting`), and again, until no triangle is inverted.
     a---b    -->   a | b       Where that gains nothing, edges of inverted triangles are flipped one at a time for a
      \ /            \|/        trial, areas are pushed, and the best flip is kept.  Then flips are taken back, half of
       d              d         them, a quarter and so on, one by one in the end, as long as pushing areas suffices.

What is left is enough; nothing says that fewer would not be.  Where no flips are found, cavities are triangulated anew.
"""

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.interfaces import holding
from ..mesh.measure import upright
from .options import NewtonWays
from .persisting import pushed, sizes_to_push

Edge = tuple[int, int]


@dataclass(frozen=True)
class FlipSearch:
    """How long `enough_flips` looks.

    rounds  of flips that lower the inverted area, and of pushing areas, at most
    trials  single flips that are tried at most, twice, for a mesh of up to `size` triangles; for a larger one fewer
    width   flips of which the best is kept; one that leaves fewer inverted triangles is kept at once
    patience  flips without fewer inverted triangles than ever before, after which the search ends
    tabu    so many of the last edges that came by a flip are not flipped
    back    takings back of flips that are tried at most, in the same way
    size    see there
    near    meshes with more inverted triangles than this are left to re-triangulation, those with more than half of it
            after the first of both times
    ways    how areas are pushed
    """

    rounds: int = 20
    trials: int = 40
    width: int = 6
    patience: int = 8
    tabu: int = 8
    near: int = 40
    back: int = 40
    size: int = 300
    ways: NewtonWays = field(default_factory=lambda: NewtonWays(betas=(0.1,), pushes=40))


@dataclass(frozen=True)
class EnoughFlips:
    """Flips that are enough, and the valid mesh that they lead to.

    mesh      the mesh with other triangles, and with its free vertices moved
    edges     the edges that are flipped, one after the other, each as its two vertices; None where cavities were
              triangulated anew
    replaced  how many edges of the mesh given are no edges of the other
    """

    mesh: MeshBatch
    edges: tuple[Edge, ...] | None
    replaced: int

    def text(self, most: int = 8) -> str:
        """The same in words, with up to so many edges named."""
        if self.edges is None:
            return f"with {self.replaced} other edges it is possible (cavities were triangulated anew; fewer may do)"
        named = ", ".join(f"{a}-{b}" for a, b in self.edges[:most])
        more = f" and {len(self.edges) - most} more" if len(self.edges) > most else ""
        count = "1 flip is" if len(self.edges) == 1 else f"{len(self.edges)} flips are"
        return f"{count} enough to make it possible: {named}{more} (found by trial; fewer may do)"


def enough_flips(mesh: MeshBatch, options: FlipSearch | None = None) -> EnoughFlips | None:
    """Flips after which one mesh of triangles is untangled; None where nothing was found.

    Constrained edges stay.  The search starts where `mesh` is, or at the Tutte embedding, whichever is less tangled.

    Raises ValueError for more than one mesh, or for quads.
    """
    if len(mesh) != 1 or len(mesh.quads):
        raise ValueError(f"enough_flips takes one mesh of triangles, not {len(mesh)} with {len(mesh.quads)} quads")
    held = holding(mesh).to("cpu")
    search = _Search(held, options or FlipSearch())
    found = search.found()
    if found:
        search.take_back()
        done = held.with_triangles(search.wired(search.flips).triangles()).with_points(search.points)
    else:
        from .retriangulation import retriangulate_cavities

        done, _ = retriangulate_cavities(held.with_points(search.points))
        if not bool(upright(done).all()):
            return None
    edges, others = ({frozenset(edge) for face in m.triangles.tolist() for edge in _edges(face)} for m in (held, done))
    whole = mesh.with_triangles(done.triangles.to(mesh.triangles)).with_points(done.points.to(mesh.points))
    return EnoughFlips(whole, tuple(search.flips) if found else None, len(edges - others))


class _Wiring:
    """The triangles of one mesh, flipped edge by edge; rows stay."""

    def __init__(self, mesh: MeshBatch) -> None:
        self.faces = mesh.triangles.tolist()
        self.row = {edge: row for row, face in enumerate(self.faces) for edge in _edges(face)}
        self.stay = {frozenset(edge) for edge in mesh.constrained_edges.tolist()}

    def across(self, a: int, b: int) -> Edge | None:
        """The corners left and right of the edge from a to b, if it can be flipped."""
        one, other = self.row.get((a, b)), self.row.get((b, a))
        if one is None or other is None or {a, b} in self.stay:
            return None
        c, d = (next(v for v in self.faces[row] if v not in (a, b)) for row in (one, other))
        return None if c == d or (c, d) in self.row or (d, c) in self.row else (c, d)

    def flip(self, a: int, b: int) -> bool:
        """Flip the edge, if that can be."""
        ends = self.across(a, b)
        if ends is None:
            return False
        c, d = ends
        one, other = self.row.pop((a, b)), self.row.pop((b, a))
        for row, face in ((one, [a, d, c]), (other, [d, b, c])):
            self.faces[row] = face
            self.row.update(dict.fromkeys(_edges(face), row))
        return True

    def triangles(self) -> Tensor:
        return torch.tensor(self.faces, dtype=torch.int64)


def _edges(face: list[int]) -> tuple[Edge, Edge, Edge]:
    a, b, c = face
    return (a, b), (b, c), (c, a)


class _Search:
    """Flips of one mesh, and the positions (V, 2) that areas were pushed to after them."""

    def __init__(self, mesh: MeshBatch, options: FlipSearch) -> None:
        self.mesh, self.options = mesh, options
        self.flips: list[Edge] = []
        self.points, self.inverted = mesh.points, int((~upright(mesh)).sum())
        self.lack = float("inf")
        self.fewer_trials = max(1.0, len(mesh.triangles) / options.size)
        self.size = sizes_to_push(mesh, options.ways)
        self.take(self.flips, *pushed(mesh, options.ways, self.size))

    def take(self, flips: list[Edge], points: Tensor, inverted: int, lack: float) -> bool:
        """Go on with these if they are better."""
        if (inverted, lack) > (self.inverted, self.lack):
            return False
        self.flips, self.points, self.inverted, self.lack = flips, points, inverted, lack
        return True

    def wired(self, flips: list[Edge]) -> _Wiring:
        wiring = _Wiring(self.mesh)
        for edge in flips:
            wiring.flip(*edge)
        return wiring

    def pushed(self, wiring: _Wiring) -> tuple[Tensor, int, float]:
        return pushed(self.mesh.with_triangles(wiring.triangles()), self.options.ways, self.size, self.points)

    def found(self) -> bool:
        """Look until no triangle is inverted; is none?"""
        for _ in range(self.options.rounds):
            if not self.inverted:
                return True
            wiring = self.wired(self.flips)
            less = _lowering(wiring, self.points.double().numpy())
            if not less or not self.take(self.flips + less, *self.pushed(wiring)):
                break
        first = self.flips, self.points, self.inverted, self.lack
        for stay, most in ((False, self.options.near), (True, self.options.near // 2)):
            if 0 < first[2] <= most and self.inverted:
                self.flips, self.points, self.inverted, self.lack = first
                self.tried(stay)
        return not self.inverted

    def tried(self, stay: bool) -> None:
        """Try single flips, and go on with the best of them even if it is worse than what was (tabu search).

        stay  vertices stay where pushing areas leaves more inverted triangles
        """
        left = int(self.options.trials / self.fewer_trials)
        made, fewest, quiet = list[frozenset[int]](), self.inverted, 0
        while self.inverted and left > 0 and quiet < self.options.patience:
            wiring = self.wired(self.flips)
            offers = _near(wiring, self.points.double().numpy())
            fresh = [edge for edge in offers if frozenset(edge) not in made[-self.options.tabu :]]
            fresh = (fresh or offers)[: min(left, self.options.width)]
            if not fresh:
                break
            flips, points, before = self.flips, self.points, self.inverted
            self.inverted, self.lack = len(wiring.faces) + 1, float("inf")
            for edge in fresh:
                wiring = self.wired(flips)
                ends = wiring.across(*edge)
                wiring.flip(*edge)
                left -= 1
                turned = self.mesh.with_triangles(wiring.triangles()).with_points(points)
                tried = pushed(turned, self.options.ways, self.size, points)
                if stay:
                    tried = min(tried, (points, int((~upright(turned)).sum()), float("inf")), key=lambda t: t[1:])
                if self.take([*flips, edge], *tried):
                    last = frozenset(ends or ())
                if self.inverted < before:
                    break
            made.append(last)
            quiet = 0 if self.inverted < fewest else quiet + 1
            fewest = min(fewest, self.inverted)

    def take_back(self) -> None:
        """Take back flips as long as pushing areas suffices."""
        left = max(4, int(self.options.back / self.fewer_trials))
        part = max(1, len(self.flips) // 2)
        while left > 0 and self.flips:
            first = 0
            while first < len(self.flips) and left > 0:
                wiring = _Wiring(self.mesh)
                flips = [e for e in self.flips[:first] + self.flips[first + part :] if wiring.flip(*e)]
                points, inverted, _ = self.pushed(wiring)
                left -= 1
                if inverted:
                    first += part
                else:
                    self.flips, self.points = flips, points
            if part == 1:
                break
            part //= 2


def _lowering(wiring: _Wiring, points: np.ndarray) -> list[Edge]:
    """Flip edges of inverted triangles that share no triangle, where that lowers the inverted area; those flipped."""
    offers = [offer for offer in _offers(wiring, points) if offer[0] < 0]
    taken: set[int] = set()
    made: list[Edge] = []
    for _, (a, b) in sorted(offers):
        rows = {wiring.row.get((a, b), -1), wiring.row.get((b, a), -1)}
        if -1 not in rows and not rows & taken and wiring.flip(a, b):
            made.append((a, b))
            taken |= rows
    return made


def _near(wiring: _Wiring, points: np.ndarray) -> list[Edge]:
    """The edges of inverted triangles that can be flipped, those first that add least inverted area."""
    return [edge for _, edge in sorted(_offers(wiring, points))]


def _offers(wiring: _Wiring, points: np.ndarray) -> list[tuple[float, Edge]]:
    """The edges of inverted triangles that can be flipped, and how much inverted area that adds."""
    faces = np.array(wiring.faces)
    inverted = np.flatnonzero(_areas(points, faces) <= 0)
    edges = {tuple(sorted(edge)) for row in inverted.tolist() for edge in _edges(wiring.faces[row])}
    offers = []
    for a, b in sorted(edges):
        ends = wiring.across(a, b)
        if ends is not None:
            c, d = ends
            around = np.array([[a, b, c], [b, a, d], [a, d, c], [d, b, c]])
            lack = np.minimum(_areas(points, around), 0.0)
            offers.append((float(lack[:2].sum() - lack[2:].sum()), (a, b)))
    return offers


def _areas(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = points[faces].transpose(1, 0, 2)
    area: np.ndarray = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return area
