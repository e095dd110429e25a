"""Boxes that touch and areas that triangles share, compiled: the twins of `transferring.pairs` and `.overlaps`."""

import numpy as np
import torch
from torch import Tensor

from .library import ADDRESS, INT64, call, pointer

# A call of the library looks at so many boxes, a fraction of a second, so that Python sees interrupts.
_WORK = 200_000


def touching_boxes(
    here: tuple[np.ndarray, np.ndarray, np.ndarray], there: tuple[np.ndarray, np.ndarray, np.ndarray], meshes: int
) -> tuple[np.ndarray, np.ndarray]:
    """The pairs of a box of `here` and a box of `there` that touch and are of one mesh, each (P,), ascending.

    here, there  the lower left corners (N, 2), the upper right corners (N, 2) and the meshes (N,) of the boxes; those
                 of `there` are in the order of their meshes
    """
    low, high, mesh = (_tensor(v) for v in here)
    tree_low, tree_high = (_tensor(v) for v in there[:2])
    offsets = torch.from_numpy(np.searchsorted(there[2], np.arange(meshes + 1)))
    boxes = (ADDRESS(pointer(v)) for v in (tree_low, tree_high, offsets))
    join = ADDRESS(call("tm_boxes_start", ADDRESS, *boxes, INT64(meshes)))
    try:
        count, given = 0, [ADDRESS(pointer(v)) for v in (low, high, mesh)]
        for first in range(0, len(mesh), _WORK):
            last = min(first + _WORK, len(mesh))
            count = call("tm_boxes_find", INT64, join, *given, INT64(first), INT64(last))
        pairs = torch.empty((2, count), dtype=torch.int64)
        call("tm_boxes_pairs", None, join, ADDRESS(pointer(pairs[0])), ADDRESS(pointer(pairs[1])))
    finally:
        call("tm_boxes_end", None, join)
    i, j = pairs.numpy()
    return i, j


def shared_areas(
    after: np.ndarray, i: np.ndarray, before: np.ndarray, j: np.ndarray, moments: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    """(P,) the areas that the triangles i of `after` share with the triangles j of `before`, and (P, 6) the moments.

    after, before  (6, T) x and y of the corners, counter-clockwise
    """
    area = torch.empty(len(i), dtype=torch.float64)
    integrals = torch.empty((len(i), 6), dtype=torch.float64) if moments else None
    columns = [_tensor(v) for v in (after, i, before, j)]
    t, rows, s, others = (ADDRESS(pointer(v)) for v in columns)
    call(
        "tm_shared_areas", None, t, INT64(after.shape[1]), rows, s, INT64(before.shape[1]), others, INT64(len(i)),
        ADDRESS(pointer(area)), ADDRESS(pointer(integrals)),
    )  # fmt: skip
    return area.numpy(), None if integrals is None else integrals.numpy()


def _tensor(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values))
