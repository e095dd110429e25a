"""Flips by a metric field lower its energy, keep triangles upright, and end."""

import meshes
import numpy as np
import torch
from exact import inverted

from torchmesh import MetricField, flip_to_delaunay, target_quality


def test_flips_by_a_metric_never_raise_the_energy_and_end():
    mesh = meshes.scrambled(meshes.delaunay(80, 9), 2)
    values = torch.from_numpy(np.random.default_rng(1).normal(size=(80, 2, 2)))
    metric = MetricField(values @ values.mT + 0.01 * torch.eye(2))
    flipped, info = flip_to_delaunay(mesh, metric=metric)
    assert info.flips.item() > 10
    assert inverted(flipped) == 0
    energies = [target_quality(m, metric).square().sum().item() for m in (mesh, flipped)]
    assert energies[1] < energies[0]
    _, info = flip_to_delaunay(flipped, metric=metric)
    assert info.flips.item() == 0
