"""Graded triangle meshes of polygons with holes, from a size field; `tm.domains` is made with them.

    outline -> vertices on the loops -> seeds on a triangular lattice, thinned to the size field
            -> Delaunay and centroids in turn -> (points, triangles), every sign checked exactly

A domain lies on the left of its loops: the outer loop runs counter-clockwise, and holes run clockwise.
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


# A factor that exceeds 1 by more than the rounding of the spacing of the lattice.
_ROUNDING = 1 + 1e-9


# Entries of a table of points times samples that are worked on at once.
_CHUNK = 4_000_000


@dataclass(frozen=True, eq=False)
class Outline:
    """A domain to be meshed.

    loops      closed polylines (n, 2) of any spacing: first the outer one, counter-clockwise, then the holes, clockwise
    sizes      the edge lengths wanted along the loops; only their ratios are read
    gradation  how fast the size may grow with the distance from the outline, length per length
    """

    loops: tuple[np.ndarray, ...]
    sizes: tuple[float, ...]
    gradation: float = 0.15


class MeshingError(ValueError):
    """The outline cannot be meshed; the message says why."""


@dataclass(frozen=True)
class MesherOptions:
    """How `mesh_outline` works.

    corner           an outline that turns by more than this (radians) has a corner there, which always gets a vertex
    edges_per_loop   every loop has at least so many edges
    cells_across     a passage between two parts of the outline is at least so many edges wide
    samples          points of the outline at which its widths and sizes are measured
    detour           two points that are this many times farther apart along the outline than straight across face each
                     other; the two sides of a right angle do not (1.4), those of an angle of 45 degrees do (2.6)
    clearance        seeds keep this part of the local size away from the outline
    centroid_rounds  rounds of Delaunay triangulation and moves to centroids; more were seen to change little
    scale_rounds     rounds of correcting the scale of the sizes at most; more were seen to change little
    scale_tolerance  the scale is right when the number of triangles is wrong by less than this part of it
    """

    corner: float = 0.4
    edges_per_loop: int = 12
    cells_across: float = 3.0
    samples: int = 400
    detour: float = 2.5
    clearance: float = 0.55
    centroid_rounds: int = 5
    scale_rounds: int = 7
    scale_tolerance: float = 0.02

    def __post_init__(self) -> None:
        for name, least in (("edges_per_loop", 3), ("samples", 1), ("centroid_rounds", 0), ("scale_rounds", 1)):
            if getattr(self, name) < least:
                raise ValueError(f"MesherOptions.{name} must be at least {least}, not {getattr(self, name)}")
        for name in ("corner", "cells_across", "detour", "clearance", "scale_tolerance"):
            if not getattr(self, name) > 0:
                raise ValueError(f"MesherOptions.{name} must be positive, not {getattr(self, name)}")


def mesh_outline(
    outline: Outline, triangles: int, rng: np.random.Generator, options: MesherOptions | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mesh `outline` with about `triangles` triangles.

    Returns points (V, 2) float64, with the vertices of the loops first, in their order; triangles (T, 3) int64, which
    are counter-clockwise by exact signs; and (Nb,) int64, the loop of each vertex on the outline.  The same arguments
    and the same state of `rng` give the same bits.  Raises MeshingError for loops that bound no domain.
    """
    options = options or MesherOptions()
    _polygon(outline.loops)
    if _area(outline) <= 0:
        raise MeshingError("the outline bounds no domain: its outer loop runs clockwise, or a hole counter-clockwise")
    samples, thickness, relative = _sampled(outline, options)
    scale = np.sqrt(4 / _SQRT3 * abs(_area(outline)) / triangles) / max(outline.sizes)
    state = rng.bit_generator.state
    for _ in range(options.scale_rounds):
        # The lattice is the same each time, so that the count depends on the scale alone.
        rng.bit_generator.state = state
        field = _SizeField.of(outline, samples, np.minimum(relative * scale, thickness), max(outline.sizes) * scale)
        boundary = [
            _resampled(loop, field, size * scale, options)
            for loop, size in zip(outline.loops, outline.sizes, strict=True)
        ]
        seeds = _seeds(boundary, field, rng, options.clearance)
        count = 2 * len(seeds) + sum(map(len, boundary)) + 2 * len(boundary) - 4
        if abs(count / triangles - 1) < options.scale_tolerance:
            break
        scale *= np.sqrt(count / triangles)
    points, corners = _meshed(boundary, seeds, field, options.centroid_rounds)
    return points, corners, np.repeat(np.arange(len(boundary)), [len(loop) for loop in boundary])


@dataclass(frozen=True, eq=False)
class _SizeField:
    """The size h(x) = min(cap, min over samples b of h_b + gradation |x - b|).

    positions  (N,) complex, the positions of the samples
    sizes      (N,) the sizes h_b at them
    """

    positions: np.ndarray
    sizes: np.ndarray
    gradation: float
    cap: float

    @classmethod
    def of(cls, outline: Outline, samples: list[np.ndarray], wanted: np.ndarray, cap: float) -> "_SizeField":
        """The size field of the sizes `wanted` (N,) at the `samples` of each loop, (n, 2)."""
        positions = _complex(np.concatenate(samples))
        # A sample is left out if another sample allows no larger size there.
        limit = np.abs(positions[:, None] - positions) * outline.gradation + wanted
        np.fill_diagonal(limit, np.inf)
        needed = (limit.min(1) > wanted) & (wanted < cap)
        return cls(positions[needed], wanted[needed], outline.gradation, cap)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """(N,) the edge lengths wanted at the points (N, 2)."""
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
        """The smallest size."""
        return float(min(self.cap, self.sizes.min(initial=np.inf)))


def _complex(points: np.ndarray) -> np.ndarray:
    """(N,) complex numbers x + i y of points (N, 2)."""
    return np.ascontiguousarray(points, dtype=np.float64).view(np.complex128)[:, 0]


def _polygon(loops: Sequence[np.ndarray]) -> shapely.Polygon:
    """The loops as a polygon that is prepared for queries."""
    polygon = shapely.Polygon(loops[0], loops[1:])
    if not polygon.is_valid:
        raise MeshingError(f"the outline bounds no domain: {shapely.is_valid_reason(polygon)}")
    shapely.prepare(polygon)
    return polygon


def _area(outline: Outline) -> float:
    """The area of the domain, negative if its loops run the wrong way."""
    return float(sum(0.5 * np.sum(np.conj(z) * np.roll(z, -1)).imag for z in map(_complex, outline.loops)))


def _sampled(outline: Outline, options: MesherOptions) -> tuple[list[np.ndarray], np.ndarray, np.ndarray]:
    """Points along each loop, (n, 2), and at all of them the largest size that the width admits, and the relative size.

    The width at p is the diameter of the smallest disc that touches the outline in p from inside and passes through
    another point q that faces p.  It is |q - p|^2 / ((q - p) . n), where n is the inward normal (the medial ball; Ma,
    Bae & Choi, 3D medial axis point approximation using nearest neighbors and the normal field, The Visual Computer 28,
    2012).
    """
    lengths = [np.abs(np.roll(z, -1) - z).sum() for z in map(_complex, outline.loops)]
    weights = np.array([length / size for length, size in zip(lengths, outline.sizes, strict=True)])
    counts = np.maximum(4 * options.edges_per_loop, (options.samples * weights / weights.sum()).astype(int))
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
    facing = (height > 1e-9 * distance.max()) & ((owner != owner[:, None]) | (arc > options.detour * distance))
    width = np.where(facing, distance**2 / np.where(facing, height, 1.0), np.inf).min(1)
    relative = np.array(outline.sizes)[owner]
    thickness = np.minimum(width / options.cells_across, total / options.edges_per_loop)
    points = np.stack([p.real, p.imag], 1)
    return np.split(points, counts.cumsum()[:-1]), thickness, relative


def _resampled(loop: np.ndarray, field: _SizeField, wanted: float, options: MesherOptions) -> np.ndarray:
    """The loop with a vertex in each corner and, between the corners, edges of the sizes of the field.

    wanted  the size wanted along this loop, which no edge exceeds
    """
    z = _complex(loop)
    before, after = z - np.roll(z, 1), np.roll(z, -1) - z
    corner = np.abs(np.angle(after / before)) > options.corner
    if not corner.any():
        corner[0] = True
    first = int(corner.argmax())
    z, corner = np.roll(z, -first), np.roll(corner, -first)
    starts = np.flatnonzero(corner)
    parts = []
    for start, end in zip(starts, [*starts[1:], len(z)], strict=True):
        path = np.append(z[start:end], z[end % len(z)])
        fine = _refined(path, 0.25 * field.smallest)
        density = 1 / np.minimum(field(np.stack([fine.real, fine.imag], 1)), wanted)
        step = np.abs(np.diff(fine))
        total = np.concatenate([[0.0], (0.5 * (density[1:] + density[:-1]) * step).cumsum()])
        count = max(1 if len(starts) > 2 else options.edges_per_loop // 2, round(total[-1]))
        steps = np.interp(np.arange(count) / count * total[-1], total, np.arange(len(fine)))
        k = np.minimum(steps.astype(int), len(fine) - 2)
        parts.append(fine[k] + (steps - k) * (fine[k + 1] - fine[k]))
    out = np.concatenate(parts)
    return np.stack([out.real, out.imag], 1)


def _refined(path: np.ndarray, step: float) -> np.ndarray:
    """The open polyline (n,) complex with no edge longer than `step`."""
    edge = np.diff(path)
    parts = np.maximum(1, np.ceil(np.abs(edge) / step).astype(int))
    k = np.repeat(np.arange(len(edge)), parts)
    within = np.arange(len(k)) - np.repeat(parts.cumsum() - parts, parts)
    return np.append(path[k] + within / parts[k] * edge[k], path[-1])


def _seeds(boundary: list[np.ndarray], field: _SizeField, rng: np.random.Generator, clearance: float) -> np.ndarray:
    """(M, 2) positions for the interior vertices: lattice points inside the outline and away from it."""
    polygon = _polygon(boundary)
    seeds = _lattice(boundary[0].min(0), boundary[0].max(0), field, rng)
    seeds = seeds[shapely.contains_xy(polygon, seeds)]
    middles = [0.5 * (loop + np.roll(loop, -1, 0)) for loop in boundary]
    distance = cKDTree(np.concatenate([*boundary, *middles])).query(seeds)[0]
    return seeds[distance > clearance * field(seeds)]


def _lattice(low: np.ndarray, high: np.ndarray, field: _SizeField, rng: np.random.Generator) -> np.ndarray:
    """(M, 2) points of nested triangular lattices in a box, as dense as the size field wants.

    Each lattice has a third of the points of the next one, which is finer by sqrt(3).  In Eisenstein integers, a
    point z of a lattice gives three points theta z, theta z + 1 and theta z - 1 of the next one, where theta^2 = -3.
    Lattices that are coarser than the size wanted are taken whole, and a random part of the first finer one is.
    """
    # One of the lattices has the spacing `cap`.  Where that is the size wanted, no other lattice is needed.
    spacing = field.cap * _SQRT3 ** np.ceil(np.log((high - low).max() / field.cap) / np.log(_SQRT3))
    turn = np.exp(1j * rng.uniform(0, np.pi / 3))
    shift = spacing * rng.uniform(-0.5, 0.5, 2)
    i, j = np.mgrid[-3:4, -3:4].reshape(2, -1)
    unit = spacing * turn
    middle = 0.5 * (low + high) + shift
    points = complex(*middle) + unit * (i + j * np.exp(2j * np.pi / 3))
    theta = 1 - np.exp(2j * np.pi / 3)

    def there(z: np.ndarray, reach: float) -> np.ndarray:
        """Those of the points within `reach` of the box."""
        return z[
            (z.real > low[0] - reach) & (z.real < high[0] + reach)
            & (z.imag > low[1] - reach) & (z.imag < high[1] + reach)
        ]  # fmt: skip

    points = there(points, spacing)
    sizes = field(np.stack([points.real, points.imag], 1))
    taken = [points[:0]]
    while len(points):
        finer = spacing / _SQRT3
        # A point gets children if the size at one of them may be below the present spacing.
        split = sizes - field.gradation * finer < spacing
        parents = points[split]
        unit = unit / theta
        children = there(np.concatenate([parents + unit, parents - unit]), finer)
        wanted = field(np.stack([children.real, children.imag], 1))
        # The lattices so far have a third of the density 2 / (sqrt(3) finer^2), and the children add the rest.
        share = (3 * (finer / wanted) ** 2 * _ROUNDING - 1) / 2
        taken.append(children[rng.random(len(children)) < share])
        points, sizes = np.concatenate([parents, children]), np.concatenate([sizes[split], wanted])
        spacing = finer
    z = np.concatenate(taken)
    return np.stack([z.real, z.imag], 1)


def _meshed(
    boundary: list[np.ndarray], seeds: np.ndarray, field: _SizeField, rounds: int
) -> tuple[np.ndarray, np.ndarray]:
    """Delaunay triangles of loops and seeds, where the seeds move to the centroids of their patches between the rounds.

    The weight of a triangle in a centroid is its area over its squared size (Chen & Holst, Efficient mesh optimization
    schemes based on optimal Delaunay triangulations, Computer Methods in Applied Mechanics and Engineering 200, 2011:
    centroidal patch triangulation).
    """
    outline = np.concatenate(boundary)
    outer = len(outline)
    polygon = _polygon(boundary)
    points = np.concatenate([outline, seeds])
    sizes = field(points)
    for _ in range(rounds):
        _move_to_centroids(points, outer, sizes, _inside(points, outer, polygon), polygon)
    corners = _inside(points, outer, polygon)
    turned = signs(points, *corners.T) < 0
    corners[turned] = corners[turned][:, ::-1]
    starts = np.cumsum([0, *(len(loop) for loop in boundary)])
    loops = [np.arange(start, end) for start, end in itertools.pairwise(starts.tolist())]
    edges = np.concatenate([loop_edges(loop) for loop in loops])
    if is_triangulation_of(points, corners, edges) and len(np.unique(corners)) == len(points):
        return points, corners
    return _inserted(points, loops, sizes)


def _move_to_centroids(
    points: np.ndarray, outer: int, sizes: np.ndarray, corners: np.ndarray, polygon: shapely.Polygon
) -> None:
    """Move the points (V, 2) after the first `outer` to the centroids of their triangles that are in the polygon."""
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


def _inside(points: np.ndarray, outer: int, polygon: shapely.Polygon) -> np.ndarray:
    """(T, 3) the Delaunay triangles in the polygon; only those with three vertices on the outline can be outside it."""
    corners = Delaunay(points).simplices.astype(np.int64)
    doubtful = np.flatnonzero((corners < outer).all(1))
    out = doubtful[~shapely.contains_xy(polygon, points[corners[doubtful]].mean(1))]
    return np.delete(corners, out, 0)


def _inserted(points: np.ndarray, loops: list[np.ndarray], sizes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same mesh by exact steps, first the outline and then the seeds, if edges of the outline are not Delaunay."""
    work = triangulate_polygon(points.copy(), loops, sizes.copy())
    if isinstance(work, Obstacle):
        raise MeshingError(f"the outline bounds no domain: {work}")
    seeds = np.arange(sum(map(len, loops)), len(points))
    home = locate(work.points, seeds, work.corners)
    refused = work.insert(seeds[home >= 0], home[home >= 0])
    gone = np.concatenate([seeds[home < 0], refused])
    name = np.cumsum(~np.isin(np.arange(len(points)), gone)) - 1
    return np.delete(points, gone, 0), name[work.corners]
