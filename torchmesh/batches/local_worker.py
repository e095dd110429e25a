"""A worker that is a process of this machine.

The process is a fresh interpreter that talks to its parent over its standard streams.  Nothing is forked, on no system,
and the caller's script needs no `if __name__ == "__main__"`.
"""

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO

from ..errors import MeshError
from ..files.field_transfer import FieldChoice
from ..improving.options import ImproveOptions
from .batches import Job, improve_jobs
from .manifest import FileResult
from .workers import WorkerLost

# How many starts of a worker may fail, one after another, before the run is given up.
_STARTS = 3

# Seconds that a process which has closed its output may take to end, before it is killed.
_GRACE = 10


class LocalWorker:
    """A process of this machine that computes with one thread; after its death the next run starts another."""

    def __init__(self, options: ImproveOptions, budget: int, label: str, fields: FieldChoice = "interpolate") -> None:
        self._settings = pickle.dumps((options, budget, label, fields))
        self._process: subprocess.Popen | None = None
        self._stopped = False

    def run(self, jobs: Sequence[Job]) -> Iterator[FileResult]:
        process = self._running()
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            with _broken_pipes_raise():
                pickle.dump(list(jobs), process.stdin)
                process.stdin.flush()
            while (result := pickle.load(process.stdout)) is not None:
                yield result
        except (EOFError, OSError, pickle.UnpicklingError):
            raise WorkerLost(self._end(process)) from None

    def stop(self) -> None:
        self._stopped = True
        if self._process is not None:
            self._process.kill()

    def close(self) -> None:
        if self._process is not None:
            self._end(self._process)

    def _running(self) -> subprocess.Popen:
        """The process, started if there is none; raises WorkerLost when stopped, MeshError if none starts."""
        reason = ""
        for _ in range(_STARTS):
            if self._stopped:
                raise WorkerLost("stopped")
            if self._process is not None:
                return self._process
            process = self._process = self._start()
            assert process.stdin is not None
            assert process.stdout is not None
            if self._stopped:
                process.kill()
            try:
                with _broken_pipes_raise():
                    process.stdin.write(self._settings)
                    process.stdin.flush()
                pickle.load(process.stdout)
            except (EOFError, OSError, pickle.UnpicklingError):
                reason = self._end(process)
        if self._process is None:
            raise MeshError(f"a worker process does not start: {reason}")
        return self._process

    def _start(self) -> subprocess.Popen:
        # The child imports the package from where this process did, whether it is installed or not.
        home = str(Path(__file__).resolve().parents[2])
        code = f"import sys; sys.path.append({home!r}); from torchmesh.batches.local_worker import serve; serve()"
        one = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        # The child has a process group of its own, so that Ctrl-C reaches the parent only, which then ends its workers.
        group: dict[str, Any] = (
            {"creationflags": getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)}
            if os.name == "nt"
            else {"start_new_session": True}
        )
        return subprocess.Popen(
            [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=os.environ | one, **group
        )

    def _end(self, process: subprocess.Popen) -> str:
        """Waits for a process that has closed its output, and says how it ended."""
        self._process = None
        for stream in (process.stdin, process.stdout):
            with contextlib.suppress(OSError), _broken_pipes_raise():
                stream.close()  # type: ignore[union-attr]
        try:
            code = process.wait(timeout=_GRACE)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
        if code < 0:
            return f"killed by signal {-code}" + (", perhaps for want of memory" if code == -9 else "")
        return f"exit status {code}"


@contextlib.contextmanager
def _broken_pipes_raise() -> Iterator[None]:
    """Inside, writing to a process that has ended raises BrokenPipeError, as it does in Python by default.

    A library may have restored the system's own rule, which kills the writer: `gmsh.initialize` does.  The signal is
    blocked in this thread only and then discarded, because handlers belong to the caller.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows has no such signal
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGPIPE})
    try:
        yield
    finally:
        if signal.SIGPIPE not in before and signal.SIGPIPE in signal.sigpending():
            signal.sigwait({signal.SIGPIPE})
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def serve() -> None:
    """The main function of a worker process.

    It reads settings and then lists of jobs from standard input, and writes results to standard output, with None
    after the last result of each list.
    """
    import torch

    torch.set_num_threads(1)
    source, sink = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries print to standard output, and that must not come between the results
    settings = pickle.load(source)
    inbox: queue.SimpleQueue[list[Job]] = queue.SimpleQueue()
    threading.Thread(target=_receive, args=(source, inbox), daemon=True).start()
    _send(sink, "ready")
    while True:
        for result in improve_jobs(inbox.get(), *settings):
            _send(sink, result)
        _send(sink, None)


def _receive(source: BinaryIO, inbox: "queue.SimpleQueue[list[Job]]") -> None:
    """Hands jobs on; ends the process, in the midst of its work, when the parent has ended or was killed."""
    try:
        while True:
            inbox.put(pickle.load(source))
    finally:
        os._exit(0)


def _send(sink: BinaryIO, message: Any) -> None:
    pickle.dump(message, sink)
    sink.flush()
