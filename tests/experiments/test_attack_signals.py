"""A share of `experiments.robustness.attack signals`: commands bear signals at any moment."""

import itertools
import signal
from contextlib import closing

import pytest

from experiments.robustness.attack import signals


def faults(seed: int, kinds: list[str], count: int) -> list[str]:
    with closing(signals.trials(seed, kinds)) as found:
        return [fault for _, fault in itertools.islice(found, count)]


def test_commands_end_in_one_line_and_leave_nothing():
    assert faults(7, ["improve"], 1) == [""]


@pytest.mark.slow
def test_batches_go_on_where_they_were():
    assert faults(5, ["batch"], 1) == [""]


def test_the_judge_finds_faults(tmp_path):
    assert signals._told(-signal.SIGINT, "") == ""
    assert signals._told(130, "interrupted\n") == ""
    assert "traceback" in signals._told(130, 'Traceback\n File "/a/torchmesh/a.py"\n')
    assert "status 3" in signals._told(3, "")
    assert "one line" in signals._told(130, "a\nb\nc\n")
    assert signals._whole(tmp_path, ("a",)) == ""
    (tmp_path / "x.part").touch()
    assert "x.part" in signals._whole(tmp_path, ("a",))
    with pytest.raises(ValueError, match="no kinds of commands: swim"):
        next(signals.trials(0, ["swim"]))
