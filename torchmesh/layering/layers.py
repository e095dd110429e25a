"""The layers of a mesh: rows of thin quadrilaterals, two triangles each, along a wall.

    x-------x-------x-------x     A wall is the boundary, or one side of a chain of constrained edges.  Over each of
    |     / |     / |     / |     its edges stands a strip of quadrilaterals, which is walked outwards row by row:
    x-------x-------x-------x     two triangles are the next quadrilateral if they are upright and thin, and if their
    |   /   |   /   |   /   |     columns rise steeply from the wall.  The foot of a vertex is the vertex of the wall
    =========================     at the lower end of its column.
            wall

The meshers of boundary layers build such rows (Garimella & Shephard, Boundary layer mesh generation for viscous flow
simulations, International Journal for Numerical Methods in Engineering 49, 2000).  Triangles that a motion has
flattened are no layer: they have no columns, or the strips beside them are of other heights or numbers of rows.
"""

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from ..kernels import geometry, layer_rows
from ..mesh.batch import MeshBatch
from ..mesh.connectivity import edge_components, heads, keys_of, next_in_triangle, previous_in_triangle, tails
from ..mesh.detached import loops_may_read
from ..mesh.kept_edges import constrained_half_edges
from ..mesh.measure import upright
from ..mesh.ragged import true_rows

# A first row is of at least so many quadrilaterals, side by side.
_SIDE_BY_SIDE = 3


@dataclass(frozen=True)
class LayerOptions:
    """What counts as a layer.

    first    the height of the first row is at most this part of the wall's edge below it
    height   the height of each further row is at most this part of that edge, and of its own mean width: where strips
             come together far from a long edge, as in the lattice of a usual mesher, no layer is left
    lean     a column is at most so many times as long as its row is high; 2 is a lean of 60 degrees
    turn     the cosine of the greatest angle between the lower and the upper edge of a quadrilateral
    shrink   a row is at least this part of the row below it high: layers grow outwards
    alike    the first rows of neighbouring strips, and the columns beside them, differ by at most this factor
    rows     a layer has at least so many rows, side by side in at least three strips whose numbers of rows differ by
             one at most.  A motion may flatten a few triangles at a wall: before an airfoil that turned by 60 degrees
             there were two or three rows, before a bar at 45 degrees strips of 1, 4, 7, 2 and 7 rows
    strips   a layer has at least so many strips.  Of 200 bars at some angle that moved, four had 3 to 5 sheared strips,
             some of them even; four high rows beside the long edges of a lattice's wall are none either
    """

    first: float = 0.25
    height: float = 0.5
    lean: float = 2.0
    turn: float = 0.5
    shrink: float = 0.8
    alike: float = 2.0
    rows: int = 4
    strips: int = 6

    @property
    def limits(self) -> tuple[float, ...]:
        """What a single quadrilateral must keep to: all but `rows` and `strips`."""
        return self.first, self.height, self.lean, self.turn, self.shrink, self.alike

    def __post_init__(self) -> None:
        for f in fields(self):
            if not getattr(self, f.name) > 0:
                raise ValueError(f"LayerOptions.{f.name} must be positive, not {getattr(self, f.name)}")


@dataclass(frozen=True, eq=False)
class Layers:
    """The quadrilaterals of all layers of a batch, N in number, those of a row together, the lowest row first.

    wall       (N,) int64, the half-edge of the wall below
    row        (N,) int64, 1 next to the wall
    corners    (N, 4) int64, lower left, lower right, upper right, upper left, seen from the wall
    diagonal   (N, 2) int64, the ends of the edge between its two triangles
    triangles  (N, 2) int64, these triangles
    height     (N,) float64, its area over the mean of its lower and upper edge
    """

    wall: Tensor
    row: Tensor
    corners: Tensor
    diagonal: Tensor
    triangles: Tensor
    height: Tensor

    def __len__(self) -> int:
        return len(self.wall)

    def select(self, keep: Tensor) -> "Layers":
        """The quadrilaterals whose `keep` (N,) bool is true, or those of the rows `keep` (M,) int64."""
        return Layers(*(getattr(self, f.name)[keep] for f in fields(self)))

    def vertices(self, count: int) -> Tensor:
        """(V,) bool, of `count` vertices: those above the wall."""
        mask = torch.zeros(count, dtype=torch.bool, device=self.wall.device)
        mask[self.corners[:, 2:].reshape(-1)] = True
        return mask

    def loose_edges(self, batch: MeshBatch) -> Tensor:
        """(K, 2) int64, the edges of the quadrilaterals and their diagonals that flips of `batch` may remove.

        These are the edges that are neither constrained nor on the boundary.
        """
        half = (3 * self.triangles.reshape(-1, 1) + torch.arange(3, device=self.wall.device)).reshape(-1)
        loose = batch.twin[half] >= 0
        if len(batch.constrained_edges):
            loose &= ~constrained_half_edges(batch)[half]
        half = half[loose]
        # Each of them is there from both sides, unless only one is in a layer.
        once = torch.zeros(batch.triangles.numel(), dtype=torch.bool, device=half.device)
        once[torch.minimum(half, batch.twin[half])] = True
        half = true_rows(once)
        ends = torch.stack([tails(batch.triangles)[half], heads(batch.triangles)[half]], 1)
        keys = keys_of(ends, len(batch.points)).sort().values
        return torch.stack([keys // len(batch.points), keys % len(batch.points)], 1)

    def up_to(self, share: float) -> "Layers":
        """The lowest rows, this share of those of each strip, rounded up."""
        return self.select(self.row <= (share * self._rows_of_strip()).ceil())

    def unbroken(self, good: Tensor) -> "Layers":
        """The quadrilaterals below the first one of their strip that is not `good` (N,) bool."""
        none = torch.iinfo(torch.int64).max
        first = torch.full((int(self.wall.max()) + 1 if len(self) else 0,), none, device=self.wall.device)
        first.scatter_reduce_(0, self.wall[~good], self.row[~good], "amin")
        return self.select(self.row < first[self.wall])

    def _rows_of_strip(self) -> Tensor:
        """(N,) the number of rows of each quadrilateral's strip."""
        rows = self.row.new_zeros(int(self.wall.max()) + 1 if len(self) else 0)
        return rows.scatter_reduce_(0, self.wall, self.row, "amax")[self.wall]


def find_layers(batch: MeshBatch, options: LayerOptions | None = None, known: Tensor | None = None) -> Layers:
    """The layers of every mesh of the batch.

    known  (T,) bool, which triangles are upright, if the caller has measured it
    """
    options = options or LayerOptions()
    blocked = batch.twin < 0
    if len(batch.constrained_edges):
        blocked = blocked | constrained_half_edges(batch)
    # The lower triangle of a quadrilateral is less than twice as high as the quadrilateral, even where its upper edge
    # is not parallel to the wall.  In most meshes hardly any triangle at a wall is so low.
    among = blocked if known is None else blocked & known.repeat_interleave(3)
    walls = low_half_edges(batch, among, 2 * options.first)
    if not _side_by_side(batch, walls):
        return _joined([], batch)
    walk = _Walk(batch, blocked, options, walls)
    is_upright = upright(batch) if known is None else known
    found = _walked(walk, batch, is_upright)
    walls = found.wall.unique()
    if 0 < len(walls) < len(walk.begun):
        # Strips that came to nothing may have stood in the way of others.
        found = _walked(_Walk(batch, blocked, options, walls), batch, is_upright)
    return found


def low_half_edges(batch: MeshBatch, among: Tensor, share: float) -> Tensor:
    """(N,) int64, ascending, those of the half-edges `among` (3T,) bool whose triangle is low.

    It is at most `share` times as high above the half-edge as the half-edge is long.
    """
    if loops_may_read(batch.points):
        return geometry.low_half_edges(batch.points.to(torch.float64), batch.triangles, among, share)
    h, vertex, points = true_rows(among), tails(batch.triangles), batch.points.to(torch.float64)
    p, q, apex = (points[vertex[g]] for g in (h, next_in_triangle(h), previous_in_triangle(h)))
    edge = q - p
    return h[_cross(edge, apex - p) <= share * (edge * edge).sum(1)]


def _side_by_side(batch: MeshBatch, walls: Tensor) -> bool:
    """Whether one of the half-edges `walls` (N,) has others at both ends, as the three of a first row have."""
    if len(walls) < _SIDE_BY_SIDE:
        return False
    vertex = tails(batch.triangles)
    first, last = vertex[walls], vertex[next_in_triangle(walls)]
    begins = torch.zeros(len(batch.points), dtype=torch.bool, device=walls.device)
    begins[first] = True
    ends = torch.zeros_like(begins)
    ends[last] = True
    return bool((begins[last] & ends[first]).any())


def _walked(walk: "_Walk", batch: MeshBatch, is_upright: Tensor) -> Layers:
    """What a walk finds among the triangles that are upright (T,) bool."""
    return _rooted(_rows(walk, batch, is_upright), walk.options)


def _rows(walk: "_Walk", batch: MeshBatch, is_upright: Tensor) -> Layers:
    """All rows of a walk; `walk.begun` are then the walls on which a first row stands."""
    options, rows = walk.options, list[Layers]()
    if loops_may_read(walk.points):
        mesh = walk.points, walk.tail, walk.twin, walk.blocked, is_upright
        found, begun = layer_rows.walk(mesh, options.limits, options.rows, walk.wall, walk.length)
        walk.begun = found[0][:begun]
        return Layers(*found)
    walk.free = is_upright.clone()
    while len(walk.front):
        quads = walk.next_row(len(rows) + 1)
        if len(rows) < options.rows:
            quads = quads.select(_in_company(quads, options))
        walk.begun = walk.begun if rows else quads.wall
        if not len(quads):
            break
        walk.go_on(quads)
        rows.append(quads)
    return _joined(rows, batch)


class _Walk:
    """The walk from the walls outwards, all strips at once.

    blocked  (3T,) bool, the half-edges of walls
    front    (S,) int64, the half-edges at their upper ends
    begun    (N,) int64, the walls on which a first row stands
    free     (T,) bool, the upright triangles that belong to no strip
    """

    free: Tensor

    def __init__(self, batch: MeshBatch, blocked: Tensor, options: LayerOptions, walls: Tensor) -> None:
        self.options = options
        self.points = batch.points.to(torch.float64)
        self.twin, self.blocked = batch.twin, blocked
        # Half-edge 3 t + k runs from corner k of triangle t to the next one.
        self.tail, self.head = tails(batch.triangles), heads(batch.triangles)
        self.front = self.wall = self.begun = walls
        self.length = self._length(walls)
        self.below = torch.full_like(self.length, torch.inf)

    def _length(self, h: Tensor) -> Tensor:
        return (self.points[self.head[h]] - self.points[self.tail[h]]).norm(dim=1)

    def next_row(self, row: int) -> Layers:
        """The quadrilaterals on the front, each of the better of the two pairs of triangles that it may be."""
        quads, good, lean = self._quadrilaterals(row)
        count = len(self.front)
        falls, rises = good[:count], good[count:]
        take_second = rises & (~falls | (lean[count:] < lean[:count]))
        some = falls | rises
        # Row k of the second half is the other choice for row k.
        chosen = (torch.arange(count, device=some.device) + count * take_second)[some]
        quads = quads.select(chosen)
        # Of two strips that meet, neither goes on into what both claim.
        claims = torch.bincount(quads.triangles.reshape(-1), minlength=len(self.free))
        return quads.select((claims[quads.triangles] == 1).all(1))

    def _quadrilaterals(self, row: int) -> tuple[Layers, Tensor, Tensor]:
        """The quadrilaterals on the front, whether they will do, and their lean, (2 S,).

        The diagonals of the first S fall to the right, those of the others rise.
        """
        h, count = self.front, len(self.front)
        onward, back = next_in_triangle(h), previous_in_triangle(h)
        diagonal = torch.cat([onward, back])
        across = self.twin[diagonal]
        there = across.clamp_min(0)
        u, w, apex = self.tail[h], self.head[h], self.head[onward]
        far = self.head[next_in_triangle(there)]
        corners = torch.stack(
            [torch.cat([u, u]), torch.cat([w, w]), torch.cat([far[:count], apex]), torch.cat([apex, far[count:]])], 1
        )
        pair = torch.stack([torch.cat([h, h]) // 3, there // 3], 1)
        ends = torch.stack([self.tail[diagonal], self.head[diagonal]], 1)
        p, q, r, s = self.points[corners].unbind(1)
        lower, upper, left, right = q - p, r - s, s - p, r - q
        a, b, at_left, at_right = torch.stack([lower, upper, left, right]).norm(dim=2).unbind(0)
        area = 0.5 * _cross(r - p, s - q)
        height = area / (0.5 * (a + b))
        column = torch.maximum(at_left, at_right)
        o = self.options
        wide = self.length.repeat(2)
        limit = o.first * wide if row == 1 else o.height * torch.minimum(wide, 0.5 * (a + b))
        good = ~self.blocked[diagonal] & (across >= 0) & self.free[pair].all(1)
        good &= (height > 0) & (height <= limit) & (column <= o.lean * height)
        good &= (lower * upper).sum(1) >= o.turn * a * b
        if row == 1:
            good &= column <= o.alike * torch.minimum(at_left, at_right)
        else:
            good &= height >= o.shrink * self.below.repeat(2)
        wall = self.wall.repeat(2)
        return Layers(wall, torch.full_like(wall, row), corners, ends, pair, height), good, column

    def go_on(self, quads: Layers) -> None:
        """The strips that have a quadrilateral in this row go on above it; the others end."""
        self.free[quads.triangles.reshape(-1)] = False
        order = torch.searchsorted(self.wall, quads.wall)
        self.wall, self.length, self.below = quads.wall, self.length[order], quads.height
        # The upper edge is in the second triangle, from right to left.
        top = 3 * quads.triangles[:, 1:] + torch.arange(3, device=self.wall.device)
        is_top = (self.tail[top] == quads.corners[:, 2:3]) & (self.head[top] == quads.corners[:, 3:])
        top = top[is_top]
        # At another wall, and at one side of an interface, the layer ends.
        on = ~self.blocked[top]
        self.front = self.twin[top][on]
        self.wall, self.length, self.below = self.wall[on], self.length[on], self.below[on]


def _cross(a: Tensor, b: Tensor) -> Tensor:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _in_company(quads: Layers, options: LayerOptions) -> Tensor:
    """(N,) bool: the quadrilateral of a row is one of at least three of like height, side by side."""
    neighbours = _neighbours(quads)
    ratio = quads.height[neighbours.clamp_min(0)] / quads.height[:, None]
    alike = (neighbours >= 0) & (ratio <= options.alike) & (ratio * options.alike >= 1)
    amid = alike.all(1)
    return amid | (alike & amid[neighbours.clamp_min(0)]).any(1)


def _neighbours(quads: Layers) -> Tensor:
    """(N, 2) int64, the quadrilaterals of a row at the left and the right, with which they share columns; -1: none."""
    count = len(quads)
    neighbours = torch.full((count, 2), -1, device=quads.wall.device)
    if not count:
        return neighbours
    foot, top = quads.corners[:, :2], quads.corners[:, 2:].flip(1)
    limit = int(quads.corners.max()) + 1
    left, right = (foot[:, k] * limit + top[:, k] for k in (0, 1))
    order = left.argsort()
    after = order[torch.searchsorted(left[order], right).clamp_max(count - 1)]
    rows = true_rows(left[after] == right)
    neighbours[rows, 1] = after[rows]
    neighbours[after[rows], 0] = rows
    return neighbours


def _rooted(layers: Layers, options: LayerOptions) -> Layers:
    """The strips of layers that have enough rows, or a strip beside them that has.

    A layer has enough strips, and somewhere three of them, side by side, end evenly: their numbers of rows differ by
    one at most.  Triangles that a motion has flattened and sheared may look like strips, but few, which end anywhere.
    """
    if not len(layers):
        return layers
    strips = layers.select(layers.row == 1)
    foot, count = strips.corners[:, :2], int(layers.corners.max()) + 1
    rows = layers._rows_of_strip()[layers.row == 1]
    chain = edge_components(foot, count)[foot[:, 0]]
    even, beside = torch.zeros((2, count), dtype=torch.bool, device=rows.device)
    even[chain[_amid_even_ones(strips, rows, options.rows)]] = True
    good = (rows >= options.rows) & even[chain] & (torch.bincount(chain)[chain] >= options.strips)
    beside[foot[good].reshape(-1)] = True
    kept = torch.zeros(int(layers.wall.max()) + 1, dtype=torch.bool, device=rows.device)
    kept[strips.wall[beside[foot].any(1)]] = True
    return layers.select(kept[layers.wall])


def _amid_even_ones(strips: Layers, rows: Tensor, least: int) -> Tensor:
    """(N,) bool: the strips in the middle of three that have `least` rows or more and end evenly.

    strips  the quadrilaterals of first rows
    rows    (N,) how many rows the strip of each has
    """
    neighbours = _neighbours(strips)
    three = torch.cat([rows[:, None], rows[neighbours.clamp_min(0)]], 1)
    low, high = three.aminmax(dim=1)
    return (neighbours >= 0).all(1) & (low >= least) & (high - low <= 1)


def _joined(rows: list[Layers], batch: MeshBatch) -> Layers:
    """All rows in one."""
    if rows:
        return Layers(*(torch.cat([getattr(row, f.name) for row in rows]) for f in fields(Layers)))
    none = torch.zeros(0, dtype=torch.int64, device=batch.points.device)
    return Layers(none, none, none.reshape(0, 4), none.reshape(0, 2), none.reshape(0, 2), none.to(torch.float64))
