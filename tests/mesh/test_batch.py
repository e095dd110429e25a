import dataclasses
import math
import pickle
import warnings

import meshes
import numpy as np
import pytest
import torch
from exact import boundary, directed_edges, double_areas, total_area, triangle_set
from hypothesis import given
from hypothesis import strategies as st

from torchmesh import InvalidMeshError, MeshBatch, MeshError, MeshWarning, join
from torchmesh.mesh import connectivity
from torchmesh.mesh.batch import lift, put, triangle_mesh, vertex_mesh

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
HALVES = np.array([[0, 1, 2], [0, 2, 3]])


def same(a: MeshBatch, b: MeshBatch) -> bool:
    """Every tensor of the two has the same values and dtype."""
    pairs = [
        (getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(MeshBatch) if not f.name.startswith("_")
    ]
    return all(torch.equal(x, y) and x.dtype == y.dtype for x, y in pairs)


def three() -> list[MeshBatch]:
    return [meshes.l_shape(), meshes.grid(2, 3), meshes.dragged_interface()]


# --- what is accepted ---


@pytest.mark.parametrize("name", list(meshes.VALID))
def test_a_mesh_that_needs_no_repair_is_taken_as_it_is(name):
    mesh = meshes.VALID[name]()
    again = MeshBatch.from_arrays(mesh.points, mesh.triangles, mesh.fixed, mesh.constrained_edges)
    assert same(mesh, again)
    assert len(mesh) == 1
    assert (mesh.points.dtype, mesh.triangles.dtype, mesh.fixed.dtype) == (torch.float64, torch.int64, torch.bool)
    assert mesh.point_offsets.tolist() == [0, len(mesh.points)]
    assert mesh.triangle_offsets.tolist() == [0, len(mesh.triangles)]


@pytest.mark.parametrize("as_given", [np.asarray, torch.as_tensor, lambda a: a.tolist()])
def test_numpy_torch_and_lists_mean_the_same(as_given):
    expected = MeshBatch.from_arrays(SQUARE, HALVES)
    got = MeshBatch.from_arrays(
        as_given(SQUARE), as_given(HALVES), as_given(np.zeros(4, bool)), as_given(np.zeros((0, 2), np.int64))
    )
    assert same(got, expected)


@pytest.mark.parametrize("dtype", ["int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64", ">i4"])
def test_triangles_of_any_integer_dtype(dtype):
    assert torch.equal(MeshBatch.from_arrays(SQUARE, HALVES.astype(dtype)).triangles, torch.from_numpy(HALVES))


@pytest.mark.parametrize(
    ("dtype", "kept"),
    [("float64", torch.float64), ("float32", torch.float32), ("float16", torch.float64), ("int32", torch.float64),
     (">f8", torch.float64)],
)  # fmt: skip
def test_points_of_any_real_dtype(dtype, kept):
    mesh = MeshBatch.from_arrays(SQUARE.astype(dtype), HALVES)
    assert mesh.points.dtype == kept
    assert mesh.points.tolist() == SQUARE.tolist()


def test_strided_and_read_only_arrays():
    wide = np.zeros((8, 4))
    wide[::2, :2] = SQUARE
    view = wide[::2, :2]
    view.flags.writeable = False
    assert MeshBatch.from_arrays(view, HALVES[::-1, ::1]).points.tolist() == SQUARE.tolist()


def test_the_callers_arrays_are_neither_changed_nor_kept():
    points, triangles = meshes.grid_arrays(3, 3)
    fixed, constraints = np.zeros(len(points), bool), np.array([[5, 10]])
    turned = triangles[:, ::-1].copy()
    given_arrays = [points, turned, fixed, constraints]
    before = [a.copy() for a in given_arrays]
    tensors = [torch.from_numpy(a.copy()) for a in given_arrays]
    with pytest.warns(MeshWarning):
        mesh = MeshBatch.from_arrays(*given_arrays)
    with pytest.warns(MeshWarning):
        other = MeshBatch.from_arrays(*tensors)
    for a, t, b in zip(given_arrays, tensors, before, strict=True):
        assert np.array_equal(a, b)
        assert np.array_equal(t.numpy(), b)
    for a, t in zip(given_arrays, tensors, strict=True):
        a[...] = 0
        t.zero_()
    assert mesh.points.tolist() == other.points.tolist() == before[0].tolist()
    assert triangle_set(mesh.triangles) == triangle_set(other.triangles) == triangle_set(triangles)
    assert bool(mesh.fixed.any())
    assert mesh.constrained_edges.tolist() == other.constrained_edges.tolist() == [[5, 10]]


def test_a_tensor_that_requires_grad_is_detached():
    assert not MeshBatch.from_arrays(torch.tensor(SQUARE, requires_grad=True), HALVES).points.requires_grad


# --- fixed vertices and constrained edges ---


def test_the_boundary_is_fixed_and_nothing_else():
    mesh = meshes.grid(4, 3)
    on_rim = {v for e in boundary(mesh.triangles) for v in e}
    assert set(mesh.fixed.nonzero().squeeze(1).tolist()) == on_rim
    assert len(on_rim) == 14


def test_fixed_adds_to_the_boundary():
    points, triangles = meshes.grid_arrays(4, 4)
    wanted = np.zeros(len(points), bool)
    wanted[12] = True
    mesh = MeshBatch.from_arrays(points, triangles, wanted)
    plain = MeshBatch.from_arrays(points, triangles)
    assert (mesh.fixed ^ plain.fixed).nonzero().squeeze(1).tolist() == [12]


def test_ends_of_constrained_edges_are_not_fixed_and_boundary_edges_need_no_constraint():
    points, triangles = meshes.grid_arrays(4, 4)
    mesh = MeshBatch.from_arrays(points, triangles, constrained_edges=[[12, 7], [0, 1], [1, 0]])
    assert mesh.constrained_edges.tolist() == [[12, 7]]
    assert mesh.fixed[[12, 7]].tolist() == [False, False]


def test_unused_vertices_are_kept_fixed_and_counted():
    points = np.concatenate([SQUARE, [[5.0, 5.0], [6.0, 6.0]]])
    with pytest.warns(MeshWarning, match="2 vertices"):
        mesh = MeshBatch.from_arrays(points, HALVES)
    assert mesh.points.tolist() == points.tolist()
    assert mesh.fixed[4:].tolist() == [True, True]


# --- winding ---


@pytest.mark.parametrize("name", [*meshes.VALID, *meshes.TANGLED])
def test_wholly_clockwise_input_is_turned(name):
    mesh = (meshes.VALID | meshes.TANGLED)[name]()
    with pytest.warns(MeshWarning, match="clockwise"):
        turned = MeshBatch.from_arrays(mesh.points, mesh.triangles.flip(1))
    assert triangle_set(turned.triangles) == triangle_set(mesh.triangles)


@pytest.mark.parametrize("name", ["grid", "ring", "jittered", "heavily jittered", "moved hole"])
@pytest.mark.parametrize("share", [0.05, 0.5, 0.95])
def test_mixed_winding_is_made_consistent_and_inverted_triangles_stay_inverted(name, share, rng):
    mesh = (meshes.VALID | meshes.TANGLED)[name]()
    triangles = mesh.triangles.numpy().copy()
    wrong = rng.uniform(size=len(triangles)) < share
    triangles[wrong] = triangles[wrong, ::-1]
    with pytest.warns(MeshWarning, match="turned"):
        repaired = MeshBatch.from_arrays(mesh.points, triangles)
    assert triangle_set(repaired.triangles) == triangle_set(mesh.triangles)


def test_the_warning_counts_the_turned_triangles():
    points, triangles = meshes.grid_arrays(4, 4)
    triangles[[3, 8, 30]] = triangles[[3, 8, 30], ::-1]
    with pytest.warns(MeshWarning, match=f"3 of {len(triangles)} triangles"):
        MeshBatch.from_arrays(points, triangles)


def test_each_component_is_wound_by_the_area_it_encloses():
    points, triangles = meshes.grid_arrays(2, 2)
    both = np.concatenate([triangles, triangles[:, ::-1] + len(points)])
    with pytest.warns(MeshWarning, match="turned"):
        mesh = MeshBatch.from_arrays(np.concatenate([points, points + 5]), both)
    assert all(area > 0 for area in double_areas(mesh))


def test_inverted_triangles_alone_are_no_reason_to_warn():
    mesh = meshes.jittered(cells=0.9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = MeshBatch.from_arrays(mesh.points, mesh.triangles)
    assert torch.equal(again.triangles, mesh.triangles)


def test_the_warning_points_at_the_caller():
    with pytest.warns(MeshWarning) as caught:
        MeshBatch.from_arrays(SQUARE, HALVES[:, ::-1])
    with pytest.warns(MeshWarning) as counted:
        MeshBatch.from_arrays(np.concatenate([SQUARE, SQUARE]), HALVES)
    assert {w.filename for w in [*caught, *counted]} == {__file__}


# --- what is refused ---


def refused(match, points=SQUARE, triangles=HALVES, **more):
    with pytest.raises(InvalidMeshError, match=match) as error:
        MeshBatch.from_arrays(points, triangles, **more)
    assert isinstance(error.value, MeshError)
    assert isinstance(error.value, ValueError)
    return str(error.value)


@pytest.mark.parametrize("index", [4, -1, 2**40])
def test_index_out_of_range(index):
    message = refused(r"triangles row 1 is \[0, 2, .*0 to 3", triangles=[[0, 1, 2], [0, 2, index]])
    assert str(index) in message


def test_unsigned_index_beyond_int64():
    refused("triangles row 1", triangles=np.array([[0, 1, 2], [0, 2, 2**64 - 1]], np.uint64))


@pytest.mark.parametrize("row", [[0, 0, 1], [1, 0, 0], [0, 1, 0], [2, 2, 2]])
def test_repeated_vertex(row):
    refused(r"triangles row 2 is \[.*three different vertices", triangles=[*HALVES.tolist(), row])


def test_edge_with_three_triangles():
    points = np.concatenate([SQUARE, [[2.0, 0.0]]])
    message = refused("an edge may have two triangles at most", points, [[3, 0, 1], [0, 1, 2], [1, 0, 4]])
    assert "rows 0, 1 and 2" in message
    assert "[0, 1]" in message or "[1, 0]" in message


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("width", [2, 3])
def test_coordinates_that_are_not_finite(bad, width):
    points = np.zeros((4, width))
    points[:, :2] = SQUARE
    points[2, width - 1] = bad
    refused(r"points row 2 is .*finite \(1 rows", points)


def test_coordinates_whose_areas_overflow():
    points = SQUARE.copy()
    points[1, 0] = 1e151
    refused("points row 1 .*rescale", points)


@pytest.mark.parametrize(
    ("match", "arrays"),
    [
        ("no points", {"points": np.zeros((0, 2))}),
        ("no triangles", {"triangles": np.zeros((0, 3), int)}),
        ("no triangles", {"triangles": []}),
        (r"points must have shape .*\(4,\)", {"points": SQUARE[:, 0]}),
        (r"points must have shape .*\(4, 1\)", {"points": SQUARE[:, :1]}),
        (r"points must have shape .*\(4, 4\)", {"points": np.zeros((4, 4))}),
        (r"points must have shape .*\(1, 4, 2\)", {"points": SQUARE[None]}),
        (r"triangles must have shape .*\(3,\)", {"triangles": HALVES[0]}),
        (r"triangles must have shape .*\(1, 4\)", {"triangles": [[0, 1, 2, 3]]}),
        (r"triangles must be integers.*float64", {"triangles": HALVES.astype(float)}),
        (r"triangles must be integers.*bool", {"triangles": HALVES.astype(bool)}),
        (r"points must be real.*complex", {"points": SQUARE.astype(complex)}),
        (r"points must be real.*bool", {"points": SQUARE.astype(bool)}),
        ("points is not a rectangular array", {"points": [[0, 0], [1]]}),
        ("points is not a rectangular array", {"points": [["a", "b"]]}),
        ("triangles is not a rectangular array", {"triangles": [[0, 1, 2], [0, 2]]}),
        (r"fixed must have shape \(4,\).*\(3,\)", {"fixed": np.zeros(3, bool)}),
        (r"fixed must have shape \(4,\).*\(4, 2\)", {"fixed": np.zeros((4, 2), bool)}),
        ("fixed must be bool, not torch.int64", {"fixed": np.array([0, 1, 2, 3])}),
        (r"constrained_edges must have shape .*\(2,\)", {"constrained_edges": [0, 2]}),
        (r"constrained_edges must have shape .*\(1, 3\)", {"constrained_edges": [[0, 1, 2]]}),
        ("constrained_edges must be integers", {"constrained_edges": [[0.0, 2.0]]}),
        (r"constrained_edges row 1 is \[0, 4\]", {"constrained_edges": [[0, 2], [0, 4]]}),
        (r"constrained_edges row 1 is \[1, 3\].*no triangle", {"constrained_edges": [[0, 2], [1, 3]]}),
        (r"constrained_edges row 0 is \[2, 2\]", {"constrained_edges": [[2, 2]]}),
    ],
)
def test_wrong_shapes_and_dtypes(match, arrays):
    refused(match, **({"points": SQUARE, "triangles": HALVES} | arrays))


def test_a_moebius_strip_is_refused():
    refused(r"triangles row \d+ .*Moebius", *meshes.MOEBIUS)


def test_the_first_bad_row_is_the_one_named():
    refused("triangles row 1 ", triangles=[[0, 1, 2], [0, 2, 9], [0, 1, 9]])


# --- planes in space ---


def tilted(points, rng):
    """(V, 3): the points in a random plane of space."""
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return rng.normal(size=3) + points @ frame[:2]


def test_constant_z_keeps_x_and_y_to_the_bit():
    mesh = meshes.delaunay()
    flat = np.concatenate([mesh.points.numpy(), np.full((len(mesh.points), 1), 7.1)], 1)
    lifted = MeshBatch.from_arrays(flat, mesh.triangles)
    assert torch.equal(lifted.points, mesh.points)
    assert lift(lifted).tolist() == flat.tolist()


def test_any_plane_of_space_will_do(rng):
    points, triangles = meshes.delaunay_arrays(40, 3)
    for _ in range(5):
        space = tilted(points, rng)
        with warnings.catch_warnings():
            # Seen from one of its two sides, any mesh is clockwise.
            warnings.simplefilter("ignore", MeshWarning)
            mesh = MeshBatch.from_arrays(space, triangles)
        assert all(area > 0 for area in double_areas(mesh))
        # A rotation there and back: some 1e-16 of coordinates of size one.
        np.testing.assert_allclose(lift(mesh).numpy(), space, rtol=0, atol=1e-14)
        distances = np.linalg.norm(points[:, None] - points, axis=2)
        np.testing.assert_allclose(torch.cdist(mesh.points, mesh.points).numpy(), distances, rtol=0, atol=1e-7)


def test_a_tilted_mesh_is_not_called_clockwise_for_the_side_it_is_seen_from(rng):
    points, triangles = meshes.grid_arrays(3, 3)
    for _ in range(8):
        mesh = MeshBatch.from_arrays(tilted(points, rng), triangles)
        assert torch.equal(mesh.triangles, torch.from_numpy(triangles))


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
def test_a_vertex_off_the_plane_is_named(size, rng):
    points, triangles = meshes.grid_arrays(3, 3)
    space = size * tilted(points, rng)
    normal = np.cross(space[1] - space[0], space[5] - space[0])
    space[6] += 0.01 * size * normal / np.linalg.norm(normal)
    refused(r"points row 6 is .*off the plane", space, triangles)


def test_a_bowl_is_refused():
    points, triangles = meshes.grid_arrays(4, 4)
    refused("off the plane", np.concatenate([points, (points**2).sum(1, keepdims=True)], 1), triangles)


def test_single_precision_planes_are_planes(rng):
    points, triangles = meshes.grid_arrays(3, 3)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MeshWarning)
        mesh = MeshBatch.from_arrays((100 * tilted(points, rng)).astype(np.float32), triangles)
    assert mesh.points.dtype == torch.float32


# --- batches ---


def test_join_and_split_undo_each_other():
    parts = three()
    batch = join(parts)
    assert len(batch) == 3
    assert all(same(a, b) for a, b in zip(batch.split(), parts, strict=True))
    assert same(join(batch.split()), batch)
    assert same(join([join(parts[:2]), parts[2]]), batch)


def test_join_lays_rows_end_to_end():
    parts = three()
    batch = join(parts)
    assert torch.equal(batch.points, torch.cat([m.points for m in parts]))
    for b, mesh in enumerate(parts):
        rows = slice(int(batch.triangle_offsets[b]), int(batch.triangle_offsets[b + 1]))
        assert torch.equal(batch.points[batch.triangles[rows]], mesh.points[mesh.triangles])
        assert bool((triangle_mesh(batch)[rows] == b).all())
    assert vertex_mesh(batch).tolist() == [b for b, m in enumerate(parts) for _ in range(len(m.points))]
    where = torch.cat([m.points[m.constrained_edges] for m in parts])
    assert torch.equal(batch.points[batch.constrained_edges], where)


def test_join_of_one_and_of_none():
    mesh = meshes.grid()
    assert same(join([mesh]), mesh)
    with pytest.raises(InvalidMeshError, match="at least one"):
        join([])


def test_join_refuses_mixed_precision():
    with pytest.raises(InvalidMeshError, match="dtype"):
        join([meshes.grid(), meshes.grid().to(torch.float32)])


@given(st.lists(st.booleans(), min_size=3, max_size=3))
def test_select_is_the_join_of_the_meshes_kept(keep):
    parts = three()
    part = join(parts).select(torch.tensor(keep))
    kept = [m for m, k in zip(parts, keep, strict=True) if k]
    if kept:
        assert same(part, join(kept))
    else:
        assert len(part) == len(part.points) == len(part.triangles) == 0


def test_select_takes_one_bool_a_mesh():
    batch = join(three())
    for keep in (torch.ones(2, dtype=torch.bool), torch.tensor([0, 1, 2]), torch.ones((3, 1), dtype=torch.bool)):
        with pytest.raises(InvalidMeshError, match=r"keep must be \(3,\) bool"):
            batch.select(keep)


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("numbers", [[0], [2, 0], [1, 1, 2, 0]])
@pytest.mark.parametrize("given_as", [list, np.array, torch.tensor, lambda n: torch.tensor(n, dtype=torch.int32)])
def test_meshes_are_taken_in_any_order_and_any_number_of_times(numbers, given_as, known):
    parts = three()
    batch = join(parts)
    taken = (batch if known else dataclasses.replace(batch, _twin=None))[given_as(numbers)]
    assert same(taken, join([parts[n] for n in numbers]))
    assert (taken.known_twin is not None) == known
    assert torch.equal(taken.twin, connectivity.twins(taken.triangles))


@pytest.mark.parametrize("index", [0, -1, 2, np.int64(1), torch.tensor(2)])
def test_a_number_gives_one_mesh(index):
    parts = three()
    assert same(join(parts)[index], parts[int(index)])


@pytest.mark.parametrize("index", [slice(1, 3), slice(None), slice(None, None, -1), slice(-2, None), slice(2, 0, -1)])
def test_a_slice_gives_the_meshes_of_a_list(index):
    parts = three()
    assert same(join(parts)[index], join(parts[index]))


@pytest.mark.parametrize("index", [slice(2, 1), [], torch.zeros(3, dtype=torch.bool), np.zeros(0, int)])
def test_no_meshes_are_a_batch_of_none(index):
    none = join(three())[index]
    assert (len(none), len(none.points), len(none.triangles)) == (0, 0, 0)
    assert list(none) == []


@pytest.mark.parametrize("given_as", [list, np.array, torch.tensor])
def test_a_mask_gives_what_select_does(given_as):
    batch, mask = join(three()), [True, False, True]
    assert same(batch[given_as(mask)], batch.select(torch.tensor(mask)))


def test_a_batch_is_walked_through_mesh_by_mesh():
    parts = three()
    assert all(same(mesh, part) for mesh, part in zip(join(parts), parts, strict=True))


@pytest.mark.parametrize(
    ("index", "error"),
    [(3, IndexError), (-4, IndexError), ([0, 3], IndexError), ([True], IndexError), (0.0, TypeError), (None, TypeError),
     ([0.5], TypeError), ((0, 1), TypeError), ("a", TypeError), (True, TypeError), ([[0]], TypeError)],
)  # fmt: skip
def test_an_index_that_names_no_mesh_is_refused(index, error):
    with pytest.raises(error, match="meshes"):
        join(three())[index]


def test_put_undoes_select():
    batch, at = join(three()), torch.tensor([True, False, True])
    part = batch.select(at)
    moved = part.with_points(part.points + 1).with_triangles(part.triangles.roll(1, 1))
    whole = put(batch, at, moved)
    assert same(whole.select(at), moved)
    assert same(whole.select(~at), batch.select(~at))
    assert same(put(whole, at, part), batch)


def test_with_points_and_with_triangles_change_that_and_nothing_else():
    mesh = meshes.l_shape()
    moved = mesh.with_points(mesh.points + 1)
    assert torch.equal(moved.points, mesh.points + 1)
    assert same(moved.with_points(mesh.points), mesh)
    turned = mesh.with_triangles(mesh.triangles.roll(1, 1))
    assert same(turned.with_triangles(mesh.triangles), mesh)
    with pytest.raises(InvalidMeshError, match="points must be"):
        mesh.with_points(mesh.points[1:])
    with pytest.raises(InvalidMeshError, match="triangles must be"):
        mesh.with_triangles(mesh.triangles[1:])


def test_to_converts_the_points_only():
    mesh = meshes.l_shape().to(torch.float32)
    assert mesh.points.dtype == torch.float32
    assert mesh.triangles.dtype == mesh.constrained_edges.dtype == torch.int64
    assert same(mesh.to(torch.float64).to(torch.float32), mesh)


def test_a_mesh_is_frozen():
    with pytest.raises(dataclasses.FrozenInstanceError):
        meshes.grid().points = torch.zeros(1)


def test_repr_says_how_much_of_what():
    assert repr(join([meshes.grid(2, 2), meshes.grid(1, 1)])).startswith("MeshBatch(2 meshes, 13 points, 10 triangles")


# --- the named meshes are what their names say ---


@pytest.mark.parametrize("name", list(meshes.VALID))
def test_named_valid_meshes_are_valid(name):
    mesh = meshes.VALID[name]()
    assert all(area > 0 for area in double_areas(mesh))
    assert max(directed_edges(mesh.triangles).values()) == 1


@pytest.mark.parametrize("name", list(meshes.TANGLED))
def test_named_tangled_meshes_are_tangled_but_their_boundary_is_not(name):
    mesh = meshes.TANGLED[name]()
    assert any(area < 0 for area in double_areas(mesh))
    assert total_area(mesh) > 0
    assert connectivity.euler_number(mesh.triangles, connectivity.twins(mesh.triangles)) in (0, 1)


def test_a_mesh_whose_areas_would_underflow_is_refused():
    points = np.array([[0, 0], [1, 0], [0, 1]]) * 1e-160
    with pytest.raises(InvalidMeshError, match="underflow"):
        MeshBatch.from_arrays(points, [[0, 1, 2]])


def test_twins_travel_with_the_mesh_and_cannot_go_stale():
    batch = join([meshes.grid(), meshes.ring(), meshes.l_shape()])
    assert torch.equal(batch.known_twin, connectivity.twins(batch.triangles))
    for mesh in batch.split():
        assert torch.equal(mesh.known_twin, connectivity.twins(mesh.triangles))
    keep = torch.tensor([True, False, True])
    part = batch.select(keep)
    assert torch.equal(part.known_twin, connectivity.twins(part.triangles))
    assert batch.with_points(batch.points + 1).known_twin is not None
    # Other triangles, by whatever way, have other twins.
    turned = part.triangles.roll(1, 1)
    for other in (part.with_triangles(turned), dataclasses.replace(part, triangles=turned)):
        assert other.known_twin is None
        assert torch.equal(other.twin, connectivity.twins(turned))
        assert other.known_twin is other.twin
        back = put(batch, keep, other)
        assert torch.equal(back.known_twin, connectivity.twins(back.triangles))
    unasked = dataclasses.replace(batch, _twin=None)
    assert unasked.select(keep).known_twin is None
    assert all(mesh.known_twin is None for mesh in unasked.split())
    assert join([unasked, batch]).known_twin is None
    assert put(unasked, keep, part).known_twin is None
    sent = pickle.loads(pickle.dumps(batch))
    assert sent.known_twin is None
    assert torch.equal(sent.twin, batch.twin)
    assert batch.to(torch.float32).points.dtype == torch.float32


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("value", [torch.inf, -torch.inf, torch.nan])
def test_positions_that_are_not_finite_are_refused_in_either_precision(dtype, value):
    points, triangles = meshes.grid_arrays(3, 3)
    points = torch.from_numpy(points).to(dtype)
    points[5, 1] = value
    with pytest.raises(InvalidMeshError, match=r"points row 5 .* every coordinate must be finite"):
        MeshBatch.from_arrays(points, triangles)


def test_pinning_reaches_every_tensor(monkeypatch):
    """Without a GPU there is nothing to pin: the calls are counted."""
    pinned = []
    monkeypatch.setattr(torch.Tensor, "pin_memory", lambda tensor: pinned.append(tensor) or tensor.clone())
    mesh = join(three())
    again = mesh.pin_memory()
    assert same(again, mesh)
    names = [f.name for f in dataclasses.fields(MeshBatch) if isinstance(getattr(mesh, f.name), torch.Tensor)]
    assert {id(tensor) for tensor in pinned} == {id(getattr(mesh, name)) for name in names}
