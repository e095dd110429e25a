"""The formats that torchmesh reads and writes, by name and by extension."""

import difflib
import functools
import importlib
from collections.abc import Iterator, Mapping
from pathlib import Path

from ...errors import MeshIOError
from .format import Document, Format

# For each format the module that has it and the extensions of its files, in the order in which they are tried.  A
# module is loaded when a file of its format is read or written: all together would take longer than most files.
_MODULES: dict[str, tuple[str, tuple[str, ...]]] = {
    "vtu": ("vtu", (".vtu",)),
    "vtp": ("vtu", (".vtp",)),
    "vtk": ("vtk", (".vtk",)),
    "vtkhdf": ("vtkhdf", (".vtkhdf",)),
    "vtm": ("vtm", (".vtm",)),
    "gmsh": ("gmsh", (".msh",)),
    "xdmf": ("xdmf", (".xdmf", ".xmf")),
    "obj": ("obj", (".obj",)),
    "off": ("meshio_formats", (".off",)),
    "stl": ("meshio_formats", (".stl",)),
    "ply": ("meshio_formats", (".ply",)),
    "su2": ("su2", (".su2",)),
    "exodus": ("exodus", (".e", ".exo", ".ex2")),
    "mdpa": ("kratos", (".mdpa",)),
    "nastran": ("nastran", (".bdf", ".fem", ".nas")),
    "abaqus": ("abaqus", (".inp",)),
    "medit": ("meshio_formats", (".mesh", ".meshb")),
    "med": ("med", (".med",)),
    "permas": ("meshio_formats", (".post", ".dato")),
    "netgen": ("meshio_formats", (".vol",)),
    "avsucd": ("meshio_formats", (".avs",)),
    "tecplot": ("meshio_formats", (".dat", ".tec")),
    "h5m": ("meshio_formats", (".h5m",)),
    "hmf": ("meshio_formats", (".hmf",)),
    "dolfin-xml": ("meshio_formats", (".xml",)),
    "freefem": ("freefem", (".freefem", ".msh")),
    "mfem": ("mfem", (".mfem", ".mesh")),
    "triangle": ("triangle", (".node", ".ele", ".poly")),
    "adcirc": ("adcirc", (".14", ".grd", ".gr3", ".ll")),
    "sms": ("sms", (".2dm",)),
    "selafin": ("selafin", (".slf", ".sel", ".selafin")),
    "comsol": ("comsol", (".mphtxt",)),
    "unv": ("unv", (".unv",)),
    "cgns": ("cgns", (".cgns",)),
}


@functools.cache
def _loaded(name: str) -> Format:
    """The format of that name, from its module."""
    module = importlib.import_module(f".{_MODULES[name][0]}", __package__)
    every = [v for value in vars(module).values() for v in (value if isinstance(value, tuple) else (value,))]
    found = [v for v in every if isinstance(v, Format) and v.name == name]
    if not found:
        raise LookupError(f"{module.__name__} makes no object of its `Format` that is named {name!r}")
    return found[0]


class _Formats(Mapping[str, Format]):
    """All formats by name; each is loaded when it is asked for."""

    def __getitem__(self, name: str) -> Format:
        if name not in _MODULES:
            raise KeyError(name)
        return _loaded(name)

    def __iter__(self) -> Iterator[str]:
        return iter(_MODULES)

    def __len__(self) -> int:
        return len(_MODULES)


FORMATS: Mapping[str, Format] = _Formats()


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
        if head.startswith(b"$MeshFormat") and candidates[0].name != "gmsh":
            raise MeshIOError(f"{path}: it is one of Gmsh's files; give it the extension .msh")
    return candidates[0]


def known_extensions() -> list[str]:
    """All extensions, in the order of the table of formats."""
    return list(dict.fromkeys(extension for _, extensions in _MODULES.values() for extension in extensions))


# What files with extensions of other kinds are, and which format would do.
_HINTS = {
    **dict.fromkeys((".vts", ".vtr", ".vti"), "a structured grid; save it as .vtu"),
    **dict.fromkeys((".pvtu", ".pvtp", ".vtpc", ".vtpd"), "a list of pieces; give a piece, or save all as one .vtu"),
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), "arrays that belong to an .xdmf file; give that"),
    **dict.fromkeys((".geo", ".brep", ".step", ".stp", ".iges", ".igs"), "a geometry; mesh it and save it as .msh"),
    **dict.fromkeys((".npy", ".npz", ".pt"), "arrays; make a mesh of them by MeshBatch.from_arrays"),
    **dict.fromkeys((".cas", ".neu", ".ccm", ".foam"), "a mesh of a flow solver; save it as .su2 or .vtu"),
    **dict.fromkeys((".jou", ".edp", ".py", ".m"), "a program; run it and save its mesh as .msh or .vtu"),
    ".gmsh": "perhaps Gmsh's; give it the extension .msh",
}  # fmt: skip


def _formats_of(path: Path) -> list[Format]:
    suffix = path.suffix.lower()
    found = [FORMATS[name] for name, (_, extensions) in _MODULES.items() if suffix in extensions]
    if not found:
        problem = f"the extension {path.suffix!r} is not known" if suffix else "it has no extension to tell its format"
        known = known_extensions()
        near = difflib.get_close_matches(suffix, known, 1, 0.7)
        hint = _HINTS.get(suffix, f"the nearest one is {near[0]}" if near else "")
        if suffix and "xdmf" in hint and (beside := path.with_suffix(".xdmf")).is_file():
            hint = f"{hint} ({beside.name})"
        raise MeshIOError(f"{path}: {problem}{': ' if hint else ''}{hint}; known ones are {' '.join(known)}")
    return found
