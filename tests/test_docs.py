"""The documentation: every code block of every page runs, its names exist, its figure is what the script draws."""

import importlib.util
import re
import shutil
import subprocess
import sys
from pathlib import Path

import documents
import pytest
from browser import chromium
from documents import blocks

import torchmesh
from experiments.paper import draw_loop

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))


@pytest.mark.parametrize(
    "page", [p for p in PAGES if any(b[0] in ("python", "sh") for b in blocks(p))], ids=lambda p: p.stem
)
def test_the_blocks_of_a_page_run(page, tmp_path, monkeypatch, inline):
    if "to_pyvista" in page.read_text():
        pytest.importorskip("pyvista")
    shutil.copy(ROOT / "torchmesh" / "data" / "bar.vtk", tmp_path / "undeformed.vtk")
    monkeypatch.chdir(tmp_path)
    documents.run(blocks(page))


def test_the_guides_are_there_and_every_block_has_a_language_that_runs_or_is_text():
    assert {p.stem for p in (DOCS / "guides").glob("*.md")} == {
        "untangle-a-file", "batches", "moving-meshes", "training",
    }  # fmt: skip
    for page in PAGES:
        assert {language for language, _ in blocks(page)} <= {"python", "sh", "text"}, page
    assert sum(len(blocks(page)) for page in PAGES) >= 20


def test_the_names_of_the_reference_exist():
    names = re.findall(r"^::: torchmesh\.([\w.]+)$", (DOCS / "api.md").read_text(), re.MULTILINE)
    assert set(torchmesh.__all__) - set(names) == {"nn"}, "which stands there as its classes"
    for name in names:
        value = torchmesh
        for part in name.split("."):
            value = getattr(value, part)
        assert value.__doc__, name


def test_the_figure_is_what_the_script_draws(tmp_path):
    draw_loop.main(["--out", str(tmp_path / "loop.svg")])
    assert (tmp_path / "loop.svg").read_text() == (DOCS / "loop.svg").read_text()


def of_docs(name: str):
    """A script of the folder docs as a module."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_on_the_architecture_has_the_folders_and_imports_that_the_tests_hold():
    text = (DOCS / "architecture.md").read_text(encoding="utf-8")
    assert of_docs("architecture").written(text) == text, "run python docs/architecture.py"
    for folder in (ROOT / "torchmesh").iterdir():
        if (folder / "__init__.py").exists():
            assert f"| `{folder.name}` |" in text


def test_the_way_of_the_data_names_what_there_is():
    text = (DOCS / "architecture.md").read_text(encoding="utf-8").split("## The way of the data")[1]
    named = re.findall(r"^ *(\w+) {3,}(improving/\w+\.py):", text, re.MULTILINE)
    assert len(named) >= 5
    for name, path in named:
        source = (ROOT / "torchmesh" / path).read_text(encoding="utf-8")
        assert re.search(rf"^(def|class) {name}\b", source, re.MULTILINE), (name, path)


@pytest.mark.parametrize("page", ["CONTRIBUTING.md", "docs/architecture.md", "docs/how-it-works.md"])
def test_every_path_that_a_page_names_exists(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    paths = re.findall(r"\b(?:torchmesh|tests|experiments|docs)/[\w./-]*[\w/]", text)
    assert len(paths) >= 40 or page != "CONTRIBUTING.md"
    assert not [path for path in paths if not (ROOT / path).exists()]


def test_every_make_target_that_is_named_exists():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"`make ([\w-]+)`", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


@pytest.fixture(scope="module")
def docstrings():
    pytest.importorskip("griffe")
    return of_docs("docstrings")


def test_columns_of_a_docstring_become_a_list(docstrings):
    text = "Sum.\n\npoints    (V, 2) float64, any\n          unit\nlow, high  (B,) limits\n\nRaises  nothing\nat all"
    assert docstrings.lists_of_columns(text) == (
        "Sum.\n\n- **points**: (V, 2) float64, any\n  unit\n- **low, high**: (B,) limits\n\n"
        "- **Raises**: nothing\n\nat all"
    )
    drawing = "A drawing:\n\n    a  --> b\n    c  --> d"
    assert docstrings.lists_of_columns(drawing) == drawing


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The documentation, built with warnings as errors."""
    pytest.importorskip("mkdocs")
    pytest.importorskip("material")
    pytest.importorskip("mkdocstrings")
    folder = tmp_path_factory.mktemp("docs") / "site"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", folder]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    return folder


def test_the_site_asks_no_other_server(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) >= len(PAGES)
    for page in pages:
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe)[^>]*\ssrc=\"?([^\s\">]+)", text)
        loaded += re.findall(r"<link[^>]*rel=\"?(?:stylesheet|icon|preconnect|preload)[^>]*href=\"?([^\s\">]+)", text)
        assert not [url for url in loaded if url.startswith(("http:", "https:", "//"))], page
    reference = (site / "api.html").read_text(encoding="utf-8")
    for name in ("torchmesh.improve", "torchmesh.MeshBatch", "torchmesh.report_page"):
        assert f'id="{name}"' in reference


def test_the_search_works_in_a_page_opened_from_a_file(site):
    with chromium() as browser:
        for width, scheme in ((390, "dark"), (1600, "light")):
            search(browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme), site, width)


def search(page, site: Path, width: int) -> None:
    """Searches for a word in a page that is as wide as said, and sees whether anything goes wrong."""
    trouble: list[str] = []
    page.on("pageerror", lambda error: trouble.append(str(error)))
    page.on("console", lambda message: trouble.append(message.text))
    page.goto((site / "guides" / "batches.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.evaluate("document.getElementById('__search').click()")
    page.locator(".md-search__input").press_sequentially("untangle", delay=30)
    page.wait_for_selector(".md-search-result__link")
    assert page.locator(".md-search-result__link").count() >= 3
    assert trouble == []
