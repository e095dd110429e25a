"""Certificates hold for a program that knows nothing of this package, and what is changed in them does not."""

import copy
import itertools
import json
import math
from dataclasses import replace

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm
from experiments.robustness import check_certificates
from experiments.shared import feasible
from torchmesh.bench import boundary
from torchmesh.diagnosing.certificates import certificates, write_certificates


def certified(mesh: tm.MeshBatch) -> dict:
    """The mesh and its certificates, as they are read back from JSON."""
    return json.loads(json.dumps(certificates(mesh, tm.diagnose(mesh, "keep", thorough=True))))


def moved(mesh: tm.MeshBatch, where: dict[int, tuple[float, float]]) -> tm.MeshBatch:
    points = mesh.points.clone()
    for v, position in where.items():
        points[v] = torch.tensor(position, dtype=points.dtype)
    return mesh.with_points(points)


def turned_ring(degrees: float) -> tm.MeshBatch:
    """A thin ring whose inner circle has turned."""
    mesh = feasible.meshed(feasible.ring(0.7), np.random.default_rng(0), 200)
    return tm.relax(
        mesh.with_points(torch.from_numpy(feasible.twisted(mesh.points.numpy(), 0.7, math.radians(degrees))))
    )


def notched(gap: float) -> tm.MeshBatch:
    """A free vertex in an octagon; of the sides of two notches nothing is on the left where the gap is below 0.

    On the left side another free vertex stands between.
    """
    ring = [[0, 0], [4, 0], [4, 2], [2 + gap, 2], [3 + gap, 4], [1 - gap, 4], [2 - gap, 2], [0, 2]]
    faces = [[i, i + 1, 8] for i in range(7)] + [[7, 0, 9], [0, 8, 9], [8, 7, 9]]
    return tm.MeshBatch.from_arrays(np.array([*ring, [2, 1], [1, 1]], float), np.array(faces))


def square(where: dict[int, tuple[float, float]], fixed: tuple[int, ...] = ()) -> tm.MeshBatch:
    """A square of 32 triangles, with vertices moved and more of them fixed."""
    mesh = moved(meshes.grid(4, 4), where)
    return replace(mesh, fixed=mesh.fixed.index_fill(0, torch.tensor(fixed, dtype=torch.int64), True))


def hole_outside() -> tm.MeshBatch:
    mesh = meshes.ring()
    return moved(mesh, {v: (x + 9, y) for v, (x, y) in enumerate(mesh.points[:16].tolist())})


def torus_with_a_hole() -> tm.MeshBatch:
    faces = []
    for i, j in itertools.product(range(4), range(4)):
        a, b, c, d = (((i + p) % 4) * 4 + (j + q) % 4 for p, q in ((0, 0), (1, 0), (1, 1), (0, 1)))
        faces += [[a, b, c], [a, c, d]] if (i, j) != (0, 0) else []
    loop = boundary.loops(torch.tensor(faces))[0].tolist()
    points = np.random.default_rng(0).uniform(size=(16, 2)) + 1
    points[loop] = [[0, 0], [3, 0], [3, 3], [0, 3]]
    return tm.MeshBatch.from_arrays(points, np.array(faces))


CASES = {
    "fixed triangle": lambda: square({20: (0.78125, 0.21875)}),
    "empty kernel": lambda: notched(-0.6),
    "edges meet": lambda: square({6: (0.45, 0.3), 7: (0.3, 0.2)}, fixed=(6, 7, 11, 12)),
    "vertex outside": lambda: square({12: (1.5, 0.5)}, fixed=(12,)),
    "point outside": hole_outside,
    "turns": lambda: square({5: (0.5, 0.0), 10: (0.25, 0.0)}),
    "handles": torus_with_a_hole,
    "no place": lambda: turned_ring(150),
}


@pytest.fixture(scope="module")
def known() -> dict[str, dict]:
    """The certified meshes by kind."""
    return {kind: certified(made()) for kind, made in CASES.items()}


@pytest.mark.parametrize("kind", CASES)
def test_an_independent_program_agrees(kind, known):
    data = known[kind]
    assert kind in [given["kind"] for given in data["certificates"]]
    assert check_certificates.check(data) == []


@pytest.mark.parametrize("kind", CASES)
def test_the_program_refuses_what_does_not_hold(kind, known):
    """The certificates of an impossible mesh, given to one that is valid: the same triangles laid out well."""
    data = copy.deepcopy(known[kind])
    if kind == "handles":
        data["triangles"] = data["triangles"][:3]  # no handle is left
    elif kind == "turns":
        data["points"] = meshes.grid(4, 4).points.tolist()
    elif kind in ("fixed triangle", "edges meet", "vertex outside", "empty kernel"):
        well = notched(0.3) if kind == "empty kernel" else meshes.grid(4, 4)
        data["points"] = well.points.tolist()
    elif kind == "point outside":
        data["points"] = meshes.ring().points.tolist()
    else:
        (given,) = data["certificates"]
        given["steps"] = given["steps"][:-1]
    assert check_certificates.check(data)


def test_free_vertices_prove_nothing(known):
    """What holds of fixed vertices alone is refused where they are free."""
    for kind in ("fixed triangle", "empty kernel", "vertex outside", "point outside", "turns", "no place"):
        assert check_certificates.check({**known[kind], "fixed": []}), kind


def test_nothing_is_certified_of_a_mesh_that_can_be_valid():
    data = certified(notched(0.3))
    assert data["certificates"] == []
    assert check_certificates.check(data) == ["there is no certificate"]


def test_a_file_is_checked_from_the_command_line(known, tmp_path, capsys):
    mesh = CASES["empty kernel"]()
    assert write_certificates(tmp_path / "one.json", mesh, tm.diagnose(mesh, "keep")) == 1
    assert check_certificates.main([str(tmp_path / "one.json")]) == 0
    assert "proved: empty kernel" in capsys.readouterr().out
    lines = [json.dumps({"case": "a", **known["no place"]}), json.dumps({"case": "b", **known["turns"], "fixed": []})]
    (tmp_path / "two.jsonl").write_text("\n".join(lines))
    assert check_certificates.main([str(tmp_path / "two.jsonl")]) == 1
    assert "a: proved: no place" in capsys.readouterr().out
