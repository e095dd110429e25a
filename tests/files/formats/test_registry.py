"""The table of formats: every extension leads to its format, and contents tell formats of one extension apart."""

import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from torchmesh import MeshIOError
from torchmesh.files.formats import registry
from torchmesh.files.formats.format import Document
from torchmesh.files.formats.meshio_formats import MeshioFormat
from torchmesh.files.formats.registry import FORMATS, format_in, format_of, known_extensions


def test_every_extension_leads_to_its_format():
    leads_to = {".msh": "gmsh", ".mesh": "medit"}  # the formats of extensions that several share
    extensions = [extension for form in FORMATS.values() for extension in form.extensions]
    assert sorted(extensions) == sorted([*known_extensions(), *leads_to])
    for name, form in FORMATS.items():
        for extension in form.extensions:
            assert format_of(Path(f"a{extension.upper()}")).name == leads_to.get(extension, name)
            assert format_of(Path(f"a{extension}"), Document(None, name)) is form  # as the file that is followed


def test_formats_are_loaded_when_they_are_needed():
    code = (
        "import sys, torchmesh; torchmesh.read\n"
        "loaded = {name.rpartition('.')[2] for name in sys.modules if 'files.formats.' in name}\n"
        "assert 'registry' in loaded and not loaded & {'exodus', 'abaqus', 'kratos', 'gmsh', 'su2', 'comsol'}, loaded"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_unknown_extension_is_told_with_the_known_ones():
    with pytest.raises(MeshIOError, match=r"a\.xyz: the extension '\.xyz' is not known; known ones are .*\.cgns$"):
        format_of(Path("a.xyz"))


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("a.vts", "a structured grid; save it as .vtu"),
        ("a.vtuu", "the nearest one is .vtu"),
        ("a.step", "a geometry; mesh it and save it as .msh"),
        ("a.h5", r"arrays that belong to an .xdmf file; give that \(a.xdmf\)"),
    ],
)
def test_the_nearest_format_that_would_do_is_named(tmp_path, name, hint):
    (tmp_path / "a.xdmf").touch()
    with pytest.raises(MeshIOError, match=f"is not known: {hint}; known ones are"):
        format_of(tmp_path / name)


@dataclass(frozen=True)
class Marked(MeshioFormat):
    """A format whose files begin with a mark."""

    def recognises(self, head: bytes) -> bool:
        return head.startswith(b"MARK")


@pytest.mark.parametrize(("text", "found"), [("MARK and more", "marked"), ("something else", "off")])
def test_contents_tell_formats_of_one_extension_apart(tmp_path, monkeypatch, text, found):
    marked = Marked("marked", (".off",))
    off = replace(FORMATS["off"])
    monkeypatch.setattr(registry, "FORMATS", {"marked": marked, "off": off})
    monkeypatch.setattr(registry, "_MODULES", dict.fromkeys(("marked", "off"), ("", (".off",))))
    (tmp_path / "a.off").write_text(text)
    assert format_in(tmp_path / "a.off").name == found
    assert format_of(tmp_path / "new.off") is marked  # a new file is written in the first one
