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
from ..mesh.units import centre_and_unit
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
    ceiling  the last smoothing has no higher ceiling than this: with 1.5, as splits and collapses have it, a few triangles
             stay between 1.3 and 1.45 for which there is room
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


def mesh_anew(
    batch: MeshBatch, remesh: RemeshOptions, names: Names, options: AnewOptions | None = None
) -> Anew | None:
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
    points = batch.points.to(torch.float64) / spread(centre_and_unit(batch.points, batch.point_offsets)[1],
                                                     batch.point_offsets)[:, None]  # fmt: skip
    edges = connectivity.boundary_edges(batch.triangles, batch.twin)
    ends = offsets_from_counts(torch.bincount(owner_of(edges[:, 0], batch.point_offsets), minlength=len(batch)))
    locks = offsets_from_counts(torch.bincount(constraint_owner(batch), minlength=len(batch)))
    held = _held(batch)
    meshers: list[Mesher | None] = []
    for b, (start, stop) in enumerate(zip(batch.point_offsets.tolist(), batch.point_offsets.tolist()[1:], strict=False)):
        own, kept = (v[slice(*o[b : b + 2].tolist())] for v, o in ((edges, ends), (batch.constrained_edges, locks)))
        mesher = outline_mesher(points[start:stop], held[start:stop], own - start, kept - start)
        meshers.append(None if mesher.fault else mesher)
    return meshers


def _held(batch: MeshBatch) -> Tensor:
    """(V,) bool: the vertices that must be in the mesh; those in no triangle need not."""
    used = torch.zeros_like(batch.fixed)
    used[batch.triangles.reshape(-1)] = True
    return (batch.fixed | interface_vertices(batch)) & used


def _placed(
    given: MeshBatch, meshers: list[Mesher], remesh: RemeshOptions, names: Names, options: AnewOptions
) -> tuple[MeshBatch, Tensor, Names, Tensor]:
    """The meshes with vertices where the front has placed them; sizes, names, and which vertices are old (V',) bool."""
    size = _sizes(given, meshers, remesh, options.inward)
    unit = centre_and_unit(given.points, given.point_offsets)[1]
    scaled = size / spread(unit, given.point_offsets)
    found, starts = [], given.point_offsets.tolist()
    for b, mesher in enumerate(meshers):
        found.append(mesher.mesh(scaled[starts[b] : starts[b + 1]], options.front.done, options.front.room))
    added = torch.tensor([len(f[1]) for f in found])
    new_owner = torch.arange(len(found)).repeat_interleave(added)
    points = torch.cat([f[1] for f in found]) * unit[new_owner][:, None]
    wanted = torch.cat([f[2] for f in found]) * unit[new_owner]
    corners = torch.cat([f[3] for f in found]) + given.point_offsets[new_owner][:, None]
    weights = torch.cat([f[4] for f in found])
    taken = _nearest_old(given, points, options.near * wanted, corners)
    # Rows of old vertices, -1 for those that go, and of new positions: first all that stay, mesh by mesh, in order.
    stays = given.fixed | interface_vertices(given)
    stays[taken[taken >= 0]] = True
    fresh = true_rows(taken < 0)
    row_owner = torch.cat([vertex_mesh(given)[stays], new_owner[fresh]])
    order = row_owner.argsort(stable=True)
    row = torch.empty_like(order)
    row[order] = torch.arange(len(order))
    old_row, new_row = torch.full((len(given.points),), -1), torch.empty(len(points), dtype=torch.int64)
    old_row[stays] = row[: int(stays.sum())]
    new_row[fresh] = row[int(stays.sum()) :]
    new_row[taken >= 0] = old_row[taken[taken >= 0]]
    at, sizes = given.points.clone(), size.clone()
    at[taken[taken >= 0]], sizes[taken[taken >= 0]] = points[taken >= 0].to(at.dtype), wanted[taken >= 0]
    triangles = _renamed([f[0] for f in found], given, old_row, new_row, added)
    own = names.fresh + torch.arange(len(fresh))
    of = torch.cat([names.of[stays], own])[order]
    placed = names.with_placed(of, Placed(own, names.of[corners[fresh]], weights[fresh]))
    flags = torch.zeros(len(fresh), dtype=torch.bool)
    counts = torch.bincount(row_owner, minlength=len(given))
    whole = MeshBatch(
        torch.cat([at[stays], points[fresh].to(at.dtype)])[order],
        triangles,
        torch.cat([given.fixed[stays], flags])[order],
        old_row[given.constrained_edges],
        offsets_from_counts(counts),
        offsets_from_counts(torch.tensor([len(f[0]) for f in found])),
        given.frames,
    )
    return whole, torch.cat([sizes[stays], wanted[fresh]])[order], placed, torch.cat([~flags[:0].new_zeros(int(stays.sum())), flags])[order]


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


def _nearest_old(given: MeshBatch, points: Tensor, reach: Tensor, corners: Tensor) -> Tensor:
    """(N,) for each new position the free old vertex that takes it, -1 for none; each takes the nearest."""
    free = ~(given.fixed | interface_vertices(given))
    far = (given.points[corners].to(points.dtype) - points[:, None]).square().sum(2)
    far = torch.where(free[corners], far, torch.inf)
    distance, column = far.min(1)
    near = corners.gather(1, column[:, None])[:, 0]
    asks = true_rows(distance < reach.square())
    least = distance.new_full((len(given.points),), torch.inf)
    least.scatter_reduce_(0, near[asks], distance[asks], "amin")
    asks = asks[distance[asks] == least[near[asks]]]
    first = torch.full((len(given.points),), len(points))
    first.scatter_reduce_(0, near[asks], asks, "amin")
    taken = torch.full((len(points),), -1)
    winners = asks[first[near[asks]] == asks]
    taken[winners] = near[winners]
    return taken


def _renamed(
    triangles: list[Tensor], given: MeshBatch, old_row: Tensor, new_row: Tensor, added: Tensor
) -> Tensor:
    """(T, 3) the triangles of all meshes in the rows of the new batch."""
    rows, starts, shift = [], given.point_offsets.tolist(), offsets_from_counts(added).tolist()
    for b, own in enumerate(triangles):
        count = starts[b + 1] - starts[b]
        name = torch.cat([old_row[starts[b] : starts[b + 1]], new_row[shift[b] : shift[b + 1]]])
        assert count + shift[b + 1] - shift[b] == len(name)
        rows.append(name[own])
    return torch.cat(rows)
