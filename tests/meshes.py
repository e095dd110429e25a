"""Small named meshes, shared by the tests.

grid        structured grid of the unit square         jittered    the same, interior vertices thrown about
disc        rings round a hub                          ring        an annulus, one hole
l_shape     two regions, the interface constrained     delaunay    scipy's triangulation of random points
equilateral a patch of equilateral triangles           moved_hole  a hole dragged through its mesh by FEMWARP
"""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import torch
from scipy.spatial import Delaunay

import torchmesh as tm
from torchmesh import MeshBatch
from torchmesh.mesh.interfaces import holding


def grid_arrays(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (V, 2) in the unit square and triangles (T, 3), two a cell."""
    x, y = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1), indexing="ij")
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    triangles = np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3)
    return np.stack([x.ravel(), y.ravel()], 1), triangles


def grid(columns: int = 6, rows: int = 5) -> MeshBatch:
    return MeshBatch.from_arrays(*grid_arrays(columns, rows))


def disturbed(mesh: MeshBatch, size: float, seed: int) -> MeshBatch:
    """`mesh` with every free vertex thrown off by a normal deviate of `size`."""
    throw = size * torch.randn(mesh.points.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    return mesh.with_points(torch.where(holding(mesh).fixed[:, None], mesh.points, mesh.points + throw.to(mesh.points)))


def jittered(columns: int = 8, rows: int = 7, cells: float = 0.5, seed: int = 0) -> MeshBatch:
    """A grid whose interior vertices are off by a normal deviate of `cells` columns: tangled from 0.3 on."""
    return disturbed(grid(columns, rows), cells / columns, seed)


def ring_arrays(sectors: int, layers: int, inner: float, outer: float) -> tuple[np.ndarray, np.ndarray]:
    radius = np.linspace(inner, outer, layers + 1)
    angle = 2 * np.pi * np.arange(sectors) / sectors
    points = np.stack([np.outer(radius, np.cos(angle)).ravel(), np.outer(radius, np.sin(angle)).ravel()], 1)
    k, i = np.meshgrid(np.arange(layers), np.arange(sectors), indexing="ij")
    a, b = (k * sectors + i).ravel(), (k * sectors + (i + 1) % sectors).ravel()
    triangles = np.concatenate([np.stack([a, a + sectors, b + sectors], 1), np.stack([a, b + sectors, b], 1)])
    return points, triangles


def ring(sectors: int = 16, layers: int = 4, inner: float = 0.4, outer: float = 1.3) -> MeshBatch:
    """An annulus; the inner rim has the vertices 0 ... sectors - 1."""
    return MeshBatch.from_arrays(*ring_arrays(sectors, layers, inner, outer))


def disc(sectors: int = 12, layers: int = 4) -> MeshBatch:
    """A disc of radius 1, the last vertex in its centre."""
    points, triangles = ring_arrays(sectors, layers - 1, 1 / layers, 1.0)
    hub = len(points)
    fan = [[i, (i + 1) % sectors, hub] for i in range(sectors)]
    return MeshBatch.from_arrays(np.concatenate([points, [[0.0, 0.0]]]), np.concatenate([triangles, fan]))


def l_shape(cells: int = 3) -> MeshBatch:
    """[0, 2]^2 without its upper right quarter; the line x = 1 between its two regions is constrained."""
    points, triangles = grid_arrays(2 * cells, 2 * cells)
    points = 2 * points
    triangles = triangles[~(points[triangles].mean(1) > 1).all(1)]
    used, triangles = np.unique(triangles, return_inverse=True)
    points, triangles = points[used], triangles.reshape(-1, 3)
    line = np.flatnonzero((points[:, 0] == 1) & (points[:, 1] <= 1))
    return MeshBatch.from_arrays(points, triangles, constrained_edges=np.stack([line[:-1], line[1:]], 1))


def equilateral(columns: int = 5, rows: int = 4, side: float = 1.0) -> MeshBatch:
    """A parallelogram of equilateral triangles."""
    points, triangles = grid_arrays(columns, rows)
    steps = points * [columns, rows]
    # The diagonal of a cell runs from (0, 0) to (1, 1): the cell's corner at (1, 1) is 60 degrees up.
    lattice = np.stack([steps[:, 0] - 0.5 * steps[:, 1], np.sqrt(3) / 2 * steps[:, 1]], 1)
    return MeshBatch.from_arrays(side * lattice, triangles)


def delaunay_arrays(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 2))
    triangles = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[triangles].transpose(1, 0, 2)
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    triangles[clockwise] = triangles[clockwise, ::-1]
    return points, triangles


def delaunay(count: int = 40, seed: int = 0) -> MeshBatch:
    """Random points in general position and their Delaunay triangles; the boundary is their convex hull."""
    return MeshBatch.from_arrays(*delaunay_arrays(count, seed))


def scrambled(mesh: MeshBatch, seed: int, tries: int = 400) -> MeshBatch:
    """The same points and boundary, valid, joined otherwise: random flips inside convex quadrilaterals."""
    rng = np.random.default_rng(seed)
    points, rows = mesh.points.numpy(), [list(row) for row in mesh.triangles.tolist()]

    def positive(a, b, c):
        p, q, r = points[a], points[b], points[c]
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]) > 1e-9

    for _ in range(tries):
        i, corner = int(rng.integers(len(rows))), int(rng.integers(3))
        u, w, s = (rows[i][(corner + k) % 3] for k in range(3))
        for j, other in enumerate(rows):
            if j != i and u in other and w in other:
                r = next(v for v in other if v not in (u, w))
                if positive(u, r, s) and positive(r, w, s):
                    rows[i], rows[j] = [u, r, s], [r, w, s]
                break
    return mesh.with_triangles(torch.tensor(rows))


def holed_arrays(columns: int = 18, rows: int = 10, sides: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """A rectangle 18 by 10 with a round hole of radius 1 about (4, 5); the hole's vertices come last."""
    x, y = np.meshgrid(np.linspace(0, 18, columns + 1), np.linspace(0, 10, rows + 1), indexing="ij")
    lattice = np.stack([x.ravel(), y.ravel()], 1)
    lattice = lattice[np.hypot(lattice[:, 0] - 4, lattice[:, 1] - 5) > 1.4]
    angle = 2 * np.pi * (np.arange(sides) + 0.25) / sides
    points = np.concatenate([lattice, np.stack([4 + np.cos(angle), 5 + np.sin(angle)], 1)])
    triangles = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[triangles].transpose(1, 0, 2)
    twice = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles = np.where((twice < 0)[:, None], triangles[:, ::-1], triangles)
    inside = (triangles >= len(lattice)).all(1)
    return points, triangles[~inside & (np.abs(twice) > 1e-9)]


def turned(points: torch.Tensor, degrees: float) -> torch.Tensor:
    a = math.radians(degrees)
    return points @ torch.tensor([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]], dtype=torch.float64)


def moved_hole(distance: float = 5.0) -> MeshBatch:
    """A hole moved right by `distance` (its radius is 1), the rest carried along by FEMWARP: tangled."""
    mesh = MeshBatch.from_arrays(*holed_arrays())
    on_hole = torch.hypot(mesh.points[:, 0] - 4, mesh.points[:, 1] - 5) < 1.1
    return tm.femwarp(mesh, mesh.points + on_hole[:, None] * torch.tensor([distance, 0.0], dtype=torch.float64))


def hopeless() -> MeshBatch:
    """A grid with four held vertices in its middle, two of which have been exchanged: their triangles stay inverted."""
    mesh = grid(10, 10)
    points, fixed = mesh.points.clone(), mesh.fixed.clone()
    one, two, *rest = 49, 60, 48, 61
    points[[one, two]] = points[[two, one]]
    fixed[[one, two, *rest]] = True
    return dataclasses.replace(mesh, points=points, fixed=fixed)


def dragged_interface() -> MeshBatch:
    """The L-shape, its interface kept and its other interior vertices thrown about."""
    return disturbed(l_shape(4), 0.2, 5)


# Five vertices, five triangles round a band with one twist; no edge has three.
MOEBIUS = (
    np.array([[np.cos(a), np.sin(a)] for a in 2 * np.pi * np.arange(5) / 5]),
    np.array([[0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 0], [4, 0, 1]]),
)

# Two triangles that meet in the vertex 2 only.
BOWTIE = (
    np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 0.0], [1.0, 1.0], [-1.0, 1.0]]),
    np.array([[0, 1, 2], [2, 3, 4]]),
)

VALID: dict[str, Callable[[], MeshBatch]] = {
    "grid": grid,
    "disc": disc,
    "ring": ring,
    "l_shape": l_shape,
    "equilateral": equilateral,
    "delaunay": delaunay,
    "bowtie": lambda: MeshBatch.from_arrays(*BOWTIE),
}

TANGLED: dict[str, Callable[[], MeshBatch]] = {
    "jittered": lambda: jittered(8, 7, 0.5, 0),
    "heavily jittered": lambda: jittered(7, 7, 0.9, 1),
    "disc": lambda: disturbed(disc(), 0.2, 2),
    "ring": lambda: disturbed(ring(), 0.15, 3),
    "moved hole": moved_hole,
    "interface": dragged_interface,
}


def crowded_square(cells: int = 14) -> MeshBatch:
    """A square whose inner columns are pressed to the left: crowded there, empty on the right."""
    mesh = grid(cells, cells)
    pressed = torch.stack([mesh.points[:, 0] ** 2.5, mesh.points[:, 1]], 1)
    return mesh.with_points(torch.where(holding(mesh).fixed[:, None], mesh.points, pressed))


def mixed_arrays(columns: int, rows: int, quads: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of a grid, the triangles of its right part and the quads of its first columns, `quads` of them."""
    points, halves = grid_arrays(columns, rows)
    first, second = halves.reshape(2, -1, 3)
    quad = np.concatenate([first, second[:, 2:]], 1)
    left = np.arange(len(quad)) < quads * rows
    return points, np.concatenate([first[~left], second[~left]]), quad[left]


def mixed(columns: int = 6, rows: int = 5, quads: int = 3) -> MeshBatch:
    """A grid of the unit square with quads in its first columns; `quads` may be all of the columns."""
    points, triangles, rows_of_quads = mixed_arrays(columns, rows, quads)
    return MeshBatch.from_arrays(points, triangles, quads=rows_of_quads)


def quad_layers(sectors: int = 24, rows: int = 3, height: float = 0.01) -> MeshBatch:
    """An annulus with thin rows of quads round its hole of radius 0.4, whose vertices are the first, and triangles."""
    radius = 0.4 + height * np.cumsum([0.0, *[1.3**k for k in range(rows)]])
    outer = np.linspace(radius[-1], 1.6, 7)[1:]
    angle = 2 * np.pi * np.arange(sectors) / sectors
    every = np.concatenate([radius, outer])
    points = np.stack([np.outer(every, np.cos(angle)).ravel(), np.outer(every, np.sin(angle)).ravel()], 1)
    k, i = np.meshgrid(np.arange(len(every) - 1), np.arange(sectors), indexing="ij")
    a, b = (k * sectors + i).ravel(), (k * sectors + (i + 1) % sectors).ravel()
    quads = np.stack([a, a + sectors, b + sectors, b], 1)
    of_layer = (k < rows).ravel()
    rest = quads[~of_layer]
    triangles = np.concatenate([rest[:, [0, 1, 2]], rest[:, [0, 2, 3]]])
    return MeshBatch.from_arrays(points, triangles, quads=quads[of_layer])
