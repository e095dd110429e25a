"""torchmesh: untangle and improve planar triangle meshes, one or a hundred thousand at once."""

from .delaunay import FlipInfo, FlipOptions, flip_to_delaunay
from .errors import (
    ConvergenceError,
    InvalidMeshError,
    MeshError,
    MeshIOError,
    MeshWarning,
    MissingDependencyError,
)
from .mesh import MeshBatch, join
from .pipeline import ImproveOptions, Progress, Report, Step, improve
from .quality import Quality, minimum_angle, quality
from .smoothing import MoveInfo, SmoothOptions, smooth
from .status import Status
from .untangling import UntangleOptions, untangle
from .warping import femwarp, relax
