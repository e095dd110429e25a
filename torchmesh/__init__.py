"""torchmesh: untangle and improve planar triangle meshes, one or a hundred thousand at once."""

import importlib
from typing import TYPE_CHECKING, Any

from .quality import Quality, minimum_angle, quality

if TYPE_CHECKING:
    from . import datasets, domains, losses, metrics, nn
    from .animation import animate
    from .deformation import DeformOptions, DeformReport, deform
    from .delaunay import FlipInfo, FlipOptions, flip_to_delaunay
    from .diagnosis import Problem, ProblemKind, diagnose
    from .errors import ConvergenceError, InvalidMeshError, MeshError, MeshIOError, MeshWarning, MissingDependencyError
    from .files import improve_files
    from .genealogy import VertexMap
    from .io import held, read, write
    from .manifest import FileResult
    from .mesh import MeshBatch, join
    from .options import ImproveOptions
    from .page import report_page
    from .paths import largest_step
    from .pipeline import improve
    from .polishing import PolishInfo, PolishOptions, polish
    from .pyg import from_pyg, to_pyg
    from .pyvista_export import to_pyvista
    from .remesh_options import RemeshOptions
    from .remeshing import RemeshInfo, remesh
    from .report import Progress, Report, Step
    from .series import Series, read_series, write_series
    from .sizing import SizeConformity, size_conformity, size_field
    from .smoothing import MoveInfo, SmoothOptions, smooth
    from .status import Status
    from .storage import BatchFile, BatchWriter, load_batch, load_fields, save_batch
    from .targets import MetricField, metric_from, target_from, target_quality
    from .untangling import UntangleOptions, untangle
    from .warping import femwarp, relax

# Loaded when first asked for: a program pays for what it uses.  `quality` is here from the start, since the import
# of the module of the same name, by whichever other module, would put that in its place.
_NAMES = {
    "animation": "animate",
    "deformation": "DeformOptions DeformReport deform",
    "delaunay": "FlipInfo FlipOptions flip_to_delaunay",
    "diagnosis": "Problem ProblemKind diagnose",
    "errors": "ConvergenceError InvalidMeshError MeshError MeshIOError MeshWarning MissingDependencyError",
    "files": "improve_files",
    "genealogy": "VertexMap",
    "io": "held read write",
    "manifest": "FileResult",
    "mesh": "MeshBatch join",
    "options": "ImproveOptions",
    "page": "report_page",
    "paths": "largest_step",
    "pipeline": "improve",
    "polishing": "PolishInfo PolishOptions polish",
    "pyg": "from_pyg to_pyg",
    "pyvista_export": "to_pyvista",
    "remesh_options": "RemeshOptions",
    "remeshing": "RemeshInfo remesh",
    "report": "Progress Report Step",
    "series": "Series read_series write_series",
    "sizing": "SizeConformity size_conformity size_field",
    "smoothing": "MoveInfo SmoothOptions smooth",
    "status": "Status",
    "storage": "BatchFile BatchWriter load_batch load_fields save_batch",
    "targets": "MetricField metric_from target_from target_quality",
    "untangling": "UntangleOptions untangle",
    "warping": "femwarp relax",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        value = globals()[name] = getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)
        return value
    if not name.startswith("_"):
        try:
            return importlib.import_module(f".{name}", __name__)
        except ModuleNotFoundError as error:
            if error.name != f"{__name__}.{name}":
                raise
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
