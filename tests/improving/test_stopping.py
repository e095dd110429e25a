"""The loops of the strategy stop when their rules say so, mesh by mesh."""

import torch

from torchmesh.improving.step_options import Rounds
from torchmesh.improving.stopping import Gain, Stall
from torchmesh.optimising.lbfgs_options import LbfgsOptions


def numbers(*values: int) -> torch.Tensor:
    return torch.tensor(values)


def test_the_loop_of_the_paper_stops_after_rounds_without_gain():
    options, flips, many = Rounds(paper_patience=3), numbers(5, 5), numbers(99, 99)
    stall = Stall.of(numbers(10, 10))
    for left, reached in [((9, 10), (False, False)), ((9, 10), (False, False)), ((9, 10), (False, True))]:
        stall = stall.after(numbers(*left), flips, many, short=False)
        assert stall.reached(options, may_flip=True).tolist() == list(reached)
    # Gain begins the count again; without flips one round without gain is enough.
    assert not stall.after(numbers(8, 9), flips, many, short=False).reached(options, may_flip=False).any()
    assert stall.after(numbers(9, 11), flips, many, short=False).reached(options, may_flip=False).all()


def test_a_round_of_few_iterations_does_not_count_as_one_without_gain():
    options, stall = Rounds(paper_patience=1), Stall.of(numbers(4))
    assert not stall.after(numbers(4), numbers(1), numbers(99), short=True).reached(options, may_flip=True).any()
    assert stall.after(numbers(4), numbers(1), numbers(99), short=False).reached(options, may_flip=True).all()


def test_the_loop_of_the_paper_stops_when_nothing_happens_any_more():
    options, least = Rounds(paper_quiet=2), LbfgsOptions().patience
    stall = Stall.of(numbers(4, 4, 4))
    for _ in range(2):
        stall = stall.after(numbers(4, 4, 4), numbers(0, 1, 0), numbers(least, least, least + 1), short=False)
    assert stall.reached(options, may_flip=True).tolist() == [True, False, False]


def test_the_default_loop_goes_on_while_the_number_falls_by_a_quarter():
    options = Rounds(progress=0.75, patience=2)
    gain = Gain.of(numbers(100, 100))
    assert gain.lasts(options).all()
    gain = gain.after(numbers(75, 76), options)
    assert gain.lasts(options).tolist() == [True, True]
    gain = gain.after(numbers(70, 75), options)
    assert gain.lasts(options).tolist() == [True, False]
    # The measure is the fewest so far: 52 is three quarters of 70, 53 is not.
    assert gain.after(numbers(52, 0), options).lasts(options).tolist() == [True, True]
    assert gain.after(numbers(53, 0), options).lasts(options).tolist() == [False, True]
