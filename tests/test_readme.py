"""The README's code blocks run; commands/test_reproduce.py compares its table with what is measured."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import documents
import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"<!-- test: files -->\n```(\w+)\n(.*?)```", README, re.DOTALL)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    shutil.copy(ROOT / "torchmesh" / "data" / "bar.vtk", tmp_path / "undeformed.vtk")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("language", "code"), BLOCKS, ids=[language for language, _ in BLOCKS])
def test_code_block_runs(language, code, folder):
    if language == "python":
        subprocess.run([sys.executable, "-c", code], check=True, timeout=120)
        assert (folder / "better.vtu").exists()
    else:
        # The third line measures a tangled file too, and says so by its exit status.
        for line, expected in zip(code.strip().splitlines(), (0, 0, 1, 0), strict=True):
            documents.run_line(line, expected)
        assert (folder / "better.png").exists()


def test_training_blocks_run(folder):
    blocks = re.findall(r"<!-- test: training -->\n```(\w+)\n(.*?)```", README, re.DOTALL)
    assert [language for language, _ in blocks] == ["sh", "python"]
    (_, command), (_, code) = blocks
    assert "--count 64" in command
    ends = "\nassert torch.isfinite(points.grad).all() and points.grad.abs().max() > 0\n"
    # A batch of eight is taken, so no more meshes are needed.
    documents.run([("sh", command.replace("--count 64", "--count 8")), ("python", code + ends)])


def test_both_languages_are_shown():
    assert [language for language, _ in BLOCKS] == ["sh", "python"]


def test_every_command_and_name_exists():
    import torchmesh

    for names in re.findall(r"^\| `([^|]*)` \|", README, re.MULTILINE):
        for name in re.findall(r"\b[A-Za-z_]\w*(?=\(|`|$|\.)", names):
            assert hasattr(torchmesh, name) or hasattr(torchmesh.MeshBatch, name), name


def test_table_of_formats_is_what_the_formats_keep():
    pytest.importorskip("netCDF4")
    from experiments.files import format_table

    shown = README.split("<!-- the table of experiments/files/format_table.py -->\n")[1].split("\n\n")[0]
    assert shown == format_table.table()
