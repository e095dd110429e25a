"""Where a result comes from: versions, the processor, the commit."""

import functools
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

# The distributions whose versions may change a result.
_DISTRIBUTIONS = ("torchmesh-untangle", "torch", "numpy", "scipy", "gmsh", "mfem", "mouette", "scikit-fem")


@functools.cache
def versions() -> dict[str, str]:
    """The versions of Python and of what is installed, by name of the distribution."""
    found = {"python": platform.python_version()}
    for name in _DISTRIBUTIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


@functools.cache
def processor() -> str:
    """The name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine() or "unknown processor"


@functools.cache
def commit() -> str:
    """The commit of the checkout that this is, with "+" if tracked files differ from it; "" in an installation."""
    root = Path(__file__).parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        head = _git(root, "rev-parse", "--short=12", "HEAD")
        return head + ("+" if _git(root, "status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.SubprocessError):
        return ""


def _git(root: Path, *arguments: str) -> str:
    done = subprocess.run(["git", "-C", str(root), *arguments], capture_output=True, text=True, check=True, timeout=20)
    return done.stdout.strip()


def provenance() -> dict[str, Any]:
    """Versions, processor, operating system, kernels and commit, as plain values for a record."""
    from ..kernels.library import kernels_in_use

    return {
        "versions": versions(),
        "processor": processor(),
        "system": platform.platform(terse=True),
        "kernels": kernels_in_use(),
        "commit": commit(),
    }
