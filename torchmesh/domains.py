"""Meshes to try things on: our versions of the three domains of Kim 2017."""

from importlib import resources
from typing import Literal

import numpy as np
import torch

from .formats import load
from .io import read
from .mesh import MeshBatch
from .warping import femwarp


def moving(name: Literal["circle", "bar", "gate"]) -> tuple[MeshBatch, MeshBatch]:
    """One of the paper's domains: its undeformed mesh, and that mesh after its boundary moved (FEMWARP).

    "circle" is a small hole in a long rectangle, moved by four of its diameters; "bar" a thin
    upright hole, moved; "gate" a notch in the outer boundary, pushed in.  The paper shows pictures
    only: the dimensions are ours (experiments/make_paper_meshes.py).
    """
    with resources.as_file(resources.files(__package__) / "data" / f"{name}.vtk") as path:
        mesh = read(path)
        displacement = np.asarray(load(path).mesh.point_data["displacement"], dtype=np.float64)[:, :2]
    return mesh, femwarp(mesh, mesh.points + torch.from_numpy(displacement).to(mesh.points))
