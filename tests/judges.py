"""What several tests assert of a mesh before and after an operation."""

from fractions import Fraction

import torch
from exact import boundary, directed_edges, double_areas, edge_counts, inverted, total_area

from torchmesh import MeshBatch
from torchmesh.mesh import connectivity
from torchmesh.mesh.certificate import same_frame
from torchmesh.mesh.interfaces import holding
from torchmesh.mesh.kept_edges import constrained_half_edges


def assert_every_row_stays(before, after):
    """Vertices, triangles and the boundary keep their rows, no triangle is inverted, the area is that of before."""
    for name in ("fixed", "constrained_edges", "point_offsets", "triangle_offsets"):
        assert torch.equal(getattr(after, name), getattr(before, name)), name
    assert after.triangles.shape == before.triangles.shape
    assert torch.equal(after.points[holding(before).fixed], before.points[holding(before).fixed])
    assert inverted(after) == 0
    assert max(directed_edges(after.triangles).values()) == 1
    assert boundary(after.triangles) == boundary(before.triangles)
    assert total_area(after) == total_area(before)
    assert same_frame(before, after, holding(before).fixed).all()
    assert torch.equal(
        connectivity.vertex_triangle_counts(after.triangles, len(after.points)) > 0,
        connectivity.vertex_triangle_counts(before.triangles, len(before.points)) > 0,
    )


def region_areas(mesh: MeshBatch) -> list[Fraction]:
    """The exact area of every part between boundary and constrained edges, in ascending order."""
    twin = connectivity.twins(mesh.triangles)
    locked = constrained_half_edges(mesh)
    part = connectivity.triangle_components(mesh.triangles, twin, locked)
    areas = double_areas(mesh)
    return sorted(
        sum((a for a, p in zip(areas, part.tolist(), strict=True) if p == k), Fraction(0)) for k in set(part.tolist())
    )


def euler(mesh: MeshBatch) -> int:
    return connectivity.euler_number(mesh.triangles, connectivity.twins(mesh.triangles))


def _boundary_positions(mesh: MeshBatch) -> set:
    points = mesh.points.tolist()
    return {(tuple(points[u]), tuple(points[v])) for u, v in boundary(mesh.triangles)}


def _constrained_positions(mesh: MeshBatch) -> set:
    points = mesh.points.tolist()
    return {frozenset((tuple(points[u]), tuple(points[v]))) for u, v in mesh.constrained_edges.tolist()}


def assert_same_domain(before: MeshBatch, after: MeshBatch) -> None:
    """A valid mesh of the same domain, regions and frame, whatever its vertices."""
    assert inverted(after) == 0
    assert max(directed_edges(after.triangles).values()) == 1
    assert max(edge_counts(after.triangles).values()) <= 2
    assert _boundary_positions(after) == _boundary_positions(before)
    assert _constrained_positions(after) == _constrained_positions(before)
    edges = set(edge_counts(after.triangles))
    assert {frozenset(e) for e in after.constrained_edges.tolist()} <= edges
    assert euler(after) == euler(before)
    assert total_area(after) == total_area(before)
    assert region_areas(after) == region_areas(before)
    fixed = [{tuple(p) for p in m.points[m.fixed].tolist()} for m in (before, after)]
    assert fixed[0] == fixed[1]
    MeshBatch.from_arrays(after.points, after.triangles, after.fixed, after.constrained_edges)
