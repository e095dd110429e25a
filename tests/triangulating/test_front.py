"""Meshes of boundaries from nothing: valid, Delaunay, with the edges that were asked for, or a fault that is named."""

import itertools
import math

import numpy as np
import pytest
import torch
from both_loops import need_compiled_loops
from exact import areas_of, incircle

from torchmesh.kernels.library import using
from torchmesh.triangulating.front import FrontOptions, outline_mesher

FRONT = FrontOptions()


def outline(*loops, segments=(), free=()):
    """The arguments of `outline_mesher`: closed loops of points, edges inside, and vertices that are free."""
    points = [p for loop in loops for p in loop] + list(free)
    edges, start = [], 0
    for loop in loops:
        rows = [*range(start, start + len(loop)), start]
        edges += list(itertools.pairwise(rows))
        start += len(loop)
    held = torch.arange(len(points)) < len(points) - len(free)
    rows = torch.tensor(list(segments), dtype=torch.int64).reshape(-1, 2)
    return torch.tensor(points, dtype=torch.float64), held, torch.tensor(edges), rows


def square(side=1.0, divided=6, x=0.0, y=0.0, turned=False):
    t = np.linspace(0, side, divided, endpoint=False)
    loop = [(x + a, y) for a in t] + [(x + side, y + a) for a in t]
    loop += [(x + side - a, y + side) for a in t] + [(x, y + side - a) for a in t]
    return loop[::-1] if turned else loop


@pytest.fixture(params=["compiled", "torch"])
def loops(request):
    if request.param == "compiled":
        need_compiled_loops()
    with using(request.param):
        yield request.param


def sizes(given, length):
    return torch.full((len(given[0]),), length, dtype=torch.float64)


def is_delaunay(points, triangles, locked) -> bool:
    """Whether no vertex across an edge that is not locked lies inside the circle of a triangle, exactly."""
    across = {(a, b): c for t in triangles for a, b, c in (t, t[1:] + t[:1], t[2:] + t[:2])}
    for (a, b), c in across.items():
        d = across.get((b, a))
        free = d is not None and (a, b) not in locked and (b, a) not in locked
        if free and incircle(points[a], points[b], points[c], points[d]) > 0:
            return False
    return True


def test_a_square_with_a_hole_is_filled_exactly(loops):
    given = outline(square(divided=8), square(0.3, 4, 0.4, 0.3, turned=True))
    mesher = outline_mesher(*given)
    assert mesher.fault == 0
    triangles, points, _, corners, weights = mesher.mesh(sizes(given, 0.12), *FRONT.numbers)
    every = torch.cat([given[0], points]).tolist()
    areas = areas_of(every, triangles.tolist())
    assert min(areas) > 0
    assert float(sum(areas)) == pytest.approx(2 * (1 - 0.09), abs=1e-12)
    assert is_delaunay(every, triangles.tolist(), set(map(tuple, given[2].tolist())))
    # Linear functions over the background are read exactly where new vertices are.
    assert torch.allclose((given[0][corners] * weights[..., None]).sum(1), points, atol=1e-12)
    a, b, c = (torch.cat([given[0], points])[triangles[:, k]] for k in range(3))
    squares = sum(((p - q) ** 2).sum(1) for p, q in ((a, b), (b, c), (c, a)))
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert float((squares / (2 * math.sqrt(3) * area)).mean()) < 1.1


def test_edges_inside_stay_and_vertices_outside_do_not_come_in(loops):
    free = [(0.6, 0.52), (5.0, 5.0), (0.25, 0.25), (0.25, 0.25), (0.5, 0.0)]
    loop = square(divided=4)
    given = outline(loop, segments=[(2, 10)], free=free)
    mesher = outline_mesher(*given)
    assert mesher.fault == 0
    used = set(mesher.background().reshape(-1).tolist()) - set(range(len(loop)))
    # Of two vertices in one position one is in the background, and none that is on the boundary or outside.
    assert len(used) == 2
    assert len(loop) in used
    triangles = mesher.mesh(sizes(given, 0.25), *FRONT.numbers)[0].tolist()
    assert any({2, 10} <= set(t) for t in triangles)


def test_a_segment_across_many_edges_is_recovered(loops):
    # From one corner to the other, between two rows of vertices on both sides of the segment.
    row = [(0.5 * i + 0.1 * s, 0.25 * i - 0.02 * s - 0.03) for i in range(1, 15) for s in (-1.0, 1.0)]
    given = outline([(0.0, 0.0), (8.0, 0.0), (8.0, 4.0), (0.0, 4.0)])
    points = torch.cat([given[0], torch.tensor(row, dtype=torch.float64)])
    held = torch.ones(len(points), dtype=torch.bool)
    ends = torch.tensor([[0, 2]])
    mesher = outline_mesher(points, held, given[2], ends)
    assert mesher.fault == 0
    triangles = mesher.background().tolist()
    assert any(set(ends[0].tolist()) <= set(t) for t in triangles)
    every = points.tolist()
    assert min(areas_of(every, triangles)) > 0
    assert is_delaunay(every, triangles, {tuple(ends[0].tolist())})


@pytest.mark.parametrize(
    ("loop", "fault"),
    [
        ([(0, 0), (1, 1), (1, 0), (0, 1)], 2),
        ([(0, 0), (1, 0), (1, 1), (0, 0)], 1),
        ([(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)], 2),
        ([(0, 0), (0, 1), (1, 1), (1, 0)], 3),
    ],
)
def test_what_bounds_no_domain_is_named(loops, loop, fault):
    given = outline([tuple(map(float, p)) for p in loop])
    assert outline_mesher(*given).fault == fault
