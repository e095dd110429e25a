"""How long a step may be for |w| dt / h."""

import meshes
import pytest
import torch

from torchmesh import courant_step, femwarp, join


def test_the_bound_is_that_of_the_fastest_vertex_by_a_slow_twin():
    mesh = meshes.jittered(6, 5, 0.3, 2)
    goal = mesh.points + torch.tensor([0.4, 0.1]) * mesh.points[:, :1]
    warped = femwarp(mesh, goal).points
    worst = 0.0
    for triangle in mesh.triangles.tolist():
        p = mesh.points[triangle]
        area = 0.5 * float((p[1] - p[0])[0] * (p[2] - p[0])[1] - (p[1] - p[0])[1] * (p[2] - p[0])[0])
        longest = max(float((p[i] - p[i - 1]).norm()) for i in range(3))
        for v in triangle:
            worst = max(worst, float((warped[v] - mesh.points[v]).norm()) / (2 * area / longest))
    assert float(courant_step(mesh, goal, 0.5)[0]) == pytest.approx(0.5 / worst, rel=1e-12)


def test_each_mesh_has_its_own_bound_and_stillness_has_none():
    mesh = meshes.grid()
    goal = mesh.points * 1.5
    both = courant_step(join([mesh, mesh]), torch.cat([mesh.points, goal]))
    # But for the rounding of the warp nothing moves there.
    assert both[0] > 1e12
    assert both[1] == courant_step(mesh, goal)[0]
    with pytest.raises(ValueError, match="courant"):
        courant_step(mesh, goal, 0.0)
