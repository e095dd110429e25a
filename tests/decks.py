"""What the tests of solver decks share: a square in two materials with one flip to make, as text of each solver."""

import warnings
from pathlib import Path

import torch

import torchmesh as tm

# A rectangle of two squares.  Vertex 8 is inside; the edge 1-4 is the interface; in the right half, the diagonal 1-5
# of the quadrilateral 1 2 5 4 is long, and a flip replaces it by 2-4.
POINTS = [(0, 0), (1, 0), (2, 0.5), (0, 1), (1, 1), (2, 1), (0.25, 0.5)]
TRIANGLES = [(0, 1, 6), (1, 4, 6), (4, 3, 6), (3, 0, 6), (1, 2, 5), (1, 5, 4)]


def flip_and_move(mesh: tm.MeshBatch) -> tm.MeshBatch:
    """The mesh with the last edge flipped, rows 4 and 5, and with vertex 6 at (1/3, 0.55)."""
    points, triangles = mesh.points.clone(), mesh.triangles.clone()
    points[6] = torch.tensor([1 / 3, 0.55], dtype=points.dtype)
    triangles[4], triangles[5] = torch.tensor([1, 2, 4]), torch.tensor([2, 5, 4])
    return tm.MeshBatch.from_arrays(points, triangles, mesh.fixed, mesh.constrained_edges)


def stale(source: Path) -> list[str]:
    """What is said of values at nodes when the deck is written with vertex 6 moved and fields interpolated."""
    mesh, target = tm.read(source), source.with_stem("moved")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        tm.write(target, flip_and_move(mesh), like=source, fields="interpolate")
        tm.write(target, mesh, like=source, fields="interpolate")  # nothing has moved: nothing is said
    start = f"{target}: values at nodes that moved stay as they were: "
    return [str(one.message).removeprefix(start) for one in told if str(one.message).startswith(start)]


def changed_lines(before: str | Path, after: Path) -> list[tuple[str, str]]:
    """The pairs of lines that differ; asserts that there are as many lines."""
    old = before.read_bytes().decode() if isinstance(before, Path) else before
    new = after.read_bytes().decode()
    pairs = list(zip(old.split("\n"), new.split("\n"), strict=True))
    return [(a, b) for a, b in pairs if a != b]
