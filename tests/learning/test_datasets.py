"""Datasets under a DataLoader: the same meshes for any number of workers."""

import dataclasses
import itertools

import pytest
import torch
from meshes import disc, grid
from torch.utils.data import DataLoader

import torchmesh as tm
from torchmesh.learning.datasets import GeneratedMeshes, MeshDataset, Pair, collate
from torchmesh.mesh.batch import MeshBatch

OPTIONS = {"triangles": 200, "motions": 2, "seed": 3}


def same(a: MeshBatch, b: MeshBatch) -> bool:
    return all(torch.equal(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a) if f.name[0] != "_")


@pytest.fixture(scope="module")
def made():
    return tm.domains.generate(10, ["gate", "circle"], **OPTIONS)


@pytest.fixture
def paths(made, tmp_path):
    """The ten meshes in two files, of seven and three."""
    first = torch.arange(10) < 7
    out = []
    for name, keep in (("a.h5", first), ("b.h5", ~first)):
        part = made.undeformed.select(keep)
        tm.save_batch(tmp_path / name, made.deformed.select(keep), point_fields={"undeformed": part.points})
        out.append(tmp_path / name)
    return out


def test_items_are_the_meshes_of_all_files(made, paths):
    dataset = MeshDataset(paths)
    assert len(dataset) == 10
    for b, mesh in enumerate(made.deformed.split()):
        assert same(dataset[b], mesh)
        assert same(dataset[b - 10], mesh)
    for wrong in (10, -11):
        with pytest.raises(IndexError, match="10 meshes"):
            dataset[wrong]


def test_pairs_are_before_and_after(made, paths):
    dataset = MeshDataset(paths, pairs=True)
    item = dataset[8]
    assert isinstance(item, Pair)
    assert same(item.undeformed, made.undeformed.split()[8])
    assert same(item.deformed, made.deformed.split()[8])


def test_a_loader_that_is_to_pin_goes_on_without_a_gpu_and_says_so(made, monkeypatch):
    # A pretended device that another test has named since is no accelerator to pin for.
    monkeypatch.setattr(torch.accelerator, "is_available", lambda: False)
    loader = DataLoader(tm.datasets.InMemoryMeshes(made.deformed), 4, collate_fn=collate, pin_memory=True)
    with pytest.warns(UserWarning, match="no accelerator is found"):
        batches = list(loader)
    assert [len(batch) for batch in batches] == [4, 4, 2]
    assert same(tm.join(batches), made.deformed)


def test_pinning_itself_raises_the_error_of_torch_where_it_does_so_for_a_tensor(made):
    try:
        made.deformed.points.pin_memory()
    except RuntimeError:
        with pytest.raises(RuntimeError):
            made.deformed.pin_memory()
    else:
        assert made.deformed.pin_memory().points.is_pinned()


def test_a_loader_pins_the_tensors_of_pairs_and_items(made, monkeypatch):
    """What torch's loader does with a batch when there is a GPU, with a counter in the place of the pinning itself."""
    from torch.utils.data._utils.pin_memory import pin_memory

    pinned = []
    monkeypatch.setattr(torch.Tensor, "pin_memory", lambda tensor, *_: pinned.append(tensor) or tensor.clone())
    item = tm.datasets.Item(Pair(made.undeformed, made.deformed), {"seed": torch.arange(10), "family": ["gate"] * 10})
    again = pin_memory(item)
    assert isinstance(again, tm.datasets.Item)
    assert isinstance(again.meshes, Pair)
    assert same(again.meshes.deformed, made.deformed)
    assert torch.equal(again.fields["seed"], item.fields["seed"])
    assert again.fields["family"] == item.fields["family"]
    wanted = [made.undeformed.points, made.deformed.points, made.deformed.triangles, item.fields["seed"]]
    assert {id(tensor) for tensor in wanted} <= {id(tensor) for tensor in pinned}


def test_a_file_without_pairs_is_told(tmp_path):
    tm.save_batch(tmp_path / "plain.h5", grid())
    with pytest.raises(tm.MeshIOError, match=r"plain\.h5.*undeformed"):
        MeshDataset(tmp_path / "plain.h5", pairs=True)


@pytest.mark.parametrize("workers", [0, 2])
def test_a_loader_gives_the_meshes_in_order(made, paths, workers):
    dataset = MeshDataset(paths, pairs=True)
    # A file that is open here already must be opened anew in each worker.
    assert len(dataset[0].deformed) == 1
    loader = DataLoader(dataset, batch_size=4, collate_fn=collate, num_workers=workers)
    batches = list(loader)
    assert [len(batch.deformed) for batch in batches] == [4, 4, 2]
    assert same(tm.join([batch.deformed for batch in batches]), made.deformed)
    assert same(tm.join([batch.undeformed for batch in batches]), made.undeformed)


@pytest.fixture
def few_at_once(monkeypatch) -> None:
    """The stream draws as many meshes ahead as are looked at; how many it draws changes none of them."""
    monkeypatch.setattr("torchmesh.learning.datasets._AT_ONCE", 4)


def test_generated_meshes_are_the_stream(made, few_at_once):
    items = list(itertools.islice(GeneratedMeshes(["gate", "circle"], **OPTIONS), 10))
    assert same(tm.join(items), made.deformed)
    pairs = list(itertools.islice(GeneratedMeshes(["gate", "circle"], pairs=True, **OPTIONS), 3))
    assert all(same(pair.undeformed, mesh) for pair, mesh in zip(pairs, made.undeformed.split(), strict=False))


def test_workers_share_the_domains(made, few_at_once):
    stream = GeneratedMeshes(["gate", "circle"], **OPTIONS)
    loader = DataLoader(stream, batch_size=2, collate_fn=collate, num_workers=2)
    # Batches come from the workers in turn: the motions of one domain from one, of the next from the other.
    batches = list(itertools.islice(loader, 5))
    assert same(tm.join(batches), made.deformed)


def test_wrong_options_are_told_at_once():
    with pytest.raises(ValueError, match="square"):
        GeneratedMeshes(["square"])


def test_collate_goes_into_tuples_and_dicts():
    items = [{"mesh": m, "pair": (m, torch.tensor([1.0])), "n": n} for n, m in enumerate((grid(), disc()))]
    result = collate(items)
    assert same(result["mesh"], tm.join([grid(), disc()]))
    assert same(result["pair"][0], result["mesh"])
    assert result["pair"][1].shape == (2, 1)
    assert result["n"].tolist() == [0, 1]


@pytest.mark.parametrize("in_memory", [False, True])
def test_batches_are_read_at_once_in_any_order(made, paths, in_memory, monkeypatch):
    dataset = MeshDataset(paths, pairs=True, in_memory=in_memory)
    numbers = [9, 0, 3, 0, 8]
    reads = []
    read = tm.BatchFile.read
    monkeypatch.setattr(tm.BatchFile, "read", lambda file, rows=None: reads.append(len(rows)) or read(file, rows))
    pair = dataset[numbers]
    # Two meshes of the second file and three of the first.
    assert sorted(reads) == ([] if in_memory else [2, 3])
    assert same(pair.deformed, made.deformed[numbers])
    assert same(pair.undeformed, made.undeformed[numbers])
    assert same(dataset[2:9:3].deformed, made.deformed[2:9:3])
    loader = DataLoader(dataset, batch_size=5, collate_fn=collate, shuffle=True)
    sizes = [len(batch.undeformed) for batch in loader]
    assert sizes == [5, 5]


def test_items_know_family_seed_and_domain(tmp_path):
    from torchmesh.commands.main import main
    from torchmesh.learning.datasets import InMemoryMeshes, Item

    path = tmp_path / "made.h5"
    arguments = ["generate", str(path), "--count", "4", "--family", "gate", "--family", "onto", "--triangles", "150"]
    assert main([*arguments, "--seed", "3", "--motions", "1", "-q"]) == 0
    dataset = MeshDataset(path, fields=True)
    item = dataset[[3, 0]]
    assert isinstance(item, Item)
    assert item.fields["family"] == ["onto", "gate"]
    assert (item.fields["seed"].tolist(), item.fields["domain"].tolist()) == ([3, 3], [3, 0])
    again = next(iter(DataLoader(InMemoryMeshes(item), batch_size=2, collate_fn=collate)))
    assert same(again.meshes, item.meshes)
    assert again.fields["family"] == item.fields["family"]
    joined = collate([dataset[1], dataset[2]])
    assert joined.fields["family"] == ["onto", "gate"]
    assert len(joined.meshes) == 2


def test_a_graph_has_edges_meshes_and_regions():
    from meshes import dragged_interface

    batch = tm.join([grid(), dragged_interface(), disc()])
    found = tm.datasets.graph(batch)
    edge = {tuple(e) for e in found.edge_index.T.tolist()}
    assert edge == {(v, u) for u, v in edge}
    assert len(edge) == found.edge_index.shape[1]
    assert edge == {e for a, b, c in batch.triangles.tolist() for e in ((a, b), (b, c), (c, a), (b, a), (c, b), (a, c))}
    assert torch.equal(found.node_mesh.bincount(), batch.point_offsets.diff())
    faces = found.region.split(batch.triangle_offsets.diff().tolist())
    assert [sorted(set(part.tolist())) for part in faces] == [[0], [0, 1], [0]]
    left, right = (
        batch.triangles[batch.triangle_offsets[1] : batch.triangle_offsets[2]][faces[1] == k] for k in (0, 1)
    )
    # The regions share the vertices of the interface, and nothing else.
    shared = set(left.flatten().tolist()) & set(right.flatten().tolist())
    assert shared == set(batch.constrained_edges.flatten().tolist())
