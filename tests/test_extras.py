"""Every extra that a message, a page or another extra names is one that the package has."""

import re
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NAME = "torchmesh-untangle"
FOLDERS = ("torchmesh", "experiments", "docs")
TEXTS = [*ROOT.glob("*.md"), *(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.[mp][dy]"))]


def named(text: str) -> set[str]:
    """The extras in texts such as pip install '.[plot]', or the distribution's name with [bench,peers]."""
    found = re.findall(rf"(?:{NAME}|'\.|\"\.)\\*\[([\w,-]+)\\*\]", text)
    return {extra for names in found for extra in names.split(",")}


def test_extras_are_found_in_texts():
    assert named("pip install '.[plot]' or a[0] '.vtu'") == {"plot"}
    assert named(r"pip install 'torchmesh-untangle\\[bench,peers]'") == {"bench", "peers"}


@pytest.mark.parametrize("text", [p for p in TEXTS if named(p.read_text())], ids=lambda p: p.name)
def test_what_a_text_names_can_be_installed(text):
    assert named(text.read_text()) <= set(metadata.metadata(NAME).get_all("Provides-Extra"))


def test_what_an_extra_names_can_be_installed():
    required = "\n".join(metadata.requires(NAME))
    assert named(required), "some extras consist of others"
    assert named(required) <= set(metadata.metadata(NAME).get_all("Provides-Extra"))
