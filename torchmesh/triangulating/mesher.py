"""Graded triangle meshes of polygons with holes, from a size field: the mesher behind `tm.domains`.

    outline -> vertices on the loops -> seeds on a triangular lattice, thinned to the size field
            -> Delaunay and centroids in turn -> (points, triangles), every sign checked exactly

Domains lie on the left of their loops: the outer one counter-clockwise, holes clockwise.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from scipy.spatial import Delaunay, cKDTree

from .arrays import Obstacle, signs
from .polygon import loop_edges
from .polygon_triangulation import is_triangulation_of, locate, triangulate_polygon

_SQRT3 = np.sqrt(3.0)


# A corner turns by more than this (radians) and always gets a vertex.
_CORNER = 0.4


# Every loop has at least so many edges, and a passage between two parts of the outline so many across.
_EDGES_PER_LOOP = 12


_CELLS_ACROSS = 3.0


# Points of the outline that its widths and sizes are measured at.
_SAMPLES = 400


# Two points this much farther apart along the outline than straight across face each other; the two
# sides of a right angle do not (1.4), those of an angle of 45 degrees would (2.6).
_DETOUR = 2.5


# Seeds keep this part of the local size off the outline.
_CLEARANCE = 0.55


# Rounds of Delaunay and centroids, and of correcting the scale; both were seen to change little beyond.
_CENTROID_ROUNDS = 5


_SCALE_ROUNDS = 7


_SCALE_TOLERANCE = 0.02


# Above the rounding of the lattice's spacing.
_ROUNDING = 1 + 1e-9


# Rows of a points-times-samples table worked on at once.
_CHUNK = 4_000_000


@dataclass(frozen=True, eq=False)
class Outline:
    """A domain to be meshed.

    loops      closed polylines (n, 2), any spacing: the outer one first, counter-clockwise, then holes, clockwise
    sizes      the edge length wanted along each loop, relative to one another
    gradation  how fast the size may grow away from the outline, length per length
    """

    loops: tuple[np.ndarray, ...]
    sizes: tuple[float, ...]
    gradation: float = 0.15


class MeshingError(ValueError):
    """The outline cannot be meshed; says why."""


def mesh_outline(
    outline: Outline, triangles: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mesh `outline` with about `triangles` triangles.

    Returns points (V, 2) float64, the vertices of the loops first, in their order; triangles (T, 3)
    int64, counter-clockwise by exact sign; and (Nb,) int64, the loop of each vertex on the outline.
    The same arguments and state of `rng` give the same bits.  Raises MeshingError for loops that
    bound no domain.
    """
    _polygon(outline.loops)
    if _area(outline) <= 0:
        raise MeshingError("the outline bounds no domain: its outer loop runs clockwise, or a hole counter-clockwise")
    samples, thickness, relative = _sampled(outline)
    scale = np.sqrt(4 / _SQRT3 * abs(_area(outline)) / triangles) / max(outline.sizes)
    state = rng.bit_generator.state
    for _ in range(_SCALE_ROUNDS):
        # The same lattice each time, so that the count answers to the scale alone.
        rng.bit_generator.state = state
        field = _SizeField.of(outline, samples, np.minimum(relative * scale, thickness), max(outline.sizes) * scale)
        boundary = [
            _resampled(loop, field, size * scale) for loop, size in zip(outline.loops, outline.sizes, strict=True)
        ]
        seeds = _seeds(boundary, field, rng)
        count = 2 * len(seeds) + sum(map(len, boundary)) + 2 * len(boundary) - 4
        if abs(count / triangles - 1) < _SCALE_TOLERANCE:
            break
        scale *= np.sqrt(count / triangles)
    points, corners = _meshed(boundary, seeds, field)
    return points, corners, np.repeat(np.arange(len(boundary)), [len(loop) for loop in boundary])


@dataclass(frozen=True, eq=False)
class _SizeField:
    """h(x) = min(cap, min over samples b of h_b + gradation |x - b|).

    positions  (N,) complex, of the samples;  sizes (N,)
    """

    positions: np.ndarray
    sizes: np.ndarray
    gradation: float
    cap: float

    @classmethod
    def of(cls, outline: Outline, samples: list[np.ndarray], wanted: np.ndarray, cap: float) -> "_SizeField":
        positions = _complex(np.concatenate(samples))
        # What a coarser neighbour allows anyway need not be asked again.
        limit = np.abs(positions[:, None] - positions) * outline.gradation + wanted
        np.fill_diagonal(limit, np.inf)
        needed = (limit.min(1) > wanted) & (wanted < cap)
        return cls(positions[needed], wanted[needed], outline.gradation, cap)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """(N, 2) to (N,) edge lengths."""
        z = _complex(points)
        size = np.full(len(z), self.cap)
        step = max(1, _CHUNK // max(1, len(self.positions)))
        for start in range(0, len(z) if len(self.positions) else 0, step):
            part = slice(start, start + step)
            near = np.abs(z[part, None] - self.positions)
            near *= self.gradation
            near += self.sizes
            size[part] = np.minimum(near.min(1), self.cap)
        return size

    @property
    def smallest(self) -> float:
        return float(min(self.cap, self.sizes.min(initial=np.inf)))


def _complex(points: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(points, dtype=np.float64).view(np.complex128)[:, 0]


def _polygon(loops: Sequence[np.ndarray]) -> shapely.Polygon:
    """The loops as a polygon ready to be asked."""
    polygon = shapely.Polygon(loops[0], loops[1:])
    if not polygon.is_valid:
        raise MeshingError(f"the outline bounds no domain: {shapely.is_valid_reason(polygon)}")
    shapely.prepare(polygon)
    return polygon


def _area(outline: Outline) -> float:
    return float(sum(0.5 * np.sum(np.conj(z) * np.roll(z, -1)).imag for z in map(_complex, outline.loops)))


def _sampled(outline: Outline) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Points along each loop; at each of them all a cap from the domain's width there, and the relative size wanted.

    The width at p is the diameter of the smallest disc that touches the outline in p from inside
    and passes through another point q that faces it: |q - p|^2 / ((q - p) . n), n the inward normal
    (the medial ball; Ma, Bae & Choi, 3D medial axis point approximation using nearest neighbors and
    the normal field, The Visual Computer 28, 2012).
    """
    lengths = [np.abs(np.roll(z, -1) - z).sum() for z in map(_complex, outline.loops)]
    weights = np.array([length / size for length, size in zip(lengths, outline.sizes, strict=True)])
    counts = np.maximum(4 * _EDGES_PER_LOOP, (_SAMPLES * weights / weights.sum()).astype(int))
    positions, normals, along, whole, loop_of = [], [], [], [], []
    for i, (loop, count) in enumerate(zip(outline.loops, counts.tolist(), strict=True)):
        z = _complex(loop)
        edge = np.roll(z, -1) - z
        ends = np.concatenate([[0.0], np.abs(edge).cumsum()])
        s = (np.arange(count) + 0.5) / count * ends[-1]
        k = np.searchsorted(ends, s, side="right") - 1
        direction = edge[k] / np.abs(edge[k])
        positions.append(z[k] + (s - ends[k]) * direction)
        normals.append(1j * direction)
        along.append(s)
        whole.append(np.full(count, ends[-1]))
        loop_of.append(np.full(count, i))
    p, n, s, total, owner = (np.concatenate(v) for v in (positions, normals, along, whole, loop_of))
    across = p - p[:, None]
    height = (np.conj(n[:, None]) * across).real
    distance = np.abs(across)
    arc = np.abs(s - s[:, None])
    arc = np.minimum(arc, total - arc)
    facing = (height > 1e-9 * distance.max()) & ((owner != owner[:, None]) | (arc > _DETOUR * distance))
    width = np.where(facing, distance**2 / np.where(facing, height, 1.0), np.inf).min(1)
    relative = np.array(outline.sizes)[owner]
    thickness = np.minimum(width / _CELLS_ACROSS, total / _EDGES_PER_LOOP)
    points = np.stack([p.real, p.imag], 1)
    return np.split(points, counts.cumsum()[:-1]), thickness, relative


def _resampled(loop: np.ndarray, field: _SizeField, wanted: float) -> np.ndarray:
    """The loop with a vertex in each corner and, in between, edges as long as the field asks."""
    z = _complex(loop)
    before, after = z - np.roll(z, 1), np.roll(z, -1) - z
    corner = np.abs(np.angle(after / before)) > _CORNER
    if not corner.any():
        corner[0] = True
    first = int(corner.argmax())
    z, corner = np.roll(z, -first), np.roll(corner, -first)
    starts = np.flatnonzero(corner)
    pieces = []
    for start, end in zip(starts, [*starts[1:], len(z)], strict=True):
        path = np.append(z[start:end], z[end % len(z)])
        fine = _refined(path, 0.25 * field.smallest)
        density = 1 / np.minimum(field(np.stack([fine.real, fine.imag], 1)), wanted)
        step = np.abs(np.diff(fine))
        total = np.concatenate([[0.0], (0.5 * (density[1:] + density[:-1]) * step).cumsum()])
        count = max(1 if len(starts) > 2 else _EDGES_PER_LOOP // 2, round(total[-1]))
        steps = np.interp(np.arange(count) / count * total[-1], total, np.arange(len(fine)))
        k = np.minimum(steps.astype(int), len(fine) - 2)
        pieces.append(fine[k] + (steps - k) * (fine[k + 1] - fine[k]))
    out = np.concatenate(pieces)
    return np.stack([out.real, out.imag], 1)


def _refined(path: np.ndarray, step: float) -> np.ndarray:
    """The open polyline (n,) complex with no edge longer than `step`."""
    edge = np.diff(path)
    parts = np.maximum(1, np.ceil(np.abs(edge) / step).astype(int))
    k = np.repeat(np.arange(len(edge)), parts)
    within = np.arange(len(k)) - np.repeat(parts.cumsum() - parts, parts)
    return np.append(path[k] + within / parts[k] * edge[k], path[-1])


def _seeds(boundary: list[np.ndarray], field: _SizeField, rng: np.random.Generator) -> np.ndarray:
    """(M, 2) positions for the interior vertices: lattice points inside, clear of the outline."""
    polygon = _polygon(boundary)
    seeds = _lattice(boundary[0].min(0), boundary[0].max(0), field, rng)
    seeds = seeds[shapely.contains_xy(polygon, seeds)]
    middles = [0.5 * (loop + np.roll(loop, -1, 0)) for loop in boundary]
    distance = cKDTree(np.concatenate([*boundary, *middles])).query(seeds)[0]
    return seeds[distance > _CLEARANCE * field(seeds)]


def _lattice(low: np.ndarray, high: np.ndarray, field: _SizeField, rng: np.random.Generator) -> np.ndarray:
    """(M, 2) points of nested triangular lattices in a box, as dense as the size field asks.

    Each lattice holds a third of the points of the next, which is finer by sqrt(3): in Eisenstein
    integers, a point z of one has the three points theta z, theta z + 1 and theta z - 1 of the next,
    theta^2 = -3.  Lattices at one side of the wanted size are taken whole, of the one across it a random part.
    """
    # Such that one lattice has the spacing `cap`, and where the size is that, no other is needed.
    spacing = field.cap * _SQRT3 ** np.ceil(np.log((high - low).max() / field.cap) / np.log(_SQRT3))
    turn = np.exp(1j * rng.uniform(0, np.pi / 3))
    shift = spacing * rng.uniform(-0.5, 0.5, 2)
    i, j = np.mgrid[-3:4, -3:4].reshape(2, -1)
    unit = spacing * turn
    middle = 0.5 * (low + high) + shift
    points = complex(*middle) + unit * (i + j * np.exp(2j * np.pi / 3))
    theta = 1 - np.exp(2j * np.pi / 3)

    def there(z: np.ndarray, reach: float) -> np.ndarray:
        return z[
            (z.real > low[0] - reach) & (z.real < high[0] + reach)
            & (z.imag > low[1] - reach) & (z.imag < high[1] + reach)
        ]  # fmt: skip

    points = there(points, spacing)
    sizes = field(np.stack([points.real, points.imag], 1))
    taken = [points[:0]]
    while len(points):
        finer = spacing / _SQRT3
        # The size a child can at least have, and that the lattice after it need not be asked.
        split = sizes - field.gradation * finer < spacing
        parents = points[split]
        unit = unit / theta
        children = there(np.concatenate([parents + unit, parents - unit]), finer)
        wanted = field(np.stack([children.real, children.imag], 1))
        # The lattices so far hold a third of the density 2 / (sqrt(3) finer^2): the children fill it up.
        share = (3 * (finer / wanted) ** 2 * _ROUNDING - 1) / 2
        taken.append(children[rng.random(len(children)) < share])
        points, sizes = np.concatenate([parents, children]), np.concatenate([sizes[split], wanted])
        spacing = finer
    z = np.concatenate(taken)
    return np.stack([z.real, z.imag], 1)


def _meshed(boundary: list[np.ndarray], seeds: np.ndarray, field: _SizeField) -> tuple[np.ndarray, np.ndarray]:
    """Delaunay triangles of loops and seeds, the seeds moved to their patches' centroids in turn.

    A patch's triangles count by area over squared size (Chen & Holst, Efficient mesh optimization
    schemes based on optimal Delaunay triangulations, Computer Methods in Applied Mechanics and
    Engineering 200, 2011: centroidal patch triangulation).
    """
    outline = np.concatenate(boundary)
    outer = len(outline)
    polygon = _polygon(boundary)
    points = np.concatenate([outline, seeds])
    sizes = field(points)
    for _ in range(_CENTROID_ROUNDS):
        corners = _inside(points, outer, polygon)
        a, b, c = (points[corners[:, i]] for i in range(3))
        area = np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
        weight = area / sizes[corners].mean(1) ** 2
        centroid = (a + b + c) * (weight / 3)[:, None]
        flat = corners.ravel()
        sums = [np.bincount(flat, np.repeat(v, 3), len(points))[outer:] for v in (*centroid.T, weight)]
        used = sums[2] > 0
        moved = np.stack(sums[:2], 1)[used] / sums[2][used, None]
        held = shapely.contains_xy(polygon, moved)
        points[outer:][np.flatnonzero(used)[held]] = moved[held]
    corners = _inside(points, outer, polygon)
    turned = signs(points, *corners.T) < 0
    corners[turned] = corners[turned][:, ::-1]
    starts = np.cumsum([0, *(len(loop) for loop in boundary)])
    loops = [np.arange(start, end) for start, end in itertools.pairwise(starts.tolist())]
    edges = np.concatenate([loop_edges(loop) for loop in loops])
    if is_triangulation_of(points, corners, edges) and len(np.unique(corners)) == len(points):
        return points, corners
    return _inserted(points, loops, sizes)


def _inside(points: np.ndarray, outer: int, polygon: shapely.Polygon) -> np.ndarray:
    """(T, 3) the Delaunay triangles inside the polygon; of those only ones of three outline vertices can be out."""
    corners = Delaunay(points).simplices.astype(np.int64)
    doubtful = np.flatnonzero((corners < outer).all(1))
    out = doubtful[~shapely.contains_xy(polygon, points[corners[doubtful]].mean(1))]
    return np.delete(corners, out, 0)


def _inserted(points: np.ndarray, loops: list[np.ndarray], sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same by exact steps, for outlines whose edges are not all Delaunay: the outline first, then the seeds."""
    work = triangulate_polygon(points.copy(), loops, sizes.copy())
    if isinstance(work, Obstacle):
        raise MeshingError(f"the outline bounds no domain: {work}")
    seeds = np.arange(sum(map(len, loops)), len(points))
    home = locate(work.points, seeds, work.corners)
    refused = work.insert(seeds[home >= 0], home[home >= 0])
    gone = np.concatenate([seeds[home < 0], refused])
    name = np.cumsum(~np.isin(np.arange(len(points)), gone)) - 1
    return np.delete(points, gone, 0), name[work.corners]
