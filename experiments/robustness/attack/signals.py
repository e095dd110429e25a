"""Signals at any moment: does a command end in one line, leave nothing half-written, and go on where it was?

    command --- SIGINT after a random time ---> one line, status 130, no file but whole ones
    batch   --- several signals, run again ---> in the end every mesh once, as without signals

The times are drawn up to that which the command takes undisturbed.  A trial is a function of the seed, its kind and its
number but for the speed of the machine.
"""

import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import torch

import torchmesh as tm

KINDS = ("improve", "quality", "clean", "batch")

# How a command may end after a signal: by itself, by SIGINT as it says, or by the signal before Python is up.
_ENDS = (0, 1, 130, -signal.SIGINT)

# Meshes of a batch.
_MESHES = 6

# Seconds that a command may take at most to end after a signal.
_PATIENCE = 60.0


@dataclass
class Attack:
    """A folder with meshes, and what commands make of them undisturbed.

    seconds  what each command takes undisturbed, as soon as it is known
    results  the points and triangles of each mesh of the batch, by file name
    """

    folder: Path
    seconds: dict[str, float] = field(default_factory=dict)
    results: dict[str, tm.MeshBatch] = field(default_factory=dict)

    def arguments(self, kind: str, out: Path, workers: int = 1) -> list[str]:
        """The arguments of a command whose files go to the folder `out`; a batch has so many `workers`."""
        mesh = str(self.folder / "in" / "0.vtu")
        return {
            "improve": ["improve", mesh, str(out / "b.vtu"), "--report", str(out / "r.json"), "-q"],
            "quality": ["quality", mesh, "--json"],
            "clean": ["clean", mesh, str(out / "c.vtu")],
            "batch": ["batch", str(self.folder / "in"), "--out", str(out / "done"), "--workers", str(workers)],
        }[kind]

    def prepare(self, kinds: Iterable[str]) -> None:
        """Writes the meshes, and runs each of these commands without a signal."""
        (self.folder / "in").mkdir()
        tangled = tm.domains.generate(_MESHES, ("circle", "jitter"), triangles=150, seed=1).deformed
        for b, mesh in enumerate(tangled.split()):
            tm.write(self.folder / "in" / f"{b}.vtu", mesh)
        for kind in kinds:
            out = self.folder / kind
            out.mkdir()
            started = time.monotonic()
            status, said = _run(self.arguments(kind, out), [])
            self.seconds[kind] = time.monotonic() - started
            if status not in (0, 1):
                raise RuntimeError(f"{kind} does not even work undisturbed: status {status}, {said}")
        self.results = {path.name: tm.read(path) for path in (self.folder / "batch" / "done").glob("*.vtu")}

    def trial(self, kind: str, rng: random.Random) -> str:
        """What is wrong with how a command bears signals; empty if nothing is."""
        with tempfile.TemporaryDirectory(dir=self.folder) as name:
            out = Path(name)
            if kind == "batch":
                return self._resumed(out, rng)
            at = rng.uniform(0, self.seconds[kind])
            status, said = _run(self.arguments(kind, out), [(at, signal.SIGINT)] * rng.choice((1, 1, 2)))
            return _told(status, said) or _whole(out, ("b.vtu", "r.json", "c.vtu"))

    def _resumed(self, out: Path, rng: random.Random) -> str:
        """A batch that is interrupted once or several times, and then ends what it began."""
        for _ in range(rng.choice((1, 1, 2, 4))):
            sent = rng.choice((signal.SIGINT, signal.SIGINT, signal.SIGTERM, signal.SIGKILL))
            status, said = _run(
                self.arguments("batch", out, workers=2), [(rng.uniform(0, self.seconds["batch"]), sent)]
            )
            fault = _told(status, said) if sent == signal.SIGINT else ""
            if fault:
                return fault
        status, said = _run(self.arguments("batch", out), [])
        if status not in (0, 1):
            return f"the resumed run ends with status {status}: {said[-300:]}"
        rows = [json.loads(line) for line in (out / "done" / "manifest.jsonl").read_text().splitlines()]
        names = sorted(row["name"] for row in rows)
        if sorted(set(names)) != sorted(self.results) or len(names) != len(set(names)):
            return f"the manifest has {names}"
        for name, mesh in self.results.items():
            found = tm.read(out / "done" / name)
            if not (torch.equal(found.points, mesh.points) and torch.equal(found.triangles, mesh.triangles)):
                return f"{name} is not what it is undisturbed"
        return _whole(out / "done", tuple(self.results))


def trials(seed: int, kinds: list[str] | None = None, start: int = 0) -> Iterator[tuple[str, str]]:
    """Name and fault of one trial after the other, without end; `kinds` in turn, from the number `start` on."""
    unknown = set(kinds or ()) - set(KINDS)
    if unknown:
        raise ValueError(f"no kinds of commands: {', '.join(sorted(unknown))}; there are {', '.join(KINDS)}")
    with tempfile.TemporaryDirectory() as folder:
        attack = Attack(Path(folder))
        attack.prepare(kinds or KINDS)
        while True:
            for kind in kinds or KINDS:
                yield f"{kind} {start}", attack.trial(kind, random.Random(f"{seed} {kind} {start}"))
            start += 1


def _run(arguments: list[str], sent: list[tuple[float, signal.Signals]]) -> tuple[int, str]:
    """Status and standard error of a command that gets signals after so many seconds."""
    command = [sys.executable, "-m", "torchmesh", *arguments]
    with subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
    ) as child:
        started = time.monotonic()
        for at, which in sent:
            with suppress(subprocess.TimeoutExpired):
                child.wait(max(0.0, at - (time.monotonic() - started)))
            with suppress(ProcessLookupError):
                child.send_signal(which)
            if which == signal.SIGKILL:  # its workers would go on, and the next run must not meet them
                child.wait()
                with suppress(ProcessLookupError):
                    os.killpg(child.pid, signal.SIGKILL)
        try:
            _, said = child.communicate(timeout=_PATIENCE + 10 * len(arguments))
        except subprocess.TimeoutExpired:
            os.killpg(child.pid, signal.SIGKILL)
            return 999, "it did not end"
    return child.returncode, said


def _told(status: int, said: str) -> str:
    """What is wrong with the end of a command after SIGINT."""
    if re.search(r'File "[^"]*/torchmesh/', said):
        return f"a traceback, status {status}: {said[-400:]}"
    if status not in _ENDS and "Traceback" not in said:  # Python itself may be interrupted while it starts
        return f"status {status}: {said[-300:]}"
    if status == 130 and said.strip().count("\n") > 1:
        return f"more than one line: {said[-400:]}"
    return ""


def _whole(folder: Path, names: tuple[str, ...]) -> str:
    """What is in a folder that should not be there, or is not whole."""
    others = {"manifest.jsonl", "manifest.parquet", "run.json", ".torchmesh.lock"}
    left = [path.name for path in folder.iterdir() if path.name not in names and path.name not in others]
    if left:
        return f"left behind: {', '.join(left)}"
    for path in folder.glob("*.vtu"):
        tm.read(path)
    for path in folder.glob("r.json"):
        json.loads(path.read_text())
    return ""
