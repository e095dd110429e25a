"""The judge finds every fault that a method can make, and takes what is right in any rows."""

import meshes
import pytest
import torch

import torchmesh as tm
from torchmesh import bench


def shuffled(mesh: tm.MeshBatch) -> tm.MeshBatch:
    """The same mesh with its vertices and triangles in other rows."""
    order = torch.randperm(len(mesh.points), generator=torch.Generator().manual_seed(1))
    row = order.argsort()
    return tm.MeshBatch.from_arrays(mesh.points[order], row[mesh.triangles].flip(0))


def test_a_mesh_that_is_right_is_valid_in_any_rows():
    tangled = meshes.jittered(6, 5, 0.5)
    better, _ = tm.improve(tangled)
    verdict = bench.judge(tangled, better)
    assert (verdict.valid, verdict.fault, verdict.inverted, verdict.fields_kept) == (True, "", 0, True)
    assert verdict.mean == float(tm.quality(better).mean)
    other = bench.judge(tangled, shuffled(better))
    assert (other.valid, other.fields_kept, other.cells_kept, other.travel_max) == (True, False, False, None)


def test_travel_is_measured_in_local_edge_lengths():
    mesh = meshes.grid(4, 4)
    points = mesh.points.clone()
    row = int((~mesh.fixed).nonzero()[0])
    points[row, 0] += 0.05
    verdict = bench.judge(mesh, mesh.with_points(points))
    assert verdict.travel_median == 0.0
    from torchmesh.mesh.means import vertex_size

    assert verdict.travel_max == pytest.approx(0.05 / float(vertex_size(mesh)[row]))


MESH = meshes.grid(4, 4)


@pytest.mark.parametrize(
    ("after", "fault"),
    [
        (meshes.jittered(4, 4, 0.9), "inverted"),
        (MESH.with_points(MESH.points + 1e-9), "fixed vertices have moved"),
        (tm.MeshBatch.from_arrays(MESH.points, MESH.triangles[1:]), "another boundary"),
        (MESH.points, "no MeshBatch but Tensor"),
        (None, "no MeshBatch but NoneType"),
        (tm.join([MESH, MESH]), "2 meshes"),
        (MESH.to(torch.float32), "float32"),
        (MESH.with_points(MESH.points * torch.nan), "not finite"),
    ],
)
def test_what_is_wrong_is_told(after, fault):
    verdict = bench.judge(MESH, after)
    assert not verdict.valid
    assert fault in verdict.fault


def test_an_interface_that_is_flipped_away_is_a_fault():
    from torchmesh.mesh.connectivity import edges

    plain = meshes.grid(4, 4)
    inner = [e for e in edges(plain.triangles, plain.twin).tolist() if not plain.fixed[e].all()]
    mesh = tm.MeshBatch.from_arrays(plain.points, plain.triangles, constrained_edges=inner[:1])
    assert bench.judge(mesh, mesh).valid
    lost = bench.judging.lost_interfaces(mesh, tm.MeshBatch.from_arrays([[0, 0], [1, 0], [0, 1.0]], [[0, 1, 2]]))
    assert lost == ["1 edges between regions are gone"]
