"""Reasons that a few fixed vertices show: triangles, edges, half-planes, the boundary's turns, handles."""

from __future__ import annotations

from fractions import Fraction

from experiments.shared.certified.mesh import Mesh, demand, meet, side


def fixed_triangle(mesh: Mesh, given: dict) -> None:
    a, b, c = given["triangle"]
    demand(mesh.third.get((a, b)) == c, "there is no such triangle")
    demand({a, b, c} <= mesh.fixed, "a corner is free")
    demand(side(*(mesh.points[v] for v in (a, b, c))) <= 0, "the triangle is upright")


def empty_kernel(mesh: Mesh, given: dict) -> None:
    v, weights = given["vertex"], [Fraction(w) for w in given["weights"]]
    demand(min(weights) >= 0 and any(weights), "a weight is negative, or all are zero")
    demand(len(weights) == len(given["edges"]), "edges and weights are not alike in number")
    sums = [Fraction(0)] * 3
    for (a, b), w in zip(given["edges"], weights, strict=True):
        demand(mesh.third.get((a, b)) == v and {a, b} <= mesh.fixed, f"{(a, b)} is no fixed edge of its triangles")
        (ax, ay), (bx, by) = mesh.points[a], mesh.points[b]
        nx, ny = ay - by, bx - ax  # a point p is on the left if n.p > n.a
        for k, term in enumerate((nx, ny, nx * ax + ny * ay)):
            sums[k] += w * term
    demand(sums[0] == 0 and sums[1] == 0 and sums[2] >= 0, "the weights prove nothing")


def edges_meet(mesh: Mesh, given: dict) -> None:
    mesh.demand_domain()
    one, other = (tuple(edge) for edge in given["edges"])
    for edge in (one, other):
        demand(edge in mesh.third or edge[::-1] in mesh.third, f"there is no edge {edge}")
        demand(set(edge) <= mesh.fixed, f"an end of {edge} is free")
    demand(set(one) != set(other) and meet(mesh.points, one, other), "the edges do not meet")


def vertex_outside(mesh: Mesh, given: dict) -> None:
    v = given["vertex"]
    demand(v in mesh.fixed, "the vertex is free")
    demand(any(v in t for t in mesh.triangles), "the vertex has no triangle")
    demand(all(a in mesh.fixed for a, _ in mesh.boundary), "a vertex of the boundary is free")
    demand(mesh.rounds(mesh.points[v]) <= 0, "the boundary goes round the vertex to the left")


def point_outside(mesh: Mesh, given: dict) -> None:
    demand(all(a in mesh.fixed for a, _ in mesh.boundary), "a vertex of the boundary is free")
    demand(mesh.rounds(tuple(Fraction(x) for x in given["point"])) < 0, "the boundary does not go round the point so")


def euler(mesh: Mesh) -> int:
    """The Euler number, a vertex counted once for each fan of triangles at it."""
    fans, left = 0, set(mesh.third)
    # From the corner at a of the triangle abc to the next one round a, across the edge from c to a; open fans first.
    for start in [*mesh.boundary, *mesh.third]:
        if start in left:
            fans += 1
        edge = start
        while edge in left:
            left.discard(edge)
            edge = (edge[0], mesh.third[edge])
    edges = len({frozenset(edge) for edge in mesh.third})
    return fans - edges + len(mesh.triangles)


def turns(mesh: Mesh, given: dict) -> None:
    part = mesh.part(mesh.piece(given["triangle"]))
    demand(all(a in mesh.fixed for a, _ in part.boundary), "a vertex of the boundary is free")
    # The boundary edge after one, round the same fan of triangles.
    onward = {}
    for a, b in part.boundary:
        edge = (b, part.third[a, b])
        while edge[::-1] in part.third:
            edge = (b, part.third[edge[::-1]])
        onward[a, b] = edge
    arrow = {}
    for a, b in part.boundary:
        (ax, ay), (bx, by) = part.points[a], part.points[b]
        arrow[a, b] = bx - ax, by - ay
        demand(any(arrow[a, b]), "a boundary edge has no length")
    # A direction along no edge; how often does the direction of the boundary pass it, to the left less to the right?
    slope = Fraction(1)
    while any(y == slope * x for x, y in arrow.values()):
        slope += Fraction(1, 1 + len(arrow))
    ray = (Fraction(1), slope)
    count = 0
    for edge, following in onward.items():
        u, w = arrow[edge], arrow[following]
        turn, before, after = side((0, 0), u, w), side((0, 0), u, ray), side((0, 0), ray, w)
        if turn > 0:
            count += before > 0 and after > 0
        elif turn < 0:
            count -= before < 0 and after < 0
        elif u[0] * w[0] + u[1] * w[1] < 0:
            # A reversal is a turn to the right, since the angle of the triangles between is positive.
            count -= before < 0
    demand(count < euler(part), "the boundary turns round often enough")


def handles(mesh: Mesh, given: dict) -> None:
    mesh.demand_domain()
    demand(euler(mesh) < 2 - len(mesh.loops()), "the mesh has no handle")
