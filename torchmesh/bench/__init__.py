"""An open benchmark of tangled meshes: seeded cases, an exact judge, and methods that plug in.

    from torchmesh import bench

    @bench.method("mine")
    def mine(mesh):                     # a MeshBatch of one mesh
        return ...                      # another one: no inverted triangle, the same boundary

    torchmesh bench run --with mine.py --methods ours --families moved,jitter --limit 20 --out results

Imports from learning, improving, smoothing, warping, triangulating, files, mesh and kernels.  The names are loaded when
they are first used, so that a file with a method is read at once.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .answers import Missing, Refused, Result
    from .case import Case, Family
    from .catalogue import cases, families
    from .judging import Verdict, judge
    from .registry import METHODS, Method, builtin_methods, method
    from .running import RunOptions, run

_HOMES = {
    "families": "catalogue",
    "METHODS": "registry",
    "Case": "case",
    "Family": "case",
    "Method": "registry",
    "Missing": "answers",
    "Refused": "answers",
    "Result": "answers",
    "RunOptions": "running",
    "Verdict": "judging",
    "builtin_methods": "registry",
    "cases": "catalogue",
    "judge": "judging",
    "method": "registry",
    "run": "running",
}

__all__ = [
    "families",
    "METHODS",
    "Case",
    "Family",
    "Method",
    "Missing",
    "Refused",
    "Result",
    "RunOptions",
    "Verdict",
    "builtin_methods",
    "cases",
    "judge",
    "method",
    "run",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)


def __dir__() -> list[str]:
    return __all__
