r"""A few flips after which a mesh can be untangled with its triangles kept, where without any it was not.

       c              c         Edges are flipped where that lowers what areas lack to a bound, and areas are pushed up
      / \            /|\        (`persisting.pushed`), and again, until no triangle is inverted.  Where that gains
     a---b    -->   a | b       nothing, edges of inverted triangles are flipped one at a time for a trial, areas are
      \ /            \|/        pushed, and the best flip is kept.  Then flips are taken back, half of them, a quarter
       d              d         and so on, one by one in the end, as long as pushing areas suffices.

All of that is done several times, with few flips a round and with many, and the shortest list of flips is told.  It is
enough; nothing says that fewer would not be.  Where no flips are found, cavities are triangulated anew.
"""

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh.batch import MeshBatch
from ..mesh.interfaces import holding
from ..mesh.measure import upright
from ..mesh.typed import typed
from ..mesh.unfit import unfit_meshes, what_is_unfit
from .options import NewtonWays
from .persisting import pushed, sizes_to_push
from .wiring import Edge, Wiring, backwards, costs, edges_of, flip_apart, offers, way_between

__all__ = ["EnoughFlips", "FlipSearch", "enough_flips"]


@dataclass(frozen=True)
class Descent:
    """How flips are chosen that lower what areas lack.

    part    of all edges whose flip does so, so many are flipped before areas are pushed again, the best ones
    every   edges of all triangles below the bound are looked at, not those of inverted triangles alone
    anew    from the Tutte embedding on, not from where the mesh is
    rounds  of growing weights at most, each time that areas are pushed
    """

    part: float = 1.0
    every: bool = False
    anew: bool = False
    rounds: int = 1


@dataclass(frozen=True)
class FlipSearch:
    """How long `enough_flips` looks.

    size      a mesh of up to so many triangles gets all `descents`, `trials` and `back`.  For a mesh of k times as many
              triangles these numbers are divided: `descents` and `trials` by k, `back` by the root of k
    descents  how flips are chosen, tried one after the other.  Of a mesh of more than `size` triangles the first ones
              alone are tried, but at least two
    few       so few flips are good enough for no other descent to be tried
    best      lists of flips, the shortest ones, from which flips are taken back
    longer    of these, lists that are so many times as long as the shortest are left out
    rounds    of flips and of pushing areas in a descent, at most
    quiet     rounds without fewer inverted triangles than ever before, after which a descent ends
    trials    single flips that are tried at most after a descent, for a mesh of up to `size` triangles
    width     flips of which the best is kept; one that leaves fewer inverted triangles is kept at once
    patience  flips without fewer inverted triangles than ever before, after which these trials end
    tabu      so many of the last edges that came by a flip are not flipped
    near      single flips are tried only if no more triangles than this are inverted after a descent
    back      how often, at most, it is tried to take flips of one list back, for a mesh of up to `size` triangles; at
              least 8 times for a larger one
    shortened  other ways to the same triangles are looked for if a list has no more flips than this
    ways      how areas are pushed
    """

    descents: tuple[Descent, ...] = (
        Descent(0.25),
        Descent(),
        Descent(every=True, anew=True),
        Descent(rounds=6),
        Descent(0.25, every=True, anew=True),
    )
    few: int = 3
    best: int = 2
    longer: float = 1.5
    rounds: int = 40
    quiet: int = 12
    trials: int = 40
    width: int = 6
    patience: int = 8
    tabu: int = 8
    near: int = 40
    back: int = 150
    shortened: int = 700
    size: int = 300
    ways: NewtonWays = field(default_factory=lambda: NewtonWays(betas=(0.1,), pushes=20, weightings=((100, 0.1, 3.0),)))


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
            return f"with {self.replaced} other edges it is possible (cavities were triangulated anew; an upper bound)"
        named = ", ".join(f"{a}-{b}" for a, b in self.edges[:most])
        more = f" and {len(self.edges) - most} more" if len(self.edges) > most else ""
        count = "1 flip is" if len(self.edges) == 1 else f"{len(self.edges)} flips are"
        return f"{count} enough to make it possible: {named}{more} (the fewest that were found, an upper bound)"


@typed
def enough_flips(mesh: MeshBatch, options: FlipSearch | None = None) -> EnoughFlips | None:
    """Flips after which one mesh of triangles is untangled; None where nothing was found.

    Constrained edges stay.  The search starts where `mesh` is, or at the Tutte embedding, whichever is less tangled.

    Raises ValueError for more than one mesh, or for quads, and InvalidMeshError for a position that is not finite, or
    beyond 1e150.
    """
    if len(mesh) != 1 or len(mesh.quads):
        raise ValueError(f"enough_flips takes one mesh of triangles, not {len(mesh)} with {len(mesh.quads)} quads")
    if bool(unfit_meshes(mesh)[0]):
        raise InvalidMeshError(f"mesh 0: {what_is_unfit(mesh, 0)[0]}")
    held = holding(mesh).to("cpu")
    search = _Search(held, options or FlipSearch())
    found = search.found()
    if found.inverted:
        from .retriangulation import retriangulate_cavities

        done, _ = retriangulate_cavities(held.with_points(search.start.points))
        if not bool(upright(done).all()):
            return None
    else:
        done = held.with_triangles(search.wired(found.flips).triangles()).with_points(found.points)
    edges, others = (
        {frozenset(edge) for face in m.triangles.tolist() for edge in edges_of(face)} for m in (held, done)
    )
    whole = mesh.with_triangles(done.triangles.to(mesh.triangles)).with_points(done.points.to(mesh.points))
    return EnoughFlips(whole, None if found.inverted else found.flips, len(edges - others))


@dataclass(frozen=True)
class _State:
    """Flips of one mesh, the positions (V, 2) that areas were pushed to after them, and what is inverted there.

    lack  the sum of negative areas, as `pushed` tells it
    """

    flips: tuple[Edge, ...]
    points: Tensor
    inverted: int
    lack: float = float("inf")

    @property
    def rank(self) -> tuple[int, float]:
        return self.inverted, self.lack


class _Search:
    """The search for flips of one mesh; `start` has none."""

    def __init__(self, mesh: MeshBatch, options: FlipSearch) -> None:
        self.mesh, self.options = mesh, options
        self.wiring = Wiring(mesh)
        self.size = sizes_to_push(mesh, options.ways)
        self.order = list[np.ndarray]()
        fewer = max(1.0, len(mesh.triangles) / options.size)
        self.descents = options.descents[: max(2, math.ceil(len(options.descents) / fewer))]
        self.trials, self.back = int(options.trials / fewer), max(8, int(options.back / math.sqrt(fewer)))
        self.start = self.anew = _State((), mesh.points, int((~upright(mesh)).sum()))
        if self.start.inverted:
            self.anew = self.pushed((), self.wiring, None, 1)
            self.start = min(self.start, self.anew, key=lambda s: s.rank)

    def wired(self, flips: tuple[Edge, ...]) -> Wiring:
        wiring = self.wiring.copy()
        for edge in flips:
            wiring.flip(*edge)
        return wiring

    def pushed(self, flips: tuple[Edge, ...], wiring: Wiring, points: Tensor | None, rounds: int) -> _State:
        """What pushing areas from `points` leads to, with these flips, which lead to that wiring."""
        ways = replace(self.options.ways, weight_rounds=rounds)
        return _State(flips, *pushed(self.mesh.with_triangles(wiring.triangles()), ways, self.size, points, self.order))

    def found(self) -> _State:
        """The shortest list of flips that was found; if none was, some triangle is inverted."""
        some = list[_State]()
        for descent in self.descents if self.start.inverted else ():
            state = self.descended(descent)
            if 0 < state.inverted <= self.options.near:
                state = self.tried(state)
            if not state.inverted:
                some.append(self.shortened(state))
                if len(some[-1].flips) <= self.options.few:
                    break
        some.sort(key=lambda state: len(state.flips))
        near = [state for state in some if len(state.flips) <= self.options.longer * len(some[0].flips)]
        some = [self.taken_back(state) for state in near[: self.options.best]]
        return min(some, key=lambda state: len(state.flips)) if some else self.start

    def descended(self, descent: Descent) -> _State:
        """Flip and push until no triangle is inverted, or nothing is gained."""
        state, best = self.anew if descent.anew else self.start, None
        wiring, quiet = self.wiring.copy(), 0
        size, least = self.size.numpy(), min(self.options.ways.betas)
        for _ in range(self.options.rounds):
            if not state.inverted or quiet >= self.options.quiet:
                break
            points = state.points.double().numpy()
            for every in (descent.every, True):
                edges = [edge for added, edge in offers(wiring, points, size, least, every) if added < 0]
                if edges:
                    break
            else:
                break
            made = flip_apart(wiring, edges, math.ceil(descent.part * len(edges)))
            state = self.pushed((*state.flips, *made), wiring, state.points, descent.rounds)
            quiet = 0 if best is None or state.inverted < best.inverted else quiet + 1
            best = state if best is None else min(best, state, key=lambda s: s.rank)
        return best or state

    def tried(self, state: _State) -> _State:
        """Try single flips, and go on with the best of them even if it is worse than what was (tabu search)."""
        options, left = self.options, self.trials
        made, fewest, quiet = list[frozenset[int]](), state.inverted, 0
        while state.inverted and left > 0 and quiet < options.patience:
            wiring = self.wired(state.flips)
            points = state.points.double().numpy()
            edges = [edge for _, edge in offers(wiring, points, self.size.numpy(), min(options.ways.betas), False)]
            fresh = [edge for edge in edges if frozenset(edge) not in made[-options.tabu :]]
            fresh = (fresh or edges)[: min(left, options.width)]
            if not fresh:
                break
            tries = list[tuple[_State, frozenset[int]]]()
            for edge in fresh:
                wired = wiring.copy()
                ends = wired.across(*edge)
                wired.flip(*edge)
                left -= 1
                tries.append((self.pushed((*state.flips, edge), wired, state.points, 1), frozenset(ends or ())))
                if tries[-1][0].inverted < state.inverted:
                    break
            state, last = min(tries, key=lambda t: t[0].rank)
            made.append(last)
            quiet = 0 if state.inverted < fewest else quiet + 1
            fewest = min(fewest, state.inverted)
        return state

    def taken_back(self, state: _State) -> _State:
        """Take back flips as long as pushing areas suffices: several together, and one by one in the end.

        Those come first that add least to what areas lack; those that could not be taken back singly come last, once.
        """
        left, part, first = self.back, max(1, len(state.flips) // 4), 0
        stay = defaultdict[Edge, int](int)
        order = self.in_order(state, stay)
        while first < len(order) and left > 0:
            wiring, left = self.wiring.copy(), left - 1
            out = set(order[first : first + part])
            flips = tuple(e for k, e in enumerate(state.flips) if k not in out and wiring.flip(*e))
            less = self.pushed(flips, wiring, state.points, 1)
            if not less.inverted:
                state, first = less, 0
                order = self.in_order(state, stay)
                part = min(part, max(1, len(order) // 4))
            elif part > 1:
                part //= 2
            else:
                stay[state.flips[order[first]]] += 1
                first += 1
        return self.shortened(state)

    def shortened(self, state: _State) -> _State:
        """The same triangles by fewer flips, if such are found: the search may have gone ways round."""
        if len(state.flips) > self.options.shortened:
            return state
        end = self.wired(state.flips)
        ways = [way_between(self.wiring, end), backwards(end, way_between(end, self.wiring))]
        return replace(state, flips=min([state.flips, *(tuple(way) for way in ways if way is not None)], key=len))

    def in_order(self, state: _State, stay: Mapping[Edge, int]) -> list[int]:
        """The flips, those first that are `stay` least and whose taking back adds least to what areas lack."""
        wiring, ends = self.wiring.copy(), list[Edge]()
        for edge in state.flips:
            ends.append(wiring.across(*edge) or edge)
            wiring.flip(*edge)
        least = min(self.options.ways.betas)
        added = costs(wiring, ends, state.points.double().numpy(), self.size.numpy(), least)
        back = [(stay[edge], added[k], k) for k, edge in enumerate(state.flips)]
        return [k for _, _, k in sorted(back)]
