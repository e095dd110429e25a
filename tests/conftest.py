"""Set-up shared by all tests: one thread, seeded generators, hypothesis without a clock."""

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, settings

torch.set_num_threads(1)

# Deadlines measure the machine, not the code; the same examples every run, so that a failure stays.
settings.register_profile(
    "torchmesh", deadline=None, max_examples=25, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("torchmesh")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20171210)


@pytest.fixture
def generator() -> torch.Generator:
    return torch.Generator().manual_seed(20171210)


@pytest.fixture
def inline(monkeypatch) -> None:
    """Runs over files work in this process: the start of another is saved where only the outcome matters."""
    from file_runs import Inline

    monkeypatch.setattr("torchmesh.batches.runs.LocalWorker", Inline)
