"""Cases of the Locally Injective Mappings benchmark, as its files have them.

Du, Aigerman, Zhou, Kovalsky, Yan, Kaufman & Ju, Lifting simplices to find injectivity, ACM Transactions on Graphics 39,
2020; the data set is https://doi.org/10.5281/zenodo.3827969.  A case is one of these:

- `NAME.obj` with a file of handles.  Lines `v x y z` are the surface in space, `vt u v` where its vertices begin in the
  plane, `f 1/1 2/2 3/3` the triangles.  Where a vertex has several texture coordinates (a seam), each of them is a
  vertex of the plane mesh.  The handles, the vertices that stay, are whole numbers from 0, one a line; the file is
  `NAME_handles.txt`, `NAME.handles` or `handles.txt` beside it, whichever is there first.  Without one the boundary
  stays.
- a plain text file, the input of the authors' programs: "count dimension" and that many rows for the rest vertices,
  the same for the first positions, for the triangles (from 0), and "count" and that many handles.  What follows does
  not matter.

Tetrahedra are left out.  Where triangles run clockwise, that is where the boundary encloses a negative area, the plane
is mirrored, which is the same problem.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import torchmesh as tm

Array = np.ndarray


@dataclass(frozen=True)
class InjectiveCase:
    """A mesh in the plane whose handles are fixed, and its rest shapes as target matrices (T, 2, 2)."""

    mesh: tm.MeshBatch
    targets: torch.Tensor


class NoCase(ValueError):
    """The file is no case with triangles; the message says why."""


def case_files(folder: Path) -> Iterator[Path]:
    """The files of all cases below the folder, in order of their names; results beside an input are none."""
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        if path.suffix.lower() == ".obj":
            if not re.match(r"(result|output)", path.stem, re.IGNORECASE):
                yield path
        elif path.suffix in ("", ".txt") and _is_plain(path):
            yield path


def read_case(path: Path) -> InjectiveCase:
    """The case of a file.  Raises NoCase for tetrahedra, and for files that are incomplete."""
    rest, start, triangles, handles = _read_obj(path) if path.suffix.lower() == ".obj" else _read_plain(path)
    a, b, c = start[triangles].transpose(1, 0, 2)
    if ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() < 0:
        start = start * [-1.0, 1.0]
    fixed = None
    if handles is not None:
        if len(handles) and not 0 <= handles.min() <= handles.max() < len(start):
            raise NoCase(f"handles reach from {handles.min()} to {handles.max()}: there are {len(start)} vertices")
        fixed = np.zeros(len(start), bool)
        fixed[handles] = True
    mesh = tm.MeshBatch.from_arrays(start, triangles, fixed=fixed)
    targets = tm.target_from(np.pad(rest, ((0, 0), (0, 3 - rest.shape[1]))), triangles)
    return InjectiveCase(mesh, targets)


def _is_plain(path: Path) -> bool:
    """Does the file begin as the input of the authors' programs does: two whole numbers, the second 2 or 3?"""
    with path.open("rb") as stream:
        words = stream.readline(200).split()
    return len(words) == 2 and words[0].isdigit() and words[1] in (b"2", b"3")


def _read_obj(path: Path) -> tuple[Array, Array, Array, Array | None]:
    positions: list[list[float]] = []
    texture: list[list[float]] = []
    faces: list[list[tuple[int, int]]] = []
    for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
        key, *words = line.split("#", 1)[0].split() or [""]
        try:
            if key == "v":
                positions.append([float(w) for w in words[:3]])
            elif key == "vt":
                texture.append([float(w) for w in words[:2]])
            elif key == "f":
                faces.append([_corner(word, len(positions), len(texture)) for word in words])
        except (ValueError, IndexError):
            raise NoCase(f"line {number} cannot be read: {line.strip()!r}") from None
    if not texture or not faces:
        raise NoCase("no texture coordinates" if faces else "no triangles")
    if any(len(face) != 3 for face in faces):
        raise NoCase("faces that are no triangles")
    corner = np.array(faces, dtype=np.int64)
    of_space, of_plane = corner[..., 0], corner[..., 1]
    counts = len(positions), len(texture)
    if corner.min() < 0 or of_space.max() >= counts[0] or of_plane.max() >= counts[1]:
        raise NoCase(f"faces name vertices that are not there: {counts[0]} vertices, {counts[1]} texture coordinates")
    space, start = np.array(positions, dtype=float), np.array(texture, dtype=float)
    rest = np.zeros((len(start), space.shape[1]))
    rest[of_plane.ravel()] = space[of_space.ravel()]
    handles = _handles(path)
    if handles is not None and not np.array_equal(of_space, of_plane):
        # Handles count the vertices; each of their texture coordinates stays.
        if len(handles) and handles.max() >= counts[0]:
            raise NoCase(f"handles reach to {handles.max()}: there are {counts[0]} vertices")
        handles = np.unique(of_plane[np.isin(of_space, handles)])
    return rest, start, of_plane, handles


def _corner(word: str, positions: int, texture: int) -> tuple[int, int]:
    """The rows of the vertex and of its texture coordinate; the same row where only one is named."""
    parts = word.split("/")
    vertex = int(parts[0])
    vertex = vertex - 1 if vertex > 0 else positions + vertex
    if len(parts) < 2 or not parts[1]:
        return vertex, vertex
    coordinate = int(parts[1])
    return vertex, coordinate - 1 if coordinate > 0 else texture + coordinate


def _handles(path: Path) -> Array | None:
    names = (f"{path.stem}_handles.txt", f"{path.stem}.handles", f"{path.stem}-handles.txt", "handles.txt", "handles")
    for name in names:
        beside = path.with_name(name)
        if beside.exists():
            try:
                return np.unique(np.array([int(word) for word in beside.read_text().split()], dtype=np.int64))
            except ValueError as error:
                raise NoCase(f"{name}: {error}") from None
    return None


def _read_plain(path: Path) -> tuple[Array, Array, Array, Array | None]:
    words = iter(path.read_text().split())

    def block(kind: type) -> Array:
        shape = int(next(words)), int(next(words))
        return np.array([kind(next(words)) for _ in range(shape[0] * shape[1])]).reshape(shape)

    try:
        rest, start, simplices = block(float), block(float), block(int)
        handles = np.array([int(next(words)) for _ in range(int(next(words)))], dtype=np.int64)
    except (StopIteration, ValueError, RuntimeError):
        raise NoCase("the file is incomplete") from None
    if simplices.shape[1] != 3 or start.shape[1] != 2:
        raise NoCase(f"simplices of {simplices.shape[1]} vertices in {start.shape[1]} dimensions")
    return rest, start, simplices, np.unique(handles)
