"""Local sizes are the sides of the triangles nearby, and their areas fill the mesh."""

import math

import meshes
import pytest

from torchmesh import quality
from torchmesh.untangling.local_size import local_size


def test_local_size_of_equilateral_triangles_is_their_side():
    sizes = local_size(meshes.equilateral(side=0.25))
    assert sizes.tolist() == pytest.approx([0.25] * len(sizes), rel=1e-13)


@pytest.mark.parametrize("name", [*meshes.VALID, *meshes.TANGLED])
def test_target_areas_sum_to_the_enclosed_area(name):
    mesh = (meshes.VALID | meshes.TANGLED)[name]()
    side = local_size(mesh)[mesh.triangles].mean(1)
    target = (math.sqrt(3) / 4 * side.square()).sum().item()
    assert target == pytest.approx(quality(mesh).area.sum().item(), rel=1e-12)


def test_local_size_grows_where_the_mesh_is_coarse():
    sizes = local_size(meshes.ring(16, 12, 0.1, 3.0), 20)
    # As many edges on a circle thirty times as long; the field is smoothed, so that it grows less.
    assert float(sizes[-16:].min()) > 1.5 * float(sizes[:16].max())
