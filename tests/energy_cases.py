"""Energies of every kind, by name, for the tests of the modules that work with them."""

import torch

from torchmesh.optimising.energies import InverseMeanRatio, Regularised, TotalLiftedContent, UntangleBeta

ENERGIES = {
    "imr": InverseMeanRatio(),
    "imr^1": InverseMeanRatio(1),
    "imr^3": InverseMeanRatio(3),
    "imr^8": InverseMeanRatio(8),
    "imr, ceiling": InverseMeanRatio(2, ceiling=1.5),
    "imr^3, ceiling": InverseMeanRatio(3, ceiling=1.5),
    "untangle-beta": UntangleBeta(0.3),
    "regularised": Regularised(0.5),
    "regularised, small eps": Regularised(1e-3),
    "lifted": TotalLiftedContent(0.1),
    "regularised, no area": Regularised(0.1, theta=0.0),
}


# Infinite for inverted triangles.
UPRIGHT_ONLY = {n for n, e in ENERGIES.items() if bool(e.value(torch.ones(1), -torch.ones(1)).isinf().all())}
