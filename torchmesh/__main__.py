"""Where the program begins: `python -m torchmesh` and the command `torchmesh`.

An interrupt ends the program in one line with status 130 from here on, also while a library is being imported, which
takes about a second.  Therefore the first act is to handle the signal, and nothing else is imported before.

A process that was started with SIGINT ignored goes on ignoring it, as is the custom: a shell starts jobs in the
background of a script that way, so that an interrupt meant for another program does not end them.
"""

import contextlib
import os
import signal
import sys
import time
from types import FrameType

INTERRUPTED = 130

# Seconds after an interrupt in which another one is taken for the same: `timeout` and terminals may send it twice.
_SAME = 1.0

_PACKAGE = os.path.dirname(os.path.abspath(__file__)) + os.sep


class Interrupt:
    """The handler of SIGINT.

    While modules are imported on behalf of a command it ends the process at once, because libraries catch what is
    raised in the midst of their import.  Everywhere else it raises KeyboardInterrupt, so that files that are being
    written and processes that were started are removed.  A second interrupt ends the process at once.
    """

    def __init__(self) -> None:
        self.at: float | None = None

    def __call__(self, number: int, frame: FrameType | None) -> None:
        now, first = time.monotonic(), self.at is None
        if not first and now - (self.at or now) < _SAME:
            return
        self.at = now
        if not first or _only_importing(frame):
            _say()
            os._exit(INTERRUPTED)
        raise KeyboardInterrupt


def main() -> int:
    """Run the command line and return its exit status."""
    interrupt = Interrupt()
    # Handlers belong to the main thread, and to whoever has set another one than Python's own.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, interrupt)
    try:
        from .commands.main import main as run

        return run()
    except BaseException:
        # An interrupt that a library has turned into another error is an interrupt all the same.
        if interrupt.at is None:
            raise
        _say()
        # Python remembers an interrupt that came while the source of a string ran (libraries make records that way),
        # even if it was handled, and would end this process by the signal.  It forgets it when another string is run.
        exec("")
        return INTERRUPTED
    finally:
        if signal.getsignal(signal.SIGINT) is interrupt:
            signal.signal(signal.SIGINT, signal.SIG_IGN)  # the work is done, and its status is known


def _say() -> None:
    with contextlib.suppress(OSError):
        os.write(2, b"interrupted\n")


def _only_importing(frame: FrameType | None) -> bool:
    """Whether a module is being imported and no function of the package, but those of commands, waits for it.

    Nothing has then been started that would have to be removed.
    """
    importing = False
    while frame is not None:
        file, name = frame.f_code.co_filename, frame.f_code.co_name
        importing |= file.startswith("<frozen importlib")
        if file.startswith(_PACKAGE) and name != "<module>":
            inside = file[len(_PACKAGE) :]
            if os.sep in inside and not inside.startswith(f"commands{os.sep}"):
                return False
        frame = frame.f_back
    return importing


if __name__ == "__main__":
    sys.exit(main())
