"""Set-up shared by all tests: one thread, seeded generators, hypothesis without a clock; which tests are slow."""

import functools
import os
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
import torch
from both_loops import need_compiled_loops
from hypothesis import HealthCheck, settings

from torchmesh.kernels import library

torch.set_num_threads(1)
# The compiler's pool leaves threads behind, and `improve` forks no process that has any.
os.environ.setdefault("TORCHINDUCTOR_COMPILE_THREADS", "1")

FOLDER = Path(__file__).parent

# What `make test-fast` leaves out: modules, and tests as "module::name".
SLOW = {line for line in (FOLDER / "slow.txt").read_text().splitlines() if not line.startswith("#")}

# Modules and folders whose tests run twice: by the compiled loops, and by torch alone.
BOTH_WAYS = (
    "flipping",
    "mesh/test_measure.py",
    "mesh/test_predicates.py",
    "optimising",
    "smoothing/test_smoothing.py",
    "untangling/test_untangling.py",
)
# Modules of those folders that run once: objectives that are written in Python, which no compiled loop takes; and whole
# improvements towards targets, whose loops tests/kernels holds together.
ONE_WAY = {"optimising/test_lbfgs.py", "optimising/test_targets.py"}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    path = _below(metafunc.module.__file__)
    if path not in ONE_WAY and any(path == place or path.startswith(f"{place}/") for place in BOTH_WAYS):
        metafunc.parametrize("loops", ["compiled", "torch"], indirect=True)


@pytest.fixture(autouse=True)
def loops(request: pytest.FixtureRequest) -> Iterator[None]:
    """The inner loops by which a test of `BOTH_WAYS` runs; the others run by those that are there."""
    choice = getattr(request, "param", None)
    if choice == "compiled" or _below(request.path).startswith("kernels/"):
        need_compiled_loops()
    with nullcontext() if choice is None else library.using(choice):
        yield


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    modules = {item: _below(item.path) for item in items}
    for item, module in modules.items():
        if module in SLOW or f"{module}::{getattr(item, 'originalname', item.name)}" in SLOW:
            item.add_marker(pytest.mark.slow)
    # Slow modules come first: at the end, when a worker takes tests over from another, there are many short ones.
    items.sort(key=lambda item: modules[item] not in SLOW)


@functools.cache
def _below(path: str | Path) -> str:
    """A file's path below this folder; "" if it lies elsewhere."""
    path = Path(path)
    return path.relative_to(FOLDER).as_posix() if path.is_relative_to(FOLDER) else ""


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
