"""What a tool returns whose own call is timed, and a check that it is installed."""

import importlib.util
from dataclasses import dataclass

import numpy as np

from ..answers import Missing
from ..stopwatch import Seconds

Array = np.ndarray


@dataclass(frozen=True)
class Outcome:
    """The mesh that a tool made.

    points     (V, 2)
    triangles  (T, 3)
    seconds    of the optimiser's own call
    note       what a reader of a table should know of it
    """

    points: Array
    triangles: Array
    seconds: Seconds
    note: str = ""


def need(module: str) -> None:
    """Raise Missing unless the module is installed."""
    if importlib.util.find_spec(module) is None:
        raise Missing(f"not installed: pip install 'torchmesh-untangle[peers]' ({module})")
