"""Winding is told by the boundary's exact area, whatever free vertices do."""

import warnings

import numpy as np
import pytest
import torch
from exact import double_area

from torchmesh import MeshBatch, MeshWarning
from torchmesh.mesh.winding import enclosed_signs


@pytest.mark.parametrize("far", [1e4, 1e9, 1e17, 1e100])
def test_a_free_vertex_far_away_does_not_turn_the_mesh(far):
    corners = np.array([[0.1, 0.2], [1.3, 0.1], [0.7, 1.1]])
    fan = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for angle in np.linspace(0, 6, 40):
            points = np.concatenate([corners, [[far * np.cos(angle), far * np.sin(angle)]]])
            assert MeshBatch.from_arrays(points, fan).triangles.tolist() == fan.tolist()


@pytest.mark.parametrize("far", [1e3, 1e9])
def test_a_far_vertex_neither_tilts_nor_turns_a_mesh_in_space(far, rng):
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    flat = np.array([[0.1, 0.2], [1.3, 0.1], [0.7, 1.1], [0.6 * far, 0.8 * far]])
    mesh = MeshBatch.from_arrays(flat @ frame[:2], [[0, 1, 3], [1, 2, 3], [2, 0, 3]])
    assert mesh.triangles.tolist() == [[0, 1, 3], [1, 2, 3], [2, 0, 3]]
    lengths = torch.cdist(mesh.points[:3], mesh.points[:3]).numpy()
    # The vertex is some 1e-16 of its distance off the plane.
    np.testing.assert_allclose(
        lengths, np.linalg.norm(flat[:3, None] - flat[:3], axis=2), rtol=0, atol=1e-15 * far + 1e-7
    )


def test_signs_of_areas_are_those_of_exact_rationals(rng):
    """Thin quadrilaterals whose rounded area says little, in one call."""
    walks, expected = [], []
    for _ in range(200):
        a, b = rng.normal(size=(2, 2)) * 1e8
        c = a + (b - a) * rng.random() + rng.normal(size=2) * 1e-8
        walks.append([a, b, c])
        area = double_area(a, b, c)
        expected.append((area > 0) - (area < 0))
    points = torch.from_numpy(np.concatenate(walks))
    rows = torch.arange(len(points)).reshape(-1, 3)
    edges = torch.stack([rows, rows.roll(-1, 1)], 2).reshape(-1, 2)
    group = torch.arange(len(rows)).repeat_interleave(3)
    assert enclosed_signs(points, edges, group, len(rows)).tolist() == expected
    assert set(expected) >= {-1, 1}


@pytest.mark.parametrize("scale", [1e-140, 1e140])
def test_signs_at_the_ends_of_the_range(scale):
    points = torch.tensor([[0.0, 0], [1, 0], [0, 1]], dtype=torch.float64) * scale
    edges = torch.tensor([[0, 1], [1, 2], [2, 0]])
    group = torch.zeros(3, dtype=torch.int64)
    assert enclosed_signs(points, edges, group, 2).tolist() == [1, 0]
    assert enclosed_signs(points, edges.flip(1), group, 1).tolist() == [-1]


def test_a_boundary_of_no_area_leaves_the_winding_as_it_is():
    points, triangles = [[0, 0], [1, 0], [2, 0], [1, 1e9]], [[0, 1, 3], [1, 2, 3], [0, 3, 2]]
    assert MeshBatch.from_arrays(points, triangles).triangles.tolist() == triangles


def test_a_lone_triangle_beside_one_that_is_wound_against_its_neighbour():
    points = [[0, 0], [1, 0], [1, 1], [0, 1], [5, 5], [6, 5], [5, 6]]
    with pytest.warns(MeshWarning, match="1 of 3"):
        mesh = MeshBatch.from_arrays(points, [[4, 5, 6], [0, 1, 2], [0, 3, 2]])
    assert mesh.triangles.tolist() == [[4, 5, 6], [0, 1, 2], [2, 3, 0]]
