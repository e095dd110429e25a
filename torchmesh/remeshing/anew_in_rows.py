"""The free vertices of a tangled mesh at new positions, from its boundary alone: their number and all rows stay.

    tangled mesh --> sizes of its boundary --> front, as many vertices --> old vertices at the nearest new positions
                                                                       +-> new triangles in the nearest old rows

It is what `anew` does under topology "full", with two differences.  The sizes are scaled such that the front places a
few vertices less than there are, and the rest go where circles are largest.  And the vertices of the tangled mesh
travel to the new positions, most of them to one that is near.
"""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.connectivity import corners_of, half_edges_on, heads, tails, touching, triangle_components
from ..mesh.interfaces import interface_vertices
from ..mesh.kept_edges import constrained_half_edges
from ..mesh.matching import pairs_nearby
from ..mesh.measure import Quality
from ..mesh.ragged import true_rows
from ..mesh.triangle import SQRT3
from ..mesh.units import centre_and_unit_of_triangles
from ..triangulating.front import FrontOptions, Mesher, is_compiled, outline_mesher
from .sizing import InwardOptions, boundary_sizes


@dataclass(frozen=True)
class InRowsOptions:
    """How `anew_in_rows` works.

    front      how vertices are placed
    inward     how the sizes of the boundary are continued inwards
    sample     sizes are continued over the boundary and so many other vertices for each edge of it
    least_sample  but over so many other vertices at least
    fuller     a front makes about so many times as many triangles as equilateral triangles of its sizes would fill the
               region (measured: 1.04 to 1.06).  Its sizes are therefore scaled such that the number of these
               equilateral triangles is the number of triangles wanted, divided by `fuller`
    lacking    the share of the free vertices that the front may leave to be placed where circles are largest
    tries      how often the front is begun, each time with other sizes if the number of its vertices does not fit
    good       triangles of at most this inverse mean ratio have the size that is meant at their place
    own_size   sizes that are continued from the boundary say how long edges round a vertex would be.  A vertex all of
               whose triangles are good has a size of its own if its edges are more than so many times as long as that,
               or if that is more than so many times as long as its edges
    own_share  a region is left alone if more than this share of the vertices among good triangles have a size of their
               own.  Holes that FEMWARP moved with the mesh round them left shares of up to 0.33, most of them 0.07 to
               0.1; meshes with a wake refined by 1.5, 2 and 4 had 0.53, 0.45 and 0.74
    regions    meshes of more regions to be made anew are left alone, as each of them takes a look at the whole mesh
    """

    front: FrontOptions = field(default_factory=FrontOptions)
    inward: InwardOptions = field(default_factory=lambda: InwardOptions(accuracy=1e-3, bisections=12))
    sample: float = 4.0
    least_sample: int = 500
    fuller: float = 1.058
    lacking: float = 0.05
    tries: int = 3
    good: float = 1.05
    own_size: float = 1.5
    own_share: float = 0.35
    regions: int = 20


def is_quick(batch: MeshBatch) -> bool:
    """Whether `anew_in_rows` takes less time than untangling: without compiled loops a front takes far more."""
    return is_compiled(batch.points)


def anew_in_rows(
    mesh: MeshBatch, known: Quality, share: float | None = None, options: InRowsOptions | None = None
) -> MeshBatch | None:
    """A batch of one mesh with free vertices at new positions and other triangles; None where that cannot be done.

    Parts, and regions that constrained edges close off, are made anew one by one.  Fixed vertices, the ends of
    constrained edges, and boundary and constrained edges stay, and so do regions without free vertices.  A region is
    left alone where its boundary crosses, touches or lies over itself, and where its good triangles have sizes of their
    own.  Whether the result is valid in the precision of the positions, the caller finds out.

    known  the quality of the mesh
    share  regions in which no more than this share of the triangles is inverted are left alone; None: no region is
    """
    options, made = options or InRowsOptions(), None
    for rows in _regions(mesh, known, share, options):
        done = _remade(mesh if made is None else made, rows, known, options)
        made = made if done is None else done
    return made


def _regions(mesh: MeshBatch, known: Quality, share: float | None, options: InRowsOptions) -> list[Tensor]:
    """The triangles of each region to be made anew."""
    walls = constrained_half_edges(mesh) if len(mesh.constrained_edges) else None
    region = triangle_components(mesh.triangles, mesh.twin, walls)
    count = torch.bincount(region)
    at = torch.bincount(region[touching(mesh.triangles, _loose(mesh))], minlength=len(count)) > 0
    if share is not None:
        at &= torch.bincount(region[~known.upright], minlength=len(count)) > share * count
    regions = true_rows(at).tolist()
    return [true_rows(region == k) for k in regions] if len(regions) <= options.regions else []


def _loose(mesh: MeshBatch) -> Tensor:
    """(V,) bool, the vertices that are neither fixed nor ends of constrained edges."""
    return ~(mesh.fixed | interface_vertices(mesh))


def _remade(mesh: MeshBatch, rows: Tensor, known: Quality, options: InRowsOptions) -> MeshBatch | None:
    """The mesh with the region of the triangles `rows` (T',) made anew; None where that cannot be done."""
    outline = _Outline.of(mesh, rows, options)
    mesher = outline.mesher()
    if mesher.fault:
        return None
    size = outline.sizes(mesher, len(rows), options)
    if _has_own_sizes(mesh, known, outline, mesher, size, options):
        return None
    made = _placed(outline, mesher, size, options)
    if made is None or len(made[0]) != len(rows):
        return None
    triangles, positions = made
    free = true_rows(outline.free)
    travels = free[pairs_nearby(outline.points[free], positions)]
    triangles = torch.cat([outline.vertices, travels])[triangles]
    moved, points = mesh.points.clone(), outline.points.clone()
    moved[travels] = (positions * outline.unit).to(moved.dtype)
    points[travels] = positions
    whole = mesh.triangles.clone()
    whole[rows[_nearby_rows(triangles, mesh.triangles[rows], outline, points)]] = triangles
    return mesh.with_points(moved).with_triangles(whole)


@dataclass(frozen=True, eq=False)
class _Outline:
    """What a mesher is given: one region of a mesh.

    unit      a power of two near its size
    points    (V, 2) float64 in that unit
    free      (V,) bool, the vertices that may move
    vertices  (N,) int64, ascending, the vertices that may not, and a sample of the others
    held      (N,) bool, those that may not
    edges, segments  (E, 2) and (K, 2) int64, rows of `vertices`: boundary of the region, and constrained edges in it
    frames    those of the mesh
    """

    unit: Tensor
    points: Tensor
    free: Tensor
    vertices: Tensor
    held: Tensor
    edges: Tensor
    segments: Tensor
    frames: Tensor

    @classmethod
    def of(cls, mesh: MeshBatch, rows: Tensor, options: InRowsOptions) -> "_Outline":
        """The outline of the triangles `rows` (T',) of a batch of one mesh."""
        unit = centre_and_unit_of_triangles(mesh.points, mesh.triangles, mesh.point_offsets)[1]
        count = len(mesh.points)
        mine = torch.zeros(len(mesh.triangles), dtype=torch.bool).index_fill_(0, rows, True)
        here = corners_of(mesh.triangles, mine, count)
        free, still = here & _loose(mesh), here & ~_loose(mesh)
        h = (3 * rows[:, None] + torch.arange(3)).reshape(-1)
        across = mesh.twin[h]
        inner = (across >= 0) & mine[across.clamp_min(0) // 3]
        walls = half_edges_on(mesh.triangles, mesh.constrained_edges, count)[h] & inner & (h < across)
        ends = torch.stack([tails(mesh.triangles), heads(mesh.triangles)], 1)
        edges, segments = ends[h[~inner]], ends[h[walls]]
        # Sizes vary slowly, so some vertices suffice.  Their choice by row follows no pattern of the mesh: the
        # multiplier is that of Knuth's multiplicative hashing.
        share = max(options.least_sample, options.sample * len(edges)) / max(int(free.sum()), 1)
        bits = (torch.arange(count) * 2654435761) % 2**32
        vertices = true_rows(still | (free & (bits < share * 2**32)))
        row = torch.full((count,), -1)
        row[vertices] = torch.arange(len(vertices))
        points = mesh.points.to(torch.float64) / unit
        return cls(unit, points, free, vertices, still[vertices], row[edges], row[segments], mesh.frames)

    def mesher(self) -> Mesher:
        """A mesher that has placed nothing yet."""
        return outline_mesher(self.points[self.vertices], self.held, self.edges, self.segments)

    def sizes(self, mesher: Mesher, triangles: int, options: InRowsOptions) -> Tensor:
        """(N,) the sizes with which a front makes about so many triangles, by `InRowsOptions.fuller`."""
        background = mesher.background()
        of_points, of_triangles = (torch.tensor([0, len(rows)]) for rows in (self.vertices, background))
        mesh = MeshBatch(
            self.points[self.vertices], background, self.held, self.segments, of_points, of_triangles, self.frames
        )
        size = boundary_sizes(mesh, torch.tensor([triangles]), options.inward)
        a, b, c = (mesh.points[corner] for corner in background.unbind(1))
        area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        # So many equilateral triangles of these sizes would fill the region; there should be `triangles / fuller`.
        room = (area / size[background].mean(1).square()).sum() * (4 / SQRT3)
        return size * (options.fuller * room / triangles).sqrt()


def _has_own_sizes(
    mesh: MeshBatch, known: Quality, outline: _Outline, mesher: Mesher, size: Tensor, options: InRowsOptions
) -> bool:
    """Whether the good triangles have sizes that the boundary does not tell, as where a wake is refined."""
    bad = ~known.upright | (known.inverse_mean_ratio > options.good)
    count = len(mesh.points)
    good = ~corners_of(mesh.triangles, bad, count)[outline.vertices]
    inside = corners_of(mesher.background(), torch.ones(len(mesher.background()), dtype=torch.bool), len(good))
    asked = good & inside & ~outline.held
    if not bool(asked.any()):
        return False
    corner = mesh.triangles.reshape(-1)
    number = torch.bincount(corner, minlength=count).clamp_min(1)
    area = torch.zeros(count, dtype=torch.float64).index_add_(0, corner, known.area.abs().repeat_interleave(3)) / number
    side = (area * (4 / SQRT3)).sqrt()[outline.vertices] / outline.unit
    ratio = (side / size)[asked]
    own = (ratio > options.own_size) | (ratio * options.own_size < 1)
    return float(own.double().mean()) > options.own_share


def _placed(outline: _Outline, mesher: Mesher, size: Tensor, options: InRowsOptions) -> tuple[Tensor, Tensor] | None:
    """The triangles (T, 3) and positions (F, 2) of a front with as many new vertices as there are free ones."""
    wanted = int(outline.free.sum())
    few = int((1 - options.lacking) * wanted)
    for turn in range(options.tries):
        mesher = outline.mesher() if turn else mesher
        triangles, positions, *_ = mesher.mesh(size, *options.front.numbers, (few, wanted))
        found = len(positions)
        if found == wanted:
            return triangles, positions
        # Half of what may be left over is left over.
        size = size * (max(found, 1) / (wanted * (1 - 0.5 * options.lacking))) ** 0.5
    return None


def _nearby_rows(triangles: Tensor, before: Tensor, outline: _Outline, points: Tensor) -> Tensor:
    """(T,) int64 the rows of `before` (T, 3) that the new `triangles` (T, 3) take; vertices are at `points` (V, 2).

    Triangles of vertices that may not move keep their rows.  The others take those of old triangles near them.
    """
    old_still, new_still = (true_rows(~touching(rows, outline.free)) for rows in (before, triangles))
    names = torch.cat([before[old_still], triangles[new_still]]).sort(1).values
    _, name = names.unique(dim=0, return_inverse=True)
    of_name = torch.full((len(names),), -1)
    of_name[name[: len(old_still)]] = old_still
    rows = torch.full((len(triangles),), -1)
    rows[new_still] = of_name[name[len(old_still) :]]
    left = torch.ones(len(before), dtype=torch.bool)
    left[rows[rows >= 0]] = False
    olds, news = true_rows(left), true_rows(rows < 0)
    rows[news] = olds[pairs_nearby(outline.points[before[olds]].mean(1), points[triangles[news]].mean(1))]
    return rows
