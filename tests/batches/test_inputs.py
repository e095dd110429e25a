"""Which files a run improves, and where their results go."""

import shutil
from pathlib import Path

import pytest
from file_runs import NAMES, result_names

from torchmesh import improve_files
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
