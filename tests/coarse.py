"""A mesh whose boundary is too coarse for the vertices inside, for several tests."""

import functools

import meshes
import torch

import torchmesh as tm
from torchmesh.mesh import connectivity
from torchmesh.remeshing.options import RemeshOptions


@functools.cache
def strip(cells: int = 9, length: float = 20.0, width: float = 1.0) -> tm.MeshBatch:
    """A square's mesh with its boundary laid round a long strip at equal steps: few long edges, many vertices."""
    mesh = meshes.grid(cells, cells)
    boundary = connectivity.boundary_edges(mesh.triangles, connectivity.twins(mesh.triangles))
    loop = connectivity.boundary_loops(boundary)[0]
    at = torch.arange(len(loop), dtype=torch.float64) / len(loop) * 2 * (length + width)
    corner = torch.tensor([0.0, length, length + width, 2 * length + width], dtype=torch.float64)
    for c in corner:
        at[(at - c).abs().argmin()] = c
    x = torch.where(at < length, at, (2 * length + width - at).clamp(0, length))
    y = (at - length).clamp(0, width) - (at - 2 * length - width).clamp_min(0)
    points = mesh.points.clone()
    points[loop] = torch.stack([x, y], 1)
    after, report = tm.improve(
        tm.relax(mesh.with_points(points)), tm.ImproveOptions(smooth_rounds=3, remesh=RemeshOptions(max_rounds=0))
    )
    assert bool(report.valid)
    return after
