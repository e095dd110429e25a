"""Parts by name: loops round triangles and quads, named lines, cells and points, and the layers of quads on them."""

import meshio
import numpy as np
import pytest
import torch

from torchmesh.files.parts import parts_of
from torchmesh.files.source import Source


def ring(rings: int, quads: int, around: int = 12) -> meshio.Mesh:
    """A plate round a hole: so many rings of quads on the hole, then rings of triangles."""
    angle = 2 * np.pi * np.arange(around) / around
    points = np.concatenate([(1 + k) * np.stack([np.cos(angle), np.sin(angle)], 1) for k in range(rings + 1)])
    i = np.arange(around)
    cells = [(i + k * around, i + (k + 1) * around, (i + 1) % around + (k + 1) * around, (i + 1) % around + k * around)
             for k in range(rings)]  # fmt: skip
    four = np.concatenate([np.stack(c, 1) for c in cells[:quads]] or [np.zeros((0, 4), int)])
    rest = np.concatenate([np.stack(c, 1) for c in cells[quads:]])
    three = np.concatenate([rest[:, [0, 1, 2]], rest[:, [0, 2, 3]]])
    hole = np.stack([i, (i + 1) % around], 1)
    blocks = [("line", hole[:5]), ("triangle", three), *([("quad", four)] if len(four) else [])]
    none = [np.zeros(0, int)] * (len(blocks) - 1)
    return meshio.Mesh(points, blocks, cell_sets={"wet: left": [np.arange(5), *none]})


def parts(tmp_path, mesh: meshio.Mesh):
    points = np.pad(mesh.points, ((0, 0), (0, 1)))
    meshio.Mesh(points, mesh.cells, cell_sets=mesh.cell_sets).write(tmp_path / "a.inp")
    return parts_of(Source.open(tmp_path / "a.inp"))


def test_a_loop_runs_round_the_quads_and_their_layers_go_along(tmp_path):
    found = parts(tmp_path, ring(4, 2))
    hole = found["hole:1"]
    assert hole.vertices.tolist() == list(range(12))
    assert (hole.triangles, hole.quads) == (0, 12)
    assert hole.layer.tolist() == list(range(12, 36))
    assert hole.base.tolist() == [*range(12), *range(12)]
    assert found["outer:1"].vertices.tolist() == list(range(48, 60))
    assert len(found["outer:1"].layer) == 0


def test_a_part_of_a_loop_has_the_columns_that_stand_on_it(tmp_path):
    wet = next(part for name, part in parts(tmp_path, ring(4, 2)).items() if part.kind == "lines")
    assert wet.vertices.tolist() == list(range(6))
    assert wet.layer.tolist() == [*range(12, 18), *range(24, 30)]
    assert wet.base.tolist() == [*range(6), *range(6)]


def test_quads_that_reach_the_other_boundary_are_no_layer(tmp_path):
    mesh = ring(3, 2)
    # The triangles go, but for one, so that nearly all columns end at the outer boundary.
    blocks = {block.type: block.data for block in mesh.cells}
    three = blocks["triangle"][12:13] + 0
    points = np.concatenate([mesh.points[:36], mesh.points[three[0, three[0] >= 36]]])
    three[three >= 36] = 36
    kept = meshio.Mesh(points, [("triangle", three), ("quad", blocks["quad"])])
    found = parts(tmp_path, kept)
    hole = found["hole:1"]
    assert len(hole.layer) <= 4
    assert (hole.quads, hole.triangles) == (12, 0)


def test_lengths_and_what_lies_on_a_part(tmp_path):
    mesh = ring(2, 0)
    hole = parts(tmp_path, mesh)["hole:1"]
    assert hole.length(torch.from_numpy(mesh.points)) == pytest.approx(24 * np.sin(np.pi / 12))
    assert (hole.triangles, hole.quads) == (12, 0)


def test_numbers_name_what_has_no_name(tmp_path):
    mesh = ring(2, 0)
    triangles = next(b.data for b in mesh.cells if b.type == "triangle")
    lines = next(b.data for b in mesh.cells if b.type == "line")
    inner = (np.linalg.norm(mesh.points[triangles].mean(1), axis=1) < 1.9).astype(int) + 1
    data = {"material": [np.full(len(lines), 7), inner]}
    path = tmp_path / "a.vtu"
    meshio.Mesh(
        np.pad(mesh.points, ((0, 0), (0, 1))), [("line", lines), ("triangle", triangles)], cell_data=data
    ).write(path)
    found = parts_of(Source.open(path))
    assert set(found) == {"outer:1", "hole:1", "line:7", "material:1", "material:2"}
    assert found["line:7"].vertices.tolist() == list(range(6))
    assert found["material:2"].vertices.tolist() == list(range(24))
    assert found["material:2"].triangles == int((inner == 2).sum())


def test_quads_without_rows_are_no_layer(tmp_path):
    """Columns of unstructured quads end anywhere: here each second one is two rows higher."""
    mesh = ring(6, 5)
    blocks = {block.type: block.data for block in mesh.cells}
    row, column = np.divmod(np.arange(len(blocks["quad"])), 12)
    cut = blocks["quad"][row > 2 * (column % 2)]
    triangles = np.concatenate([blocks["triangle"], cut[:, [0, 1, 2]], cut[:, [0, 2, 3]]])
    kept = [("quad", blocks["quad"][row <= 2 * (column % 2)]), ("triangle", triangles)]
    hole = parts(tmp_path, meshio.Mesh(mesh.points, kept))["hole:1"]
    assert hole.quads == 12
    assert len(hole.layer) == 0
