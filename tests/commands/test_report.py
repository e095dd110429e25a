"""`torchmesh report` and `torchmesh animate`."""

import json
import re
from pathlib import Path

import fields
import meshes
import meshio
import pytest

from torchmesh import improve, quality, read, write
from torchmesh.commands import main as cli


@pytest.fixture
def call(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "tangled.vtu", meshes.moved_hole())

    def run(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        status = cli.main([*map(str, arguments)])
        said = capsys.readouterr()
        return status, said.out, said.err

    return run


def names(page: Path) -> list[str]:
    header = re.search(r'id="header">(.*?)</script>', page.read_text(), re.DOTALL).group(1)
    return [entry["name"] for entry in json.loads(header)["stages"]]


def steps(mesh) -> list[str]:
    _, report = improve(mesh)
    return [f"{i}. {step.stage}" for i, step in enumerate(report.steps[0])]


def test_report_makes_what_is_not_there_and_shows_its_stages(call, tmp_path):
    status, out, err = call("report", "tangled.vtu", "better.vtu", "report.html")
    assert (status, err) == (0, "")
    assert out.startswith("report.html: ")
    assert int(quality(read(tmp_path / "better.vtu")).inverted[0]) == 0
    assert names(tmp_path / "report.html") == steps(meshes.moved_hole())


@pytest.mark.parametrize("file", ["better.vtu", "better.stl", "better.su2"])
def test_report_finds_the_stages_of_what_improve_wrote(call, tmp_path, file):
    """In single precision too, which stl has."""
    write(tmp_path / file, improve(meshes.moved_hole())[0])
    before = (tmp_path / file).read_bytes()
    assert call("report", "tangled.vtu", file, "report.html")[0] == 0
    text = (tmp_path / "report.html").read_text()
    assert (len(names(tmp_path / "report.html")) > 2) == ("are not known" not in text)
    if file != "better.stl":  # whose vertices come in another order
        assert names(tmp_path / "report.html") == steps(meshes.moved_hole())
    assert (tmp_path / file).read_bytes() == before


def test_report_keeps_point_data_of_a_mesh_that_got_other_vertices(call, tmp_path):
    before = fields.write_coarse(tmp_path / "coarse.vtu")
    arguments = ["coarse.vtu", "better.vtu", "report.html", "--topology", "full", "--no-stages", "--quiet"]
    assert call("report", *arguments) == (0, "", "")
    fields.assert_carried(before, meshio.read(tmp_path / "better.vtu"))


def test_report_on_two_files_that_have_no_stages_between(call, tmp_path):
    write(tmp_path / "other.vtu", meshes.grid())
    status, _, err = call("report", "tangled.vtu", "other.vtu", "report.html", "--title", "two files")
    assert status == 0
    assert err == "The stages between are not known: other.vtu is not what improve makes of tangled.vtu.\n"
    assert names(tmp_path / "report.html") == ["0. before", "1. after"]
    text = (tmp_path / "report.html").read_text()
    assert "<h1>two files</h1>" in text
    assert "are not known" in text


def test_report_without_stages_improves_nothing(call, tmp_path, monkeypatch):
    write(tmp_path / "other.vtu", meshes.grid())
    monkeypatch.setattr("torchmesh.improving.pipeline.improve", lambda *_, **__: pytest.fail("it improved"))
    assert call("report", "tangled.vtu", "other.vtu", "report.html", "--no-stages") == (
        0, f"report.html: 2 stages, {(tmp_path / 'report.html').stat().st_size / 1e6:.1f} MB\n", "",
    )  # fmt: skip


def test_report_on_a_mesh_that_is_still_tangled_says_so(call, tmp_path):
    write(tmp_path / "same.vtu", meshes.moved_hole())
    status, _, err = call("report", "tangled.vtu", "same.vtu", "report.html", "--no-stages", "--quiet")
    assert status == 1
    count = int(quality(meshes.moved_hole()).inverted[0])
    assert err == f"not valid: {count} inverted triangles in same.vtu\n"
    assert (tmp_path / "report.html").exists()


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
        (["animate", "tangled.vtu", "film.avi"], "use one of .gif .mp4"),
        (["animate", "missing.vtu", "film.gif"], "missing.vtu: there is no such file"),
        (["animate", "tangled.vtu"], "FILM"),
    ],
)
def test_bad_usage_is_one_clear_line_and_no_file(call, tmp_path, arguments, text):
    status, _, err = call(*arguments)
    assert status == 2
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert text in err
    assert [p.name for p in tmp_path.iterdir()] == ["tangled.vtu"]


def test_animate_writes_a_film_of_the_stages(call, tmp_path):
    pytest.importorskip("matplotlib")
    write(tmp_path / "small.vtu", meshes.disturbed(meshes.grid(3, 3), 0.2, 4))
    status, out, err = call("animate", "small.vtu", "film.gif", "--title", "small")
    assert (status, err) == (0, "")
    assert out.startswith("film.gif: ")
    assert (tmp_path / "film.gif").read_bytes()[:3] == b"GIF"
