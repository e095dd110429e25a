"""The mesher: outlines kept, signs exact, sizes as asked, the same bits for the same seed."""

import numpy as np
import pytest
import torch

import torchmesh as tm
from torchmesh.triangulating import mesher as meshing
from torchmesh.triangulating.mesher import MesherOptions, MeshingError, Outline, mesh_outline

SQUARE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def circle(radius: float, centre=(0.0, 0.0), points: int = 64) -> np.ndarray:
    angle = 2 * np.pi * np.arange(points) / points
    return np.asarray(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], 1)


def meshed(outline: Outline, triangles: int, seed: int = 0) -> tm.MeshBatch:
    points, corners, loop = mesh_outline(outline, triangles, np.random.default_rng(seed))
    mesh = tm.MeshBatch.from_arrays(points, corners)
    # Vertices of the loops come first, and are the boundary.
    assert mesh.fixed.nonzero().squeeze(1).tolist() == list(range(len(loop)))
    assert int(tm.quality(mesh).inverted) == 0
    return mesh


@pytest.mark.parametrize("triangles", [200, 1500])
def test_a_holed_square_keeps_corners_and_area(triangles):
    hole = circle(0.2, (0.5, 0.4))
    mesh = meshed(Outline((SQUARE, hole[::-1]), (1.0, 1.0)), triangles)
    for corner in SQUARE:
        assert (mesh.points == torch.tensor(corner)).all(1).any()
    area = float(tm.quality(mesh).area.sum())
    # The hole's vertices lie on its circle or its chords, so the mesh's hole is the smaller one.
    assert 1 - np.pi * 0.04 < area < 1 - 0.9 * np.pi * 0.04


def test_uniform_sizes_give_nearly_equilateral_triangles():
    mesh = meshed(Outline((SQUARE,), (1.0,)), 2000)
    assert abs(len(mesh.triangles) / 2000 - 1) < 0.05
    # A lattice of equilateral triangles but for the vertices near the rim.
    assert float(tm.quality(mesh).inverse_mean_ratio.median()) < 1.0005


def test_sizes_grow_no_faster_than_asked():
    outline = Outline((circle(8.0), circle(0.5)[::-1]), (1.0, 0.1), gradation=0.15)
    mesh = meshed(outline, 2000)
    edge = mesh.points[mesh.triangles[:, 0]] - mesh.points[mesh.triangles[:, 1]]
    middle = torch.linalg.vector_norm(mesh.points[mesh.triangles].mean(1), dim=1)
    length = torch.linalg.vector_norm(edge, dim=1)
    near = length[middle < 0.7].mean()
    for low, high in ((1.0, 2.0), (2.0, 3.0), (3.0, 4.0)):
        mean = length[(middle > low) & (middle < high)].mean()
        assert mean > 1.2 * near
        # Size on the hole plus gradation times the distance from it, with room for the scatter of lengths.
        assert mean < 1.25 * (near + 0.15 * (high - 0.5))


def test_a_narrow_passage_gets_cells_across():
    dumbbell = np.array([[0, 0], [1, 0], [1, 0.45], [2, 0.45], [2, 0], [3, 0], [3, 1], [2, 1], [2, 0.55], [1, 0.55],
                         [1, 1], [0, 1]], dtype=float)  # fmt: skip
    mesh = meshed(Outline((dumbbell,), (1.0,)), 300)
    inside = mesh.points[~mesh.fixed]
    assert int(((inside[:, 0] > 1) & (inside[:, 0] < 2)).sum()) > 20


def test_the_same_seed_gives_the_same_bits():
    outline = Outline((SQUARE, circle(0.2, (0.5, 0.4))[::-1]), (1.0, 0.5))
    one, two, three = (mesh_outline(outline, 400, np.random.default_rng(s)) for s in (1, 1, 2))
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    assert one[0].shape != three[0].shape or not np.array_equal(one[0], three[0])


def test_outline_edges_that_are_not_delaunay_are_recovered_exactly(monkeypatch):
    """The way round: with the quick triangulation spoilt, vertices go in one by one, and the mesh is as valid."""
    outline = Outline((SQUARE, circle(0.2, (0.5, 0.4))[::-1]), (1.0, 1.0))
    quick = meshed(outline, 400)
    monkeypatch.setattr(meshing, "is_triangulation_of", lambda *_: False)
    exact = meshed(outline, 400)
    assert len(exact.points) == len(quick.points)
    assert len(exact.triangles) == len(quick.triangles)
    assert torch.equal(exact.points, quick.points)


@pytest.mark.parametrize(
    "loops",
    [
        (np.array([[0.0, 0], [1, 1], [1, 0], [0, 1]]),),
        (SQUARE[::-1],),
        (SQUARE, circle(0.4, (0.9, 0.5))[::-1]),
        (SQUARE, circle(0.2, (0.4, 0.5))[::-1], circle(0.2, (0.6, 0.5))[::-1]),
    ],
    ids=["crossing", "clockwise", "hole through the wall", "holes that cross"],
)
def test_loops_that_bound_no_domain_are_refused(loops):
    with pytest.raises(MeshingError, match="bounds no domain"):
        mesh_outline(Outline(loops, (1.0,) * len(loops)), 300, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("name", "value"), [("edges_per_loop", 2), ("scale_rounds", 0), ("corner", 0.0), ("detour", -1.0)]
)
def test_options_of_the_mesher_that_cannot_work_are_refused(name, value):
    with pytest.raises(ValueError, match=f"MesherOptions.{name} must be"):
        MesherOptions(**{name: value})
