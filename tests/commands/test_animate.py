"""`torchmesh animate`: the film that it writes, and bad usage."""

import meshes
import pytest
from command_line import is_one_clear_line, names

from torchmesh import write


def test_animate_writes_a_film_of_the_stages(call, folder):
    pytest.importorskip("matplotlib")
    write(folder / "small.vtu", meshes.disturbed(meshes.grid(3, 3), 0.2, 4))
    done = call("animate", "small.vtu", "film.gif", "--title", "small")
    assert (done.status, done.err) == (0, "")
    assert done.out.startswith("film.gif: ")
    assert (folder / "film.gif").read_bytes()[:3] == b"GIF"


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["tangled.vtu", "film.avi"], "use one of .gif .mp4"),
        (["missing.vtu", "film.gif"], "missing.vtu: there is no such file"),
        (["tangled.vtu"], "FILM"),
    ],
)
def test_bad_usage_is_one_clear_line_and_no_file(call, folder, arguments, text):
    before = names(folder)
    assert is_one_clear_line(call("animate", *arguments), text)
    assert names(folder) == before
