"""Mutated mesh files: is each read, or refused in one clear line, and soon?

    sample file --- mutant ---> file --- examine ---> a fault, or ""

A fault is an exception that is no MeshError, an error of more than one line or 300 characters or without the name of
the file, more than ten seconds, much more memory than the file can fill, or the death of the process.
"""

import resource
import signal
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import torchmesh as tm

from .mutants import KINDS, mutant, sample

# Seconds that a reader may take for a file of some kilobytes, on a machine with other work to do.
SECONDS = 10

# Characters of an error at most.
LENGTH = 300

# Bytes of memory that reading such a file may add to the process.
MEMORY = 1 << 29

# Mutants of one kind in a row.
_SHARE = 300


class _TooLongError(BaseException):
    """Raised when time is up; no code catches it."""


def examine(path: Path, seconds: int = SECONDS) -> str:
    """What is wrong with how a file is read; empty if nothing is.  Needs the main thread, for its clock."""

    def stop(*_: object) -> None:
        raise _TooLongError

    before, memory = signal.signal(signal.SIGALRM, stop), _peak()
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
    added = _peak() - memory
    return f"{added >> 20} MiB of memory" if added > MEMORY else ""


def _peak() -> int:
    """The most bytes of memory that this process has had so far."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


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


def trials(seed: int, kinds: list[str] | None = None, start: int = 0) -> Iterator[tuple[str, str]]:
    """Name and fault of one mutant after the other, without end; `kinds` in turn, from the mutant `start` on."""
    unknown = set(kinds or ()) - set(KINDS)
    if unknown:
        raise ValueError(f"no kinds of files: {', '.join(sorted(unknown))}; there are {', '.join(KINDS)}")
    while True:
        for kind in kinds or KINDS:
            with closing(_in_a_process(kind, seed, range(start, start + _SHARE))) as found:
                for number, fault in found:
                    yield f"{kind} {number}", fault
        start += _SHARE


def _in_a_process(kind: str, seed: int, numbers: range) -> Iterator[tuple[int, str]]:
    """As `faults`, in processes of their own: a reader may kill the one that it is in."""
    while numbers:
        words = [kind, str(seed), str(numbers.start), str(numbers.stop)]
        command = [sys.executable, "-c", f"from {__name__} import _print; _print()", *words]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as child:
            assert child.stdout is not None
            try:
                for line in child.stdout:
                    number, _, fault = line.rstrip("\n").partition(" ")
                    numbers = numbers[1:]
                    yield int(number), fault
            finally:
                child.kill()
        if numbers:
            yield numbers.start, f"the process died with status {child.wait()}"
            numbers = numbers[1:]


def _print() -> None:
    """The faults that the arguments of this process ask for, a line each."""
    kind, seed, start, stop = sys.argv[1:]
    for number, fault in faults(kind, int(seed), range(int(start), int(stop))):
        print(number, " ".join(fault.split()), flush=True)
