"""Maps from the vertices of a mesh to those of the mesh it became, and the exchange of meshes in a batch."""

import dataclasses

import meshes
import meshio
import numpy as np
import pytest
import torch
from editing import state_of

import torchmesh as tm
from torchmesh.mesh import connectivity
from torchmesh.mesh.batch import lift, vertex_mesh
from torchmesh.mesh.ragged import spread
from torchmesh.mesh.vertex_map import Names, Placed, exchange
from torchmesh.remeshing.options import RemeshOptions
from torchmesh.remeshing.remeshing import remesh
from torchmesh.remeshing.sizing import size_field
from torchmesh.remeshing.splits import split_rounds
from torchmesh.remeshing.state import editable, rebuilt


def test_the_map_names_what_went_and_what_came():
    batch = tm.join([meshes.grid(12, 12), meshes.ring(16, 4), meshes.l_shape(3)])
    factor = torch.tensor([2.0, 0.5, 0.6], dtype=torch.float64)
    sizes = size_field(batch, "uniform") * spread(factor, batch.point_offsets)
    after, info = remesh(batch, RemeshOptions(sizes=sizes, max_rounds=4))
    m = info.vertex_map
    assert m.old_to_new.shape == (len(batch.points),)
    assert m.new_to_old.shape == (len(after.points),)
    kept = m.old_to_new >= 0
    assert torch.equal(m.new_to_old[m.old_to_new[kept]], kept.nonzero().squeeze(1))
    assert int(kept.sum()) == int((m.new_to_old >= 0).sum())
    assert 0 < int(kept.sum()) < len(batch.points)
    assert bool((m.new_to_old < 0).any())
    # Kept vertices keep their order; what was removed was free.
    old = m.new_to_old[m.new_to_old >= 0]
    assert torch.equal(old, old.sort().values)
    assert bool(kept[batch.fixed].all())
    assert torch.equal(after.points[m.old_to_new[batch.fixed]], batch.points[batch.fixed])
    # No vertex of one mesh comes from another.
    owner_new, owner_old = vertex_mesh(after), vertex_mesh(batch)
    assert torch.equal(owner_new[m.rows], owner_old[m.sources])
    total = torch.zeros(len(after.points), dtype=torch.float64).index_add_(0, m.rows, m.weights)
    assert torch.equal(total, torch.ones_like(total))
    assert torch.equal(m.rows, m.rows.sort().values)


def test_fields_are_carried():
    mesh = meshes.grid(10, 10)
    state = state_of(mesh, 0.05)
    e = editable(state)
    split_rounds(e, lambda h: (e.relative_length(h) > 1.4, -e.relative_length(h)))
    state = rebuilt(state, e)
    after, m = state.batch, state.names.vertex_map()
    # Without smoothing, new vertices are where their ends' mean is: linear fields are exact.
    assert torch.allclose(m.carry(mesh.points), after.points, rtol=0, atol=1e-15)
    assert m.carry(mesh.points[:, 0]).shape == (len(after.points),)
    assert torch.allclose(m.carry(mesh.points.float()), after.points.float(), rtol=0, atol=1e-6)
    assert m.carry(mesh.points.float()).dtype == torch.float32
    flags = m.carry(torch.arange(len(mesh.points)))
    assert torch.equal(flags[: len(mesh.points)], torch.arange(len(mesh.points)))
    assert bool(((flags >= 0) & (flags < len(mesh.points))).all())
    assert m.carry(mesh.fixed).dtype == torch.bool
    with pytest.raises(tm.InvalidMeshError, match="121 old vertices"):
        m.carry(torch.zeros(3))


def test_the_map_of_a_batch_falls_into_those_of_its_meshes():
    batch = tm.join([meshes.grid(8, 8), meshes.ring(16, 4), meshes.l_shape(3)])
    sizes = 0.7 * size_field(batch, "uniform")
    after, info = remesh(batch, RemeshOptions(sizes=sizes, max_rounds=4))
    assert str(info.vertex_map).startswith("VertexMap(")
    for b, (part, own) in enumerate(zip(batch.split(), info.vertex_map.split(batch, after), strict=True)):
        rows = slice(int(batch.point_offsets[b]), int(batch.point_offsets[b + 1]))
        single, alone = remesh(part, RemeshOptions(sizes=sizes[rows], max_rounds=4))
        for name in ("old_to_new", "new_to_old", "rows", "sources", "weights"):
            assert torch.equal(getattr(own, name), getattr(alone.vertex_map, name)), name
        assert len(own.carry(part.points)) == len(single.points)


def test_files_keep_their_point_fields(tmp_path):
    mesh = meshes.grid(8, 8)
    x, number = mesh.points[:, 0].numpy(), np.arange(len(mesh.points))
    data = {"temperature": x, "velocity": mesh.points.numpy().astype(">f4"), "number": number}
    cells = [("triangle", mesh.triangles.numpy())]
    meshio.Mesh(lift(mesh).numpy(), cells, point_data=data).write(tmp_path / "in.vtu")
    given = tm.read(tmp_path / "in.vtu")
    after, info = remesh(given, RemeshOptions(sizes=lambda p: torch.full((len(p),), 0.07), max_rounds=4))
    tm.write(tmp_path / "out.vtu", after, like=tmp_path / "in.vtu", vertex_map=info.vertex_map)
    written = meshio.read(tmp_path / "out.vtu")
    assert len(written.points) == len(after.points) > len(mesh.points)
    fields = written.point_data
    assert np.allclose(fields["temperature"], info.vertex_map.carry(torch.from_numpy(x)).numpy())
    assert fields["velocity"].shape == (len(after.points), 2)
    kept = info.vertex_map.new_to_old >= 0
    assert np.array_equal(fields["number"][kept], info.vertex_map.new_to_old[kept])
    with pytest.warns(tm.MeshWarning, match="point data 'temperature'"):
        tm.write(tmp_path / "out.vtu", after, like=tmp_path / "in.vtu")
    wrong = remesh(meshes.grid(3, 3))[1].vertex_map
    with pytest.raises(tm.InvalidMeshError, match="vertex_map leads from 16 to"):
        tm.write(tmp_path / "out.vtu", after, like=tmp_path / "in.vtu", vertex_map=wrong)


def test_a_vertex_born_of_the_newly_born_goes_back_to_the_first_ones():
    births = torch.tensor([[3, 0, 1], [4, 1, 2]]), torch.tensor([[5, 3, 4]])
    m = Names.of_rows(3, torch.device("cpu")).renamed(torch.tensor([0, 2, 5]), 6, births).vertex_map()
    assert m.old_to_new.tolist() == [0, -1, 1]
    assert m.new_to_old.tolist() == [0, 1 + 1, -1]
    assert list(zip(m.rows.tolist(), m.sources.tolist(), m.weights.tolist(), strict=True)) == [
        (0, 0, 1.0), (1, 2, 1.0), (2, 0, 0.25), (2, 1, 0.5), (2, 2, 0.25)
    ]  # fmt: skip
    assert m.carry(torch.tensor([0.0, 1.0, 4.0])).tolist() == [0.0, 4.0, 1.5]


def test_meshes_of_other_sizes_can_take_a_place_in_a_batch():
    parts = [meshes.grid(3, 3), meshes.l_shape(2), meshes.ring(), meshes.l_shape(3)]
    new = [meshes.l_shape(4), meshes.grid(2, 2)]
    at = torch.tensor([False, True, False, True])
    batch, part = tm.join(parts), tm.join(new)
    field, other = torch.arange(len(batch.points)), -torch.arange(len(part.points))
    after, carried = exchange(batch, at, part, [(field, other)])
    assert after.known_twin is not None
    wanted = tm.join([parts[0], new[0], parts[2], new[1]])
    for name in ("points", "triangles", "fixed", "constrained_edges", "point_offsets", "triangle_offsets"):
        assert torch.equal(getattr(after, name), getattr(wanted, name)), name
    pieces = [field[: len(parts[0].points)], other[: len(new[0].points)]]
    assert torch.equal(carried[: len(parts[0].points) + len(new[0].points)], torch.cat(pieces))


def test_exchanged_meshes_hand_on_the_twins_that_are_known():
    parts, new = [meshes.grid(3, 3), meshes.l_shape(2), meshes.ring()], [meshes.l_shape(3)]
    at = torch.tensor([False, True, False])
    batch, part = tm.join(parts), tm.join(new)
    (after,) = exchange(batch, at, part, [])
    assert torch.equal(after.twin, connectivity.twins(after.triangles))
    unknown = dataclasses.replace(part, triangles=part.triangles.clone())
    (after,) = exchange(batch, at, unknown, [])
    assert after.known_twin is None


def test_names_keep_their_history_when_some_are_selected():
    names = Names.of_rows(4, torch.device("cpu"))
    grown = names.renamed(torch.tensor([0, 3, 4]), 5, (torch.tensor([[4, 0, 3]]),))
    assert grown.later(names) is grown
    assert names.later(grown) is grown
    part = grown.select(torch.tensor([False, True, True]))
    assert part.of.tolist() == [3, 4]
    assert part.vertex_map().new_to_old.tolist() == [3, -1]
    assert part.vertex_map().old_to_new.tolist() == [-1, -1, -1, 0]


def placed_names() -> Names:
    """Four vertices, of which the third has gone, and two that were placed in triangles of them."""
    weights = torch.tensor([[0.2, 0.3, 0.5], [0.0, 0.5, 0.5]], dtype=torch.float64)
    placed = Placed(torch.tensor([4, 5]), torch.tensor([[0, 1, 2], [1, 2, 3]]), weights)
    return Names.of_rows(4, torch.device("cpu")).with_placed(torch.tensor([0, 1, 3, 4, 5]), placed)


def test_a_vertex_placed_in_a_triangle_comes_of_its_corners():
    m = placed_names().vertex_map()
    assert m.old_to_new.tolist() == [0, 1, -1, 2]
    assert m.new_to_old.tolist() == [0, 1, 3, -1, -1]
    field = torch.tensor([1.0, 10.0, 100.0, 1000.0], dtype=torch.float64)
    assert m.carry(field).tolist() == pytest.approx([1, 10, 1000, 53.2, 550])
    # A corner of no weight is no source.
    assert m.sources[m.rows == 4].tolist() == [2, 3]


def test_an_edge_between_placed_vertices_is_halved():
    names = placed_names()
    halved = names.renamed(torch.tensor([0, 6]), 7, (torch.tensor([[6, 4, 5]]),))
    assert halved.vertex_map().carry(torch.tensor([1.0, 10.0, 100.0, 1000.0]))[1] == pytest.approx((53.2 + 550) / 2)


def test_two_histories_of_the_same_vertices_are_put_one_after_the_other():
    births = (torch.tensor([[4, 0, 3]]),)
    other = Names.of_rows(4, torch.device("cpu")).renamed(torch.tensor([0, 4]), 5, births)
    both = placed_names().after(other)
    field = torch.tensor([1.0, 10.0, 100.0, 1000.0], dtype=torch.float64)
    assert torch.equal(both.vertex_map().carry(field), placed_names().vertex_map().carry(field))
    assert both.renamed(other.of).vertex_map().carry(field).tolist() == [1, 500.5]
