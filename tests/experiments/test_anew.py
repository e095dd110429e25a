"""The comparison with meshing a boundary anew runs, on meshes so small that its numbers mean nothing."""

import pytest

from experiments.speed import anew


def test_it_has_a_row_for_each_tool(cache, capsys):
    pytest.importorskip("gmsh")
    assert anew.main(["--cache", str(cache), "--triangles", "300", "--repeats", "1"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("torchmesh, full") == printed.count("gmsh, meshed anew") == 3


def test_the_middle_of_a_hole_is_found(cache):
    case = anew.domains.case("circle", 300, 0, cache)
    edges = anew.tm.mesh.connectivity.boundary_edges(case.mesh.triangles, case.mesh.twin).numpy()
    (middle,) = anew._in_holes(case.mesh.points.numpy(), edges)
    assert tuple(middle) == pytest.approx((10.0, 4.0), abs=1e-6)
