"""Meshes in PyVista: the same positions, triangles and numbers."""

import sys

import meshes
import numpy as np
import pytest
import torch

from torchmesh import MeshBatch, MissingDependencyError, join, metrics, quality, to_pyvista


@pytest.fixture
def pyvista():
    return pytest.importorskip("pyvista")


def test_two_meshes_with_their_quality(pyvista):
    batch = join([meshes.moved_hole(), meshes.grid()])
    data = to_pyvista(batch)
    q = quality(batch)
    assert isinstance(data, pyvista.PolyData)
    assert data.points[:, :2] == pytest.approx(batch.points.numpy(), abs=0)
    assert (data.points[:, 2] == 0).all()
    assert data.regular_faces.tolist() == batch.triangles.tolist()
    assert data.cell_data["area"].tolist() == q.area.tolist()
    assert data.cell_data["inverse_mean_ratio"].tolist() == q.inverse_mean_ratio.tolist()
    assert data.cell_data["inverted"].astype(bool).tolist() == (~q.upright).tolist()
    assert int(data.cell_data["inverted"].sum()) == int(q.inverted.sum()) > 0
    sign = np.where(q.upright.numpy(), 1, -1)
    angle = metrics.METRICS["minimum_angle"]
    assert data.cell_data["minimum_angle"] * sign == pytest.approx(
        angle.formula(corners_of(batch)).numpy(), rel=1e-9, abs=1e-9
    )
    first = len(meshes.moved_hole().triangles)
    assert data.cell_data["mesh"].tolist() == [0] * first + [1] * (len(batch.triangles) - first)
    assert data.point_data["fixed"].astype(bool).tolist() == batch.fixed.tolist()
    assert len(data.point_data["mesh"]) == len(batch.points)
    assert data.active_scalars_name == "inverse_mean_ratio"


def corners_of(batch: MeshBatch):
    from torchmesh.mesh.triangle import corners

    return corners(batch.points, batch.triangles)


def test_its_area_is_what_vtk_measures(pyvista):
    mesh = meshes.delaunay(80, seed=2)
    data = to_pyvista(mesh)
    assert data.area == pytest.approx(float(quality(mesh).area.sum()))


def test_a_mesh_in_a_plane_of_space(pyvista):
    points, triangles = meshes.grid_arrays(4, 3)
    wall = np.stack([np.full(len(points), 7.0), points[:, 0], points[:, 1]], 1)
    assert to_pyvista(MeshBatch.from_arrays(wall, triangles)).points == pytest.approx(wall)


def test_single_precision_and_gradients(pyvista):
    mesh = meshes.grid().to(torch.float32)
    assert to_pyvista(mesh).points.dtype == np.float32
    mesh = mesh.with_points(mesh.points.requires_grad_())
    assert to_pyvista(mesh).n_cells == len(mesh.triangles)


def test_without_pyvista_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(MissingDependencyError, match=r"pip install 'torchmesh-untangle\[pyvista\]'"):
        to_pyvista(meshes.grid())
