"""Clocks: minima over interleaved runs, and runs in a process of their own.

Wall time is what a user waits.  The processor time of this process is given beside it, since other work on the machine
hardly changes it.  Everything runs in one thread.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from torchmesh.bench.provenance import processor
from torchmesh.bench.stopwatch import Seconds, Stopwatch


def interleaved(works: Mapping[str, Callable[[], Seconds | None]], repeats: int) -> dict[str, Seconds]:
    """The least time of each work over `repeats` rounds; a round runs every work once.

    A work may return the seconds of the part of it that counts; if it returns None, all of it counts.
    """
    best: dict[str, Seconds] = {}
    for _ in range(repeats):
        for name, work in works.items():
            with Stopwatch() as watch:
                part = work()
            seconds = part or watch.seconds
            best[name] = best[name].least(seconds) if name in best else seconds
    return best


def in_fresh_process(code: str, *arguments: object) -> dict[str, Any]:
    """Run Python `code` with `arguments` as sys.argv[1:] in a new process; return the JSON of its last line.

    The first of several runs writes the compiled bytecode that the others use, as an installation does for all.
    """
    environment = os.environ | {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    root = str(Path(__file__).parents[2])
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, (root, environment.get("PYTHONPATH"))))
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)], capture_output=True, text=True, env=environment
    )
    if done.returncode:
        raise RuntimeError(f"the measured process failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def one_thread() -> None:
    """Limit torch, and the libraries that are loaded later, to one thread."""
    import torch

    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
    torch.set_num_threads(1)


def machine() -> str:
    """The processor, its cores and how busy it is now."""
    return f"{processor()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} at {time.strftime('%Y-%m-%d %H:%M')}"
