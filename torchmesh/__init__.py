"""torchmesh: untangle and improve planar triangle meshes, one or a hundred thousand at once."""

import importlib
from typing import TYPE_CHECKING, Any

from . import metrics
from .deformation import DeformOptions, DeformReport, deform
from .delaunay import FlipInfo, FlipOptions, flip_to_delaunay
from .diagnosis import Problem, ProblemKind, diagnose
from .errors import (
    ConvergenceError,
    InvalidMeshError,
    MeshError,
    MeshIOError,
    MeshWarning,
    MissingDependencyError,
)
from .genealogy import VertexMap
from .mesh import MeshBatch, join
from .options import ImproveOptions
from .paths import largest_step
from .pipeline import improve
from .polishing import PolishInfo, PolishOptions, polish
from .quality import Quality, minimum_angle, quality
from .remeshing import RemeshInfo, RemeshOptions, remesh
from .report import Progress, Report, Step
from .sizing import SizeConformity, size_conformity, size_field
from .smoothing import MoveInfo, SmoothOptions, smooth
from .status import Status
from .targets import MetricField, metric_from, target_from, target_quality
from .untangling import UntangleOptions, untangle
from .warping import femwarp, relax

if TYPE_CHECKING:
    from . import datasets, domains, losses, nn
    from .animation import animate
    from .files import improve_files
    from .io import held, read, write
    from .manifest import FileResult
    from .page import report_page
    from .pyg import from_pyg, to_pyg
    from .pyvista_export import to_pyvista
    from .series import Series, read_series, write_series
    from .storage import BatchFile, BatchWriter, load_batch, load_fields, save_batch

# Loaded when first asked for: they import more than torch and numpy, or are of use to few.
_LAZY_MODULES = ("datasets", "domains", "losses", "nn")
_LAZY_NAMES = {
    "animate": "animation",
    "from_pyg": "pyg",
    "report_page": "page",
    "to_pyg": "pyg",
    "to_pyvista": "pyvista_export",
    "improve_files": "files",
    "FileResult": "manifest",
    "held": "io",
    "read": "io",
    "write": "io",
    "read_series": "series",
    "Series": "series",
    "write_series": "series",
    "BatchFile": "storage",
    "BatchWriter": "storage",
    "load_batch": "storage",
    "load_fields": "storage",
    "save_batch": "storage",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY_MODULES:
        return importlib.import_module(f".{name}", __name__)
    if name in _LAZY_NAMES:
        return getattr(importlib.import_module(f".{_LAZY_NAMES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


__all__ = [
    "animate",
    "BatchFile",
    "BatchWriter",
    "datasets",
    "domains",
    "from_pyg",
    "load_batch",
    "load_fields",
    "losses",
    "nn",
    "save_batch",
    "to_pyg",
    "to_pyvista",
    "deform",
    "DeformOptions",
    "DeformReport",
    "largest_step",
    "diagnose",
    "Problem",
    "ProblemKind",
    "read",
    "read_series",
    "Series",
    "write_series",
    "write",
    "ConvergenceError",
    "FileResult",
    "FlipInfo",
    "FlipOptions",
    "ImproveOptions",
    "InvalidMeshError",
    "MeshBatch",
    "MeshError",
    "MeshIOError",
    "MeshWarning",
    "MetricField",
    "MissingDependencyError",
    "MoveInfo",
    "Progress",
    "Quality",
    "Report",
    "SmoothOptions",
    "Status",
    "Step",
    "UntangleOptions",
    "femwarp",
    "flip_to_delaunay",
    "held",
    "improve",
    "improve_files",
    "join",
    "metric_from",
    "metrics",
    "minimum_angle",
    "polish",
    "PolishInfo",
    "PolishOptions",
    "quality",
    "relax",
    "remesh",
    "RemeshInfo",
    "RemeshOptions",
    "size_conformity",
    "size_field",
    "SizeConformity",
    "VertexMap",
    "report_page",
    "smooth",
    "target_from",
    "target_quality",
    "untangle",
]
