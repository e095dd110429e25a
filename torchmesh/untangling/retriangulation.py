"""The last resort with a guarantee: forget the triangles of a tangled cavity and make them anew.

Inside a simple boundary a valid triangulation with the same vertices always exists.  A cavity's rim
is triangulated without its interior vertices; these go back in, where they were if they were
inside, else where there is room.  Euler's formula gives back the cavity's number of triangles, so
the new ones take the old rows.  Every sign is exact; the result is checked as a whole.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh import connectivity
from ..mesh.batch import MeshBatch, join
from ..triangulating.arrays import Obstacle, among, distinct, signs
from ..triangulating.crossings import crossing_pairs
from ..triangulating.placing import place_vertices
from ..triangulating.polygon import loops_of, unit_exponent, why_not_simple
from ..triangulating.polygon_triangulation import locate, triangulate_polygon, triangulate_with
from ..triangulating.recovery import recover
from ..triangulating.triangulation import Triangulation

# Of free vertices nearer to each other than this part of the cavity's mean spacing only one stays.
_CLUSTER = 1e-6


@dataclass(frozen=True, eq=False)
class Retriangulation:
    """What became of the cavities of one mesh.

    mesh       the mesh with new triangles and places, same vertices and rows
    ok         whether everything asked for is now valid, checked exactly
    reason     why not, with vertex numbers; "" when ok
    moved      (V,) bool, vertices that are in another place
    rewritten  (T,) bool, rows of triangles that were made anew
    cavities    how many pieces were made anew
    """

    mesh: MeshBatch
    ok: bool
    reason: str
    moved: Tensor
    rewritten: Tensor
    cavities: int = 0


def retriangulate(mesh: MeshBatch, cavity: Tensor, keep: Tensor | None = None) -> Retriangulation:
    """Make the triangles of `cavity` (T,) bool anew, wherever their interior vertices are now.

    A constrained edge is an inner wall: each piece of the cavity that it closes off is made alone.
    keep (V,) bool, default all: the free vertices that stay in place if they can; the others are
    spread over the cavity, by area over the squared length of the rim's edges nearby.

    Fixed vertices, constrained edges, the boundary and the triangles outside the cavity stay.
    `ok` is False, and the mesh unchanged, when a piece's rim is not a simple polygon, a fixed
    vertex lies outside its piece or on another, or a constrained edge crosses an edge that stays.
    Raises InvalidMeshError for a batch of several meshes or a mask of the wrong shape.
    """
    triangles = _triangles_of_one(mesh)
    cavity = torch.as_tensor(cavity)
    if cavity.shape != (len(triangles),) or cavity.dtype != torch.bool:
        raise InvalidMeshError(f"cavity must be ({len(triangles)},) bool, not {tuple(cavity.shape)} {cavity.dtype}")
    work = _Work(mesh, keep)
    for rows, outer in work.pieces(cavity.cpu().numpy()):
        reason = work.rebuild(rows, outer)
        if reason:
            return _unchanged(mesh, reason)
    result = work.result(mesh)
    reason = why_not_certified(mesh, result.mesh, result.rewritten)
    return _unchanged(mesh, reason) if reason else result


def untangle_by_retriangulation(mesh: MeshBatch, keep: Tensor | None = None) -> Retriangulation:
    """Make anew the smallest cavities that leave no inverted or flat triangle in the mesh.

    Each cavity starts as the bad triangles and the ring around them, and grows ring by ring until
    its rim is a simple polygon that holds its fixed vertices; at last it is all that the boundary
    and the constrained edges close off.  `keep` as in `retriangulate`.  With `ok` False the cavities
    that could be repaired are, and `reason` says what stopped the others.
    Raises InvalidMeshError for a batch of several meshes.
    """
    _triangles_of_one(mesh)
    work = _Work(mesh, keep)
    reasons = work.untangle(_regions(mesh))
    result = work.result(mesh)
    if not reasons:
        everything = torch.ones(len(mesh.triangles), dtype=torch.bool)
        reasons = [r for r in [why_not_certified(mesh, result.mesh, everything)] if r]
    if not reasons:
        return result
    return dataclasses.replace(result, ok=False, reason="; ".join(reasons))


@dataclass(frozen=True, eq=False)
class RetriangulationInfo:
    """What `retriangulate_cavities` did.

    cavities  (B,) int64 pieces made anew in each mesh
    reasons  for each mesh what stopped the others, "" where nothing did
    """

    cavities: Tensor
    reasons: list[str]


def retriangulate_cavities(batch: MeshBatch) -> tuple[MeshBatch, RetriangulationInfo]:
    """`untangle_by_retriangulation` on each mesh of a batch, as far as it goes, without the last look at the whole."""
    region, face = _regions(batch), batch.triangle_offsets.tolist()
    meshes, made, reasons = [], [], []
    for b, mesh in enumerate(batch.split()):
        work = _Work(mesh, None)
        # Regions are numbered by their first triangles, so those of a mesh follow each other.
        reasons.append("; ".join(work.untangle(region[face[b] : face[b + 1]] - region[face[b]])))
        meshes.append(work.result(mesh).mesh)
        made.append(work.cavities)
    return join(meshes), RetriangulationInfo(torch.tensor(made, dtype=torch.int64, device=batch.points.device), reasons)


def _regions(batch: MeshBatch) -> np.ndarray:
    """(T,) what the boundary and the constrained edges close off, numbered by first triangles."""
    triangles, count = batch.triangles.cpu(), len(batch.points)
    twin, walls = connectivity.twins(triangles), batch.constrained_edges.cpu()
    if not len(walls):
        return connectivity.triangle_components(triangles, twin).numpy()
    keys = connectivity.edge_keys(connectivity.tails(triangles), connectivity.heads(triangles), count)
    wall = torch.isin(keys, connectivity.edge_keys(walls[:, 0], walls[:, 1], count))
    return connectivity.triangle_components(triangles, twin, wall).numpy()


def why_not_certified(before: MeshBatch, after: MeshBatch, rows: Tensor) -> str:
    """What is wrong with `after` as a repair of `before` in the triangles `rows` (T,) bool; "" if nothing.

    The exact sign of every triangle of `rows`; each edge in two triangles that run along it
    opposite ways, or on the same boundary as before; constrained edges and fixed vertices in place;
    the same vertices in use and as many triangles, so the same Euler number.
    """
    points, triangles = _numpy(after.points.to(torch.float64)), after.triangles
    sign = signs(points, *_numpy(triangles).T)
    bad = np.flatnonzero((sign <= 0) & _numpy(rows))
    if len(bad):
        return f"triangles row {bad[0]} {triangles[int(bad[0])].tolist()} is inverted or flat ({len(bad)} rows are)"
    count = len(points)
    there = connectivity.tails(triangles) * count + connectivity.heads(triangles)
    if len(there.unique()) < len(there):
        return "two triangles run along one edge the same way"
    twin, old_twin = connectivity.twins(triangles), connectivity.twins(before.triangles)
    rims = [connectivity.boundary_edges(t, w) for t, w in ((triangles, twin), (before.triangles, old_twin))]
    new, old = ((rim[:, 0] * count + rim[:, 1]).sort().values for rim in rims)
    if not torch.equal(new, old):
        return "the boundary edges changed"
    kept = connectivity.edge_keys(after.constrained_edges[:, 0], after.constrained_edges[:, 1], count)
    present = connectivity.edges(triangles, twin)
    missing = ~torch.isin(kept, connectivity.edge_keys(present[:, 0], present[:, 1], count))
    if bool(missing.any()):
        return f"the constrained edge {after.constrained_edges[missing][0].tolist()} is gone"
    if not torch.equal(after.points[after.fixed], before.points[before.fixed]):
        return "a fixed vertex moved"
    # With the same rim and number of triangles this is the Euler number.
    used, once = triangles.unique(), before.triangles.unique()
    if len(triangles) != len(before.triangles) or not torch.equal(used, once):
        return f"{len(used)} vertices are in {len(triangles)} triangles, not {len(once)} in {len(before.triangles)}"
    return ""


class _Work:
    """One mesh's arrays while its cavities are re-triangulated; points in units of a power of two near its size."""

    def __init__(self, mesh: MeshBatch, keep: Tensor | None) -> None:
        self.dtype = _numpy(mesh.points).dtype
        original = _numpy(mesh.points.to(torch.float64))
        self.exponent = unit_exponent(original)
        self.points = np.ldexp(original, -self.exponent)
        self.triangles = _numpy(mesh.triangles).copy()
        self.fixed = _numpy(mesh.fixed)
        self.keep = np.ones(len(original), bool) if keep is None else _numpy(torch.as_tensor(keep))
        if self.keep.shape != self.fixed.shape or self.keep.dtype != np.bool_:
            raise InvalidMeshError(f"keep must be ({len(original)},) bool, not {self.keep.shape} {self.keep.dtype}")
        self.walls = np.sort(self._keys(*_numpy(mesh.constrained_edges).T))
        self.moved = np.zeros(len(original), bool)
        self.rewritten = np.zeros(len(self.triangles), bool)
        self.cavities = 0

    def untangle(self, region: np.ndarray) -> list[str]:
        """Make anew the smallest cavities that will do; what stopped the others.  region (T,) as from `_regions`."""
        size = np.bincount(region)
        wanted = signs(self.points, *self.triangles.T) <= 0
        reasons = []
        attempt = 0
        while wanted.any():
            # Rings get dearer with their number; a cavity slightly too large does no harm.
            for _ in range(1 + attempt // 3):
                wanted = _with_ring(self.triangles, region, wanted)
            for rows, outer in sorted(self.pieces(wanted), key=lambda piece: len(piece[0])):
                reason = self.rebuild(rows, outer)
                if reason and len(rows) == size[region[rows[0]]]:
                    reasons.append(reason)
                if not reason or len(rows) == size[region[rows[0]]]:
                    wanted[rows] = False
            attempt += 1
        return reasons

    def pieces(self, cavity: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """The parts of `cavity` (T,) bool that are joined by edges and cross no constrained one.

        Of each its rows (N,), and which of their half-edges (3N,) bool have no other of the part beyond.
        """
        rows = np.flatnonzero(cavity)
        triangles = torch.from_numpy(self.triangles[rows])
        ends = triangles.numpy()
        wall = among(self._keys(ends.ravel(), np.roll(ends, -1, 1).ravel()), self.walls)
        twin = connectivity.twins(triangles)
        label = connectivity.triangle_components(triangles, twin, torch.from_numpy(wall)).numpy()
        beyond = twin.numpy()
        outer = (beyond < 0).reshape(-1, 3) | (label[beyond // 3].reshape(-1, 3) != label[:, None])
        order = np.argsort(label, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
        return [(rows[part], outer[part].ravel()) for part in parts if len(part)]

    def rebuild(self, rows: np.ndarray, outer: np.ndarray) -> str:
        """New triangles in `rows`, a piece with its `outer` half-edges; "" or why not, with nothing changed."""
        piece = self.triangles[rows]
        vertices, local = np.unique(piece, return_inverse=True)
        local = local.reshape(-1, 3)
        ends = np.stack([local.ravel(), np.roll(local, -1, 1).ravel()], 1)
        wall = among(self._keys(*vertices[ends].T), self.walls)
        built = _fill(
            points=self.points[vertices],
            rim=ends[outer],
            dangling=_edges_of(ends[wall & ~outer]),
            fixed=self.fixed[vertices],
            keep=self.keep[vertices],
            dtype=self.dtype,
        )
        if isinstance(built, Obstacle):
            return str(built.renumbered(vertices))
        corners, points, moved = built
        if len(corners) != len(rows):
            return f"the piece has {len(rows)} triangles, and its rim and vertices ask for {len(corners)}"
        # A chord of the rim may be an edge outside already, if the mesh there lies over itself.
        on_rim = np.zeros(len(vertices), bool)
        on_rim[ends[outer]] = True
        sides = np.stack([corners.ravel(), np.roll(corners, -1, 1).ravel()], 1)
        chords = distinct(self._keys(*vertices[sides[on_rim[sides].all(1)]].T))
        chords = chords[~among(chords, self._keys(*vertices[ends[outer]].T))]
        taken = chords[among(chords, self._keys_outside(rows, vertices[on_rim]))] if len(chords) else chords
        if len(taken):
            return f"the edge {divmod(int(taken[0]), len(self.points))} exists outside the cavity already"
        self.triangles[rows] = vertices[corners]
        self.points[vertices[moved]] = points[moved]
        self.moved[vertices[moved]] = True
        self.rewritten[rows] = True
        self.cavities += 1
        return ""

    def result(self, mesh: MeshBatch) -> Retriangulation:
        """The mesh as it is now."""
        device = mesh.points.device
        places = torch.from_numpy(np.ldexp(self.points, self.exponent)).to(mesh.points)
        moved = torch.from_numpy(self.moved).to(device)
        points = torch.where(moved[:, None], places, mesh.points)
        triangles = torch.from_numpy(self.triangles).to(device)
        rewritten = torch.from_numpy(self.rewritten).to(device)
        return Retriangulation(
            mesh.with_points(points).with_triangles(triangles), True, "", moved, rewritten, self.cavities
        )

    def _keys(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.minimum(u, v) * len(self.points) + np.maximum(u, v)

    def _keys_outside(self, rows: np.ndarray, vertices: np.ndarray) -> np.ndarray:
        """The keys of the edges among `vertices` of the triangles other than `rows`."""
        mark = np.zeros(len(self.points), bool)
        mark[vertices] = True
        a, b, c = (mark[np.ascontiguousarray(v)] for v in self.triangles.T)
        near = (a & b) | (b & c) | (c & a)
        near[rows] = False
        there = self.triangles[near]
        return self._keys(there.ravel(), np.roll(there, -1, 1).ravel())


def _edges_of(ends: np.ndarray) -> np.ndarray:
    """(K, 2) the edges among the half-edges `ends` (N, 2), each once."""
    return np.unique(np.sort(ends, 1), axis=0) if len(ends) else ends


def _fill(
    points: np.ndarray, rim: np.ndarray, dangling: np.ndarray, fixed: np.ndarray, keep: np.ndarray, dtype: np.dtype
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | Obstacle:
    """Triangulate inside the directed edges `rim` (E, 2) with all of `points` (V, 2).

    dangling (K, 2) edges inside that must be there; fixed (V,) bool vertices that must stay; keep
    (V,) bool vertices that stay if they can; dtype: that of the places to choose.
    Returns the triangles (T, 3), the points, and which moved (V,) bool; or what is in the way.
    """
    loops = loops_of(rim)
    ends = points[rim]
    length = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    degree = np.bincount(rim.ravel(), minlength=len(points))
    spacing = np.bincount(rim.ravel(), np.repeat(length, 2), len(points)) / np.maximum(degree, 1)
    on_rim = degree > 0
    anchors, free = np.flatnonzero(fixed & ~on_rim), ~fixed & ~on_rim
    obstacle = why_not_simple(points, loops)
    if obstacle:
        return obstacle
    stay = np.flatnonzero(free & keep)
    area = 0.5 * float((ends[:, 0, 0] * ends[:, 1, 1] - ends[:, 0, 1] * ends[:, 1, 0]).sum())
    # The edge of a square that each had if they shared the area.
    stay = stay[_scattered(points[stay], _CLUSTER * np.sqrt(abs(area) / max(len(stay), 1)))]
    work = triangulate_with(points.copy(), loops, spacing, np.concatenate([anchors, stay]), dangling)
    if work is None or not among(anchors, work.corners).all():
        built = _step_by_step(points.copy(), loops, spacing, anchors, stay, dangling)
        if isinstance(built, Obstacle):
            return built
        work = built
    moved = free.copy()
    moved[work.corners] = False
    left = place_vertices(work, np.flatnonzero(moved), dtype)
    if len(left):
        return Obstacle(f"no room between floating-point numbers for {len(left)} vertices, as {{}}", (int(left[0]),))
    return work.corners, work.points, moved


def _step_by_step(
    points: np.ndarray,
    loops: list[np.ndarray],
    spacing: np.ndarray,
    anchors: np.ndarray,
    stay: np.ndarray,
    dangling: np.ndarray,
) -> Triangulation | Obstacle:
    """What `triangulate_with` does, with reasons: all `anchors` (N,), those of `stay` (N,) that can go in."""
    work = triangulate_polygon(points, loops, spacing)
    if isinstance(work, Obstacle):
        return work
    refused = _insert(work, anchors)
    if len(refused):
        return Obstacle(
            "the fixed vertex {} lies outside its region, on its rim, or on another vertex", (int(refused[0]),)
        )
    crossing = crossing_pairs(points, dangling)
    if len(crossing):
        ends = tuple(dangling[crossing[0]].ravel().tolist())
        return Obstacle("the constrained edges [{}, {}] and [{}, {}] meet", ends)
    obstacle = recover(work, dangling)
    if obstacle is not None:
        return obstacle
    _insert(work, stay)
    return work


def _insert(work: Triangulation, vertices: np.ndarray) -> np.ndarray:
    """Put `vertices` in where they are; those that cannot, returned."""
    if not len(vertices):
        return vertices
    # The rim's triangles are long and their boxes large; a few vertices in, and the rest is located fast.
    order = np.random.default_rng(0).permutation(vertices)
    cuts = [len(order) // 64, len(order) // 8] if len(order) > 2000 else []
    refused = []
    for part in np.split(order, cuts):
        home = locate(work.points, part, work.corners)
        refused += [part[home < 0], work.insert(part[home >= 0], home[home >= 0])]
    return np.concatenate(refused)


def _scattered(points: np.ndarray, distance: float) -> np.ndarray:
    """Rows of `points` (N, 2), one of each square of side `distance`; all if that cannot be told."""
    with np.errstate(all="ignore"):
        square = np.floor((points - points.min(0, initial=np.inf)) / distance)
    if not np.isfinite(square).all():
        return np.arange(len(points))
    return np.unique(square[:, 0] + 1j * square[:, 1], return_index=True)[1]


def _with_ring(triangles: np.ndarray, region: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """`wanted` (T,) bool and the triangles of the same region that share a vertex with them."""
    if region.any():
        keys = triangles * (region.max() + 1) + region[:, None]
        return np.asarray(among(keys, keys[wanted]).any(1))
    corners = [np.ascontiguousarray(v) for v in triangles.T]
    mark = np.zeros(int(triangles.max(initial=0)) + 1, bool)
    for v in corners:
        mark[v[wanted]] = True
    return np.asarray(mark[corners[0]] | mark[corners[1]] | mark[corners[2]])


def _numpy(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().numpy()


def _triangles_of_one(mesh: MeshBatch) -> Tensor:
    if len(mesh) != 1:
        raise InvalidMeshError(f"cavities are re-triangulated in one mesh at a time, not {len(mesh)}; use .split()")
    return mesh.triangles


def _unchanged(mesh: MeshBatch, reason: str) -> Retriangulation:
    device = mesh.points.device
    nowhere = [torch.zeros(len(rows), dtype=torch.bool, device=device) for rows in (mesh.points, mesh.triangles)]
    moved, rewritten = nowhere
    return Retriangulation(mesh, False, reason, moved, rewritten)
