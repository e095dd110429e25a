"""Set-up shared by all tests: one thread, seeded generators, hypothesis without a clock; which modules are slow."""

from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, settings

from torchmesh.kernels import library

torch.set_num_threads(1)

# Modules that `make test-fast` leaves out as a whole: they start many processes, run programs, or work on many meshes.
# Single slow tests of other modules are marked where they stand.
SLOW = (
    "batches/test_crew.py",
    "batches/test_local_worker.py",
    "batches/test_ray_worker.py",
    "batches/test_runs.py",
    "commands/test_reproduce.py",
    "improving/test_extremes.py",
    "learning/test_datasets.py",
    "learning/test_domains.py",
    "learning/test_nn.py",
    "pictures/test_films.py",
    "pictures/test_page_in_browser.py",
    "pictures/test_pictures.py",
    "test_docs.py",
    "test_interrupts.py",
    "test_readme.py",
)
FOLDER = Path(__file__).parent


# Modules and folders whose tests run twice: by the compiled loops, and by torch alone.
BOTH_WAYS = (
    "flipping",
    "mesh/test_measure.py",
    "mesh/test_predicates.py",
    "optimising",
    "smoothing/test_smoothing.py",
    "untangling/test_untangling.py",
)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    path = Path(metafunc.module.__file__)
    if any(path == FOLDER / place or FOLDER / place in path.parents for place in BOTH_WAYS):
        metafunc.parametrize("loops", ["compiled", "torch"], indirect=True)


@pytest.fixture(autouse=True)
def loops(request: pytest.FixtureRequest) -> Iterator[None]:
    """The inner loops by which a test of `BOTH_WAYS` runs; the others run by those that are there."""
    choice = getattr(request, "param", None)
    if choice == "compiled" and not library.built():
        pytest.skip("the compiled loops were not built")
    with nullcontext() if choice is None else library.using(choice):
        yield


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.is_relative_to(FOLDER) and item.path.relative_to(FOLDER).as_posix() in SLOW:
            item.add_marker(pytest.mark.slow)


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
    """Runs over files work in this process, on one file after the other unless the run names a number of workers.

    The start of other processes is saved where only the outcome matters.
    """
    from file_runs import Inline

    monkeypatch.setattr("torchmesh.batches.runs.LocalWorker", Inline)
    monkeypatch.setattr("torchmesh.batches.runs.processors", lambda: 1)
