"""The last resort with a guarantee: forget the triangles of a tangled cavity and make them anew.

Inside a simple boundary a valid triangulation with the same vertices always exists.  A cavity is triangulated without
its interior vertices first; then these are inserted where they were if they lie inside, and elsewhere if not.  By
Euler's formula the cavity has as many triangles as before, so the new ones take the old rows.  Every sign is exact, and
the result is checked as a whole.
"""

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..errors import InvalidMeshError
from ..mesh import connectivity
from ..mesh.batch import MeshBatch, join
from ..mesh.connectivity import corners_of, touching
from ..mesh.interfaces import Interfaces, holding
from ..mesh.kept_edges import constrained_half_edges
from ..mesh.measure import upright
from ..optimising.laplacian import harmonic_extension
from ..triangulating.arrays import Obstacle, among, distinct, signs
from ..triangulating.crossings import cross_properly, crossing_pairs
from ..triangulating.polygon import unit_exponent
from ..triangulating.touching import plane_boundary
from .cavity import Cavity
from .repair_check import why_not_certified


@dataclass(frozen=True, eq=False)
class Retriangulation:
    """What became of the cavities of one mesh.

    mesh       the mesh with new triangles and positions; its vertices and the number of its rows are the same
    ok         whether everything asked for is now valid, checked exactly
    reason     why not, with vertex numbers; "" when ok
    moved      (V,) bool, vertices whose position has changed
    rewritten  (T,) bool, rows of new triangles
    cavities   number of cavities that were re-triangulated
    """

    mesh: MeshBatch
    ok: bool
    reason: str
    moved: Tensor
    rewritten: Tensor
    cavities: int = 0


def retriangulate(mesh: MeshBatch, cavity: Tensor, keep: Tensor | None = None) -> Retriangulation:
    """Make the triangles of `cavity` (T,) bool anew, wherever their interior vertices are now.

    Constrained edges are inner walls: each component of the cavity that they close off is triangulated alone.
    Fixed vertices, constrained edges and their ends, the boundary and the triangles outside the cavity stay.

    keep  (V,) bool: the free vertices that keep their position where possible; None: all.  The others are spread over
          the cavity, in density by the squared length of the boundary edges nearby

    The boundary of a component may touch itself in fixed vertices.  `ok` is False, and the mesh unchanged, when it
    crosses itself, when a fixed vertex lies outside its component or on another vertex, or when a constrained edge
    crosses an edge that stays.
    Raises InvalidMeshError for a batch of several meshes or a mask of the wrong shape.
    """
    triangles = _triangles_of_one(mesh)
    cavity = torch.as_tensor(cavity)
    if cavity.shape != (len(triangles),) or cavity.dtype != torch.bool:
        raise InvalidMeshError(f"cavity must be ({len(triangles)},) bool, not {tuple(cavity.shape)} {cavity.dtype}")
    work = _Work(mesh, keep)
    for rows, outer in work.components(cavity.cpu().numpy()):
        reason = work.rebuild(rows, outer)
        if reason:
            return _unchanged(mesh, reason)
    result = work.result(mesh)
    reason = why_not_certified(mesh, result.mesh, result.rewritten)
    return _unchanged(mesh, reason) if reason else result


def untangle_by_retriangulation(mesh: MeshBatch, keep: Tensor | None = None) -> Retriangulation:
    """Re-triangulate the smallest cavities that leave no inverted or flat triangle in the mesh.

    Each cavity starts as the inverted triangles and the ring around them.  It grows ring by ring until its boundary is
    a polygon around its fixed vertices that does not cross itself; at last it is all that the boundary and the
    constrained edges close off.  It stops growing where the boundary of the mesh crosses itself in it.  `keep` is that
    of `retriangulate`.  When `ok` is False, the cavities that could be repaired are, and `reason` says what stopped the
    others.
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

    cavities  (B,) int64 number of cavities re-triangulated in each mesh
    reasons   for each mesh what stopped the other cavities, "" where nothing did
    """

    cavities: Tensor
    reasons: list[str]


def retriangulate_cavities(
    batch: MeshBatch, interfaces: Interfaces | None = None
) -> tuple[MeshBatch, RetriangulationInfo]:
    """`untangle_by_retriangulation` of each mesh of a batch, without the check of the whole at the end.

    interfaces  "free": where constrained edges are in the way of cavities, they are moved first (`walls_moved`)
    """
    region, face = _regions(batch), batch.triangle_offsets.tolist()
    meshes, made, reasons = [], [], []
    for b, mesh in enumerate(batch.split()):
        work = _Work(mesh, None)
        # Regions are numbered by their first triangles, so those of a mesh follow each other.
        own = region[face[b] : face[b + 1]] - region[face[b]]
        left = work.untangle(own)
        if left and interfaces == "free" and len(mesh.constrained_edges):
            for moved in walls_moved(mesh):
                again = _Work(moved, None)
                if not again.untangle(own):
                    mesh, work, left = moved, again, []
                    break
        reasons.append("; ".join(left))
        meshes.append(work.result(mesh).mesh)
        made.append(work.cavities)
    return join(meshes), RetriangulationInfo(torch.tensor(made, dtype=torch.int64, device=batch.points.device), reasons)


def _regions(batch: MeshBatch) -> np.ndarray:
    """(T,) the region of each triangle: boundary and constrained edges close it off; numbered by first triangles."""
    walls = constrained_half_edges(batch) if len(batch.constrained_edges) else None
    return connectivity.triangle_components(batch.triangles, batch.twin, walls).cpu().numpy()


# The rings of triangles round the inverted ones within which walls are moved, the fewest first.
_RINGS = (2, 6, 18)


def walls_moved(mesh: MeshBatch) -> Iterator[MeshBatch]:
    """One mesh with the vertices near its inverted triangles at the means of their neighbours, in ever wider rings.

    The means keep what lies inside a convex part of the plane from crossing (Tutte, How to draw a graph, Proceedings of
    the London Mathematical Society s3-13, 1963).  Elsewhere triangles may stay inverted, but cavities only need that
    constrained edges do not cross each other or the boundary.
    """
    one = torch.ones(len(mesh.triangles), dtype=torch.float64, device=mesh.points.device)
    near, rings = ~upright(mesh), 0
    for goal in (*_RINGS, None):
        while goal is None or rings < goal:
            wider = touching(mesh.triangles, corners_of(mesh.triangles, near, len(mesh.points)))
            rings += 1
            if bool((wider == near).all()):
                break
            near = wider
        still = mesh.fixed | corners_of(mesh.triangles, ~near, len(mesh.points))
        points = harmonic_extension(mesh.triangles, (one, one, one), still, mesh.points, mesh.point_offsets)
        yield mesh.with_points(points)
        if bool(near.all()):
            return


class _Work:
    """One mesh as arrays while its cavities are re-triangulated; points in units of a power of two near its size."""

    def __init__(self, mesh: MeshBatch, keep: Tensor | None) -> None:
        self.dtype = _numpy(mesh.points).dtype
        original = _numpy(mesh.points.to(torch.float64))
        self.exponent = unit_exponent(original)
        self.points = np.ldexp(original, -self.exponent)
        self.triangles = _numpy(mesh.triangles).copy()
        # The walls of a cavity stay where they are.
        self.fixed = _numpy(holding(mesh).fixed)
        self.keep = np.ones(len(original), bool) if keep is None else _numpy(torch.as_tensor(keep))
        if self.keep.shape != self.fixed.shape or self.keep.dtype != np.bool_:
            raise InvalidMeshError(f"keep must be ({len(original)},) bool, not {self.keep.shape} {self.keep.dtype}")
        self.walls = np.sort(self._keys(*_numpy(mesh.constrained_edges).T))
        self.boundary = self._keys(*_numpy(connectivity.boundary_edges(mesh.triangles, mesh.twin)).T)
        self.moved = np.zeros(len(original), bool)
        self.rewritten = np.zeros(len(self.triangles), bool)
        self.cavities = 0

    def untangle(self, region: np.ndarray) -> list[str]:
        """Re-triangulate the smallest cavities that suffice; returns what stopped the others.

        region  (T,) as from `_regions`
        """
        size = np.bincount(region)
        wanted = signs(self.points, *self.triangles.T) <= 0
        reasons = []
        attempt = made = 0
        corners = _corners_in_regions(self.triangles, region)
        while wanted.any():
            if made != self.cavities:
                corners, made = _corners_in_regions(self.triangles, region), self.cavities
            # Rings cost more the more there are, and a cavity that is slightly too large does no harm.
            for _ in range(1 + attempt // 3):
                wanted = _with_ring(corners, wanted)
            for rows, outer in sorted(self.components(wanted), key=lambda component: len(component[0])):
                reason = self.rebuild(rows, outer)
                final = bool(reason) and (len(rows) == size[region[rows[0]]] or self._crosses_itself(rows, outer))
                if final:
                    reason = self.rebuild(rows, outer, over_itself=True)
                if reason and final:
                    reasons.append(reason)
                if not reason or final:
                    wanted[rows] = False
            attempt += 1
        return reasons

    def components(self, cavity: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """The parts of `cavity` (T,) bool whose triangles are joined by edges that are not constrained.

        Returns the rows (N,) of each and (3N,) bool: those of their half-edges that lie on its boundary.
        """
        rows = np.flatnonzero(cavity)
        triangles = torch.from_numpy(self.triangles[rows])
        ends = triangles.numpy()
        wall = among(self._keys(ends.ravel(), ends[:, [1, 2, 0]].ravel()), self.walls)
        twin = connectivity.twins(triangles)
        label = connectivity.triangle_components(triangles, twin, torch.from_numpy(wall)).numpy()
        beyond = twin.numpy()
        outer = (beyond < 0).reshape(-1, 3) | (label[beyond // 3].reshape(-1, 3) != label[:, None])
        order = np.argsort(label, kind="stable")
        parts = np.split(order, np.flatnonzero(np.diff(label[order])) + 1)
        return [(rows[part], outer[part].ravel()) for part in parts if len(part)]

    def rebuild(self, rows: np.ndarray, outer: np.ndarray, over_itself: bool = False) -> str:
        """Make the triangles of a component anew; returns "", or why that is impossible, with nothing changed.

        rows, outer  as from `components`
        over_itself  the boundary may lie over itself
        """
        vertices, local = np.unique(self.triangles[rows], return_inverse=True)
        local = local.reshape(-1, 3)
        ends = np.stack([local.ravel(), local[:, [1, 2, 0]].ravel()], 1)
        wall = among(self._keys(*vertices[ends].T), self.walls)
        cavity = Cavity(
            points=self.points[vertices],
            boundary=ends[outer],
            dangling=_edges_of(ends[wall & ~outer]),
            fixed=self.fixed[vertices],
            keep=self.keep[vertices],
            dtype=self.dtype,
            over_itself=over_itself,
        )
        built = cavity.filled()
        if isinstance(built, Obstacle):
            return str(built.renumbered(vertices))
        corners, points, moved = built
        if len(corners) != len(rows):
            return f"the cavity has {len(rows)} triangles, but its boundary and vertices need {len(corners)}"
        taken = self._made_twice(rows, vertices, corners, cavity.boundary)
        if len(taken):
            return f"the edge {divmod(int(taken[0]), len(self.points))} exists outside the cavity already"
        self.triangles[rows] = vertices[corners]
        self.points[vertices[moved]] = points[moved]
        self.moved[vertices[moved]] = True
        self.rewritten[rows] = True
        self.cavities += 1
        return ""

    def _crosses_itself(self, rows: np.ndarray, outer: np.ndarray) -> bool:
        """Does the boundary of the mesh cross itself within this component, so that no larger one can be rebuilt?"""
        corners = self.triangles[rows]
        ends = np.stack([corners.ravel(), corners[:, [1, 2, 0]].ravel()], 1)[outer]
        ends = ends[among(self._keys(*ends.T), self.boundary)]
        pairs = crossing_pairs(self.points, ends)
        if not len(pairs) and (self.points[ends[:, 0]] != self.points[ends[:, 1]]).any(1).all():
            return False
        if len(pairs) and cross_properly(self.points, *ends[pairs[0]].ravel().tolist()):
            return True
        return not plane_boundary(self.points, ends).sound

    def _made_twice(
        self, rows: np.ndarray, vertices: np.ndarray, corners: np.ndarray, boundary: np.ndarray
    ) -> np.ndarray:
        """The keys of new edges that exist outside the component, too.

        Such an edge is a chord of the boundary, and the mesh outside lies over the component.
        """
        on_boundary = np.zeros(len(vertices), bool)
        on_boundary[boundary] = True
        sides = np.stack([corners.ravel(), corners[:, [1, 2, 0]].ravel()], 1)
        chords = distinct(self._keys(*vertices[sides[on_boundary[sides].all(1)]].T))
        chords = chords[~among(chords, self._keys(*vertices[boundary].T))]
        return chords[among(chords, self._keys_outside(rows, vertices[on_boundary]))] if len(chords) else chords

    def result(self, mesh: MeshBatch) -> Retriangulation:
        """The mesh as it is now."""
        device = mesh.points.device
        positions = torch.from_numpy(np.ldexp(self.points, self.exponent)).to(mesh.points)
        moved = torch.from_numpy(self.moved).to(device)
        points = torch.where(moved[:, None], positions, mesh.points)
        triangles = torch.from_numpy(self.triangles).to(device)
        rewritten = torch.from_numpy(self.rewritten).to(device)
        return Retriangulation(
            mesh.with_points(points).with_triangles(triangles), True, "", moved, rewritten, self.cavities
        )

    def _keys(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.minimum(u, v) * len(self.points) + np.maximum(u, v)

    def _keys_outside(self, rows: np.ndarray, vertices: np.ndarray) -> np.ndarray:
        """The keys of edges of the triangles other than `rows`, among them all that join two of `vertices`."""
        mark = np.zeros(len(self.points), bool)
        mark[vertices] = True
        a, b, c = (mark[np.ascontiguousarray(v)] for v in self.triangles.T)
        near = (a & b) | (b & c) | (c & a)
        near[rows] = False
        there = self.triangles[near]
        return self._keys(there.ravel(), there[:, [1, 2, 0]].ravel())


def _edges_of(ends: np.ndarray) -> np.ndarray:
    """(K, 2) the edges among the half-edges `ends` (N, 2), each once."""
    return np.unique(np.sort(ends, 1), axis=0) if len(ends) else ends


def _corners_in_regions(triangles: np.ndarray, region: np.ndarray) -> np.ndarray:
    """(T, 3) numbers of the corners of the `triangles`, equal where vertex and region (T,) are.

    They are the vertices; a vertex that several regions share has another number in each of them.
    """
    if not region.any():
        return triangles
    count = int(triangles.max()) + 1
    last = np.zeros(count, np.int64)
    last[triangles] = region[:, None]
    elsewhere = last[triangles] != region[:, None]
    shared = np.zeros(count, bool)
    shared[triangles[elsewhere]] = True
    here = shared[triangles]
    corners = triangles.copy()
    keys = (triangles * (int(region.max()) + 1) + region[:, None])[here]
    corners[here] = count + np.searchsorted(distinct(keys), keys)
    return corners


def _with_ring(corners: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """`wanted` (T,) bool and the triangles that share one of the `corners` of `_corners_in_regions` with them."""
    rows, these = torch.from_numpy(corners), torch.from_numpy(wanted)
    return touching(rows, corners_of(rows, these, int(corners.max(initial=-1)) + 1)).numpy()


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
