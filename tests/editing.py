"""Meshes in the form in which splits and collapses change them, for several tests."""

import meshes
import torch

from torchmesh import MeshBatch
from torchmesh.mesh import connectivity
from torchmesh.remeshing.mutable import Editable
from torchmesh.remeshing.state import RemeshState, editable, rebuilt

VALID = {**meshes.VALID, "jittered": lambda: meshes.jittered(8, 7, 0.12, 0)}


def state_of(mesh: MeshBatch, size: float | torch.Tensor = 0.1) -> RemeshState:
    """The mesh before remeshing, with one size wanted everywhere, or (V,) sizes."""
    field = torch.as_tensor(size, dtype=torch.float64).expand(len(mesh.points)).clone()
    return RemeshState.begin(mesh, field)


def editing(mesh: MeshBatch, size: float | torch.Tensor = 0.1) -> Editable:
    """The mesh, opened for splits and collapses."""
    return editable(state_of(mesh, size))


def finished(mesh: MeshBatch, e: Editable) -> MeshBatch:
    """The mesh that `e`, which was made of `mesh`, has become."""
    return rebuilt(state_of(mesh), e).batch


def random_valid(seed: int) -> MeshBatch:
    """One of five kinds of valid meshes."""
    makers = [
        lambda: meshes.scrambled(meshes.delaunay(30, seed), seed, 40),
        lambda: meshes.jittered(5, 6, 0.1, seed),
        lambda: meshes.l_shape(2 + seed % 3),
        lambda: meshes.ring(7 + seed % 9, 2 + seed % 3),
        lambda: meshes.scrambled(meshes.disc(8 + seed % 5, 3), seed, 30),
    ]
    return makers[seed % 5]()


def assert_twins(e: Editable) -> None:
    """The twins that were kept up to date are those that sorting the edges finds."""
    alive = (e.vertex.reshape(-1, 3)[:, 0] >= 0).nonzero().squeeze(1)
    rows = torch.full((len(e.vertex) // 3,), -1)
    rows[alive] = torch.arange(len(alive))
    kept = e.twin.reshape(-1, 3)[alive].reshape(-1)
    renumbered = torch.where(kept >= 0, 3 * rows[kept.clamp_min(0) // 3] + kept % 3, -1)
    assert torch.equal(renumbered, connectivity.twins(e.triangles[alive]))
