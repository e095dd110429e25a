"""What a network makes of a moved body: one that was never trained, and one that was."""

import numpy as np
import torch

from ..case import Drawn, Family
from ..network import Mover, load
from .drawing import is_simple
from .with_bodies import channel, place


def _output(rng: np.random.Generator, network: Mover, lengths: float) -> Drawn | None:
    """The network's positions for a body moved by so many of its lengths and turned."""
    made = channel(rng)
    if made is None:
        return None
    mesh, loop, details = made
    goal = place(mesh, loop, lengths, rng.uniform(-1, 1), rng.uniform(-90, 90))
    if not is_simple(goal, loop):
        return None
    with torch.no_grad():
        return Drawn(mesh, network(mesh, goal), details=details)


def untrained(rng: np.random.Generator, gain: float) -> Drawn | None:
    """The output of the untrained network, times a gain, for a body that moved by one length."""
    network = load("untrained")
    network.gain = gain
    return _output(rng, network, 1.0)


def trained(rng: np.random.Generator, lengths: float) -> Drawn | None:
    """The output of the trained network for a body that moved by so many lengths."""
    return _output(rng, load("trained"), lengths)


FAMILIES = (
    Family("untrained", untrained, (0.5, 1, 2, 4, 8), "gain", "what an untrained network puts out", "weights"),
    Family("trained", trained, (1, 2, 4, 6, 8, 12), "lengths moved", "what a trained network puts out", "weights"),
)
