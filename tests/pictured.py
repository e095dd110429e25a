"""What tests of pictures and of the report page share: how to make and how to read them."""

import base64
import json
import re
import zlib
from pathlib import Path

import meshes
import numpy as np

from torchmesh import MeshBatch, improve


def two_faults() -> MeshBatch:
    """A square on two sides of which neighbours have passed each other: two places that nothing can mend."""
    points, triangles = meshes.grid_arrays(12, 12)
    for low, high, side in ((3, 4, 0.0), (8, 9, 1.0)):
        rows = [int(np.flatnonzero((points == (k / 12, side)).all(1))[0]) for k in (low, high)]
        points[rows] = points[rows[::-1]]
    return MeshBatch.from_arrays(points, triangles)


def recorded(mesh: MeshBatch):
    """The stages of `improve` with their names, and its report."""
    stages: list[tuple[str, MeshBatch]] = []
    _, report = improve(mesh, observe=lambda name, batch: stages.append((name, batch)))
    return stages, report


def embedded(text: str) -> tuple[dict, bytes]:
    """The header of a page's picture, and its data inflated."""
    header = re.search(r'<script type="application/json" id="header">(.*?)</script>', text, re.DOTALL).group(1)
    data = re.search(r'<script type="text/plain" id="data">(.*?)</script>', text, re.DOTALL).group(1)
    return json.loads(header), zlib.decompress(base64.b64decode(data))


def decoded(header: dict, data: bytes) -> list[list[np.ndarray]]:
    """Points, triangles, codes, flags and interfaces of each stage: the format as described, read slowly."""
    stages: list[list[np.ndarray]] = []
    offset = 0
    for entry in header["stages"]:
        v, t, e = entry["vertices"], entry["triangles"], entry["interfaces"]
        stage = []
        for k, (width, count) in enumerate([(4, 2 * v), (4, 3 * t), (2, t), (1, (t + 7) // 8), (4, 2 * e)]):
            planes = np.frombuffer(data, np.uint8, width * count, offset).reshape(width, count).astype(np.uint64)
            offset += width * count
            values = sum(planes[b] << np.uint64(8 * b) for b in range(width))
            if stages and len(stages[-1][k]) == count:
                values = values ^ stages[-1][k]
            stage.append(values)
        stages.append(stage)
    assert offset == len(data)
    return stages


def pixels(path: Path) -> np.ndarray:
    """(height, width, 3) from 0 to 1."""
    from matplotlib.image import imread

    return imread(path)[..., :3]


def vermilion(image: np.ndarray) -> int:
    """How many pixels have the colour of inverted triangles, or that colour over a pale one."""
    r, g, b = np.moveaxis(image, 2, 0)
    # Reddish, but neither the red of the frame (no green in it) nor that red where it fades into a pale mesh.
    return int(((r > 0.7) & (r - g > 0.25) & (g > 0.36) & (b < 0.28)).sum())
