"""The README's code blocks run; commands/test_reproduce.py compares its table with what is measured."""

import contextlib
import re
import shlex
from pathlib import Path

import documents
import pytest

from torchmesh.commands.main import main

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```$", README, re.DOTALL | re.MULTILINE)
INLINE = re.findall(r"`(torchmesh --?[^`]*|torchmesh \w+ [^`]*)`", README)


def test_everything_shown_runs_in_an_empty_folder(tmp_path, monkeypatch, inline):
    """In the order of the page, after the two commands; the first of them is the installation that runs here."""
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    assert [language for language, _ in BLOCKS] == ["sh", "sh", "python", "sh", "python"]
    install, *rest = BLOCKS[0][1].strip().splitlines()
    assert install.startswith("pip install '.[plot]'")
    assert [line.split("#")[0].strip() for line in rest] == ["torchmesh example"]
    ends = "\nassert torch.isfinite(points.grad).all() and points.grad.abs().max() > 0\n"
    assert "--count 64" in BLOCKS[3][1]
    # A batch of eight is taken, so no more meshes are needed.
    training = [("sh", BLOCKS[3][1].replace("--count 64", "--count 8")), ("python", BLOCKS[4][1] + ends)]
    documents.run([("sh", "\n".join(rest)), *BLOCKS[1:3], *training])
    for name in ("better.png", "better.vtu", "report.html", "film.gif", "results/more/gate.vtu"):
        assert (tmp_path / name).exists(), name


@pytest.mark.parametrize("line", INLINE)
def test_a_command_in_the_text_is_one(line, capsys):
    """Its command and its options exist."""
    words = shlex.split(line)[1:]
    command = [word for word in words[: 2 if words[0] == "bench" else 1] if not word.startswith("-")]
    with contextlib.suppress(SystemExit):  # as --version ends
        main([*command, "--help"])
    text = capsys.readouterr().out
    for option in (word for word in words if word.startswith("--")):
        assert option in text, line


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
