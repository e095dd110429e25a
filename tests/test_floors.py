"""Modules import from lower floors only, and importing the package loads nothing heavy but torch and numpy."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import torchmesh

PACKAGE = Path(torchmesh.__file__).parent

# From the ground up; a module may import from the lines above its own.
FLOORS = [
    # 0
    ["segments", "triangle", "predicates", "status", "errors"],
    # 1
    ["connectivity", "energies", "stiffness", "lbfgs", "sharding"],
    ["flipping", "packing", "insertion", "hessian", "editing"],
    ["polygons", "obstructions", "slits", "rails", "collapsing", "splitting"],
    ["meshing"],
    ["families"],
    ["validation"],
    # 2
    ["mesh"],
    # 3
    ["quality"],
    ["targets"],
    ["delaunay", "metrics", "pockets", "diagnosis", "paths", "genealogy", "sizing"],
    ["warping", "unscrambling", "pyg", "sliding", "anisotropy", "patches"],
    ["smoothing"],
    ["untangling", "remesh_options", "polishing"],
    ["remeshing", "certificate"],
    ["surgery"],
    ["relocation"],
    ["gathering"],
    ["report"],
    ["losses", "excerpts"],
    # 4
    ["options"],
    ["job"],
    ["pipeline"],
    ["formats_gmsh", "formats_text"],
    ["formats_gmsh_write"],
    ["formats"],
    ["file_content"],
    ["plotting", "io", "charts", "page_data"],
    ["domains", "nn", "storage", "console", "deformation", "page", "animation", "pyvista_export"],
    ["reproduction", "datasets", "motions"],
    ["manifest", "choices"],
    ["series"],
    ["batching"],
    ["workers"],
    ["files"],
    ["command_batch", "command_generate", "command_report"],
    # 5
    ["cli"],
    ["__init__", "__main__"],
]

MODULES = sorted(path.stem for path in PACKAGE.glob("*.py"))


def floor_of(module: str) -> int | None:
    return next((height for height, names in enumerate(FLOORS) if module in names), None)


def imports_of(module: str) -> set[str]:
    """The modules of the package that `module` imports, at its top or inside a function."""
    found = set()
    for node in ast.walk(ast.parse((PACKAGE / f"{module}.py").read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            found |= {node.module.split(".")[0]} if node.module else {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "torchmesh":
            path = node.module.split(".")
            found |= {path[1]} if len(path) > 1 else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("torchmesh.")}
    # `from . import __version__` and the like name the package itself.
    return {name if name in MODULES else "__init__" for name in found}


@pytest.mark.parametrize("module", MODULES)
def test_a_module_imports_from_below_only(module):
    height = floor_of(module)
    assert height is not None, f"{module}.py has no floor: give it one in FLOORS"
    for name in imports_of(module) - {"__init__"}:
        assert floor_of(name) is not None
        assert floor_of(name) < height, f"{module}.py imports {name}.py, which is not below it"


@pytest.mark.parametrize("module", [m for m in MODULES if m not in ("__main__", "cli")])
def test_only_the_top_imports_the_package_itself(module):
    assert "__init__" not in imports_of(module)


def test_bare_tensor_floors_know_no_mesh_type():
    for module in MODULES:
        if (floor_of(module) or 0) < floor_of("mesh"):
            assert "MeshBatch" not in (PACKAGE / f"{module}.py").read_text(), module


def test_the_reader_of_imports_sees_them():
    assert {"connectivity", "errors", "segments", "validation"} <= imports_of("mesh")
    assert "pipeline" in imports_of("__init__")


@pytest.mark.parametrize("heavy", ["scipy", "h5py", "matplotlib", "typer", "gmsh"])
def test_importing_the_package_does_not_import(heavy, loaded):
    assert heavy not in loaded


@pytest.fixture(scope="module")
def loaded() -> set[str]:
    """The top-level packages that `import torchmesh` brings into a fresh interpreter."""
    code = "import sys, torchmesh; print(*{name.split('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


def test_the_names_that_are_loaded_late_are_those_that_a_type_checker_sees():
    seen = {}
    for node in ast.walk(ast.parse((PACKAGE / "__init__.py").read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.level:
            seen |= {alias.name: node.module for alias in node.names}
    late = {name: module for name, module in seen.items() if module != "quality"}
    assert late == torchmesh._HOMES


def test_a_name_that_is_none_of_the_package_is_an_attribute_error():
    assert not hasattr(torchmesh, "no_such_thing")
    assert torchmesh.connectivity.__name__ == "torchmesh.connectivity"


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


def test_untangling_a_small_mesh_loads_nothing_heavy():
    done = subprocess.run([sys.executable, "-c", FIRST_CALL], capture_output=True, text=True, check=True)
    assert {"scipy", "shapely"}.isdisjoint(done.stdout.split())


def test_the_public_names_are_all_there():
    assert sorted(torchmesh.__all__) == sorted(set(torchmesh.__all__))
    for name in torchmesh.__all__:
        assert hasattr(torchmesh, name), name
