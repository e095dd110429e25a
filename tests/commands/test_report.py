"""`torchmesh report`: which stages its page shows, and what it writes."""

import json
import re
from pathlib import Path

import fields
import meshes
import meshio
import numpy as np
import pytest
from command_line import Outcome, inverted, is_one_clear_line, names

from torchmesh import MeshBatch, improve, quality, write


def stage_names(page: Path) -> list[str]:
    header = re.search(r'id="header">(.*?)</script>', page.read_text(), re.DOTALL).group(1)
    return [entry["name"] for entry in json.loads(header)["stages"]]


def steps(mesh) -> list[str]:
    _, report = improve(mesh)
    return [f"{i}. {step.stage}" for i, step in enumerate(report.steps[0])]


def test_report_makes_what_is_not_there_and_shows_its_stages(call, folder):
    done = call("report", "tangled.vtu", "new.vtu", "report.html")
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith("report.html: ")
    assert inverted(folder / "new.vtu") == 0
    assert stage_names(folder / "report.html") == steps(meshes.moved_hole())


@pytest.mark.parametrize("file", ["better.vtu", "better.stl", "better.su2"])
def test_report_finds_the_stages_of_what_improve_wrote(call, folder, file):
    """In single precision too, which stl has."""
    write(folder / file, improve(meshes.moved_hole())[0])
    before = (folder / file).read_bytes()
    assert call("report", "tangled.vtu", file, "report.html").status == 0
    text = (folder / "report.html").read_text()
    assert "are not known" not in text
    assert stage_names(folder / "report.html") == steps(meshes.moved_hole())
    assert (folder / file).read_bytes() == before


def test_report_finds_the_stages_where_triangles_come_back_in_another_order(call, folder):
    """Some formats begin triangles at other corners, group them by blocks, or number vertices anew."""
    after = improve(meshes.moved_hole())[0]
    rng = np.random.default_rng(0)
    order = rng.permutation(len(after.points))
    faces = np.empty_like(order)
    faces[order] = np.arange(len(order))
    faces = faces[np.roll(after.triangles.numpy(), 1, axis=1)][rng.permutation(len(after.triangles))]
    write(folder / "better.vtu", MeshBatch.from_arrays(after.points[order], faces))
    assert call("report", "tangled.vtu", "better.vtu", "report.html").status == 0
    assert stage_names(folder / "report.html") == steps(meshes.moved_hole())
    # Vertices elsewhere are another mesh.
    points = after.points.clone()
    points[~after.fixed] += 1e-3
    write(folder / "better.vtu", after.with_points(points))
    assert "are not known" in call("report", "tangled.vtu", "better.vtu", "report.html").err


def test_report_keeps_point_data_of_a_mesh_that_got_other_vertices(call, folder):
    before = fields.write_coarse(folder / "coarse.vtu")
    arguments = ["coarse.vtu", "new.vtu", "report.html", "--topology", "full", "--no-stages", "--quiet"]
    assert call("report", *arguments) == Outcome(0, "", "")
    fields.assert_carried(before, meshio.read(folder / "new.vtu"))


def test_report_on_two_files_that_have_no_stages_between(call, folder):
    write(folder / "other.vtu", meshes.grid())
    done = call("report", "tangled.vtu", "other.vtu", "report.html", "--title", "two files")
    assert done.status == 0
    assert done.err == "The stages between are not known: other.vtu is not what improve makes of tangled.vtu.\n"
    assert stage_names(folder / "report.html") == ["0. before", "1. after"]
    text = (folder / "report.html").read_text()
    assert "<h1>two files</h1>" in text
    assert "are not known" in text


def test_report_without_stages_improves_nothing(call, folder, monkeypatch):
    write(folder / "other.vtu", meshes.grid())
    monkeypatch.setattr("torchmesh.batches.file_improvement.improve", lambda *_, **__: pytest.fail("it improved"))
    assert call("report", "tangled.vtu", "other.vtu", "report.html", "--no-stages") == Outcome(
        0, f"report.html: 2 stages, {(folder / 'report.html').stat().st_size / 1e6:.1f} MB\n", "",
    )  # fmt: skip


def test_report_on_a_mesh_that_is_still_tangled_says_so(call, folder):
    write(folder / "same.vtu", meshes.moved_hole())
    done = call("report", "tangled.vtu", "same.vtu", "report.html", "--no-stages", "--quiet")
    assert done.status == 1
    count = int(quality(meshes.moved_hole()).inverted[0])
    assert done.err == f"not valid: {count} inverted triangles in same.vtu\n"
    assert (folder / "report.html").exists()


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["report", "missing.vtu", "b.vtu", "r.html"], "missing.vtu: there is no such file"),
        (["report", "tangled.vtu", "b.vtu", "r.pdf"], "a page's name ends in .html"),
        (["report", "tangled.vtu", "b.vtu", "nowhere/r.html"], "does not exist"),
        (["report", "tangled.vtu", "tangled.vtu", "r.html"], "named twice"),
        (["report", "tangled.vtu", "b.foo", "r.html"], "'.foo' is not known"),
        (["report", "tangled.vtu", "b.vtu", "r.html", "--beta", "1"], "--beta needs --method paper"),
        (["report", "tangled.vtu", "b.vtu"], "PAGE.html"),
    ],
)
def test_bad_usage_is_one_clear_line_and_no_file(call, folder, arguments, text):
    before = names(folder)
    assert is_one_clear_line(call(*arguments), text)
    assert names(folder) == before


def test_report_compares_meshes_of_which_one_has_quads(call, folder):
    """As where --quads split made triangles of them."""
    write(folder / "quads.vtu", meshes.mixed())
    count = len(meshes.mixed().quads)
    for before, after, head in (("quads.vtu", "tangled.vtu", (count, 0)), ("tangled.vtu", "quads.vtu", (0, count))):
        done = call("report", before, after, "report.html", "--no-stages")
        assert "Traceback" not in done.err
        text = (folder / "report.html").read_text()
        cells = [f'<td data-label="{name}">{n}</td>' for name, n in zip(("before", "after"), head, strict=True)]
        assert f'<th scope="row">quads</th>{"".join(cells)}' in text
        assert "smallest angle of a triangle or quad, average" in text
        assert "after; numbers of elements" in text
        assert text.count("90: square") == 2, "as title and as text of one chart"


def test_report_finds_the_stages_where_quads_come_back_in_another_order(call, folder):
    before = meshes.mixed()
    after = improve(before)[0]
    again = MeshBatch.from_arrays(after.points, after.triangles, quads=after.quads.flip(0).roll(1, 1))
    write(folder / "before.vtu", before)
    write(folder / "after.vtu", again)
    assert call("report", "before.vtu", "after.vtu", "report.html").err == ""
