r"""A start inside the domain for meshes of a ring: by way of a cylinder, as `overlay` goes by way of a circle.

    inner boundary   +--+---+--+--+-      The strip repeats after one turn.  Every free vertex is at the mean of its
                     | /|\  | /|\ | ...   neighbours, where a whole turn is added to edges that cross a cut: such
    outer boundary   +--+-+-+--+-+-       embeddings of a cylinder are valid (Gortler, Gotsman & Thurston, Discrete
                                          one-forms on meshes, CAGD 23, 2006).

The domain is triangulated with its boundary's vertices only.  If each of its cells touches both boundaries, as in a
ring that is not too bent, the cells make such a strip, too, and vertices go with them.  The mesh may wind round the
hole in any number of turns more or less; the ways that lengthen edges least come first.
"""

import numpy as np
import torch
from torch import Tensor

from ..mesh.batch import MeshBatch
from ..optimising.laplacian import harmonic_extension
from .overlay import loops_around, through_cells

Edge = tuple[int, int]

# So many ways round are offered.
_WAYS = 2


def overlaid_rings(mesh: MeshBatch, free: Tensor) -> list[Tensor]:
    """Positions (V, 2) of one mesh, by way of a cylinder; none unless it is a ring whose boundary is fixed, and simple.

    free  (V,) bool, the vertices that move: all but those of the boundary
    """
    from ..triangulating.arrays import Obstacle
    from ..triangulating.polygon import turns_left
    from ..triangulating.polygon_triangulation import triangulate_polygon

    used = torch.zeros_like(free).index_fill_(0, mesh.triangles.ravel(), True)
    loops = loops_around(mesh, used & ~free, 2)
    if loops is None:
        return []
    points = mesh.points.to(torch.float64)
    if turns_left(points.numpy(), loops)[0] < 0:
        loops = loops[::-1]
    work = triangulate_polygon(points.numpy().copy(), loops, np.ones(len(points)))
    if isinstance(work, Obstacle):
        return []
    strip = _strip(work.corners, loops)
    if strip is None:
        return []
    corners, along = strip
    moves = (used & free).nonzero().squeeze(1)
    one = torch.ones(len(mesh.triangles), dtype=torch.float64)
    high = torch.zeros_like(points)
    high[torch.from_numpy(loops[1]), 1] = 1.0
    high = harmonic_extension(mesh.triangles, (one, one, one), ~free, high, mesh.point_offsets)[moves, 1]
    # The strip again on both sides, for vertices near where it repeats.
    cells = torch.from_numpy(work.corners).repeat(3, 1)
    there = torch.cat([corners + torch.tensor([turn, 0.0], dtype=torch.float64) for turn in (-1, 0, 1)])
    found = []
    for x in _round(mesh, free, loops, along):
        at = torch.stack([x[moves] % 1.0, high], 1)
        over = points.clone()
        over[moves] = through_cells(at, there, points[cells])
        found.append(over.to(mesh.points))
    return found


def _strip(cells: np.ndarray, loops: list[np.ndarray]) -> tuple[Tensor, dict[int, float]] | None:
    """The cells (C, 3, 2) as a strip of length 1, and where along it each vertex is.

    The first loop is the lower side of the strip.  None if a cell touches one loop only.
    """
    step = {int(v): (1.0 if k == 0 else -1.0) / len(loop) for k, loop in enumerate(loops) for v in loop}
    follow = {int(v): int(w) for loop in loops for v, w in zip(loop, np.roll(loop, -1), strict=True)}
    lower = set(loops[0].tolist())
    before = {w: v for v, w in follow.items()}
    left = {(c[k - 2], c[k - 1]): row for row, c in enumerate(cells.tolist()) for k in range(3)}
    if any(len(lower & set(c)) in (0, 3) for c in cells.tolist()):
        return None
    low, up = (next(v for v in cells[0].tolist() if (v in lower) == side) for side in (True, False))
    x = {low: 0.0, up: 0.0}
    along = dict(x)
    corners = np.empty((len(cells), 3, 2))
    for _ in range(len(cells)):
        # The cell on the far side of the bridge from low to up, in the direction of the lower side.
        row = left.get((up, low))
        if row is None:
            return None
        (new,) = set(cells[row].tolist()) - {low, up}
        if new in lower:
            if new != follow[low]:
                return None
            x[new] = x[low] + step[new]
        else:
            if new != before[up]:
                return None
            x[new] = x[up] - step[new]
        corners[row] = [[x[v], float(v not in lower)] for v in cells[row].tolist()]
        along.setdefault(new, x[new])
        low, up = (new, up) if new in lower else (low, new)
    return torch.from_numpy(corners), along


def _round(mesh: MeshBatch, free: Tensor, loops: list[np.ndarray], along: dict[int, float]) -> list[Tensor]:
    """(V,) where along the strip vertices are, in several ways round, those first whose edges are shortest."""
    from scipy.sparse import coo_matrix, diags
    from scipy.sparse.linalg import splu

    jumps = _cut(mesh, loops)
    sides = mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()
    edges = np.array(sorted({(min(edge), max(edge)) for edge in map(tuple, sides)}))
    jump = np.array([jumps.get((a, b), 0) for a, b in edges.tolist()], float)
    known = np.zeros(len(free))
    for k, loop in enumerate(loops):
        start = known[loop[0]] = along[int(loop[0])]
        turn = 1.0 if k == 0 else -1.0
        crossed = [jumps.get((int(v), int(w)), 0) for v, w in zip(loop, np.roll(loop, -1), strict=True)]
        # Round the lower loop once is a whole turn; the sign of the cut is made to say so.
        if k == 0:
            sign = turn / sum(crossed)
        known[loop] = (
            start + turn * np.arange(len(loop)) / len(loop) - sign * np.concatenate([[0], np.cumsum(crossed)[:-1]])
        )
    jump *= sign
    count = len(free)
    a, b = edges.T
    weight = coo_matrix((np.ones(2 * len(edges)), (np.append(a, b), np.append(b, a))), shape=(count, count)).tocsr()
    laplacian = (diags(np.asarray(weight.sum(1)).ravel()) - weight).tocsr()
    source = np.bincount(a, jump, count) - np.bincount(b, jump, count)
    moves = free.numpy() & (np.diff(weight.indptr) > 0)
    factors = splu(laplacian[moves][:, moves].tocsc())
    tried = []
    for turns in range(-3, 4):
        x = np.where(moves, 0.0, known)
        x[loops[1]] += turns
        x[moves] = factors.solve((source - laplacian @ x)[moves])
        tried.append((float(((x[b] - x[a] + jump) ** 2).sum()), turns, x))
    return [torch.from_numpy(x) for _, _, x in sorted(tried, key=lambda t: t[:2])[:_WAYS]]


def _cut(mesh: MeshBatch, loops: list[np.ndarray]) -> dict[Edge, int]:
    """The edges that a walk through triangles crosses from one loop to the other: 1 in one direction, -1 back."""
    faces = mesh.triangles.tolist()
    left = {(f[k - 2], f[k - 1]): row for row, f in enumerate(faces) for k in range(3)}
    ends = [{(int(v), int(w)) for v, w in zip(loop, np.roll(loop, -1), strict=True)} for loop in loops]
    first = min(ends[0])
    came: dict[int, Edge] = {left[first]: first}
    queue = [left[first]]
    for row in queue:
        f = faces[row]
        for edge in ((f[0], f[1]), (f[1], f[2]), (f[2], f[0])):
            if edge in ends[1]:
                jumps = {edge: 1, edge[::-1]: -1}
                back: int | None = row
                while back is not None:
                    a, b = came[back]
                    jumps |= {(a, b): -1, (b, a): 1}
                    back = left.get((b, a))
                return jumps
            other = left.get(edge[::-1])
            if other is not None and other not in came:
                came[other] = edge[::-1]
                queue.append(other)
    return {}
