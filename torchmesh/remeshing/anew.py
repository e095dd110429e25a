"""Meshes whose inside is made anew: the boundary stays, and old vertices stay where new ones are needed near them.

    old mesh --> background: its vertices, Delaunay --> sizes --> front --> flips and smoothing --> new mesh
                      |                                              |
                      +--- corners and weights of new vertices <-----+--- an old vertex nearby takes the new position

That is where splits and collapses come to after many rounds, in a tenth of the time.
"""

from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from ..flipping.delaunay import FlipOptions, flip_to_delaunay
from ..mesh import connectivity
from ..mesh.batch import MeshBatch, constraint_owner, put, vertex_mesh
from ..mesh.interfaces import interface_vertices
from ..mesh.measure import quality
from ..mesh.ragged import counts_from_offsets, offsets_from_counts, owner_of, segment_any, spread, true_rows
from ..mesh.units import centre_and_unit_of_triangles
from ..mesh.vertex_map import Names, Placed
from ..smoothing.polishing import PolishOptions, polish
from ..smoothing.smoothing import SmoothOptions, smooth
from ..triangulating.front import FrontOptions, Mesher, outline_mesher
from .options import RemeshOptions
from .sizing import InwardOptions, boundary_sizes, size_field


@dataclass(frozen=True)
class AnewOptions:
    """How `mesh_anew` works.

    front    how vertices are placed
    near     an old vertex takes the position of a new one that is nearer than this many times the size wanted there
    inward   how the sizes of the boundary are continued inwards.  The front reaches them within some percent
    between  the smoothing after the first flips
    ceiling  the last smoothing has no higher ceiling than this: with 1.5, as splits and collapses have it, a few
             triangles stay between 1.3 and 1.45 although there is room
    polish   how the worst triangles are worked on one by one at the end; None: they are not
    worst    inverse mean ratios: triangles above the first are worked on, in meshes that have none those above the next
    """

    front: FrontOptions = field(default_factory=FrontOptions)
    near: float = 0.5
    inward: InwardOptions = field(default_factory=lambda: InwardOptions(bisections=12))
    between: SmoothOptions = field(default_factory=lambda: SmoothOptions(max_iterations=15, energy_tolerance=1e-3))
    ceiling: float = 1.3
    polish: PolishOptions | None = field(
        default_factory=lambda: PolishOptions(
            angle=27.0, max_rounds=1, levels=PolishOptions().levels[:1], limit_share=0.98
        )
    )
    worst: tuple[float, ...] = (1.5, 1.3)


@dataclass(frozen=True, eq=False)
class Anew:
    """What `mesh_anew` made of some of the meshes.

    made      (B,) bool, which meshes have a new inside; the others are not in `batch`
    batch     those meshes
    names     of their vertices
    size      (V,) float64, the size wanted at each vertex
    inserted  (B',) int64 for each of those meshes, the vertices that came
    removed   (B',) int64, the vertices that went
    flips, iterations  (B',) int64
    """

    made: Tensor
    batch: MeshBatch
    names: Names
    size: Tensor
    inserted: Tensor
    removed: Tensor
    flips: Tensor
    iterations: Tensor


def mesh_anew(batch: MeshBatch, remesh: RemeshOptions, names: Names, options: AnewOptions | None = None) -> Anew | None:
    """New insides for the meshes whose boundary allows it, tangled or not; None: there is no such mesh.

    Boundary and constrained edges stay, and so do fixed vertices and the ends of constrained edges.  An old vertex
    near a new position takes it; the others go.  Kept vertices keep their order, and new ones come after them.
    Positions on the boundary that are in one place, edges that cross, and boundaries that lie over themselves do not
    allow it.

    remesh  its sizes ("boundary", "uniform" or a function) and its last smoothing
    names   of the vertices of `batch`
    """
    options = options or AnewOptions()
    meshers = _meshers(batch)
    made = torch.tensor([m is not None for m in meshers], dtype=torch.bool)
    if not bool(made.any()):
        return None
    given = batch.select(made)
    names = names.select(spread(made, batch.point_offsets))
    whole, size, names, old = _placed(given, [m for m in meshers if m is not None], remesh, names, options)
    good = ~segment_any(~quality(whole).upright, whole.triangle_offsets)
    if not bool(good.any()):
        return None
    if not bool(good.all()):
        rows = spread(good, whole.point_offsets)
        made = made.masked_scatter(made, good)
        given, whole, size, names = given.select(good), whole.select(good), size[rows], names.select(rows)
        old = old[rows]
    flips = iterations = torch.zeros(len(whole), dtype=torch.int64)
    last = replace(remesh.smooth, ceiling=min(remesh.smooth.ceiling or options.ceiling, options.ceiling))
    for smoothing in (options.between, last):
        whole, flipped = flip_to_delaunay(whole, FlipOptions(rule="shape"))
        whole, info = smooth(whole, smoothing)
        flips, iterations = flips + flipped.flips, iterations + info.iterations
    if options.polish is not None:
        whole, polished = _polished(whole, options.polish, options.worst)
        flips = flips + polished
    if callable(remesh.sizes):
        size = size_field(whole, remesh.sizes)
    kept = torch.bincount(vertex_mesh(whole)[old], minlength=len(whole))
    inserted, removed = (counts_from_offsets(m.point_offsets) - kept for m in (whole, given))
    return Anew(made, whole, names, size, inserted, removed, flips, iterations)


def _polished(batch: MeshBatch, options: PolishOptions, worst: tuple[float, ...]) -> tuple[MeshBatch, Tensor]:
    """The batch with its worst triangles polished, as `AnewOptions.worst` says; the edges flipped (B,)."""
    flips, highest = torch.zeros(len(batch), dtype=torch.int64), quality(batch).max
    left = torch.ones_like(highest, dtype=torch.bool)
    for ratio in worst:
        at = left & (highest > ratio)
        if bool(at.any()):
            part, info = polish(batch.select(at), replace(options, ratio=ratio))
            batch, flips = put(batch, at, part), flips.masked_scatter(at, info.flips)
        left = left & ~at
    return batch, flips


def _meshers(batch: MeshBatch) -> list[Mesher | None]:
    """For each mesh its mesher; None where there can be none."""
    points = batch.points.to(torch.float64) / spread(_unit(batch), batch.point_offsets)[:, None]
    edges = connectivity.boundary_edges(batch.triangles, batch.twin)
    ends = offsets_from_counts(torch.bincount(owner_of(edges[:, 0], batch.point_offsets), minlength=len(batch)))
    locks = offsets_from_counts(torch.bincount(constraint_owner(batch), minlength=len(batch)))
    held = _held(batch)
    meshers: list[Mesher | None] = []
    for b, (start, stop) in enumerate(
        zip(batch.point_offsets.tolist(), batch.point_offsets.tolist()[1:], strict=False)
    ):
        own, kept = (v[slice(*o[b : b + 2].tolist())] for v, o in ((edges, ends), (batch.constrained_edges, locks)))
        mesher = outline_mesher(points[start:stop], held[start:stop], own - start, kept - start)
        meshers.append(None if mesher.fault else mesher)
    return meshers


def _unit(batch: MeshBatch) -> Tensor:
    """(B,) float64 the unit of each mesh, in which the front works: vertices in no triangle do not count."""
    return centre_and_unit_of_triangles(batch.points, batch.triangles, batch.point_offsets)[1]


def _held(batch: MeshBatch) -> Tensor:
    """(V,) bool: the vertices that must be in the mesh; those in no triangle need not."""
    used = torch.zeros_like(batch.fixed)
    used[batch.triangles.reshape(-1)] = True
    return (batch.fixed | interface_vertices(batch)) & used


@dataclass(frozen=True, eq=False)
class _New:
    """The N positions that the fronts have found, mesh by mesh.

    points   (N, 2) float64
    size     (N,) float64, the sizes wanted there
    corners  (N, 3) int64, the vertices of the triangle of the background in which each is
    weights  (N, 3) float64, with which a linear function over the background is read there
    owner    (N,) int64, the mesh of each
    """

    points: Tensor
    size: Tensor
    corners: Tensor
    weights: Tensor
    owner: Tensor


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of the new batch: in each mesh first the old vertices that stay, in their order, then the others.

    stays    (V,) bool, the old vertices that stay
    fresh    (N,) bool, the new positions that no old vertex has taken
    order    (V',) int64: old vertices that stay and then fresh ones, in the order of the rows
    old, new  (V,) and (N,) int64, the rows of old vertices, -1 for those that go, and of new positions
    offsets  (B+1,) int64, where the rows of each mesh begin
    """

    stays: Tensor
    fresh: Tensor
    order: Tensor
    old: Tensor
    new: Tensor
    offsets: Tensor

    @classmethod
    def of(cls, given: MeshBatch, owner: Tensor, taken: Tensor) -> "_Rows":
        """The rows where the old vertices `taken` (N,), -1 for none, take the new positions with these owners."""
        stays, fresh = given.fixed | interface_vertices(given), taken < 0
        stays[taken[~fresh]] = True
        mesh = torch.cat([vertex_mesh(given)[stays], owner[fresh]])
        order = mesh.argsort(stable=True)
        row = torch.empty_like(order)
        row[order] = torch.arange(len(order))
        count = int(stays.sum())
        old, new = torch.full_like(stays, -1, dtype=torch.int64), torch.empty_like(taken)
        old[stays], new[fresh] = row[:count], row[count:]
        new[~fresh] = old[taken[~fresh]]
        return cls(stays, fresh, order, old, new, offsets_from_counts(torch.bincount(mesh, minlength=len(given))))

    def joined(self, old: Tensor, new: Tensor) -> Tensor:
        """(V', ...) values of old vertices (V, ...) and of new positions (N, ...) in the rows of the new batch."""
        return torch.cat([old[self.stays], new[self.fresh].to(old.dtype)])[self.order]


def _placed(
    given: MeshBatch, meshers: list[Mesher], remesh: RemeshOptions, names: Names, options: AnewOptions
) -> tuple[MeshBatch, Tensor, Names, Tensor]:
    """The meshes with vertices where the fronts have placed them, and of their V' vertices three things.

    These are the sizes wanted (V',), the names, and (V',) bool, which were there before.
    """
    size = _sizes(given, meshers, remesh, options.inward)
    new, triangles = _fronts(given, meshers, size, options.front)
    taken = _nearest_old(given, new, options.near)
    rows = _Rows.of(given, new.owner, taken)
    points, kept = given.points.clone(), taken >= 0
    points[taken[kept]], size[taken[kept]] = new.points[kept].to(points.dtype), new.size[kept]
    fresh = names.fresh + torch.arange(int(rows.fresh.sum()))
    named = torch.empty_like(taken).masked_scatter(rows.fresh, fresh)
    placed = Placed(fresh, names.of[new.corners[rows.fresh]], new.weights[rows.fresh])
    whole = MeshBatch(
        rows.joined(points, new.points),
        _renamed(triangles, given, rows, offsets_from_counts(torch.bincount(new.owner, minlength=len(given)))),
        rows.joined(given.fixed, torch.zeros_like(kept)),
        rows.old[given.constrained_edges],
        rows.offsets,
        offsets_from_counts(torch.tensor([len(t) for t in triangles])),
        given.frames,
    )
    old = rows.joined(torch.ones_like(rows.stays), torch.zeros_like(kept))
    return whole, rows.joined(size, new.size), names.with_placed(rows.joined(names.of, named), placed), old


def _fronts(given: MeshBatch, meshers: list[Mesher], size: Tensor, options: FrontOptions) -> tuple[_New, list[Tensor]]:
    """The new positions, and the triangles (T, 3) of each mesh, where the new ones come after the old vertices."""
    unit, starts = _unit(given), given.point_offsets.tolist()
    scaled = size / spread(unit, given.point_offsets)
    found = [mesher.mesh(scaled[starts[b] : starts[b + 1]], *options.numbers) for b, mesher in enumerate(meshers)]
    owner = torch.arange(len(found)).repeat_interleave(torch.tensor([len(f[1]) for f in found]))
    points, wanted, corners, weights = (torch.cat([f[i] for f in found]) for i in range(1, 5))
    corners += given.point_offsets[owner][:, None]
    return _New(points * unit[owner][:, None], wanted * unit[owner], corners, weights, owner), [f[0] for f in found]


def _sizes(given: MeshBatch, meshers: list[Mesher], remesh: RemeshOptions, inward: InwardOptions) -> Tensor:
    """(V,) float64 the sizes asked for, over the backgrounds of the meshes."""
    triangles = [m.background() for m in meshers]
    offsets = offsets_from_counts(torch.tensor([len(t) for t in triangles]))
    rows = torch.cat(triangles) + spread(given.point_offsets[:-1], offsets)[:, None]
    background = replace(given, triangles=rows, triangle_offsets=offsets)
    wanted = counts_from_offsets(given.triangle_offsets)
    if isinstance(remesh.sizes, str) and remesh.sizes == "boundary":
        return boundary_sizes(background, wanted, inward)
    return size_field(background, remesh.sizes, triangles=wanted)


def _nearest_old(given: MeshBatch, new: _New, near: float) -> Tensor:
    """(N,) for each new position the free old vertex that takes it, -1 for none; each takes the nearest."""
    free = ~(given.fixed | interface_vertices(given))
    far = (given.points[new.corners].to(torch.float64) - new.points[:, None]).square().sum(2)
    distance, column = torch.where(free[new.corners], far, torch.inf).min(1)
    vertex = new.corners.gather(1, column[:, None])[:, 0]
    asks = true_rows(distance < (near * new.size).square())
    least = distance.new_full((len(free),), torch.inf).scatter_reduce_(0, vertex[asks], distance[asks], "amin")
    asks = asks[distance[asks] == least[vertex[asks]]]
    first = torch.full((len(free),), len(distance)).scatter_reduce_(0, vertex[asks], asks, "amin")
    winners = asks[first[vertex[asks]] == asks]
    return torch.full((len(distance),), -1).index_put((winners,), vertex[winners])


def _renamed(triangles: list[Tensor], given: MeshBatch, rows: _Rows, new_offsets: Tensor) -> Tensor:
    """(T, 3) the triangles of all meshes in the rows of the new batch."""
    old, new = given.point_offsets.tolist(), new_offsets.tolist()
    return torch.cat(
        [
            torch.cat([rows.old[old[b] : old[b + 1]], rows.new[new[b] : new[b + 1]]])[own]
            for b, own in enumerate(triangles)
        ]
    )
