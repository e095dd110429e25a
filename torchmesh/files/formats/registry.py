"""The formats that torchmesh reads and writes, by name and by extension."""

from pathlib import Path

from ...errors import MeshIOError
from .abaqus import ABAQUS
from .adcirc import ADCIRC
from .comsol import COMSOL
from .exodus import EXODUS
from .format import Document, Format
from .freefem import FREEFEM
from .gmsh import GMSH
from .kratos import KRATOS
from .meshio_formats import SOLVER_FORMATS, SURFACE_FORMATS
from .mfem import MFEM
from .nastran import NASTRAN
from .obj import OBJ
from .sms import SMS
from .su2 import SU2
from .triangle import TRIANGLE
from .vtk import VTK
from .vtu import VTU
from .xdmf import XDMF

_ALL = (
    VTU,
    VTK,
    GMSH,
    XDMF,
    OBJ,
    *SURFACE_FORMATS,
    SU2,
    EXODUS,
    KRATOS,
    NASTRAN,
    ABAQUS,
    *SOLVER_FORMATS,
    FREEFEM,
    MFEM,
    TRIANGLE,
    ADCIRC,
    SMS,
    COMSOL,
)

FORMATS: dict[str, Format] = {form.name: form for form in _ALL}


def format_of(path: Path, like: Document | None = None) -> Format:
    """The format that a file with this extension is written in.  Raises MeshIOError for an unknown extension.

    Where several formats share the extension, it is that of `like`, the file that is followed, if it is one of them.
    """
    found = _formats_of(path)
    return next((form for form in found if like is not None and form.name == like.format), found[0])


def format_in(path: Path) -> Format:
    """The format that an existing file is in.  Raises MeshIOError for an unknown extension, OSError.

    Where several formats share the extension, the first that recognises the beginning of the file is taken.
    """
    candidates = _formats_of(path)
    if len(candidates) > 1:
        with open(path, "rb") as stream:
            head = stream.read(4096)
        candidates = [form for form in candidates if form.recognises(head)] or candidates
    return candidates[0]


def known_extensions() -> list[str]:
    """All extensions, in the order of the table of formats."""
    return list(dict.fromkeys(extension for form in FORMATS.values() for extension in form.extensions))


def _formats_of(path: Path) -> list[Format]:
    found = [form for form in FORMATS.values() if path.suffix.lower() in form.extensions]
    if not found:
        problem = f"the extension {path.suffix!r} is not known"
        problem = problem if path.suffix else "it has no extension to tell its format"
        raise MeshIOError(f"{path}: {problem}; known ones are {' '.join(known_extensions())}")
    return found
