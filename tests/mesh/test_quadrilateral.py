"""Quad metrics are those of Verdict: against a slow twin in space, VTK's own, and what moves and turns leave alone."""

import math

import numpy as np
import pytest
import torch

import torchmesh as tm
from tests.meshes import disturbed, mixed
from torchmesh.mesh import quadrilateral
from torchmesh.mesh.quadrilateral import QuadCorners, quad_corners


def some(count: int = 40, seed: int = 0) -> np.ndarray:
    """(N, 4, 2) quads about the unit square, some folded, some with a corner that turns inwards."""
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    return square + 0.45 * np.random.default_rng(seed).standard_normal((count, 4, 2))


def measured(name: str, quads: np.ndarray) -> np.ndarray:
    points = torch.from_numpy(quads.reshape(-1, 2))
    rows = torch.arange(len(points)).reshape(-1, 4)
    return tm.metrics.QUAD_METRICS[name].formula(quad_corners(points, rows)).numpy()


def slow(name: str, q: np.ndarray) -> float:
    """The metric of one quad (4, 2) by the words of the Verdict manual, one corner after the other."""
    edges = [q[(k + 1) % 4] - q[k] for k in range(4)]
    alpha = [float(edges[k - 1][0] * edges[k][1] - edges[k - 1][1] * edges[k][0]) for k in range(4)]
    length = [float(np.linalg.norm(e)) for e in edges]
    x1, x2 = edges[0] - edges[2], edges[1] - edges[3]
    diagonals = [float(np.linalg.norm(q[2] - q[0])), float(np.linalg.norm(q[3] - q[1]))]
    area = 0.25 * sum(alpha)
    return {
        "area": lambda: area,
        "jacobian": lambda: min(alpha),
        "shape": lambda: max(0.0, 2 * min(a / (length[k - 1] ** 2 + length[k] ** 2) for k, a in enumerate(alpha))),
        "mean_ratio": lambda: 2 * min(a / (length[k - 1] ** 2 + length[k] ** 2) for k, a in enumerate(alpha)),
        "condition": lambda: max((length[k - 1] ** 2 + length[k] ** 2) / (2 * abs(a)) for k, a in enumerate(alpha)),
        "scaled_jacobian": lambda: min(a / (length[k - 1] * length[k]) for k, a in enumerate(alpha)),
        "aspect_ratio": lambda: max(length) * sum(length) / (4 * abs(area)),
        "radius_ratio": lambda: (
            math.sqrt(sum(v * v for v in length)) * max(*length, *diagonals) / (math.sqrt(8) * min(map(abs, alpha)))
        ),
        "edge_ratio": lambda: max(length) / min(length),
        "skew": lambda: abs(float(x1 @ x2)) / (np.linalg.norm(x1) * np.linalg.norm(x2)),
        "taper": lambda: np.linalg.norm((q[0] - q[1]) + (q[2] - q[3])) / min(np.linalg.norm(x1), np.linalg.norm(x2)),
        "stretch": lambda: math.sqrt(2) * min(length) / max(diagonals),
    }[name]()


@pytest.mark.parametrize(
    "name",
    [
        "area",
        "jacobian",
        "shape",
        "mean_ratio",
        "condition",
        "scaled_jacobian",
        "aspect_ratio",
        "radius_ratio",
        "edge_ratio",
        "skew",
        "taper",
        "stretch",
    ],
)
def test_metrics_are_the_manuals(name):
    quads = some()
    want = [slow(name, q) for q in quads]
    np.testing.assert_allclose(measured(name, quads), want, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "verdict"),
    [("shape", "shape"), ("condition", "condition"), ("scaled_jacobian", "scaled_jacobian"), ("skew", "skew"),
     ("taper", "taper"), ("stretch", "stretch"), ("aspect_ratio", "aspect_ratio"), ("radius_ratio", "radius_ratio"),
     ("edge_ratio", "edge_ratio"), ("minimum_angle", "min_angle"), ("maximum_angle", "max_angle")],
)  # fmt: skip
def test_metrics_are_those_of_vtk(name, verdict):
    """On convex quads, where a surface in space has no other sign than one in the plane."""
    vtk = pytest.importorskip("vtkmodules.vtkFiltersVerdict")
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkQuad

    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    quads = square + 0.15 * np.random.default_rng(1).uniform(-1, 1, (20, 4, 2))
    call = getattr(vtk.vtkMeshQuality, "Quad" + "".join(word.capitalize() for word in verdict.split("_")))
    want = []
    for quad in quads:
        cell = vtkQuad()
        points = vtkPoints()
        points.SetDataTypeToDouble()
        for k, (x, y) in enumerate(quad):
            cell.GetPoints().SetPoint(k, x, y, 0.0)
        want.append(call(cell))
    np.testing.assert_allclose(measured(name, quads), want, rtol=1e-6)


@pytest.mark.parametrize("name", list(tm.metrics.QUAD_METRICS))
def test_a_square_is_ideal_and_nothing_leaves_its_range(name):
    metric = tm.metrics.QUAD_METRICS[name]
    square = np.array([[[0.0, 0], [2, 0], [2, 2], [0, 2]]])
    if metric.ideal is not None:
        np.testing.assert_allclose(measured(name, square), metric.ideal, atol=1e-12)
    values = measured(name, np.concatenate([some(200), np.zeros((1, 4, 2)), square[:, [0, 1, 1, 0]]]))
    assert (values >= metric.lowest - 1e-12).all()
    assert (values <= metric.highest + 1e-12).all()


@pytest.mark.parametrize("name", [n for n, m in tm.metrics.QUAD_METRICS.items() if not m.unit.startswith("length")])
def test_turns_shifts_scales_and_the_first_corner_change_nothing(name):
    quads = some()
    turn = np.array([[math.cos(0.7), -math.sin(0.7)], [math.sin(0.7), math.cos(0.7)]])
    for other in (3.7 * quads @ turn.T + [5.0, -2.0], np.roll(quads, 1, 1)):
        np.testing.assert_allclose(measured(name, other), measured(name, quads), rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("name", [n for n in tm.metrics.QUAD_METRICS if n not in ("warpage",)])
def test_gradients_are_exact(name):
    points = torch.from_numpy(some(3, seed=4).reshape(-1, 2)).requires_grad_()
    rows = torch.arange(12).reshape(-1, 4)
    assert torch.autograd.gradcheck(lambda p: tm.metrics.QUAD_METRICS[name].formula(quad_corners(p, rows)), (points,))


def test_gradients_are_finite_at_a_point():
    points = torch.zeros((4, 2), dtype=torch.float64, requires_grad=True)
    for metric in tm.metrics.QUAD_METRICS.values():
        value = metric.formula(quad_corners(points, torch.arange(4)[None]))
        if value.requires_grad:
            (gradient,) = torch.autograd.grad(value.nan_to_num(posinf=0.0).sum(), points, allow_unused=True)
            assert gradient is None or gradient.isfinite().all()


def test_angles_of_a_dart_sum_to_a_full_turn():
    dart = QuadCorners(*(torch.tensor([v]) for v in (0.0, 0.0, 2.0, 1.0, 4.0, 0.0, 2.0, 3.0)))
    found = quadrilateral.angles(dart)
    assert float(found.sum()) == pytest.approx(2 * math.pi)
    assert float(found.amax()) > math.pi


def test_summaries_count_triangles_and_quads_together_mesh_by_mesh():
    meshes = [disturbed(mixed(4, 3, 2), 0.02, 1), mixed(2, 2, 2), mixed(3, 2, 0)]
    found = tm.metrics.evaluate(tm.join(meshes))
    assert {"skew", "equiangle_skew", "radius_ratio"} <= set(found)
    for name, summary in found.items():
        parts = [torch.cat([part.values, part.quad_values]) for part in (tm.metrics.evaluate(m, [name])[name]
                 if len(m.quads) or name in tm.metrics.METRICS else summary for m in meshes[:2])]  # fmt: skip
        for b, values in enumerate(parts):
            assert float(summary.max[b]) == float(values.max())
            assert float(summary.mean[b]) == pytest.approx(float(values.mean()))
    assert math.isnan(float(found["skew"].mean[2]))
    assert tm.metrics.measure_quads(meshes[0], "skew").shape == (6,)
    with pytest.raises(ValueError, match="no metric 'skew'"):
        tm.metrics.evaluate(meshes[2], ["skew"])
