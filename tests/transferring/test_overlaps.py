"""Areas of overlaps against exact rationals, and the identities that they must satisfy."""

from fractions import Fraction

import meshes
import numpy as np
import pytest

from torchmesh import MeshBatch, join
from torchmesh.transferring.overlaps import overlaps, signed_areas
from torchmesh.transferring.pairs import both_sides


def exact_overlap(one: np.ndarray, other: np.ndarray) -> Fraction:
    """The area that two triangles (3, 2) share: Sutherland & Hodgman with Python's rationals, one edge at a time."""

    def upright(triangle):
        a, b, c = ([Fraction(float(v)) for v in p] for p in triangle)
        turn = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        return [a, b, c] if turn > 0 else [a, c, b]

    polygon, cutter = upright(one), upright(other)
    for k in range(3):
        (px, py), (qx, qy) = cutter[k], cutter[(k + 1) % 3]
        left = [(qx - px) * (y - py) - (qy - py) * (x - px) for x, y in polygon]
        cut = []
        for i, ((ax, ay), s) in enumerate(zip(polygon, left, strict=True)):
            (bx, by), t = polygon[(i + 1) % len(polygon)], left[(i + 1) % len(polygon)]
            if s >= 0:
                cut.append((ax, ay))
            if s * t < 0:
                cut.append((ax + s / (s - t) * (bx - ax), ay + s / (s - t) * (by - ay)))
        polygon = cut
    twice = sum(ax * by - ay * bx for (ax, ay), (bx, by) in zip(polygon, polygon[1:] + polygon[:1], strict=True))
    return Fraction(twice) / 2


def shared(before: MeshBatch, after: MeshBatch) -> dict[tuple[int, int], float]:
    found = overlaps(*both_sides(before, after))
    return dict(zip(zip(found.after.tolist(), found.before.tolist(), strict=True), found.area.tolist(), strict=True))


PAIRS = {
    "unlike grids": (meshes.grid(4, 3), meshes.grid(3, 5)),  # many coinciding lines and corners on edges
    "the same": (meshes.grid(3, 3), meshes.grid(3, 3)),
    "tangled": (meshes.jittered(5, 4, 0.6), meshes.grid(5, 4)),
    "random": (meshes.delaunay(12, 0), meshes.delaunay(14, 1)),
    "turned": (meshes.grid(4, 4), meshes.grid(4, 4).with_points(meshes.turned(meshes.grid(4, 4).points, 45.0))),
}


@pytest.mark.parametrize("name", PAIRS)
def test_areas_are_those_of_exact_arithmetic(name):
    before, after = PAIRS[name]
    found = shared(before, after)
    old, new = before.points[before.triangles].numpy(), after.points[after.triangles].numpy()
    half_extent = float((before.points.amax(0) - before.points.amin(0)).max() / 2)
    unit = 2.0 ** np.floor(np.log2(half_extent))
    for i, one in enumerate(new):
        for j, other in enumerate(old):
            exact = float(exact_overlap(one, other)) / unit**2
            assert abs(found.get((i, j), 0.0) - exact) < 1e-15, (i, j)


def test_the_overlaps_of_a_triangle_add_up_to_it():
    """On one domain the triangles of each mesh are covered, once, by those of the other."""
    before, after = meshes.jittered(14, 11, 0.1), meshes.scrambled(meshes.jittered(14, 11, 0.15, seed=3), 0)
    sides = both_sides(before, after)
    found = overlaps(*sides)
    for side, rows in zip(sides, (found.before, found.after), strict=True):
        np.testing.assert_allclose(np.bincount(rows, found.area), np.abs(signed_areas(side)), rtol=1e-12)


def test_pairs_of_different_meshes_never_overlap():
    """All meshes lie in one tree, and those of one batch lie in one place."""
    meshes_before = [meshes.grid(3, 3), meshes.jittered(4, 4, 0.1), meshes.grid(2, 5)]
    meshes_after = [meshes.grid(2, 2), meshes.grid(4, 4), meshes.delaunay(20, 2)]
    joined = overlaps(*both_sides(join(meshes_before), join(meshes_after)))
    alone = [overlaps(*both_sides(b, a)) for b, a in zip(meshes_before, meshes_after, strict=True)]
    starts = [np.cumsum([0, *(len(m.triangles) for m in many)]) for many in (meshes_after, meshes_before)]
    for name, start in (("after", starts[0]), ("before", starts[1])):
        rows = np.concatenate([getattr(one, name) + s for one, s in zip(alone, start, strict=False)])
        np.testing.assert_array_equal(getattr(joined, name), rows)
    np.testing.assert_array_equal(joined.area, np.concatenate([one.area for one in alone]))


@pytest.mark.parametrize("scale", [2.0**-600, 2.0**500])
def test_units_do_not_matter(scale):
    before, after = PAIRS["random"]
    far = [mesh.with_points(mesh.points * scale) for mesh in (before, after)]
    assert shared(*far) == shared(before, after)


def test_the_moments_integrate_quadratic_functions():
    """Summed over all overlaps in a triangle, the integrals of 1, x, y, x^2, xy, y^2 are those over the triangle."""
    before, after = meshes.delaunay(15, 4), meshes.delaunay(15, 4)
    after = after.with_points(before.points * 0.4)
    sides = both_sides(before, after)
    found = overlaps(*sides, moments=True)
    origin = sides[0].points[sides[0].triangles[found.before, 0]]
    x, y = origin.T
    m1, mx, my, mxx, mxy, myy = found.moments.T
    about_zero = [m1, mx + x * m1, my + y * m1, mxx + 2 * x * mx + x * x * m1]
    about_zero += [mxy + x * my + y * mx + x * y * m1, myy + 2 * y * my + y * y * m1]
    corners = sides[1].points[sides[1].triangles]
    middles = 0.5 * (corners + np.roll(corners, 1, 1))
    area = np.abs(signed_areas(sides[1]))
    u, v = middles[..., 0], middles[..., 1]
    for value, f in zip(about_zero, (u**0, u, v, u * u, u * v, v * v), strict=True):
        np.testing.assert_allclose(np.bincount(found.after, value), area * f.mean(1), atol=1e-14)


def test_triangles_without_area_share_nothing():
    flat = MeshBatch.from_arrays([[0, 0], [1, 0], [1, 1.0], [0.5, 0.5]], [[0, 1, 2], [0, 2, 3]])
    assert {j for _, j in shared(flat, meshes.grid(2, 2))} == {0}
