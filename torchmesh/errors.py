"""What can go wrong, as types: every error a caller may want to catch is a `MeshError`."""


class MeshError(Exception):
    """Anything torchmesh raises on purpose."""


class InvalidMeshError(MeshError, ValueError):
    """The arrays given are not a planar triangle mesh; says which mesh, which row and why."""


class MeshIOError(MeshError, OSError):
    """A file could not be read or written; says which file and why."""


class ConvergenceError(MeshError, RuntimeError):
    """Some meshes did not reach the state that was asked for; names them."""


class MissingDependencyError(MeshError, ImportError):
    """An optional package is not installed; names the extra that brings it."""


class MeshWarning(UserWarning):
    """The input was accepted, but only after a repair or with something worth knowing."""


def what_failed(error: Exception) -> str:
    """The type of an error and what it says, in one line of at most 200 characters."""
    text = f"{type(error).__name__}: {' '.join(str(error).split())}".removesuffix(": ")
    return text if len(text) <= 200 else f"{text[:197]}..."
