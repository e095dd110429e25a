"""Free vertices at new positions: valid, in the same number and rows, and only where nothing speaks against it."""

from dataclasses import replace

import pytest
import torch
from both_loops import need_compiled_loops
from exact import edge_counts, inverted
from meshes import TANGLED, delaunay, disturbed, dragged_interface, grid, holed_arrays, jittered, moved_hole, ring

from torchmesh import MeshBatch, MeshWarning, join, quality
from torchmesh.mesh.connectivity import boundary_edges, triangle_components
from torchmesh.mesh.kept_edges import constrained_half_edges
from torchmesh.remeshing.anew_in_rows import InRowsOptions, anew_in_rows

ANY_SIZE = InRowsOptions(own_share=1.0)


def anew(mesh, options=None):
    return anew_in_rows(mesh, quality(mesh), options=options)


def edges_of(mesh):
    return {tuple(edge) for edge in boundary_edges(mesh.triangles, mesh.twin).tolist()}


@pytest.mark.parametrize("mesh", [moved_hole(), jittered(12, 11, cells=2.5, seed=1)], ids=["hole", "jittered"])
def test_all_vertices_are_in_valid_triangles_within_the_boundary(mesh):
    assert inverted(mesh) > 0
    made = anew(mesh)
    assert inverted(made) == 0
    assert made.triangles.shape == mesh.triangles.shape
    assert torch.equal(made.triangles.unique(), mesh.triangles.unique())
    assert torch.equal(made.points[mesh.fixed], mesh.points[mesh.fixed])
    assert edges_of(made) == edges_of(mesh)
    assert float(quality(made).mean) < 1.2


def test_vertices_and_triangles_stay_near_where_nothing_was_wrong():
    mesh = moved_hole(0.0)
    made = anew(mesh)
    side = float((made.points[made.triangles[:, 0]] - made.points[made.triangles[:, 1]]).norm(dim=1).mean())
    far = (made.points - mesh.points).norm(dim=1)[~mesh.fixed]
    assert 0 < float(far.median()) < side
    centres = [m.points[m.triangles].mean(1) for m in (mesh, made)]
    assert float((centres[0] - centres[1]).norm(dim=1).median()) < side


def test_fixed_vertices_and_vertices_of_no_triangle_stay():
    mesh = moved_hole()
    points, fixed = torch.cat([mesh.points, torch.tensor([[50.0, 50.0]]).double()]), mesh.fixed.clone()
    held = int((~fixed).nonzero()[3])
    fixed[held] = True
    points[held] = torch.tensor([1.0, 1.1])
    one = MeshBatch(
        points, mesh.triangles, torch.cat([fixed, torch.tensor([False])]), mesh.constrained_edges,
        mesh.point_offsets + torch.tensor([0, 1]), mesh.triangle_offsets, mesh.frames,
    )  # fmt: skip
    made = anew(one, ANY_SIZE)
    assert inverted(made) == 0
    assert torch.equal(made.points[[held, -1]], points[[held, -1]])


def test_how_far_away_a_vertex_of_no_triangle_is_does_not_matter():
    mesh = moved_hole()
    far, fixed = torch.tensor([[1e140, 0.0]], dtype=torch.float64), torch.cat([mesh.fixed, torch.tensor([True])])
    with pytest.warns(MeshWarning, match="no triangle"):
        more = MeshBatch.from_arrays(torch.cat([mesh.points, far]), mesh.triangles, fixed)
    made = anew(mesh)
    assert torch.equal(anew(more).points, torch.cat([made.points, far]))
    assert torch.equal(anew(more).triangles, made.triangles)


def test_what_constrained_edges_shut_in_keeps_its_triangles():
    mesh = moved_hole()
    row = int(((~mesh.fixed)[mesh.triangles].sum(1) == 3).nonzero()[-1])
    corners = mesh.triangles[row]
    edges = torch.stack([corners, corners.roll(-1)], 1)
    made = anew(replace(mesh, constrained_edges=edges), ANY_SIZE)
    assert inverted(made) == 0
    assert torch.equal(made.triangles[row], corners)
    assert torch.equal(made.points[corners], mesh.points[corners])


def test_constrained_edges_that_divide_nothing_stay_edges():
    mesh = moved_hole()
    inner = (~mesh.fixed)[mesh.triangles].all(1).nonzero()[-1]
    edge = mesh.triangles[inner, :2]
    made = anew(replace(mesh, constrained_edges=edge), ANY_SIZE)
    assert inverted(made) == 0
    assert frozenset(edge[0].tolist()) in edge_counts(made.triangles)


def test_single_precision_keeps_its_type():
    mesh = moved_hole()
    made = anew(replace(mesh, points=mesh.points.float()))
    assert made.points.dtype == torch.float32
    assert inverted(made) == 0


@pytest.mark.parametrize("name", list(TANGLED))
def test_boundaries_that_bound_nothing_are_left_alone(name):
    mesh = TANGLED[name]()
    made = anew(mesh)
    assert made is None or inverted(made) == 0


def labels(mesh):
    return triangle_components(mesh.triangles, mesh.twin, constrained_half_edges(mesh))


def test_two_materials_keep_their_triangles():
    mesh = dragged_interface()
    made = anew(mesh, ANY_SIZE)
    assert inverted(mesh) > 0
    assert inverted(made) == 0
    assert int(labels(mesh).max()) == 1
    assert torch.equal(labels(made), labels(mesh))
    assert {frozenset(edge) for edge in mesh.constrained_edges.tolist()} <= set(edge_counts(made.triangles))
    # The edges of the interface stay where they are.
    held = mesh.constrained_edges.unique()
    assert torch.equal(made.points[held], mesh.points[held])


def test_only_tangled_regions_are_made_anew():
    mesh = dragged_interface()
    label, bad = labels(mesh), ~quality(mesh).upright
    counts = torch.bincount(label[bad], minlength=2) / torch.bincount(label)
    assert float(counts.min()) < float(counts.max())
    made = anew_in_rows(mesh, quality(mesh), float(counts.min()), ANY_SIZE)
    stays = label == int(counts.argmin())
    assert torch.equal(made.triangles[stays], mesh.triangles[stays])
    assert torch.equal(made.points[made.triangles[stays]], mesh.points[mesh.triangles[stays]])
    assert inverted(made) == int(bad[stays].sum())
    assert anew_in_rows(mesh, quality(mesh), 1.0, ANY_SIZE) is None
    assert anew_in_rows(mesh, quality(mesh), None, replace(ANY_SIZE, regions=1)) is None


def test_parts_keep_their_vertices():
    one = disturbed(ring(), 0.15, 3)
    apart = MeshBatch.from_arrays(
        torch.cat([ring().points, ring().points + 9]), torch.cat([one.triangles, one.triangles + len(one.points)])
    ).with_points(torch.cat([one.points, one.points + 9]))
    made = anew(apart, ANY_SIZE)
    assert inverted(apart) > 0
    assert inverted(made) == 0
    assert torch.equal(made.triangles.amax(1) < len(one.points), apart.triangles.amax(1) < len(one.points))
    assert anew(MeshBatch.from_arrays([[0.0, 0], [1, 0], [0, 1]], [[0, 1, 2]])) is None


def test_sizes_that_the_boundary_does_not_tell_are_left_alone():
    points, triangles = holed_arrays(60, 40)
    mesh = MeshBatch.from_arrays(points, triangles)
    assert anew(mesh) is not None
    middle = mesh.points.mean(0)
    refined, inside = mesh.points.clone(), ~mesh.fixed
    # Towards the middle everything becomes finer, alike in both directions.
    reach = (mesh.points - middle).norm(dim=1, keepdim=True)
    widest = float(reach.max())
    refined[inside] = (middle + (mesh.points - middle) * (reach / widest))[inside]
    own = mesh.with_points(refined)
    assert anew(own) is None


def test_one_mesh_of_a_batch_is_made_as_alone():
    batch = join([grid(), moved_hole(), delaunay(60)])
    one = torch.tensor([False, True, False])
    made, alone = anew(batch.select(one)), anew(moved_hole())
    assert torch.equal(made.points, alone.points)
    assert torch.equal(made.triangles, alone.triangles)


def test_by_the_twin_the_same(monkeypatch):
    need_compiled_loops()
    from torchmesh.kernels import library

    mesh, made = moved_hole(), []
    for choice in ("torch", "compiled"):
        with library.using(choice):
            made.append(anew(mesh))
    assert torch.equal(made[0].triangles, made[1].triangles)
    assert torch.allclose(made[0].points, made[1].points, atol=1e-9)
