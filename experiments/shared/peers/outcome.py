"""What a peer returns, and the two reasons why it may return nothing."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

import numpy as np

from experiments.shared.clocks import Seconds

Array = np.ndarray


@dataclass(frozen=True)
class Outcome:
    """The mesh that a peer made.

    points     (V, 2)
    triangles  (T, 3)
    seconds    of the optimiser's own call
    note       what a reader of a table should know of it
    """

    points: Array
    triangles: Array
    seconds: Seconds
    note: str = ""


class Missing(Exception):
    """The peer is not installed; the message names the extra, and a row of a table can show it."""


class Refused(Exception):
    """The peer says that it cannot take this mesh."""


def need(module: str) -> None:
    """Raise Missing unless the module is installed."""
    if importlib.util.find_spec(module) is None:
        raise Missing(f"not installed: pip install 'torchmesh-untangle[peers]' ({module})")
