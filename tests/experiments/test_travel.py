"""The table of what it costs to stay near has its rows, and the tether holds in it."""

from experiments.quality import travel


def test_no_vertex_goes_further_than_a_width_unless_it_is_asked_to(capsys):
    assert travel.main(["--count", "2", "--vertices", "80"]) == 0
    rows = [line.strip("| ").split(" | ") for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    furthest = {(row[0], row[2]): float(row[-1]) for row in rows[1:]}
    assert len(furthest) == 9
    assert max(far for (_, relocate), far in furthest.items() if relocate != "True") <= 1
    assert furthest["random Delaunay", "True"] > 1
