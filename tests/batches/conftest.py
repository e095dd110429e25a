"""Folders of mesh files for runs over many files."""

import shutil
from pathlib import Path

import meshes
import pytest

from torchmesh import write


@pytest.fixture(scope="session")
def originals(tmp_path_factory) -> Path:
    """The files that `file_runs.NAMES` names."""
    folder = tmp_path_factory.mktemp("originals")
    for n, part in enumerate(("a", "b", "b/c")):
        (folder / part).mkdir(parents=True, exist_ok=True)
        write(folder / part / "x.vtu", meshes.jittered(seed=n))
        write(folder / part / "y.msh", meshes.jittered(6, 5, seed=n))
    return folder


@pytest.fixture
def inputs(originals, tmp_path) -> Path:
    """A copy of them, which may be changed."""
    shutil.copytree(originals, tmp_path / "in")
    return tmp_path / "in"
