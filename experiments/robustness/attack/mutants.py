"""Mesh files of every kind, and mutants of them: cut, flipped, swapped, with huge counts, doubled lines, foreign words.

A mutant is a function of the file, the seed and its number, so that it can be made again.
"""

import contextlib
import io
import random
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import meshio
import numpy as np

import torchmesh as tm
from torchmesh.files.drafts import Draft
from torchmesh.files.formats.registry import FORMATS

# Variants of formats beside those that torchmesh writes for a new file: name of the file, options of meshio.write.
_VARIANTS: dict[str, tuple[str, dict]] = {
    "vtu-text": ("a.vtu", {"binary": False}),
    "vtu-plain": ("a.vtu", {"binary": True, "compression": None}),
    "vtk-text": ("a.vtk", {"binary": False}),
    "vtk-4.2": ("a.vtk", {"binary": True, "file_format": "vtk42"}),
    "gmsh-text": ("a.msh", {"binary": False, "file_format": "gmsh"}),
    "gmsh-2.2": ("a.msh", {"binary": True, "file_format": "gmsh22"}),
    "gmsh-2.2-text": ("a.msh", {"binary": False, "file_format": "gmsh22"}),
    "ply-text": ("a.ply", {"binary": False}),
    "stl-text": ("a.stl", {"binary": False}),
    "xdmf-hdf5": ("a.xdmf", {"data_format": "HDF"}),
}
# Files beside that of a format which are read with it: the format and their extension.
_BESIDE = {"triangle-elements": ("triangle", ".ele"), "triangle-segments": ("triangle", ".poly")}
KINDS = (*FORMATS, *_VARIANTS, *_BESIDE, "batch")


def sample(kind: str, folder: Path) -> Path:
    """A whole file of a kind: a square of 32 triangles in two regions, with lines and fields where the kind has them.

    kind  the name of a format, one of the variants, or "batch" for a file of `save_batch`
    """
    x, y = np.meshgrid(np.arange(5) / 3, np.arange(5) / 7)
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    q = (np.arange(4)[:, None] * 5 + np.arange(4)).ravel()
    faces = np.concatenate([np.stack([q, q + 1, q + 6], 1), np.stack([q, q + 6, q + 5], 1)])
    if kind == "batch":
        mesh = tm.MeshBatch.from_arrays(points, faces)
        tm.save_batch(folder / "a.h5", tm.join([mesh, mesh]), point_fields={"u": tm.join([mesh, mesh]).points})
        return folder / "a.h5"
    only_triangles = kind in ("gmsh-text", "gmsh-2.2-text", "ply-text", "stl-text")
    lines = np.stack([np.arange(4), np.arange(1, 5)], 1)
    cells = [("triangle", faces.astype(np.int32) if kind == "ply-text" else faces)]
    cell_data = {"region": [np.where(np.arange(32) % 2, 1, 2)]}
    if not only_triangles:
        cells.insert(0, ("line", lines))
        cell_data["region"].insert(0, np.full(4, 5))
    data = {} if only_triangles else {"point_data": {"u": np.arange(25) / 3}, "cell_data": cell_data}
    content = meshio.Mesh(points, cells, **data)
    silent = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stdout(silent), contextlib.redirect_stderr(silent):
        warnings.simplefilter("ignore")
        if kind in _VARIANTS:
            name, options = _VARIANTS[kind]
            meshio.write(folder / name, content, **options)
            return folder / name
        form, extension = _BESIDE.get(kind, (kind, ""))
        path = folder / f"a{FORMATS[form].extensions[0]}"
        Draft.of(path, content).save()
    return path.with_suffix(extension) if extension else path


def _cut(data: bytes, rng: random.Random) -> bytes:
    """The file without its end, sometimes between two lines."""
    end = rng.randrange(len(data))
    return data[: data.rfind(b"\n", 0, end) + 1] if rng.random() < 0.5 else data[:end]


def _flip(data: bytes, rng: random.Random) -> bytes:
    """Some bytes are others."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 3, 30))):
        out[rng.randrange(len(out))] = rng.randrange(256)
    return bytes(out)


def _number(data: bytes, rng: random.Random, choose: Callable[[list[bytes]], bytes]) -> bytes:
    """One of the numbers of a text is another; binary data gets other bytes."""
    found = list(re.finditer(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", data))
    if not found:
        return _flip(data, rng)
    at = rng.choice(found[:20] if rng.random() < 0.5 else found)
    return data[: at.start()] + choose([m[0] for m in found]) + data[at.end() :]


def _swap(data: bytes, rng: random.Random) -> bytes:
    """A number is one that stands elsewhere in the file."""
    return _number(data, rng, lambda numbers: rng.choice(numbers))


_EXTREME = (b"0", b"-1", b"99999999", b"2147483648", b"9999999999999", b"99999999999999999999", b"nan", b"1e308", b"")


def _extreme(data: bytes, rng: random.Random) -> bytes:
    """A number is huge, negative, none, or not finite."""
    return _number(data, rng, lambda _: rng.choice(_EXTREME))


def _lines(data: bytes, rng: random.Random) -> bytes:
    """Lines are doubled, missing, or in another order."""
    lines = data.split(b"\n")
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    what = rng.randrange(4)
    if what == 0:
        lines.insert(at, lines[other])
    elif what == 1:
        del lines[at]
    elif what == 2:
        lines[at], lines[other] = lines[other], lines[at]
    else:
        lines[at:at] = [lines[at]] * 50
    return b"\n".join(lines)


def _words(data: bytes, rng: random.Random) -> bytes:
    """A word is gone, very long, or no text."""
    found = list(re.finditer(rb"[A-Za-z_]{2,}", data))
    if not found:
        return _flip(data, rng)
    at = rng.choice(found)
    return data[: at.start()] + rng.choice((b"", b"x" * 5000, b"\xff\xfe", b"\x1b[31m")) + data[at.end() :]


_MUTATIONS = (_cut, _flip, _swap, _extreme, _lines, _words)


def mutant(data: bytes, seed: int, number: int) -> tuple[str, bytes]:
    """The name of the mutations of one mutant, and its bytes."""
    rng = random.Random(f"{seed} {number}")
    chosen = [_MUTATIONS[number % len(_MUTATIONS)], *rng.choices(_MUTATIONS, k=rng.choice((0, 0, 1, 2)))]
    for mutate in chosen:
        data = mutate(data, rng) or data
    return "+".join(mutate.__name__[1:] for mutate in chosen), data
