"""Arrays that are made once and kept in a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

Array = np.ndarray


def cached(path: Path, make: Callable[[], Mapping[str, Array]]) -> Mapping[str, Array]:
    """The arrays in the .npz file at `path`; if it is not there, `make` is called and its arrays are written first.

    The file gets its name when it is complete, so a run that is stopped leaves no half of one.
    """
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial.npz")
        np.savez(partial, **make())
        partial.rename(path)
    return np.load(path)
