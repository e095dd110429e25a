"""Valid meshes of domains that are hard to triangulate: each is a witness that a valid mesh exists.

polygons   ragged stars with holes                  cracks    lips of a crack, divided differently
needles    up to 1e8 times as long as they are wide  pinches   snakes of cells that touch themselves
combs      long thin teeth                           lattices  many points on one line and on one circle
spirals    wound strips and block letters            carved    parts of Delaunay triangulations
"""

from collections.abc import Callable

import numpy as np
import torch

from experiments.robustness import fuzz
from experiments.shared import outlines
from torchmesh.learning.outlines import bent_band
from torchmesh.mesh import connectivity
from torchmesh.triangulating.polygon_triangulation import triangulate_with

from . import cracks

Array = np.ndarray
# Points (V, 2), triangles (T, 3) and constrained edges (K, 2).
Arrays = tuple[Array, Array, Array]

_NO_EDGES = np.zeros((0, 2), np.int64)


def polygon(rng: np.random.Generator, triangles: int) -> Arrays | None:
    """A star-shaped polygon with up to four holes, a quarter to three quarters of its vertices inside."""
    share = rng.uniform(0.25, 0.75)
    count = max(4, round((1 - share) * triangles / (1 + share)))
    holes = int(rng.integers(0, 5)) if count > 30 else 0
    sides = np.maximum(3, rng.multinomial(count // 3, np.ones(holes) / holes)) if holes else []
    loops = [_star(rng, max(3, count - sum(sides)), rng.choice([0.1, 0.5, 0.9]))]
    for k, side in enumerate(sides):
        angle = 2 * np.pi * k / holes
        loops.append(_star(rng, side, 0.5)[::-1] * 0.03 + 0.06 * np.array([np.cos(angle), np.sin(angle)]))
    return _meshed(rng, loops, round(share * triangles / (1 + share)))


def needle(rng: np.random.Generator, triangles: int) -> Arrays | None:
    """A sliver of a domain: a strip, a triangle, or a lens with hardly bent sides."""
    count, height = max(4, triangles // 3), 10.0 ** -rng.uniform(1, 8)
    low, high = (np.sort(np.append(rng.uniform(size=max(1, count // 2)), [0.0, 1.0])) for _ in range(2))
    bend = rng.choice([0.0, 1.0, -0.9])
    lower = np.stack([low, np.zeros(len(low))], 1)
    upper = np.stack([high, height * (1 + bend * 4 * high * (1 - high))], 1)[::-1]
    return _meshed(rng, [np.concatenate([lower, upper])], triangles // 3)


def comb(rng: np.random.Generator, triangles: int) -> Arrays | None:
    """A bar with teeth, thin or thick, the gaps between them likewise."""
    teeth = max(1, triangles // 12)
    ends = np.cumsum(rng.uniform(0.02, 1.0, 2 * teeth))
    left, right = ends[0::2], ends[1::2]
    top = rng.uniform(0.5, 10.0, teeth)
    corners = np.stack([left, np.zeros(teeth), left, top, right, top, right, np.zeros(teeth)], 1).reshape(-1, 2)
    bar = np.array([[ends[-1], -rng.uniform(0.1, 2)], [left[0], -rng.uniform(0.1, 2)]])
    return _meshed(rng, [np.concatenate([corners, bar])[::-1]], triangles // 4)


def spiral(rng: np.random.Generator, triangles: int) -> Arrays | None:
    """A wound strip of up to four turns, or a block letter of up to eight bends."""
    outline = outlines.spiral(rng.uniform(0.3, 4)) if rng.uniform() < 0.5 else bent_band(int(rng.integers(1, 9)))
    if len(outline) > triangles:
        outline = bent_band(int(rng.integers(1, 4)))
    more = max(0, triangles // 3 - len(outline))
    return _meshed(rng, [_divided(rng, outline, more)], triangles // 4)


def lattice(rng: np.random.Generator, triangles: int) -> Arrays | None:
    """Cells of a square lattice, some taken out, holes that share corners among them; a few edges constrained."""
    side = max(2, round(np.sqrt(triangles / 2)))
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0), indexing="ij")
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (index[i : side + i, j : side + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    faces = np.where(
        (rng.uniform(size=len(a)) < 0.5)[:, None], np.stack([a, b, c, a, c, d], 1), np.stack([a, b, d, b, c, d], 1)
    )
    faces = faces[rng.uniform(size=len(a)) > rng.choice([0.0, 0.1, 0.3])].reshape(-1, 3)
    points = np.stack([x.ravel(), y.ravel()], 1) * [1.0, rng.choice([1.0, 1.0, 1e-3])]
    return _largest_part(points, faces, rng)


def carved(rng: np.random.Generator, triangles: int) -> Arrays | None:
    """A part of a random Delaunay triangulation (`fuzz.domain`)."""
    mesh = fuzz.domain(rng)
    return None if mesh is None else (mesh.points.numpy(), mesh.triangles.numpy(), mesh.constrained_edges.numpy())


def crack(rng: np.random.Generator, triangles: int) -> Arrays | None:
    """A square with a crack whose lips are divided differently."""
    return *cracks.crack(rng, max(3, triangles // 3), 0, bool(rng.integers(2))), _NO_EDGES


def pinch(rng: np.random.Generator, triangles: int) -> Arrays | None:
    """A snake of cells that touches itself in corners and along sides."""
    return *cracks.walk(rng, max(3, triangles // 5), rng.choice([0.0, 0.4]), 0), _NO_EDGES


DOMAINS: dict[str, Callable[[np.random.Generator, int], Arrays | None]] = {
    "polygons": polygon,
    "needles": needle,
    "combs": comb,
    "spirals": spiral,
    "lattices": lattice,
    "carved": carved,
    "cracks": crack,
    "pinches": pinch,
}


def _star(rng: np.random.Generator, count: int, ragged: float) -> Array:
    """(count, 2) a star-shaped polygon round the origin, its radii from 1 - `ragged` to 1."""
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(0, 0.9, count)) / count
    radius = rng.uniform(1 - ragged, 1, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)


def _divided(rng: np.random.Generator, outline: Array, more: int) -> Array:
    """The outline with `more` vertices somewhere on its sides."""
    side = np.sort(rng.integers(len(outline), size=more))
    part = rng.uniform(size=more)
    there = outline[side] + part[:, None] * (outline[(side + 1) % len(outline)] - outline[side])
    order = np.lexsort((np.append(np.zeros(len(outline)), part), np.append(np.arange(len(outline)), side)))
    return np.concatenate([outline, there])[order]


def _meshed(rng: np.random.Generator, loops: list[Array], inside: int) -> Arrays | None:
    """The domain between the loops with about so many vertices inside, thrown over the box of the domain."""
    low, high = loops[0].min(0), loops[0].max(0)
    box = rng.uniform(low, high, (3 * inside, 2))
    points, starts = np.concatenate([*loops, box]), np.cumsum([0, *map(len, loops)])
    rows = [np.arange(starts[i], starts[i + 1]) for i in range(len(loops))]
    work = triangulate_with(points, rows, np.ones(len(points)), np.arange(starts[-1], len(points)), _NO_EDGES)
    if work is None:
        return None
    used, corners = np.unique(work.corners, return_inverse=True)
    kept = used[: starts[-1] + inside]
    if len(kept) < len(used):  # again, with no more vertices inside than were asked for
        work = triangulate_with(points, rows, np.ones(len(points)), kept[starts[-1] :], _NO_EDGES)
        if work is None:
            return None
        used, corners = np.unique(work.corners, return_inverse=True)
    return points[used], corners.reshape(-1, 3), _NO_EDGES


def _largest_part(points: Array, faces: Array, rng: np.random.Generator) -> Arrays | None:
    """The largest part of the triangles that is joined by edges, some of its edges constrained."""
    if not len(faces):
        return None
    twin = connectivity.twins(torch.from_numpy(faces))
    label = connectivity.triangle_components(torch.from_numpy(faces), twin).numpy()
    used, corners = np.unique(faces[label == np.bincount(label).argmax()], return_inverse=True)
    corners = corners.reshape(-1, 3)
    rows = torch.from_numpy(corners)
    edges = connectivity.edges(rows, connectivity.twins(rows)).numpy()
    return points[used], corners, edges[rng.uniform(size=len(edges)) < rng.choice([0.0, 0.0, 0.05])]
