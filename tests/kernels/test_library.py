"""Which loops run: by the environment, by choice, and where there is no library."""

import subprocess
import sys

import pytest
import torch

from torchmesh.kernels import library


@pytest.fixture(autouse=True)
def read_anew():
    """The environment is read once in a process, so these tests make it be read again."""
    library.asked_for.cache_clear()
    yield
    library.asked_for.cache_clear()


@pytest.mark.parametrize("choice", ["torch", "compiled"])
def test_the_environment_chooses(monkeypatch, choice):
    monkeypatch.setenv("TORCHMESH_KERNELS", choice)
    assert library.kernels_in_use() == choice


def test_an_unknown_choice_is_refused(monkeypatch):
    monkeypatch.setenv("TORCHMESH_KERNELS", "cuda")
    with pytest.raises(RuntimeError, match=r"TORCHMESH_KERNELS must be 'torch' or 'compiled'.*'cuda'"):
        library.library()


def test_without_the_library_torch_works_unless_it_is_asked_for(monkeypatch):
    monkeypatch.setattr(library, "_load", lambda: None)
    monkeypatch.delenv("TORCHMESH_KERNELS", raising=False)
    assert library.kernels_in_use() == "torch"
    monkeypatch.setenv("TORCHMESH_KERNELS", "compiled")
    library.asked_for.cache_clear()
    with pytest.raises(RuntimeError, match="not built when torchmesh was installed"):
        library.library()


def test_a_choice_holds_inside_its_context_only():
    before = library.kernels_in_use()
    with library.using("torch"):
        assert library.kernels_in_use() == "torch"
    assert library.kernels_in_use() == before


def test_other_devices_have_no_compiled_loops():
    assert library.library_for(torch.empty(1, device="meta")) is None


def test_the_commands_say_which_loops_they_use():
    said = subprocess.run([sys.executable, "-m", "torchmesh", "--version"], capture_output=True, text=True, check=True)
    assert f"{library.kernels_in_use()} kernels" in said.stdout
