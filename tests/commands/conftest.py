"""A folder of files for each test of the command line, and the command line called in this process."""

import shutil
from pathlib import Path

import pytest
from command_line import Call, Outcome, write_bad, write_examples

from torchmesh.commands.main import main


@pytest.fixture(scope="session")
def originals(tmp_path_factory) -> Path:
    """The files of the examples in the help texts, and some that are bad."""
    folder = tmp_path_factory.mktemp("files")
    write_examples(folder)
    write_bad(folder)
    return folder


@pytest.fixture
def folder(originals, tmp_path) -> Path:
    """A copy of those files."""
    shutil.copytree(originals, tmp_path / "work")
    return tmp_path / "work"


@pytest.fixture
def call(capsys, monkeypatch, folder) -> Call:
    """The command line in this process and in `folder`, without the cost of starting another process."""
    monkeypatch.chdir(folder)

    def run(*arguments: object) -> Outcome:
        capsys.readouterr()
        status = main([*map(str, arguments)])
        said = capsys.readouterr()
        return Outcome(status, said.out, said.err)

    return run
