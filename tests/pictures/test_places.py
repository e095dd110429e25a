"""Places where something is left: found, told by their faults, and marked."""

import meshes
import numpy as np
import pytest
from exact import double_area
from pictured import two_faults

from torchmesh import improve, quality, report_page
from torchmesh.pictures.places import places_left


def test_each_group_of_inverted_triangles_is_a_place():
    mesh = two_faults()
    q = quality(mesh)
    found = places_left(mesh, q)
    assert len(found) >= 2
    for corner in ((0.3, 0.04), (0.7, 0.96)):
        near = [place for place in found if np.hypot(*np.subtract(place.position, corner)) < 0.2]
        assert near, corner
        assert "inverted triangle" in near[0].text
    counts = [int(place.text.split()[0]) for place in found if "inverted triangle" in place.text]
    assert sum(counts) == int(q.inverted[0]) == sum(double_area(*mesh.points[t].numpy()) <= 0 for t in mesh.triangles)
    assert counts == sorted(counts, reverse=True)


def test_a_valid_mesh_has_none():
    mesh = meshes.grid()
    assert places_left(mesh, quality(mesh)) == []


def test_pictures_and_the_page_mark_them(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    from torchmesh.pictures import pictures

    mesh = two_faults()
    after, report = improve(mesh)
    assert not report.valid.any()
    seen = []
    monkeypatch.setattr(pictures, "mark_places", lambda ax, places: seen.append(len(places)))
    pictures.before_after(tmp_path / "a.png", mesh, after)
    left = len(places_left(after, report.quality))
    assert seen == [left, left]
    assert left >= 2
    report_page(tmp_path / "a.html", [("before", mesh), ("after", after)])
    text = (tmp_path / "a.html").read_text()
    assert text.count("data-place=") == left
    report_page(tmp_path / "b.html", [("before", mesh), ("after", meshes.grid())])
    assert "data-place=" not in (tmp_path / "b.html").read_text()
