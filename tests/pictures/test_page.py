"""The page of `report_page`: what is in it, and that it asks for nothing."""

import re
from pathlib import Path

import meshes
import pytest
from pictured import decoded, embedded, recorded

from torchmesh import InvalidMeshError, MeshBatch, MeshIOError, join
from torchmesh.pictures import page, page_data
from torchmesh.pictures.page import report_page


@pytest.fixture(scope="module")
def tangled() -> MeshBatch:
    return meshes.moved_hole()


@pytest.fixture(scope="module")
def written(tangled, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("page") / "page.html"
    report_page(path, *recorded(tangled), title="a hole </script> that moved")
    return path


def test_the_page_holds_the_tables_and_asks_for_nothing(tangled, written):
    text = written.read_text()
    stages, report = recorded(tangled)
    assert "default-src 'none'" in text
    assert not re.search(r"""(src|href|action)\s*=\s*["'](?!data:,)|@import|url\(|fetch\(|XMLHttp|https?://""", text)
    for step in report.steps[0]:
        assert re.search(rf"<td[^>]*>{step.mean:.3f}</td>", text)
    assert text.count("<tr data-stage=") == len(stages)
    for title in ("triangles", "vertices", "inverted", "IMR average", "IMR maximum", "smallest angle (degrees)"):
        assert f'<th scope="row">{title}</th>' in text
    assert "Certified valid" in text
    assert text.count('<svg class="histogram"') == 2
    assert written.stat().st_size < 200_000


def test_names_cannot_break_out_of_the_page(tmp_path):
    name = '</script><b a="1">&'
    report_page(tmp_path / "page.html", [(name, meshes.grid()), ("after", meshes.grid())], title=name, note=name)
    text = (tmp_path / "page.html").read_text()
    assert "<b a" not in text
    assert text.count("</script>") == 3
    assert embedded(text)[0]["stages"][0]["name"] == f"0. {name}"


def test_before_and_after_alone(tmp_path):
    report_page(tmp_path / "page.html", [("before", meshes.moved_hole()), ("after", meshes.grid())])
    text = (tmp_path / "page.html").read_text()
    assert "<title>page</title>" in text
    assert "seconds" not in text
    assert text.count("<tr data-stage=") == 2


def test_one_stage_is_enough(tmp_path):
    report_page(tmp_path / "page.html", [("mesh", meshes.grid())])
    header, _ = embedded((tmp_path / "page.html").read_text())
    assert [entry["name"] for entry in header["stages"]] == ["0. mesh"]


def test_a_mesh_with_a_flat_triangle(tmp_path):
    flat = MeshBatch.from_arrays([[0, 0], [1, 0], [2, 0], [1, 1.0]], [[0, 1, 2], [0, 2, 3]])
    report_page(tmp_path / "page.html", [("flat", flat)])
    text = (tmp_path / "page.html").read_text()
    header, data = embedded(text)
    assert decoded(header, data)[0][2][0] == page_data.INFINITE_CODE
    assert re.search("<td[^>]*>inf</td>", text)


def test_a_point_and_a_line(tmp_path):
    for points in ([[3, 4], [3, 4], [3, 4.0]], [[0, 0], [1, 0], [2, 0.0]]):
        report_page(tmp_path / "page.html", [("mesh", MeshBatch.from_arrays(points, [[0, 1, 2]]))])


def test_too_many_stages_are_thinned_out_but_not_in_the_table(tangled, tmp_path, monkeypatch):
    stages = [(f"way {i}", tangled) for i in range(9)] + [
        (f"way {i}", MeshBatch.from_arrays(*meshes.holed_arrays())) for i in range(9, 20)
    ]
    monkeypatch.setattr(page, "_TRIANGLES_SHOWN", 5 * len(tangled.triangles))
    report_page(tmp_path / "page.html", stages)
    text = (tmp_path / "page.html").read_text()
    header, _ = embedded(text)
    shown = [int(entry["name"].split(".")[0]) for entry in header["stages"]]
    assert len(shown) == 5
    assert {0, 9, 19} <= set(shown), "the ends and the first that is valid"
    assert shown == sorted(shown)
    assert text.count('<th scope="row">') == 7 + 20
    assert text.count("<tr data-stage=") == 5


def test_bad_stages(tangled, tmp_path):
    path = tmp_path / "page.html"
    with pytest.raises(InvalidMeshError, match="at least one stage"):
        report_page(path, [])
    with pytest.raises(InvalidMeshError, match="'both' is a batch of 2 meshes"):
        report_page(path, [("both", join([tangled, tangled]))])
    stages, report = recorded(tangled)
    with pytest.raises(ValueError, match="its steps are not the stages given"):
        report_page(path, stages[1:], report)
    with pytest.raises(MeshIOError, match="does not exist"):
        report_page(tmp_path / "nowhere" / "page.html", stages)
    assert not list(tmp_path.iterdir())
