"""The formats that torchmesh reads and writes, by name and by extension."""

import difflib
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
from .selafin import SELAFIN
from .sms import SMS
from .su2 import SU2
from .triangle import TRIANGLE
from .unv import UNV
from .vtk import VTK
from .vtkhdf import VTKHDF
from .vtm import VTM
from .vtu import VTP, VTU
from .xdmf import XDMF

_ALL = (
    VTU,
    VTP,
    VTK,
    VTKHDF,
    VTM,
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
    SELAFIN,
    COMSOL,
    UNV,
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


# What files with extensions of other kinds are, and which format would do.
_HINTS = {
    **dict.fromkeys((".vts", ".vtr", ".vti"), "a structured grid; save it as .vtu"),
    **dict.fromkeys((".pvtu", ".pvtp"), "a list of pieces; give a piece, or save all as one .vtu"),
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), "arrays that belong to an .xdmf file; give that"),
    **dict.fromkeys((".geo", ".brep", ".step", ".stp", ".iges", ".igs"), "a geometry; mesh it and save it as .msh"),
    **dict.fromkeys((".npy", ".npz", ".pt"), "arrays; make a mesh of them by MeshBatch.from_arrays"),
    **dict.fromkeys((".cas", ".neu", ".ccm", ".foam"), "a mesh of a flow solver; save it as .su2 or .vtu"),
    **dict.fromkeys((".jou", ".edp", ".py", ".m"), "a program; run it and save its mesh as .msh or .vtu"),
    ".cgns": "not read; Gmsh reads it: save it as .msh",
    ".gmsh": "perhaps Gmsh's; give it the extension .msh",
}  # fmt: skip


def _formats_of(path: Path) -> list[Format]:
    suffix = path.suffix.lower()
    found = [form for form in FORMATS.values() if suffix in form.extensions]
    if not found:
        problem = f"the extension {path.suffix!r} is not known" if suffix else "it has no extension to tell its format"
        known = known_extensions()
        near = difflib.get_close_matches(suffix, known, 1, 0.7)
        hint = _HINTS.get(suffix, f"the nearest one is {near[0]}" if near else "")
        beside = next((p.name for p in (path.with_suffix(".xdmf"),) if suffix and "xdmf" in hint and p.is_file()), "")
        hint = f"{hint} ({beside})" if beside else hint
        raise MeshIOError(f"{path}: {problem}{': ' if hint else ''}{hint}; known ones are {' '.join(known)}")
    return found
