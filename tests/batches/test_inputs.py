"""Which files a run improves, and where their results go."""

import glob
import os
import shutil
from pathlib import Path

import pytest
from file_runs import NAMES, result_names

from torchmesh import improve_files
from torchmesh.batches.inputs import _matches, files_below
from torchmesh.batches.runs import Run
from torchmesh.errors import MeshIOError


def test_paths_and_patterns(inputs, tmp_path, monkeypatch):
    out = tmp_path / "out"
    assert result_names(inputs, out) == NAMES
    assert result_names(f"{inputs}/**/*.vtu", out) == ["a/x.vtu", "b/c/x.vtu", "b/x.vtu"]
    assert result_names([f"{inputs}/a/*", inputs / "b" / "x.vtu"], out) == ["a/x.vtu", "a/y.msh", "b/x.vtu"]
    assert result_names([inputs / "a", inputs / "a" / "x.vtu"], out) == ["x.vtu", "y.msh"]
    assert result_names(inputs / "a" / "x.vtu", out) == ["x.vtu"]
    monkeypatch.chdir(inputs / "b")
    assert result_names("*.msh", out) == ["y.msh"]
    assert result_names(["c/x.vtu", "x.vtu"], out) == ["c/x.vtu", "x.vtu"]
    assert result_names("../**/y.msh", out) == ["a/y.msh", "b/c/y.msh", "b/y.msh"]


def test_results_inside_the_folder_of_inputs_are_no_inputs(inputs):
    out = inputs / "out"
    shutil.copytree(inputs / "a", out / "a")
    assert result_names(inputs, out) == NAMES


def test_another_extension(inputs, tmp_path):
    assert [job.output for job in Run.plan(inputs / "a" / "y.msh", tmp_path, suffix="vtk").jobs] == [
        str(tmp_path / "y.vtk")
    ]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"paths": "nothing/*.vtu"}, r"nothing/\*\.vtu: there is no such file"),
        ({"paths": []}, "no files were given"),
        ({"paths": ["a/x.vtu", "missing.vtu"]}, "missing.vtu: there is no such file"),
        ({"paths": "a", "out": "a"}, "would be overwritten by its own result"),
        ({"paths": "a/x.vtu", "out": "a"}, "would be overwritten by its own result"),
        ({"paths": "**/x.vtu", "out": "."}, "would be overwritten by its own result"),
        ({"paths": "a", "suffix": ".vtu", "extra": "x.msh"}, r"a/x\.msh and a/x\.vtu would both be written"),
        ({"paths": "a", "suffix": ".abc"}, r"'\.abc' is not known"),
        ({"paths": "a", "out": "a/x.vtu"}, "is not a folder"),
        ({"paths": "a", "engine": "cloud"}, "engine must be 'local' or 'ray', not 'cloud'"),
        ({"paths": "a", "workers": 0}, "workers must be at least 1, not 0"),
        ({"paths": "a", "budget": -3}, "budget must be at least 1, not -3"),
    ],
)
def test_mistakes_are_said_before_the_work(inputs, monkeypatch, change, text):
    monkeypatch.chdir(inputs)
    if name := change.pop("extra", None):
        shutil.copy("a/x.vtu", f"a/{name}")
    with pytest.raises((MeshIOError, ValueError), match=text):
        improve_files(**({"out": "out"} | change))
    assert not Path("out").exists()


def test_a_result_never_overwrites_an_input(inputs, tmp_path):
    """Through a link the folder of results is that of the inputs."""
    (tmp_path / "link").symlink_to(inputs)
    with pytest.raises(MeshIOError, match="would be overwritten by its own result"):
        improve_files(inputs, tmp_path / "link")


def test_links_that_lead_back_are_not_followed(inputs, tmp_path):
    """Two such links in one folder have made the search endless."""
    for name in ("loop", "loop2"):
        (inputs / name).symlink_to(".")
    (inputs / "a" / "up").symlink_to(tmp_path)  # above all inputs
    (inputs / "b" / "side").symlink_to(inputs / "a")
    out = tmp_path / "out"
    assert result_names(inputs, out) == NAMES
    assert result_names(f"{inputs}/**/*.vtu", out) == ["a/x.vtu", "b/c/x.vtu", "b/x.vtu"]


def test_a_link_to_another_folder_is_followed_once(inputs, tmp_path):
    (tmp_path / "far" / "deep").mkdir(parents=True)
    shutil.copy(inputs / "a" / "x.vtu", tmp_path / "far" / "deep" / "z.vtu")
    (tmp_path / "far" / "back").symlink_to(inputs)
    for name in ("link", "link2"):
        (inputs / name).symlink_to(tmp_path / "far")
    assert result_names(inputs, tmp_path / "out") == [*NAMES, "link/deep/z.vtu"]


def test_a_link_to_the_folder_of_results_is_not_followed(inputs, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(inputs / "a", out / "a")
    (inputs / "results").symlink_to(out)
    assert result_names(inputs, out) == NAMES


def test_patterns_choose_as_those_of_glob(tmp_path):
    names = ["a.vtu", "b/a.vtu", "b/c/a.vtu", "b/.hidden/a.vtu", ".a.vtu", "b/c/d.txt", "ab/x/c/a.vtu"]
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    for pattern in ("**/*.vtu", "**", "b/**", "*b/**/c/*", "**/c/**/a.vtu", "*/*.vtu", "a**/x/c/*", "**/[ac].vtu"):
        path = f"{tmp_path}/{pattern}"
        expected = sorted({file for file in glob.glob(path, recursive=True) if Path(file).is_file()})
        assert sorted(_matches(path, "")[1]) == expected, pattern
    assert sorted(files_below(str(tmp_path))) == sorted(n for n in names if "/." not in f"/{n}")


def test_files_that_belong_to_another_one_are_no_inputs(tmp_path):
    folder = tmp_path / "in"
    (folder / "parts").mkdir(parents=True)
    for name in ("a.1.node", "a.1.ele", "a.1.poly", "alone.ele", "b.xdmf", "b.h5", "parts/left.vtu", "parts/free.vtu"):
        (folder / name).touch()
    (folder / "c.vtm").write_text('<VTKFile><DataSet index="0" file="parts/left.vtu"/></VTKFile>')
    wanted = ["a.1.node", "alone.ele", "b.xdmf", "c.vtm", "parts/free.vtu"]
    assert result_names(folder, tmp_path / "out") == wanted


def test_links_that_lead_nowhere_are_errors_and_pipes_are_skipped(inputs, tmp_path, inline):
    (inputs / "broken.vtu").symlink_to("nowhere")
    (inputs / "broken.txt").symlink_to("nowhere")
    os.mkfifo(inputs / "pipe.vtu")
    run = Run.plan(inputs, tmp_path / "out")
    assert run.skipped == [str(inputs / "broken.txt"), str(inputs / "pipe.vtu")]
    (result,) = (one for one in run.results() if one.name == "broken.vtu")
    assert result.error == f"{inputs / 'broken.vtu'}: there is no such file"
    assert result_names(f"{inputs}/*.vtu", tmp_path / "other") == ["broken.vtu"]
    assert result_names(f"{inputs}/**/br*.vtu", tmp_path / "other") == ["broken.vtu"]
