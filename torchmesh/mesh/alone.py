"""Meshes of a batch worked on one by one, to find those in which there is an error."""

from collections.abc import Callable

import torch
from torch import Tensor

from .batch import MeshBatch
from .ragged import spread


def errors_alone(batch: MeshBatch, work: Callable[[MeshBatch, Tensor], object]) -> dict[int, Exception]:
    """The errors that `work` raises for the meshes of the batch, by their rows.

    work  is called with each mesh alone and (V,) bool, its vertices in the batch

    The caller reports them as the status of their meshes: none is lost.
    """
    errors: dict[int, Exception] = {}
    for b in range(len(batch)):
        own = torch.arange(len(batch), device=batch.points.device) == b
        try:
            work(batch.select(own), spread(own, batch.point_offsets))
        except Exception as error:
            errors[b] = error
    return errors
