"""torchmesh: untangle and improve planar triangle meshes, one or a hundred thousand at once.

The folders are the algorithm, from the ground up; a folder imports from those above it in this list only:

    mesh            what a mesh is: arrays, connectivity, exact signs, measures of quality
    optimising      energies and the minimiser            triangulating  exact triangulation of polygons
    transferring    values of one mesh for another        files          reading and writing meshes
    flipping        step 1 of Kim 2017: edges             untangling     step 2: inverted triangles
    warping         moving a boundary                     diagnosing     can a valid mesh exist
    smoothing       step 3: shapes
    remeshing       vertices that come, go and travel
    improving       the whole job, and how it is put together from the steps
    learning        losses, layers and data for networks  pictures       plots, films, the report page
    batches         files by the thousand                 bench          a benchmark of tangled meshes
    commands        the command line
"""

import gc
import importlib
import importlib.machinery
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str

    from . import bench
    from .batches.manifest import FileResult
    from .batches.runs import improve_files
    from .diagnosing.diagnosis import Problem, ProblemKind, diagnose
    from .errors import ConvergenceError, InvalidMeshError, MeshError, MeshIOError, MeshWarning, MissingDependencyError
    from .files.hdf5 import BatchWriter, load_batch, load_fields, save_batch
    from .files.hdf5_reading import BatchFile
    from .files.mesh_files import held, read, write
    from .files.pyg import from_pyg, to_pyg
    from .files.pyvista import to_pyvista
    from .files.time_series import Series, read_series, write_series
    from .flipping.delaunay import FlipInfo, FlipOptions, flip_to_delaunay
    from .improving.deform_options import DeformOptions
    from .improving.deform_report import DeformReport
    from .improving.deformation import deform
    from .improving.options import ImproveOptions
    from .improving.pipeline import improve
    from .improving.report import Progress, Report, Step
    from .improving.step_options import Bound
    from .improving.trail import Piece, rewired
    from .learning import datasets, domains, losses, nn
    from .mesh import metrics
    from .mesh.batch import MeshBatch, join
    from .mesh.clean_log import CleanLog
    from .mesh.cleaning import clean
    from .mesh.measure import Quality, minimum_angle, quality
    from .mesh.vertex_map import VertexMap
    from .optimising.metric_field import MetricField
    from .optimising.moves import MoveInfo
    from .optimising.targets import metric_from, target_from, target_quality
    from .pictures.films import animate
    from .pictures.page import report_page
    from .remeshing.options import RemeshOptions
    from .remeshing.remeshing import RemeshInfo, remesh
    from .remeshing.sizing import SizeConformity, size_conformity, size_field
    from .smoothing.polishing import PolishInfo, PolishOptions, polish
    from .smoothing.smoothing import SmoothOptions, smooth
    from .status import Status
    from .transferring.transfer import TransferInfo, transfer, transfer_matrix
    from .untangling.enough_flips import EnoughFlips, enough_flips
    from .untangling.options import NewtonWays, UntangleOptions
    from .untangling.untangling import untangle
    from .warping.boundary_path import largest_step
    from .warping.femwarp import femwarp, relax
    from .warping.step_bound import courant_step

# A module is imported when one of its names is first used, so that a program pays only for what it uses.
_NAMES = {
    "batches.manifest": "FileResult",
    "batches.runs": "improve_files",
    "diagnosing.diagnosis": "Problem ProblemKind diagnose",
    "errors": "ConvergenceError InvalidMeshError MeshError MeshIOError MeshWarning MissingDependencyError",
    "files.hdf5": "BatchWriter load_batch load_fields save_batch",
    "files.hdf5_reading": "BatchFile",
    "files.mesh_files": "held read write",
    "files.pyg": "from_pyg to_pyg",
    "files.pyvista": "to_pyvista",
    "files.time_series": "Series read_series write_series",
    "flipping.delaunay": "FlipInfo FlipOptions flip_to_delaunay",
    "improving.deform_options": "DeformOptions",
    "improving.deform_report": "DeformReport",
    "improving.deformation": "deform",
    "improving.options": "ImproveOptions",
    "improving.step_options": "Bound",
    "improving.pipeline": "improve",
    "improving.report": "Progress Report Step",
    "improving.trail": "Piece rewired",
    "mesh.batch": "MeshBatch join",
    "mesh.clean_log": "CleanLog",
    "mesh.cleaning": "clean",
    "mesh.measure": "Quality minimum_angle quality",
    "mesh.vertex_map": "VertexMap",
    "optimising.metric_field": "MetricField",
    "optimising.moves": "MoveInfo",
    "optimising.targets": "metric_from target_from target_quality",
    "pictures.films": "animate",
    "pictures.page": "report_page",
    "remeshing.options": "RemeshOptions",
    "remeshing.remeshing": "RemeshInfo remesh",
    "remeshing.sizing": "SizeConformity size_conformity size_field",
    "smoothing.polishing": "PolishInfo PolishOptions polish",
    "smoothing.smoothing": "SmoothOptions smooth",
    "status": "Status",
    "transferring.transfer": "TransferInfo transfer transfer_matrix",
    "untangling.enough_flips": "EnoughFlips enough_flips",
    "untangling.options": "NewtonWays UntangleOptions",
    "untangling.untangling": "untangle",
    "warping.boundary_path": "largest_step",
    "warping.femwarp": "femwarp relax",
    "warping.step_bound": "courant_step",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

# Public modules, known as torchmesh.nn and so on wherever they lie.
_MODULES = {
    "bench": "bench",
    "datasets": "learning.datasets",
    "domains": "learning.domains",
    "losses": "learning.losses",
    "metrics": "mesh.metrics",
    "nn": "learning.nn",
}


class _PublicModules:
    """Lets `import torchmesh.nn` and `from torchmesh.nn import Untangle` find the module in its folder.

    This is a finder and a loader of the import system, without their base classes, which take 20 ms to import.
    """

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        package, _, name = fullname.rpartition(".")
        loader: Any = self
        return importlib.machinery.ModuleSpec(fullname, loader) if package == __name__ and name in _MODULES else None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> "ModuleType":
        module = importlib.import_module(f".{_MODULES[spec.name.rpartition('.')[2]]}", __name__)
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: "ModuleType") -> None:
        # The import system has just put the alias in the place of the module's own specification.
        assert module.__spec__ is not None
        module.__spec__ = module.__spec__.loader_state


sys.meta_path.append(_PublicModules())


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        value = getattr(_loaded(_HOMES[name]), name)
    elif name in _MODULES:
        value = _loaded(_MODULES[name])
    elif name == "__version__":
        value = _version()
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def _version() -> str:
    """The version of the installed package; AttributeError where the files lie in a folder without being installed."""
    from importlib import metadata

    try:
        return metadata.version("torchmesh-untangle")
    except metadata.PackageNotFoundError as error:
        raise AttributeError(f"module {__name__!r} has no version: {error.name} is not installed") from None


def _loaded(module: str) -> ModuleType:
    """A module of this package.

    What a module makes while it is loaded is there to stay.  To look through all of it, and all that torch has made,
    for garbage would take longer than the loading itself.
    """
    collects = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(f".{module}", __name__)
    finally:
        if collects:
            gc.enable()


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


__all__ = [
    "BatchFile",
    "BatchWriter",
    "Bound",
    "CleanLog",
    "ConvergenceError",
    "DeformOptions",
    "DeformReport",
    "EnoughFlips",
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
    "NewtonWays",
    "Piece",
    "PolishInfo",
    "PolishOptions",
    "Problem",
    "ProblemKind",
    "Progress",
    "Quality",
    "RemeshInfo",
    "RemeshOptions",
    "Report",
    "Series",
    "SizeConformity",
    "SmoothOptions",
    "Status",
    "Step",
    "TransferInfo",
    "UntangleOptions",
    "VertexMap",
    "animate",
    "bench",
    "clean",
    "courant_step",
    "datasets",
    "deform",
    "diagnose",
    "enough_flips",
    "domains",
    "femwarp",
    "flip_to_delaunay",
    "from_pyg",
    "held",
    "improve",
    "improve_files",
    "join",
    "largest_step",
    "load_batch",
    "load_fields",
    "losses",
    "metric_from",
    "metrics",
    "minimum_angle",
    "nn",
    "polish",
    "quality",
    "read",
    "read_series",
    "relax",
    "remesh",
    "report_page",
    "rewired",
    "save_batch",
    "size_conformity",
    "size_field",
    "smooth",
    "target_from",
    "target_quality",
    "to_pyg",
    "to_pyvista",
    "transfer",
    "transfer_matrix",
    "untangle",
    "write",
    "write_series",
]
