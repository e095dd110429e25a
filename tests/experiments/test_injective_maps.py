"""Cases in the benchmark's own format are read as its authors read them, and a run goes on where it was."""

import json

import numpy as np
import pytest
import torch

import torchmesh as tm
from experiments.robustness import injective_maps
from experiments.shared.injective_cases import NoCase, case_files, read_case


def surface(cells: int = 5):
    """A square patch bent in space (V, 3), its triangles, its tangled plan and its boundary."""
    x, y = np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(0, 1, cells + 1), indexing="ij")
    corner = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    space = np.stack([x.ravel(), y.ravel(), (x * x + 0.5 * y).ravel()], 1)
    rim = (np.minimum(x, 1 - x) * np.minimum(y, 1 - y)).ravel() == 0
    start = np.stack([x.ravel(), y.ravel()], 1)
    start[~rim] = 0.4
    return space, triangles, start, np.flatnonzero(rim)


def write_obj(path, space, triangles, start, handles=None, name="handles.txt"):
    lines = [f"v {p[0]!r} {p[1]!r} {p[2]!r}" for p in space.tolist()]
    lines += [f"vt {p[0]!r} {p[1]!r}" for p in start.tolist()]
    lines += ["f " + " ".join(f"{v}/{v}" for v in t) for t in (triangles + 1).tolist()]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("# a case\n" + "\n".join(lines) + "\n")
    if handles is not None:
        path.with_name(name).write_text("\n".join(map(str, handles.tolist())) + "\n")


def write_plain(path, space, triangles, start, handles):
    def block(rows):
        return f"{len(rows)} {rows.shape[1]}\n" + "\n".join(" ".join(map(repr, row)) for row in rows.tolist())

    tail = f"{len(handles)}\n" + "\n".join(map(str, handles.tolist())) + "\ntutte-uniform\n1e-06\n"
    path.write_text("\n".join([block(space), block(start), block(triangles), tail]))


def test_both_formats_tell_the_same_case(tmp_path):
    space, triangles, start, rim = surface()
    write_obj(tmp_path / "input.obj", space, triangles, start, rim)
    write_plain(tmp_path / "input", space, triangles, start, rim)
    one, other = read_case(tmp_path / "input.obj"), read_case(tmp_path / "input")
    assert torch.equal(one.mesh.points, torch.from_numpy(start))
    assert one.mesh.fixed.nonzero().squeeze(1).tolist() == rim.tolist()
    for a, b in ((one.mesh.points, other.mesh.points), (one.mesh.triangles, other.mesh.triangles),
                 (one.mesh.fixed, other.mesh.fixed), (one.targets, other.targets)):  # fmt: skip
        assert torch.equal(a, b)
    edges = torch.from_numpy(space[triangles[:, 1]] - space[triangles[:, 0]])
    torch.testing.assert_close(one.targets[:, :, 0].norm(dim=1), edges.norm(dim=1))


def test_a_run_goes_on_where_it_was_and_has_its_table(tmp_path):
    folder, out = tmp_path / "data", tmp_path / "out"
    space, triangles, start, rim = surface()
    write_obj(folder / "letters" / "A" / "input.obj", space, triangles, start, rim)
    write_obj(folder / "letters" / "A" / "result.obj", space, triangles, start)
    # Clockwise, and without handles: the boundary stays.
    write_obj(folder / "simple" / "B.obj", space, triangles[:, ::-1], start)
    (folder / "simple" / "tetrahedra").write_text(
        "4 3\n" + "0 0 0\n" * 4 + "4 3\n" + "0 0 0\n" * 4 + "1 4\n0 1 2 3\n0\n"
    )
    assert injective_maps.main([str(folder), "--out", str(out), "--limit", "1"]) == 0
    record = out / "injective_maps.jsonl"
    first = record.read_text()
    assert len(first.splitlines()) == 1
    record.write_text(first + '{"case": "cut sh')
    assert injective_maps.main([str(folder), "--out", str(out)]) == 0
    rows = [json.loads(line) for line in record.read_text().splitlines()]
    assert record.read_text().startswith(first)
    assert {row["case"]: row["valid"] for row in rows} == {
        "letters/A/input.obj": True, "simple/B.obj": True, "simple/tetrahedra": None
    }  # fmt: skip
    assert all(row["inverted before"] > 0 for row in rows if row["valid"])
    table = (out / "injective_maps.md").read_text()
    assert "| letters | 1 | 1 | 1 |" in table
    assert "| all | 2 | 2 | 2 |" in table


def test_a_case_that_stays_tangled_is_named_and_the_run_fails(tmp_path, monkeypatch, capsys):
    space, triangles, start, rim = surface()
    write_obj(tmp_path / "data" / "input.obj", space, triangles, start, rim)
    monkeypatch.setattr(injective_maps, "untangled", lambda case: (case.mesh, tm.improve(case.mesh)[1]))
    assert injective_maps.main([str(tmp_path / "data"), "--out", str(tmp_path / "out")]) == 1
    assert "not valid: input.obj: " in capsys.readouterr().out


def test_each_texture_coordinate_of_a_seam_is_a_vertex(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 5\nv 0 1 0\n" + "vt 0 0\nvt 2 0\nvt 2 2\nvt 0 0.1\nvt 2 2.1\nvt 0 2\n"
    (tmp_path / "seam.obj").write_text(text + "f 1/1 2/2 3/3\nf -4/4 -2/5 4/6\n")
    (tmp_path / "seam_handles.txt").write_text("0\n2\n")
    case = read_case(tmp_path / "seam.obj")
    assert case.mesh.triangles.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert case.mesh.fixed.tolist() == [True] * 6  # the boundary always stays
    assert torch.allclose(case.targets[1, :, 0].norm(), torch.tensor(27.0, dtype=torch.float64).sqrt())


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no texture coordinates"),
        ("v 0 0 0\nvt 0 0\nf 1/1 2/2 3/3\n", "name vertices that are not there"),
        ("v 0 0 0\nvt 0 0\nf 1/1 1/1 1/1 1/1\n", "no triangles"),
        ("v 0 0 x\n", "line 1 cannot be read"),
    ],
)
def test_what_is_no_case_is_told(tmp_path, text, message):
    (tmp_path / "bad.obj").write_text(text)
    with pytest.raises(NoCase, match=message):
        read_case(tmp_path / "bad.obj")
    assert list(case_files(tmp_path)) == [tmp_path / "bad.obj"]
