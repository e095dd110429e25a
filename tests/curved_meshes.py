"""Six-node meshes for tests, and judges of them that know nothing of torchmesh."""

from collections import Counter

import meshio
import numpy as np


def annulus(around=12, layers=2, inner=0.4, outer=1.0):
    """Points (V, 3) and six-node triangles (T, 6) of a ring between two circles, with curved sides on the circles."""
    turn = 2 * np.pi * np.arange(around) / around
    radii = np.linspace(inner, outer, layers + 1)
    points = [(r * np.cos(t), r * np.sin(t)) for r in radii for t in turn]
    faces = []
    for k in range(layers):
        for i in range(around):
            a, b = k * around + i, k * around + (i + 1) % around
            faces += [(a, b, b + around)[::-1], (a, b + around, a + around)[::-1]]
    return with_nodes(np.array(points), np.array(faces), circles=(inner, outer))


def with_nodes(points, faces, circles=()):
    """Straight triangles with a node in the middle of each side, or on the circle that has both of its ends."""
    nodes: dict[tuple[int, int], int] = {}
    at = [tuple(p) for p in points]
    rows = []
    for face in faces:
        own = []
        for i, j in ((0, 1), (1, 2), (2, 0)):
            key = tuple(sorted((int(face[i]), int(face[j]))))
            if key not in nodes:
                nodes[key] = len(at)
                a, b = points[key[0]], points[key[1]]
                middle = (a + b) / 2
                for r in circles:
                    if abs(np.hypot(*a) - r) < 1e-9 and abs(np.hypot(*b) - r) < 1e-9:
                        middle = middle * (r / np.hypot(*middle))
                at.append(tuple(middle))
            own.append(nodes[key])
        rows.append([*face, *own])
    return np.pad(np.array(at), ((0, 0), (0, 1))), np.array(rows)


def tangled_annulus(step=0.45, **shape):
    """The ring after its inner circle has moved right with its nodes, and nothing else."""
    points, six = annulus(**shape)
    inner = shape.get("inner", 0.4)
    on = np.isclose(np.hypot(points[:, 0], points[:, 1]), inner)
    points[on, 0] += step
    # Nodes between a vertex that moved and one that did not are in the middle again: sides inside are straight.
    on_circle = {tuple(e) for e in boundary(six)}
    for e, m in edges(six).items():
        if e not in on_circle:
            points[m] = (points[e[0]] + points[e[1]]) / 2
    return points, six


def edges(six):
    """The node of each edge.  Fails where triangles that share an edge have different nodes there."""
    found: dict[tuple[int, int], int] = {}
    for row in np.asarray(six).tolist():
        for k, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
            key = tuple(sorted((row[i], row[j])))
            assert found.setdefault(key, row[3 + k]) == row[3 + k], key
    assert len(set(found.values())) == len(found)
    return found


def boundary(six):
    """The edges of one triangle only."""
    count = Counter(
        tuple(sorted((row[i], row[j]))) for row in np.asarray(six).tolist() for i, j in ((0, 1), (1, 2), (2, 0))
    )
    return [edge for edge, times in count.items() if times == 1]


def jacobians(points, six, steps=40):
    """(T, S) the Jacobian of each triangle on a lattice, by the textbook's shape functions."""
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1))
    keep = i + j <= steps
    x, y = i[keep] / steps, j[keep] / steps
    z, none = 1 - x - y, np.zeros_like(x)
    along = np.array([1 - 4 * z, 4 * x - 1, none, 4 * (z - x), 4 * y, -4 * y])
    across = np.array([1 - 4 * z, none, 4 * y - 1, -4 * x, 4 * x, 4 * (z - y)])
    nodes = points[six][:, :, :2]
    a, b = np.einsum("ks,nkd->nsd", along, nodes), np.einsum("ks,nkd->nsd", across, nodes)
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def save(path, points, six, kind="triangle6", **data):
    meshio.Mesh(points, [(kind, six)], **data).write(path)
    return path
