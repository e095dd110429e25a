"""One run at a time in a folder of results."""

import contextlib
import errno
import shutil
from collections.abc import Iterator
from pathlib import Path

from ..errors import MeshIOError

# Files that are being written lie in this folder below the folder of results, and the lock file is named after it.
STAGING = ".torchmesh-run"

# What the system says of a file system that has no locks.  A run goes on there without one.
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP}


@contextlib.contextmanager
def locked_folder(out: Path, *names: str) -> Iterator[None]:
    """Inside, the folder exists and no other run writes to it; nothing of what a killed run was writing is left.

    names  the files in the folder that the run itself will write

    The system gives up the lock of a process that ends, however it ends.  Raises MeshIOError if another run has the
    lock, if the folder cannot be written, or if a file of the run itself is a link, which would lead out of the folder.
    """
    refuse_links(out, STAGING, f"{STAGING}.lock", *names)
    # Worker processes import this package too, and do not need it.
    from filelock import FileLock, Timeout

    staging, path = out / STAGING, out / f"{STAGING}.lock"
    # A generator that is closed late may be finished by another thread, which has to give up the lock too.
    lock = FileLock(path, timeout=0, thread_local=False)
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        text = f"{out}: another run is writing to this folder; wait for its end, or take another folder"
        raise MeshIOError(text) from None
    except NotImplementedError:
        pass
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise MeshIOError(f"{out}: cannot be written: {error.strerror or error}") from None
    try:
        shutil.rmtree(staging, ignore_errors=True)
        yield
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        # The file is removed before the lock is given up: a run that has opened it meanwhile sees that and is refused.
        with contextlib.suppress(OSError):  # on Windows an open file stays, and `release` removes it
            path.unlink()
        lock.release()


def refuse_links(out: Path, *names: str) -> None:
    """Raises MeshIOError if one of these files in the folder is a symbolic link: what it leads to is not ours."""
    for name in names:
        if (out / name).is_symlink():
            raise MeshIOError(f"{out / name}: is a symbolic link, which a run does not follow; remove it")
