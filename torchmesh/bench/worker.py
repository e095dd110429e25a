"""A process that runs methods, so that one that crashes or does not end costs its row and nothing else."""

import multiprocessing
import multiprocessing.connection
import os
import signal
import time
from collections.abc import Callable
from typing import Any


class Worker:
    """A forked process that answers calls of `function` one at a time; it is started anew where it ended.

    Where processes cannot be forked, the calls are made in this one, without a limit of time.
    """

    def __init__(self, function: Callable[..., dict[str, Any]]) -> None:
        self._function = function
        self._process: Any = None
        self._pipe: Any = None

    def call(self, seconds: float, *arguments: Any) -> dict[str, Any]:
        """What the function returns, or `{"fault": ...}` if that took longer than `seconds` or ended the process."""
        if "fork" not in multiprocessing.get_all_start_methods():
            return self._function(*arguments)
        if self._process is None:
            self._start()
        self._pipe.send(arguments)
        until = time.monotonic() + seconds
        while not self._pipe.poll(min(0.5, max(0.0, until - time.monotonic()))):
            if time.monotonic() >= until:
                self.stop()
                return {"fault": f"stopped after {seconds:g} seconds"}
            if not self._process.is_alive():
                break
        try:
            answer: dict[str, Any] = self._pipe.recv()
        except (EOFError, OSError):
            self._process.join(5)
            code = self._process.exitcode
            self.stop()
            return {"fault": f"the process ended with status {code}"}
        return answer

    def _start(self) -> None:
        context = multiprocessing.get_context("fork")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, self._pipe, self._function))
        self._process.start()
        theirs.close()

    def stop(self) -> None:
        """End the process and the processes that it started."""
        if self._process is not None:
            if self._process.is_alive():
                # The process leads a group of its own (see `_serve`).
                for number in (signal.SIGTERM, signal.SIGKILL):
                    try:
                        os.killpg(self._process.pid, number)
                    except (ProcessLookupError, PermissionError):
                        self._process.kill()
                    self._process.join(2)
                    if not self._process.is_alive():
                        break
            self._pipe.close()
        self._process = self._pipe = None

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def _serve(pipe: Any, other_end: Any, function: Callable[..., dict[str, Any]]) -> None:
    """Answer calls until the other side is gone."""
    other_end.close()
    os.setpgrp()
    # The one that started this process ends it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    while True:
        try:
            arguments = pipe.recv()
        except (EOFError, OSError):
            return
        pipe.send(function(*arguments))
