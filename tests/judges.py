"""What several tests assert of a mesh before and after an operation."""

import torch
from exact import boundary, directed_edges, inverted, total_area

from torchmesh.mesh import connectivity
from torchmesh.mesh.certificate import same_frame


def assert_every_row_stays(before, after):
    """Vertices, triangles and the boundary keep their rows, no triangle is inverted, the area is that of before."""
    for name in ("fixed", "constrained_edges", "point_offsets", "triangle_offsets"):
        assert torch.equal(getattr(after, name), getattr(before, name)), name
    assert after.triangles.shape == before.triangles.shape
    assert torch.equal(after.points[before.fixed], before.points[before.fixed])
    assert inverted(after) == 0
    assert max(directed_edges(after.triangles).values()) == 1
    assert boundary(after.triangles) == boundary(before.triangles)
    assert total_area(after) == total_area(before)
    assert same_frame(before, after, before.fixed).all()
    assert torch.equal(
        connectivity.vertex_triangle_counts(after.triangles, len(after.points)) > 0,
        connectivity.vertex_triangle_counts(before.triangles, len(before.points)) > 0,
    )
