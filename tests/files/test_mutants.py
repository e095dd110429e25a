"""A share of `experiments.robustness.attack.files`: mutated files of every kind are read or refused in one line."""

import collections

import pytest

from experiments.robustness.attack.files import examine, faults
from experiments.robustness.attack.mutants import KINDS, mutant, sample


@pytest.mark.parametrize("kind", KINDS)
def test_mutants_are_read_or_refused_in_one_line(kind):
    found = list(faults(kind, seed=1, numbers=range(24)))
    assert len(found) == 24
    assert [fault for _, fault in found if fault] == []


def test_mutants_differ_and_can_be_made_again(tmp_path):
    whole = sample("off", tmp_path).read_bytes()
    made = [mutant(whole, 1, number) for number in range(60)]
    assert made == [mutant(whole, 1, number) for number in range(60)]
    assert len({data for _, data in made} - {whole}) > 50
    first = collections.Counter(name.split("+")[0] for name, _ in made)
    assert set(first) == {"cut", "flip", "swap", "extreme", "lines", "words"}


def test_the_examination_finds_faults(tmp_path, monkeypatch):
    path = sample("off", tmp_path)
    assert examine(path) == ""

    def fail(_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("torchmesh.read", fail)
    assert examine(path) == "ZeroDivisionError: a bug"
    monkeypatch.setattr("torchmesh.read", lambda _: [0 for _ in iter(int, 1)])
    assert examine(path, seconds=1) == "more than 1 s"
