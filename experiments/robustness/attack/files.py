"""Mutated mesh files: is each read, or refused in one clear line, and soon?

    sample file --- mutants ---> cut, flipped, swapped, huge counts, doubled lines --- examine ---> a fault, or ""

A fault is an exception that is no MeshError, an error of more than one line or 300 characters or without the name of
the file, more than ten seconds, or the death of the process.  Mutants are a function of the file, the seed and their
number, so that a fault can be made again.

    python -m experiments.robustness.attack.files [--minutes 5] [--seed 0] [--kinds vtu,off]
"""

import argparse
import contextlib
import io
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import meshio
import numpy as np

import torchmesh as tm
from torchmesh.files.drafts import Draft
from torchmesh.files.formats.registry import FORMATS

# Seconds that a reader may take for a file of some kilobytes, on a machine with other work to do.
SECONDS = 10

# Characters of an error at most.
LENGTH = 300

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
KINDS = (*FORMATS, *_VARIANTS, "batch")


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
        path = folder / f"a{FORMATS[kind].extensions[0]}"
        Draft.of(path, content).save()
    return path


# --- mutations ---------------------------------------------------------------------------------------


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


# --- judgement ---------------------------------------------------------------------------------------


class _TooLongError(BaseException):
    """Raised when time is up; no code catches it."""


def examine(path: Path, seconds: int = SECONDS) -> str:
    """What is wrong with how a file is read; empty if nothing is.  Needs the main thread, for its clock."""

    def stop(*_: object) -> None:
        raise _TooLongError

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tm.MeshWarning)
            (tm.load_batch if path.suffix == ".h5" else tm.read)(path)
    except tm.MeshError as error:
        text = str(error)
        if len(text) > LENGTH or "\n" in text or not text.startswith(str(path)):
            return f"a bad message ({len(text)} characters): {text[:400]}"
    except _TooLongError:
        return f"more than {seconds} s"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    return ""


def faults(kind: str, seed: int, numbers: range) -> Iterator[tuple[int, str]]:
    """Number and fault of each mutant; the fault is empty where there is none."""
    with tempfile.TemporaryDirectory() as folder:
        path = sample(kind, Path(folder))
        whole = path.read_bytes()
        (tm.load_batch if kind == "batch" else tm.read)(path)  # libraries are imported before the clock runs
        for number in numbers:
            name, data = mutant(whole, seed, number)
            path.write_bytes(data)
            fault = examine(path)
            yield number, f"{name}: {fault}" if fault else ""


def _in_a_process(kind: str, seed: int, numbers: range) -> Iterator[tuple[int, str]]:
    """As `faults`, in processes of their own: a reader may kill the one that it is in."""
    while numbers:
        command = [
            sys.executable,
            "-m",
            __spec__.name,
            "--child",
            kind,
            str(seed),
            str(numbers.start),
            str(numbers.stop),
        ]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            for line in child.stdout:
                number, _, fault = line.rstrip("\n").partition(" ")
                numbers = numbers[1:]
                yield int(number), fault
        if numbers:
            yield numbers.start, f"the process died with status {child.returncode}"
            numbers = numbers[1:]


def main(arguments: list[str] | None = None) -> int:
    """Mutates files until the minutes are over, prints the faults, and returns 1 if there is any."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS), help="kinds of files, with commas between")
    parser.add_argument("--child", nargs=4, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.child:
        kind, seed, start, stop = options.child
        for number, fault in faults(kind, int(seed), range(int(start), int(stop))):
            print(number, " ".join(fault.split()), flush=True)
        return 0
    end, start, tried, found = time.monotonic() + 60 * options.minutes, 0, 0, 0
    share = 300  # mutants of a kind between two looks at the clock
    while time.monotonic() < end:
        for kind in options.kinds.split(","):
            for number, fault in _in_a_process(kind, options.seed, range(start, start + share)):
                tried += 1
                if fault:
                    found += 1
                    print(f"{kind}, seed {options.seed}, mutant {number}: {fault}", flush=True)
            if time.monotonic() > end:
                break
        start += share
    print(f"{tried:,} files of {len(options.kinds.split(','))} kinds, {found} faults")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
