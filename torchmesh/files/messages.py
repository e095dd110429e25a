"""Warnings that point to the line of the caller, and errors of other libraries as errors of torchmesh."""

import contextlib
import io
import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import MeshError, MeshIOError, MeshWarning, MissingDependencyError

# Remarks of meshio that are of no interest, or about what was done on purpose.
_NOISE = re.compile(
    r"only meant for debugging|64-bit integers|legacy format|Experimental file|converting to|Converting them to|^\s*$"
    r"|Discarding \.$"
)

_PACKAGE = str(Path(__file__).parents[1])


def warn(text: str) -> None:
    """A MeshWarning that points to the first line outside of torchmesh that led to it."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_code.co_filename.startswith((_PACKAGE, contextlib.__file__)):
        level, frame = level + 1, frame.f_back
    warnings.warn(MeshWarning(text), stacklevel=level)


def printable(value: Any) -> Any:
    """The text with escapes for what UTF-8 does not have, in lists too; anything else as it is.

    Names of files may be any bytes on Linux.  Python's text has surrogates for those bytes that are not UTF-8.
    """
    if isinstance(value, list):
        return [printable(item) for item in value]
    if not isinstance(value, str):
        return value
    try:
        return value.encode(errors="surrogateescape").decode(errors="backslashreplace")
    except UnicodeEncodeError:  # surrogates that stand for no bytes
        return value.encode(errors="backslashreplace").decode()


# Characters of an error about a file at most, and of the file's name in it.
_LONGEST, _LONGEST_NAME = 300, 180


def about(path: Path, text: str) -> str:
    """One line of at most 300 characters about a file: its name, a colon, and the text, in which nothing is control.

    A name of more than 180 characters loses its middle; the text loses its end.
    """
    name = str(path)
    if len(name) > _LONGEST_NAME:
        name = f"{name[: _LONGEST_NAME // 3]}...{name[3 - 2 * _LONGEST_NAME // 3 :]}"
    text = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    left = _LONGEST - len(name) - 2
    return f"{name}: {text if len(text) <= left else text[: left - 3] + '...'}"


@contextlib.contextmanager
def in_one_line(path: Path) -> Iterator[None]:
    """Inside, errors about a file become one line of at most 300 characters.

    What is no MeshError becomes one: a file can hold what no reader has foreseen.
    """
    try:
        yield
    except (MeshError, OSError) as error:
        text = str(error).removeprefix(f"{path}: ")
        line = about(path, text)
        if not isinstance(error, MeshError) or line == str(error) or str(path) not in str(error):
            raise
        raise type(error)(line) from None
    except Exception as error:
        text = f"it has what is not understood ({type(error).__name__}: {error}); {_ADVICE}"
        raise MeshIOError(about(path, text)) from None


# Characters of what a library says, of which more is seldom of use.
_LONGEST_REASON = 150

# What to do with a file that cannot be read.
_ADVICE = "write it anew, or as .vtu"


@contextlib.contextmanager
def translated(path: Path, verb: str, form: str) -> Iterator[None]:
    """Inside, a library prints nothing and raises nothing foreign.

    Its remarks become MeshWarnings, its exceptions a MeshIOError of one line that names the file.  meshio prints its
    remarks, and calls sys.exit after some of them.

    verb  "read" or "write"
    form  the name of the format
    """
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with np.errstate(all="ignore"):
                yield
    except (MeshError, PermissionError):
        raise
    except ImportError as error:
        package = (error.name or "a package").split(".")[0]
        wheel = "'torchmesh-untangle[exodus]'" if package == "netCDF4" else package
        raise MissingDependencyError(
            f"{path}: {form} files need the package {package}; install it (pip install {wheel})"
        ) from None
    except (Exception, SystemExit) as error:
        what = f"read as {form}" if verb == "read" else "written"
        reason = _reason(error, said.getvalue(), verb)
        advice = f"; {_ADVICE}" if verb == "read" else ""
        if len(reason) > _LONGEST_REASON:
            reason = f"{reason[:_LONGEST_REASON]}..."
        raise MeshIOError(about(path, f"cannot be {what}: {reason}{advice}")) from None
    for remark in re.split(r"(?:Warning|Info|Error):", said.getvalue()):
        remark = " ".join(remark.split())
        if not _NOISE.search(remark):
            warn(about(path, remark))


def _reason(error: BaseException, said: str, verb: str) -> str:
    """In one line, what an exception and what was printed before it say."""
    if isinstance(error, OSError) and error.errno and error.strerror:
        return error.strerror
    text = " ".join(str(error).split()) if not isinstance(error, SystemExit) else ""
    if isinstance(error, LookupError | AssertionError | UnboundLocalError | AttributeError):
        # The text of such an exception is of no use without its type: the reader met what it did not expect.
        return f"{type(error).__name__} {text}".strip() + (": the file is damaged or unusual" if verb == "read" else "")
    return text or " ".join(said.split()) or type(error).__name__
