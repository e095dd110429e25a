"""Folders import from those below them only, in no circle; importing the package loads nothing heavy."""

import ast
import functools
import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import pytest

import torchmesh

PACKAGE = Path(torchmesh.__file__).parent

# What each folder may import besides itself, from the ground up.
ALLOWED = {
    "errors": "",
    "status": "",
    "kernels": "errors status",
    "mesh": "kernels errors status",
    "optimising": "mesh kernels errors status",
    "triangulating": "mesh kernels errors status",
    "transferring": "optimising triangulating mesh kernels errors status",
    "curving": "mesh kernels errors status",
    "files": "curving transferring mesh errors status",
    "layering": "mesh kernels errors status",
    "flipping": "optimising mesh kernels errors status",
    "untangling": "optimising triangulating mesh errors status",
    "warping": "optimising mesh kernels errors status",
    "diagnosing": "triangulating mesh errors status",
    "smoothing": "flipping optimising mesh errors status triangulating",
    "remeshing": "smoothing flipping untangling triangulating optimising mesh errors status",
    "improving": "remeshing smoothing flipping untangling warping diagnosing layering optimising mesh errors status",
    "learning": "improving remeshing smoothing flipping untangling warping diagnosing optimising triangulating files "
    "mesh errors status",
    "pictures": "improving files mesh errors status",
    "batches": "pictures learning improving remeshing smoothing files curving mesh errors status",
    "bench": "learning improving smoothing warping triangulating files mesh kernels errors status",
    "commands": "bench batches pictures learning improving remeshing smoothing flipping untangling warping diagnosing "
    "optimising triangulating files mesh kernels errors status",
    "__main__": "commands",
}


def name_of(path: Path) -> str:
    """mesh/batch.py is "mesh.batch", mesh/__init__.py "mesh"."""
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")


MODULES = sorted({name_of(path) for path in PACKAGE.rglob("*.py")} - {"__init__"})


@functools.cache
def imports_of(module: str) -> frozenset[str]:
    """The modules of the package that `module` imports, at its top or inside a function; "" is the package itself."""
    path = PACKAGE / (module.replace(".", "/") + ".py")
    path = path if path.exists() else PACKAGE / module.replace(".", "/") / "__init__.py"
    here = ["torchmesh", *path.relative_to(PACKAGE).parts[:-1]]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else []
            base = [*base, *(node.module or "").split(".")] if node.module else base
            names = [".".join([*base, alias.name]) for alias in node.names]
            found |= {n if n.removeprefix("torchmesh.") in MODULES else ".".join(base) for n in names}
    inside = {n for n in found if n.split(".")[0] == "torchmesh"}
    return frozenset(n.removeprefix("torchmesh").removeprefix(".") for n in inside)


def folder(module: str) -> str:
    return module.split(".")[0]


@pytest.mark.parametrize("module", MODULES)
def test_a_module_imports_from_lower_folders_only(module):
    assert folder(module) in ALLOWED, f"{module} has no floor: give its folder one in ALLOWED"
    allowed = {folder(module), *ALLOWED[folder(module)].split()}
    for name in imports_of(module):
        assert name, f"{module} imports the package itself, which is not below it"
        assert folder(name) in allowed, f"{module} imports {name}, which is not below it"


def test_what_a_folder_may_import_has_no_circle():
    seen: set[str] = set()
    for name, below in ALLOWED.items():
        assert set(below.split()) <= seen, name
        seen.add(name)


def test_modules_import_in_no_circle():
    below = {module: imports_of(module) & set(MODULES) for module in MODULES}
    while below:
        ground = {module for module, names in below.items() if not names & set(below)}
        assert ground, f"a circle among {sorted(below)}"
        below = {module: names for module, names in below.items() if module not in ground}


def test_every_folder_says_what_lives_there_and_what_it_imports():
    for name in ALLOWED:
        path = PACKAGE / name / "__init__.py"
        if path.parent.is_dir():
            text = ast.get_docstring(ast.parse(path.read_text()))
            assert text, name
            assert "mports from" in text, name


def test_only_folders_lie_at_the_top():
    assert {p.stem for p in PACKAGE.glob("*.py")} == {"__init__", "__main__", "errors", "status"}


def test_the_tests_that_are_said_to_be_slow_exist():
    folder = Path(__file__).parent
    names = [line for line in (folder / "slow.txt").read_text().splitlines() if not line.startswith("#")]
    assert len(names) > 100
    assert names == sorted(set(names))
    for name in names:
        module, _, test = name.partition("::")
        assert (folder / module).exists(), name
        assert not test or re.search(rf"^def {test}\(", (folder / module).read_text(), re.MULTILINE), name


def test_the_reader_of_imports_sees_them():
    assert {"mesh.connectivity", "errors", "mesh.ragged", "mesh.validation"} <= imports_of("mesh.batch")
    assert "commands.main" in imports_of("__main__")
    assert "remeshing.relocation" in {name for m in MODULES for name in imports_of(m) if folder(m) == "improving"}


@pytest.mark.parametrize("heavy", ["torch", "numpy", "scipy", "h5py", "matplotlib", "typer", "gmsh"])
def test_importing_the_package_does_not_import(heavy, loaded):
    assert heavy not in loaded


@pytest.fixture(scope="module")
def loaded() -> set[str]:
    """The top-level packages that `import torchmesh` brings into a fresh interpreter."""
    code = "import sys, torchmesh; print(*{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_the_names_that_are_loaded_late_are_those_that_a_type_checker_sees():
    seen, modules = {}, {}
    for node in ast.walk(ast.parse((PACKAGE / "__init__.py").read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            for alias in node.names:
                inside = f"{node.module}.{alias.name}" if node.module else alias.name
                (modules if inside in MODULES else seen)[alias.name] = inside if inside in MODULES else node.module
    assert seen == torchmesh._HOMES
    assert modules == torchmesh._MODULES
    assert {*seen, *modules} == set(torchmesh.__all__)


def test_a_name_that_is_none_of_the_package_is_an_attribute_error():
    assert not hasattr(torchmesh, "no_such_thing")
    assert not hasattr(torchmesh, "_HIDDEN")


# Each name is imported first of all, into an interpreter that knows torch but nothing of the package.
ONE_MODULE = """
import sys
finders = list(sys.meta_path)
for name, home in {names!r}.items():
    sys.meta_path[:] = finders
    for loaded in [n for n in sys.modules if n.split(".")[0] == "torchmesh"]:
        del sys.modules[loaded]
    exec(
        f"import torchmesh.{{name}}, torchmesh as tm; from torchmesh import {{name}}; "
        f"import torchmesh.{{home}} as home; "
        f"assert torchmesh.{{name}} is {{name}} is home is tm.{{name}}, name; "
        "assert home.__spec__.name == home.__name__",
        {{"name": name}},
    )
    print(name)
"""


# A notch pushed into a square, which averaging does not untangle.
FIRST_CALL = """
import sys, torch, torchmesh as tm
points = torch.cartesian_prod(torch.arange(25.0), torch.arange(25.0)).double()
points[(points[:, 1] == 0) & (points[:, 0] > 8) & (points[:, 0] < 16), 1] = 4
a = torch.cat([k + torch.arange(24) for k in range(0, 600, 25)])
faces = torch.cat([torch.stack([a, a + 25, a + 26], 1), torch.stack([a, a + 26, a + 1], 1)])
_, report = tm.improve(tm.MeshBatch.from_arrays(points, faces))
assert "untangle-beta" in [step.stage for step in report.check().steps[0]]
print(*{name.split('.')[0] for name in sys.modules})
"""


@pytest.fixture(scope="module")
def fresh() -> list[str]:
    """What a fresh interpreter prints: the packages that a first call loads, and then the modules found to be one."""
    code = FIRST_CALL + ONE_MODULE.format(names=torchmesh._MODULES)
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


def test_untangling_a_small_mesh_loads_nothing_heavy(fresh):
    loaded = fresh[0].split()
    assert "torch" in loaded
    assert {"scipy", "shapely"}.isdisjoint(loaded)


def test_a_public_module_is_one_module_wherever_it_lies(fresh):
    assert fresh[1:] == list(torchmesh._MODULES)


@pytest.mark.parametrize("name", sorted(torchmesh._MODULES))
def test_a_public_module_shows_its_public_names_only(name):
    module = getattr(torchmesh, name)
    assert dir(module) == sorted(module.__all__)
    assert not [public for public in module.__all__ if public.startswith("_") or not hasattr(module, public)]


def test_the_public_names_are_all_there():
    assert sorted(torchmesh.__all__) == sorted(set(torchmesh.__all__))
    for name in torchmesh.__all__:
        assert hasattr(torchmesh, name), name


def test_the_package_has_the_version_of_its_distribution():
    assert torchmesh.__version__ == importlib.metadata.version("torchmesh-untangle")
    assert not hasattr(torchmesh, "__versions__")
