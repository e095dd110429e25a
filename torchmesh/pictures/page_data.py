"""The stages of a mesh as compact text that a web page can carry: what `report_page` embeds and page_mesh.js reads.

    stage --> positions on a grid (int32), triangles (uint32), quality codes (uint16), inverted flags (bits),
              interfaces, curved edges with their control points
          --> difference to the stage before, bytes of equal weight side by side --> deflate --> base64

Most vertices, triangles and shapes are the same from one stage to the next, so that differences are
mostly zero bytes, which deflate all but removes.
"""

import base64
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..mesh.batch import MeshBatch
from ..mesh.measure import Quality
from .curves import Curves

# Positions lie on a grid of 2^31 steps across all the stages: fine enough to zoom in a million times.
_GRID_STEPS = 2**31 - 2


# Quality codes a doubling of the inverse mean ratio, so that a code is good to 0.02 percent; the last code is infinity.
CODES_A_DOUBLING = 2048


INFINITE_CODE = 65535


@dataclass(frozen=True)
class Encoded:
    """What the page needs to show the stages.

    header  for JSON: the grid's `origin` and `step` in the mesh's length unit, the `frame` of its plane, and for each
            stage its `vertices`, `triangles`, `interfaces` and `curves` (counts), and `quads`, of which the last
            triangles are the halves
    text    base64 of the deflated arrays, stage by stage: points, triangles, quality codes, inverted flags,
            ends of interface edges, ends of curved edges, control points of these
    """

    header: dict[str, Any]
    text: str


def encode(stages: Sequence[tuple[MeshBatch, Quality]], curves: Sequence[Curves | None] | None = None) -> Encoded:
    """Pack the stages of one mesh, in order, each with its quality and its curved sides; their counts may differ."""
    bent = [None] * len(stages) if curves is None else list(curves)
    points = [mesh.points.detach().to("cpu", torch.float64).numpy() for mesh, _ in stages]
    controls = [np.zeros((0, 2)) if own is None else own.controls for own in bent]
    every = [p for p in (*points, *controls) if len(p)]
    low = np.min([p.min(0) for p in every], 0)
    high = np.max([p.max(0) for p in every], 0)
    step = float((high - low).max()) / _GRID_STEPS or 1.0
    chunks: list[bytes] = []
    before: list[np.ndarray] = []
    none = np.zeros((0, 2), np.int64)
    for k, (mesh, quality) in enumerate(stages):
        own = bent[k]
        arrays = [
            np.rint((points[k] - low) / step).astype(np.uint32),
            mesh.triangles.cpu().numpy().astype(np.uint32),
            codes(quality.inverse_mean_ratio.cpu().numpy()),
            np.packbits(~quality.upright.cpu().numpy(), bitorder="little"),
            mesh.constrained_edges.cpu().numpy().astype(np.uint32),
            (none if own is None else own.edges).astype(np.uint32),
            np.rint((controls[k] - low) / step).astype(np.uint32),
        ]
        for j, array in enumerate(arrays):
            known = before and before[j].shape == array.shape
            difference = array ^ before[j] if known else array
            chunks.append(_by_weight(difference))
        before = arrays
    header = {
        "origin": low.tolist(),
        "step": step,
        "frame": stages[0][0].frames[0].tolist(),
        "stages": [
            {
                "vertices": len(m.points),
                "triangles": len(m.triangles),
                "interfaces": len(m.constrained_edges),
                "curves": len(controls[k]),
                **({"quads": len(m.quads)} if len(m.quads) else {}),
            }
            for k, (m, _) in enumerate(stages)
        ],
    }
    return Encoded(header, base64.b64encode(zlib.compress(b"".join(chunks), 9)).decode("ascii"))


def codes(ratio: np.ndarray) -> np.ndarray:
    """(T,) uint16: inverse mean ratios as codes, `CODES_A_DOUBLING` to a doubling; infinite is `INFINITE_CODE`."""
    with np.errstate(over="ignore"):
        code = np.rint(CODES_A_DOUBLING * np.log2(np.maximum(ratio, 1.0)))
    return np.where(np.isfinite(ratio), np.minimum(code, INFINITE_CODE - 1), INFINITE_CODE).astype(np.uint16)


def _by_weight(array: np.ndarray) -> bytes:
    """The array's bytes, first the lowest of every number, then the second lowest, and so on."""
    little = np.ascontiguousarray(array.astype(array.dtype.newbyteorder("<")))
    return np.ascontiguousarray(little.view(np.uint8).reshape(-1, array.itemsize).T).tobytes()
