"""mouette's WinslowInjectiveEmbedding."""

from __future__ import annotations

import warnings

import numpy as np
import torch

from ...mesh import connectivity
from ..answers import Refused
from ..stopwatch import Seconds, Stopwatch
from .outcome import Outcome, need

Array = np.ndarray


def mouette(points: Array, triangles: Array, fixed: Array) -> Outcome:
    """mouette's WinslowInjectiveEmbedding (Garanzha et al. 2021), which takes discs only."""
    need("mouette")
    import mouette as M

    faces = torch.from_numpy(triangles)
    euler = len(points) - len(connectivity.edges(faces, connectivity.twins(faces))) + len(triangles)
    if euler != 1:
        raise Refused("refused: not a disc")

    def run(at: Array, faces: Array) -> tuple[Array, Seconds]:
        data = M.mesh.RawMeshData()
        data.vertices += list(np.pad(at, ((0, 0), (0, 1))))
        data.faces += [tuple(row) for row in faces.tolist()]
        surface = M.mesh.SurfaceMesh(data)
        # Each triangle has an equilateral reference, as with the other tools.
        ideal = np.linalg.inv(np.array([[1.0, 0.5], [0.0, np.sqrt(3) / 2]]))
        solver = M.parametrization.WinslowInjectiveEmbedding(
            surface, at, ref_jacs=np.tile(ideal, (len(faces), 1, 1)), verbose=False
        )
        with warnings.catch_warnings(), Stopwatch() as watch:
            # It gives SciPy options that SciPy 1.17 no longer likes.
            warnings.simplefilter("ignore", DeprecationWarning)
            solver.run()
        return np.array([solver.uvs[v] for v in surface.id_vertices]), watch.seconds

    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.4, 0.6]])
    run(square, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]))  # the first call lets numba compile
    moved, seconds = run(points, triangles)
    return Outcome(np.where(fixed[:, None], points, moved), triangles, seconds, "two threads")
