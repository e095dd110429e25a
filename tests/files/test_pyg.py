"""To PyTorch Geometric and back."""

import builtins
import dataclasses

import pytest
import torch
from meshes import TANGLED, VALID, grid, l_shape

import torchmesh as tm

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")

SAMPLES = tm.join([make() for make in (*VALID.values(), *TANGLED.values())])


@pytest.fixture(scope="module", autouse=True)
def _needs_torch_geometric():
    pytest.importorskip("torch_geometric", exc_type=ImportError)


def same(a: tm.MeshBatch, b: tm.MeshBatch) -> bool:
    names = [f.name for f in dataclasses.fields(a) if not f.name.startswith("_")]
    return all(getattr(a, n).dtype == getattr(b, n).dtype and torch.equal(getattr(a, n), getattr(b, n)) for n in names)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_there_and_back_is_the_same_bit_for_bit(dtype):
    batch = SAMPLES.to(dtype)
    assert same(tm.from_pyg(tm.to_pyg(batch)), batch)


def test_batches_of_which_only_some_meshes_have_quads_come_back():
    square = tm.MeshBatch.from_arrays([[0, 0], [1, 0], [1, 1], [0, 1.0]], [], quads=[[0, 1, 2, 3]])
    for meshes in ([grid(), square], [square, grid()], [grid(), square, square]):
        batch = tm.join(meshes)
        graphs = tm.to_pyg(batch)
        assert same(tm.from_pyg(graphs), batch)
        assert torch.equal(graphs.quad_index.T, batch.quads)


def test_one_graph_is_one_mesh():
    data = tm.to_pyg(SAMPLES).to_data_list()
    assert len(data) == len(SAMPLES)
    for graph, mesh in zip(data, SAMPLES.split(), strict=True):
        assert same(tm.from_pyg(graph), mesh)


def test_graphs_are_what_torch_geometric_makes_of_faces():
    from torch_geometric.transforms import FaceToEdge

    graph = tm.to_pyg(grid()).to_data_list()[0]
    expected = FaceToEdge(remove_faces=False)(graph.clone()).edge_index
    keys = [sorted(map(tuple, e.T.tolist())) for e in (graph.edge_index, expected)]
    assert keys[0] == keys[1]
    assert graph.validate()
    assert graph.is_undirected()


def test_a_batch_counts_vertices_on():
    batch = tm.join([grid(), l_shape()])
    graphs = tm.to_pyg(batch)
    assert torch.equal(graphs.face.T, batch.triangles)
    assert torch.equal(graphs.constrained_edge_index.T, batch.constrained_edges)
    assert torch.equal(graphs.ptr, batch.point_offsets)


def test_positions_stay_in_the_graph_of_derivatives():
    batch = grid()
    points = batch.points.clone().requires_grad_()
    graph = tm.to_pyg(dataclasses.replace(batch, points=points))
    graph.pos.sum().backward()
    assert bool((points.grad == 1).all())


def test_meshes_of_others_go_through_the_checks():
    from torch_geometric.data import Data

    mesh = grid()
    data = Data(pos=mesh.points, face=mesh.triangles.T)
    assert same(tm.from_pyg(data), mesh)
    with pytest.raises(tm.InvalidMeshError, match=r"graph 0: triangles row 0 .* rows of points"):
        tm.from_pyg(Data(pos=mesh.points[:3], face=mesh.triangles.T))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pos": None}, "graph 1 has no 'pos'"),
        ({"face": None}, "graph 1 has no 'face'"),
        ({"face": torch.zeros(4, 2, dtype=torch.int64)}, "graph 1: face must have shape"),
        ({"face": torch.full((3, 2), 1000)}, "graph 1: face names vertices that are not there"),
    ],
)
def test_graphs_that_are_no_meshes_are_told_by_number(change, message):
    from torch_geometric.data import Batch

    good, bad = tm.to_pyg(tm.join([grid(), grid()])).to_data_list()
    bad.update(change)
    with pytest.raises(tm.InvalidMeshError, match=message.replace("graph 1", "graph 0")):
        tm.from_pyg(bad)
    if None not in change.values() and bad.face.shape[0] == 3:
        with pytest.raises(tm.InvalidMeshError, match=message):
            tm.from_pyg(Batch.from_data_list([good, bad]))


def test_what_is_no_graph_is_refused():
    with pytest.raises(tm.InvalidMeshError, match="not MeshBatch"):
        tm.from_pyg(grid())


@pytest.mark.parametrize("call", [lambda: tm.to_pyg(grid()), lambda: tm.from_pyg(None)])
def test_without_torch_geometric_the_extra_is_named(monkeypatch, call):
    load = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.startswith("torch_geometric"):
            raise ImportError(name)
        return load(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(tm.MissingDependencyError, match=r"torchmesh-untangle\[pyg\]"):
        call()
