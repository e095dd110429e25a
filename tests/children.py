"""Python programs started as child processes, for tests that send them signals.

A child inherits from its parent which signals are ignored.  A script that runs the tests in its background has SIGINT
ignored, and a child that ignores it cannot be interrupted: so the children start with the default disposition.
"""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

# A module that every Python process runs at its start: it interrupts the process when a module is about to be imported.
TRAP = """
import os, signal, sys
class Trap:
    def find_spec(self, name, path=None, target=None):
        if name == {name!r}:
            sys.meta_path.remove(self)
            for _ in range({times}):
                os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Trap())
"""


def interrupted_at(name: str, folder: Path, times: int = 1) -> str:
    """The PYTHONPATH of processes that are interrupted when they import a module; the trap lies in the folder."""
    (folder / "sitecustomize.py").write_text(TRAP.format(name=name, times=times))
    return os.pathsep.join([str(folder), *sys.path])


@contextlib.contextmanager
def started(*arguments: object, sigint_ignored: bool = False, **options) -> Iterator[subprocess.Popen]:
    """Inside, a child `python *arguments` is there; at the end it is killed if it still runs.

    sigint_ignored  start it as a script starts a job in its background
    options         as for `subprocess.Popen`; with `text=True` and both streams in pipes unless they say otherwise
    """
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | options
    # A new program resets handlers to the default and inherits what is ignored.
    before = signal.signal(signal.SIGINT, signal.SIG_IGN if sigint_ignored else signal.default_int_handler)
    try:
        child = subprocess.Popen([sys.executable, *map(str, arguments)], **options)
    finally:
        signal.signal(signal.SIGINT, before)
    with child:
        try:
            yield child
        finally:
            child.kill()
