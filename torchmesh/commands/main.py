"""The command line: its commands, how errors are shown, and the exit status.

Tables go to standard output; progress, warnings and errors go to standard error.
Exit status 0: every mesh valid; 1: some mesh has inverted triangles; 2: bad input or usage, told in one line that
begins with `error:`; 130: interrupted; 141: nobody reads standard output any more.  A command that fails leaves no
file behind.  SIGTERM ends it.  `torchmesh.__main__` handles interrupts and calls `main`.

Whatever takes long to import is imported inside the functions of the commands, so that `--help` answers at once.
"""

import contextlib
import errno
import inspect
import os
import sys
from collections.abc import Callable
from typing import Annotated

import typer

from ..kernels.library import kernels_in_use
from . import animate, batch, bench, clean, console, example, generate, improve, info, quality, report, reproduce, warp
from .errors import ClickException
from .pipes import with_pipes

INTERRUPTED, UNREAD = 130, 141

# What the system says where a stream takes no more.  Errors about files have the name of the file; streams have none.
_STREAM_ERRORS = (errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)

app = typer.Typer(
    name="torchmesh",
    help="Untangle planar triangle meshes and give their triangles good shapes.",
    epilog="[dim]Start here:[/]  torchmesh example, and torchmesh improve tangled.vtu better.vtu --plot p.png"
    "\n\n[dim]Exit status:[/]  0 every mesh valid, 1 some mesh has inverted triangles, 2 bad input or usage",
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit status."""
    arguments = sys.argv[1:] if arguments is None else arguments
    console.open_streams()
    try:
        with console.warnings_as_lines():
            status = app(arguments or ["--help"], prog_name="torchmesh", standalone_mode=False)
        if status == INTERRUPTED:
            raise KeyboardInterrupt
        sys.stdout.flush()
        return (status or 0) if arguments else 2
    except (KeyboardInterrupt, typer.Abort):
        console.say("interrupted")
        return INTERRUPTED
    except SystemExit as error:
        if not isinstance(error.__context__, BrokenPipeError):
            raise
        _give_up_stdout()
        return UNREAD  # click would end with status 1, which means inverted triangles
    except ClickException as error:
        context = getattr(error, "ctx", None)
        hint = f" (see {context.command_path} --help)" if context else ""
        console.say(f"error: {error.format_message()}{hint}")  # type: ignore[attr-defined]
    except MemoryError:
        console.say("error: there is not enough memory for this mesh")
    except Exception as error:
        from ..errors import MeshError

        if not isinstance(error, MeshError | OSError):
            raise
        if isinstance(error, OSError) and error.errno in _STREAM_ERRORS and error.filename is None:
            _give_up_stdout()
            if error.errno == errno.EPIPE:
                return UNREAD
            console.say(f"error: standard output cannot be written: {error.strerror}")
            return 2
        console.say(f"error: {error}")
    return 2


def _give_up_stdout() -> None:
    """Lets what standard output has not taken vanish, so that Python does not try again when it ends."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"torchmesh {console.version()}, {kernels_in_use()} kernels")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


def _register(
    function: Callable,
    examples: tuple[str, ...],
    *,
    pipes: bool = False,
    under: typer.Typer = app,
    name: str | None = None,
) -> None:
    """Makes a function a command: its docstring is the help text, and the examples stand below the options.

    pipes  may `-` stand for standard input and output
    under  the group that it is a command of
    name   what it is called; None: as the function
    """
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    # Typer's versions differ in what they do with line breaks inside a paragraph, so there are none.
    text = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
    under.command(name, help=text, epilog="\n\n".join(["[dim]Examples:[/]", *examples]))(
        with_pipes(function) if pipes else function
    )


_register(improve.improve, improve.EXAMPLES, pipes=True)
_register(quality.quality, quality.EXAMPLES, pipes=True)
_register(clean.clean, clean.EXAMPLES, pipes=True)
_register(warp.warp, warp.EXAMPLES, pipes=True)
_register(reproduce.reproduce, reproduce.EXAMPLES)
_register(batch.batch, batch.EXAMPLES)
_register(generate.generate, generate.EXAMPLES)
_register(report.report, report.EXAMPLES)
_register(animate.animate, animate.EXAMPLES)

benchmark = typer.Typer(name="bench", help="Compare methods on a benchmark of tangled meshes.")
_register(bench.run, bench.RUN_EXAMPLES, under=benchmark)
_register(bench.show, bench.LIST_EXAMPLES, under=benchmark, name="list")
app.add_typer(benchmark)
_register(example.example, example.EXAMPLES)
_register(info.info, info.EXAMPLES, pipes=True)
