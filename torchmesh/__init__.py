"""torchmesh: untangle and improve planar triangle meshes, one or a hundred thousand at once."""

from . import metrics
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
from .io import read, write
from .mesh import MeshBatch, join
from .pipeline import ImproveOptions, Progress, Report, Step, improve
from .quality import Quality, minimum_angle, quality
from .smoothing import MoveInfo, SmoothOptions, smooth
from .status import Status
from .untangling import UntangleOptions, untangle
from .warping import femwarp, relax

__all__ = [
    "diagnose",
    "Problem",
    "ProblemKind",
    "read",
    "write",
    "ConvergenceError",
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
    "improve",
    "join",
    "metrics",
    "minimum_angle",
    "quality",
    "relax",
    "smooth",
    "untangle",
]
