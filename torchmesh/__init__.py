"""torchmesh: untangle and improve planar triangle meshes, one or a hundred thousand at once."""

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
from .files import improve_files
from .io import held, read, write
from .manifest import FileResult
from .mesh import MeshBatch, join
from .paths import largest_step
from .pipeline import ImproveOptions, Progress, Report, Step, improve
from .quality import Quality, minimum_angle, quality
from .smoothing import MoveInfo, SmoothOptions, smooth
from .status import Status
from .untangling import UntangleOptions, untangle
from .warping import femwarp, relax

__all__ = [
    "deform",
    "DeformOptions",
    "DeformReport",
    "largest_step",
    "diagnose",
    "Problem",
    "ProblemKind",
    "read",
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
    "metrics",
    "minimum_angle",
    "quality",
    "relax",
    "smooth",
    "untangle",
]
