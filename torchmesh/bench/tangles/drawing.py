"""What the families share: meshing an outline, and the check that a moved boundary is simple."""

import itertools
import math

import numpy as np
import torch
from torch import Tensor

from ...mesh.batch import MeshBatch
from ...mesh.measure import quality
from ...smoothing.smoothing import SmoothOptions, smooth
from ...triangulating.mesher import MeshingError, Outline, mesh_outline
from ...triangulating.polygon import why_not_simple

# Undeformed meshes have no triangle above this inverse mean ratio.
MAX_WORST = 4.0

# The numbers of triangles that are drawn, evenly on a logarithmic scale.
FEWEST, MOST = 150, 1200


def size(rng: np.random.Generator) -> int:
    """How many triangles the mesh shall have, about."""
    return round(math.exp(rng.uniform(math.log(FEWEST), math.log(MOST))))


def meshed(outline: Outline, triangles: int, rng: np.random.Generator) -> tuple[MeshBatch, np.ndarray] | None:
    """A smooth valid mesh of the outline, and (Nb,) the loop of each of its first Nb vertices, those on the outline.

    None if the outline cannot be meshed well with so few triangles.
    """
    try:
        points, corners, loop = mesh_outline(outline, triangles, rng)
    except MeshingError:
        return None
    mesh, _ = smooth(MeshBatch.from_arrays(points, corners), SmoothOptions(ceiling=1.5, max_iterations=20))
    measured = quality(mesh)
    return (mesh, loop) if int(measured.inverted) == 0 and float(measured.max) <= MAX_WORST else None


def is_simple(points: Tensor, loop: np.ndarray) -> bool:
    """Whether the boundary, whose vertices come first and are told apart by `loop` (Nb,), bounds one domain."""
    ends = np.flatnonzero(np.diff(loop, prepend=-1, append=-2)).tolist()
    return why_not_simple(points.numpy(), [np.arange(a, b) for a, b in itertools.pairwise(ends)]) is None


def turn(degrees: float) -> Tensor:
    """(2, 2) the matrix that turns rows of points counter-clockwise."""
    a = math.radians(degrees)
    return torch.tensor([[math.cos(a), math.sin(a)], [-math.sin(a), math.cos(a)]], dtype=torch.float64)


def ellipse(aspect: float, count: int = 48) -> np.ndarray:
    """(count, 2) an ellipse about the origin, one unit long and 1 / aspect high, clockwise as holes are."""
    angle = -2 * np.pi * np.arange(count) / count
    return np.stack([0.5 * np.cos(angle), 0.5 / aspect * np.sin(angle)], 1)
