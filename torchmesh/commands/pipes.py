"""Meshes through pipes: `-` in place of a file stands for standard input or output, and --format says what flows there.

    cat tangled.vtu | torchmesh improve - - --format vtu | torchmesh quality - --format vtu

A mesh format is read and written as a file, so that what flows is kept in a temporary folder meanwhile.  Tables go to
standard error where the mesh goes to standard output.

Nothing here imports torch before it is needed.
"""

import contextlib
import functools
import inspect
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from . import console
from .errors import UsageError

PIPE = Path("-")

FormatOption = Annotated[
    str | None,
    typer.Option(
        "--format",
        metavar="EXT",
        help="With - for IN or OUT (standard input and output): the extension of the format, as vtu; "
        "or EXT,EXT for IN and OUT.",
        show_default=False,
    ),
]


def with_pipes(command: Callable[..., int]) -> Callable[..., int]:
    """The command with the option --format, and with files in place of `-` in its arguments source, sources, target."""

    @functools.wraps(command)
    def piped(*, file_format: str | None = None, **arguments: Any) -> int:
        given = [arguments.get("source"), *(arguments.get("sources") or [])]
        reads, writes = given.count(PIPE), arguments.get("target") == PIPE
        if not reads and not writes:
            if file_format is not None:
                raise UsageError("--format goes with - in place of a file")
            return command(**arguments)
        if reads > 1:
            raise UsageError("- stands for standard input once")
        source, target = _extensions(file_format, bool(reads), writes)
        with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
            folder = Path(name)
            if reads:
                read = folder / f"standard-input{source}"
                read.write_bytes(sys.stdin.buffer.read())
                console.call_it(read, "-")
                if arguments.get("source") == PIPE:
                    arguments["source"] = read
                if "sources" in arguments:
                    arguments["sources"] = [read if path == PIPE else path for path in arguments["sources"]]
            if writes:
                written = arguments["target"] = folder / f"standard-output{target}"
                console.call_it(written, "-")
                stack.enter_context(console.tables_on_stderr())
            status = command(**arguments)
            if writes and written.exists():
                _pour(written)
        return status

    parameters = inspect.signature(command).parameters
    extra = inspect.Parameter("file_format", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=FormatOption)
    piped.__signature__ = inspect.Signature([*parameters.values(), extra])  # type: ignore[attr-defined]
    piped.__annotations__ = {**command.__annotations__, "file_format": FormatOption}
    return piped


def _extensions(file_format: str | None, reads: bool, writes: bool) -> tuple[str, str]:
    """The extensions of what flows in and out; raises UsageError without --format."""
    words = [f".{word.strip().lstrip('.')}" for word in (file_format or "").split(",") if word.strip(" .")]
    if not words or len(words) > 1 + (reads and writes):
        raise UsageError("- needs --format EXT, as --format vtu" + (" (or EXT,EXT)" if reads and writes else ""))
    return words[0], words[-1]


def _pour(path: Path) -> None:
    """What a file holds goes to standard output, as it is."""
    sys.stdout.flush()
    out = sys.stdout.buffer
    with open(path, "rb") as stream:
        for block in _blocks(stream.read):
            out.write(block)
    out.flush()


def _blocks(read: Callable[[int], bytes]) -> Iterator[bytes]:
    while block := read(1 << 20):
        yield block
