"""Mesh files as meshio meshes, whatever their format: what `io` needs to know about each.

A `Document` is one file read: meshio's mesh, and beside it what that type cannot hold.  Files are
read and written by meshio, but for .msh, .su2 and .obj, which have modules of their own.
"""

import base64
import contextlib
import importlib
import io
import os
import re
import shutil
import tempfile
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import meshio
import numpy as np

from ..errors import MeshError, MeshIOError, MeshWarning, MissingDependencyError
from . import gmsh as formats_gmsh
from . import gmsh_write as formats_gmsh_write
from . import obj
from . import su2 as formats_text


@dataclass(frozen=True)
class Format:
    """What a format can hold, as far as it matters here."""

    extensions: tuple[str, ...]
    cells: tuple[str, ...] = ("vertex", "line", "triangle", "quad", "polygon", "higher")
    point_data: bool = True
    cell_data: str = "all"  # "all", "one" (a single integer field) or "none"
    planar: bool = False  # points have two coordinates


_FLAT = ("triangle", "quad")


FORMATS = {
    "vtu": Format((".vtu",)),
    "vtk": Format((".vtk",)),
    "gmsh": Format((".msh",), ("vertex", "line", "triangle", "quad", "higher")),
    "xdmf": Format((".xdmf", ".xmf"), ("vertex", "line", "triangle", "quad", "higher")),
    "obj": Format((".obj",), ("line", "triangle", "quad", "polygon"), False, "one"),
    "off": Format((".off",), ("triangle",), False, "none"),
    "stl": Format((".stl",), ("triangle",), False, "none"),
    "ply": Format((".ply",), _FLAT, True, "none"),
    "su2": Format((".su2",), ("vertex", "line", *_FLAT), False, "one", planar=True),
    "medit": Format((".mesh", ".meshb"), ("line", *_FLAT), False, "one"),
    "med": Format((".med",), ("vertex", "line", *_FLAT, "higher")),
    "exodus": Format((".e", ".exo", ".ex2"), ("vertex", "line", *_FLAT, "higher"), True, "none"),
    "mdpa": Format((".mdpa",), ("line", *_FLAT), False, "none"),
    "nastran": Format((".bdf", ".fem", ".nas"), ("line", *_FLAT), False, "one"),
    "abaqus": Format((".inp",), ("line", *_FLAT, "higher"), False, "none"),
    "permas": Format((".post", ".dato"), ("line", *_FLAT), False, "none"),
    "netgen": Format((".vol",), ("line", *_FLAT), False, "one"),
    "avsucd": Format((".avs",), _FLAT, False, "one"),
    "tecplot": Format((".dat", ".tec"), ("triangle",), True, "none"),
    "h5m": Format((".h5m",), ("triangle",), False, "none"),
    "hmf": Format((".hmf",), ("triangle",), False, "none"),
    "dolfin-xml": Format((".xml",), ("triangle",), False, "none"),
}


# Integer cell data that names regions (materials, groups, entities) in some format.
REGION_TAGS = (
    "gmsh:physical", "gmsh:geometrical", "medit:ref", "su2:tag", "cell_tags", "CellEntityIds", "nastran:ref",
    "avsucd:material", "netgen:index", "obj:group_ids", "MaterialIDs", "MaterialIds", "material", "region",
)  # fmt: skip


_CANONICAL = {"obj": "obj:group_ids", "su2": "su2:tag", "medit": "medit:ref", "nastran": "nastran:ref",
              "netgen": "netgen:index", "avsucd": "avsucd:material"}  # fmt: skip


# What meshio remarks on that is either meant or of no interest.
_NOISE = re.compile(r"only meant for debugging|64-bit integers|legacy format|Experimental file|converting to|^\s*$")


_HIGHER = re.compile(r"^(line|quad)\d+$")


@dataclass(frozen=True)
class Document:
    """One mesh file: its mesh and what meshio's mesh type cannot hold."""

    mesh: meshio.Mesh
    format: str
    binary: bool | None = None
    rest: Any = None


def format_of(path: Path) -> str:
    """The format its extension stands for.  Raises MeshIOError for an unknown one."""
    for name, form in FORMATS.items():
        if path.suffix.lower() in form.extensions:
            return name
    known = " ".join(e for form in FORMATS.values() for e in form.extensions)
    what = f"the extension {path.suffix!r} is not known" if path.suffix else "it has no extension to tell its format"
    raise MeshIOError(f"{path}: {what}; known ones are {known}")


def is_series(path: Path) -> bool:
    """Does the file hold a time series, as `series` reads it."""
    if path.suffix.lower() not in FORMATS["xdmf"].extensions:
        return False
    with contextlib.suppress(OSError):
        return re.search(rb"CollectionType\s*=\s*[\"']Temporal", _bytes(path)) is not None
    return False


def load(path: Path) -> Document:
    """Reads a file.  Raises MeshIOError with one line, whatever is wrong with it."""
    try:
        if path.is_dir():
            raise MeshIOError(f"{path}: is a directory, not a mesh file")
        if not path.exists():
            raise MeshIOError(f"{path}: there is no such file")
        form = format_of(path)
        if path.stat().st_size == 0:
            raise MeshIOError(f"{path}: the file is empty")
        with reading(path, form):
            return _load(path, form)
    except MeshError:
        raise
    except OSError as error:
        raise MeshIOError(f"{path}: cannot be read: {error.strerror or error}") from None


def reading(path: Path, form: str) -> contextlib.AbstractContextManager[None]:
    """Inside, whatever goes wrong with the file becomes a MeshIOError of one line, and remarks MeshWarnings."""
    return _quiet(path, "read", form)


def _load(path: Path, form: str) -> Document:
    head = _bytes(path, 4096)
    name = str(path)
    rest: Any = None
    if form == "gmsh":
        mesh, rest = formats_gmsh.read(name)
        return Document(mesh, form, rest.binary if rest else None, rest)
    if form in ("su2", "obj"):
        mesh, rest = (formats_text.read_su2 if form == "su2" else obj.read_obj)(name)
        return Document(mesh, form, None, rest)
    binary = None
    if form == "vtu":
        if b"</VTKFile>" not in _bytes(path)[-500:]:
            raise ValueError("it does not end with </VTKFile>: truncated")
        binary = b'format="ascii"' not in head
    elif form == "ply":
        if b"end_header" not in _bytes(path):
            raise ValueError("its header has no end")
        binary = b"format ascii" not in head
    elif form == "stl":
        whole = _bytes(path)
        binary = len(whole) >= 84 and len(whole) == 84 + 50 * int.from_bytes(whole[80:84], "little")
        if not binary and b"endsolid" not in whole[-500:]:
            raise ValueError("it does not end with endsolid: truncated")
    elif form == "vtk":
        lines = head.split(b"\n", 3)
        binary = len(lines) > 2 and lines[2].strip().upper() == b"BINARY"
        rest = _VtkHead.of(_bytes(path))
    elif form == "permas" and b"$FIN" not in _bytes(path):
        raise ValueError("it does not end with $FIN: truncated")
    if is_series(path):
        raise ValueError("it is a time series: read it by read_series, improve it by torchmesh batch")
    reader = importlib.import_module(f"meshio.{form.removesuffix('-xml')}")
    if form in ("mdpa", "tecplot"):
        with _GuardedBytes(io.FileIO(name)) as stream:
            mesh = reader.read(stream if form == "mdpa" else _GuardedText(stream))
    else:
        mesh = reader.read(name)
    _check_counts(path, form, mesh)
    mesh.cell_data.pop("facet_normals", None)  # of stl, and GLOBAL_ID of h5m: meshio makes them anew
    mesh.point_data.pop("GLOBAL_ID", None)
    return Document(mesh, form, binary, rest)


def _bytes(path: Path, count: int = -1) -> bytes:
    with open(path, "rb") as stream:
        return stream.read(count)


class _Guard:
    """Refuses to be read past the file's end for ever, as some of meshio's readers would."""

    ends = 0

    def readline(self, size: int = -1) -> Any:
        line = super().readline(size)  # type: ignore[misc]
        self.ends += not line
        if self.ends > 100:
            raise ValueError("the file ends early")
        return line


class _GuardedBytes(_Guard, io.BufferedReader):  # type: ignore[misc]
    pass


class _GuardedText(_Guard, io.TextIOWrapper):  # type: ignore[misc]
    pass


def _check_counts(path: Path, form: str, mesh: meshio.Mesh) -> None:
    """Some of meshio's readers take a truncated file for a smaller one."""
    cells = None
    if form == "vtk":
        cells = re.search(rb"\nCELL_TYPES\s+(\d+)", _bytes(path))
    elif form == "ply":
        cells = re.search(rb"\nelement face\s+(\d+)", _bytes(path))
    read = sum(len(block) for block in mesh.cells)
    if cells and int(cells[1]) != read:
        raise ValueError(f"of its {int(cells[1])} cells only {read} could be read")


@contextlib.contextmanager
def _quiet(path: Path, verb: str, form: str) -> Iterator[None]:
    """Nothing printed, nothing foreign raised: remarks become MeshWarnings, exceptions MeshIOErrors.

    meshio prints its remarks, some ahead of sys.exit.
    """
    said = io.StringIO()
    kind = form if verb == "read" else f"{form} file"
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
        if isinstance(error, OSError) and error.errno and error.strerror:
            reason = error.strerror
        else:
            text = " ".join(str(error).split()) if not isinstance(error, SystemExit) else ""
            reason = text or " ".join(said.getvalue().split()) or type(error).__name__
            if isinstance(error, LookupError | AssertionError | UnboundLocalError | AttributeError):
                reason = f"{type(error).__name__} {text}".strip()
                reason += ": the file is damaged or unusual" if verb == "read" else ""
        raise MeshIOError(f"{path}: cannot be {'read as ' + kind if verb == 'read' else 'written'}: {reason}") from None
    for remark in re.split(r"(?:Warning|Info|Error):", said.getvalue()):
        remark = " ".join(remark.split())
        if not _NOISE.search(remark):
            warnings.warn(MeshWarning(f"{path}: {remark}"), stacklevel=5)


def save(path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
    """Writes `mesh` in the format of the path's extension, all or nothing.

    Text or binary, version and foreign content follow `like` where it has the same format; content
    tied to rows (`same_rows`: the mesh has the file's points and cells, row by row) only then.
    Raises MeshIOError; MeshWarning names what the format cannot hold.
    """
    form = format_of(path)
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise MeshIOError(f"{path}: is a directory")
    if not target.parent.is_dir():
        raise MeshIOError(f"{path}: the directory {target.parent} does not exist")
    if target.exists() and not target.is_file():
        raise MeshIOError(f"{path}: is not a regular file")
    like = like if like is not None and like.format == form else None
    mesh = _fitted(path, mesh, form)
    folder = None
    try:
        with _quiet(path, "write", form):
            # A directory of its own, in the same file system: whatever files a format makes are moved
            # into place when all of them are complete.
            folder = Path(tempfile.mkdtemp(prefix=".torchmesh-", dir=target.parent))
            _save(str(folder / target.name), form, mesh, like, same_rows)
            for made in sorted(folder.iterdir()):
                final = target.parent / made.name
                if final.exists():
                    shutil.copymode(final, made)
                os.replace(made, final)
    except PermissionError as error:
        raise MeshIOError(f"{path}: cannot be written: {error.strerror or 'permission denied'}") from None
    finally:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)


def _save(name: str, form: str, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
    binary = None if like is None else like.binary
    rest = None if like is None else like.rest
    if form == "gmsh":
        if rest is None or not same_rows:
            version = rest.version if rest else "4.1"
            mesh, rest = formats_gmsh_write.fresh(mesh, version, binary is None or binary, rest)
        formats_gmsh_write.write(name, mesh, rest)
    elif form == "su2":
        formats_text.write_su2(name, mesh, rest or [])
    elif form == "obj":
        obj.write_obj(name, mesh, rest if same_rows else None)
    elif form == "vtu":
        meshio.vtu.write(name, mesh, binary=True, compression=None if binary is False else "zlib")
        _finish_vtu(name, mesh.field_data, binary is False)
    elif form == "vtk":
        old = rest is not None and not rest.version.startswith("5")
        kind = "vtk42" if old else "vtk"
        meshio.write(name, mesh, file_format=kind, binary=binary is None or binary)
        if rest is not None:
            rest.put_into(name)
    elif form == "xdmf":
        meshio.xdmf.write(name, mesh, data_format="XML")
    elif form in ("med", "h5m", "hmf"):
        # HDF5 crashes the process when a disk is full: it writes to memory.
        memory = io.BytesIO()
        meshio.write(memory, mesh, file_format=form)
        Path(name).write_bytes(memory.getvalue())
    elif form in ("stl", "ply") and binary is not None:
        meshio.write(name, mesh, file_format=form, binary=binary)
    else:
        meshio.write(name, mesh, file_format=form)


def _fitted(path: Path, mesh: meshio.Mesh, form: str) -> meshio.Mesh:
    """The mesh without what the format cannot hold, which a MeshWarning names."""
    able = FORMATS[form]
    kept = [i for i, b in enumerate(mesh.cells) if ("higher" if _HIGHER.match(b.type) else b.type) in able.cells]
    lost = {f"{b.type} cells" for i, b in enumerate(mesh.cells) if i not in kept}
    cells = [mesh.cells[i] for i in kept]
    cell_data = {name: [values[i] for i in kept] for name, values in mesh.cell_data.items()}
    if able.cell_data != "all":
        tag = region_tag(mesh) if able.cell_data == "one" else None
        lost |= {f"cell data {name!r}" for name in cell_data if name not in (tag, "gmsh:geometrical")}
        cell_data = {_CANONICAL[form]: [v.astype(np.int64) for v in cell_data[tag]]} if tag else {}
    tag = region_tag(mesh)
    if form == "gmsh" and "gmsh:physical" not in cell_data and tag not in (None, "gmsh:geometrical"):
        cell_data["gmsh:physical"] = [v.astype(np.int64) for v in cell_data[tag]]
        if tag in REGION_TAGS:
            del cell_data[tag]
    point_data = dict(mesh.point_data)
    if not able.point_data:
        own = _CANONICAL.get(form)
        lost |= {f"point data {name!r}" for name in point_data if name != own}
        point_data = {name: v for name, v in point_data.items() if name == own}
    if form == "ply":
        lost |= {f"point data {name!r}" for name, v in point_data.items() if np.ndim(v) > 1}
        point_data = {name: v for name, v in point_data.items() if np.ndim(v) == 1}
        cells = [meshio.CellBlock(b.type, b.data.astype(np.int32)) for b in cells]
    if form not in ("vtk", "vtu", "abaqus"):
        lost |= {f"cell set {name!r}" for name in mesh.cell_sets}
    if form not in ("vtk", "vtu", "abaqus", "exodus"):
        lost |= {f"point set {name!r}" for name in mesh.point_sets}
    if form not in ("vtu", "gmsh", "su2", "netgen", "med"):
        lost |= {f"field data {name!r}" for name in mesh.field_data}
    points = mesh.points
    if able.planar:
        points = points[:, :2]
    if lost:
        warnings.warn(MeshWarning(f"{path}: {form} files do not hold {', '.join(sorted(lost))}; dropped"), stacklevel=4)
    held = {"cell_sets": {n: [s[i] for i in kept] for n, s in mesh.cell_sets.items()}, "point_sets": mesh.point_sets}
    fitted = meshio.Mesh(
        points, cells, point_data=point_data, cell_data=cell_data, field_data=dict(mesh.field_data),
        **(held if form in ("vtk", "vtu", "abaqus", "exodus") else {}), info=mesh.info,
    )  # fmt: skip
    # Readers leave more on the mesh than its type declares (med: the names of families).
    vars(fitted).update({name: value for name, value in vars(mesh).items() if name not in vars(fitted)})
    return fitted


def foreign(document: Document, form: str, same_rows: bool) -> list[str]:
    """What `save` in the format `form` leaves behind of the content that meshio's mesh cannot hold."""
    rest = document.rest
    if document.format == "gmsh" and rest is not None and not (form == "gmsh" and same_rows):
        known = ("MeshFormat", "PhysicalNames", "Entities", "Nodes", "Elements", "NodeData", "ElementData", "Comments")
        return [f"${name}" for name, _ in rest.sections if name not in known]
    if document.format == "obj" and not (form == "obj" and same_rows):
        words = {"vt": "texture coordinates", "vn": "normals", "mtllib": "materials"}
        return [text for word, text in words.items() if any(line.split()[:1] == [word] for line in rest.lines)]
    if document.format == "su2" and form != "su2":
        return [f"lines such as {line.strip()!r}" for line in rest if not line.lstrip().startswith("%")][:1]
    if document.format == "vtk" and form != "vtk" and rest.fields.startswith(b"FIELD"):
        return ["the field data"]
    return []


def region_tag(mesh: meshio.Mesh) -> str | None:
    """The integer cell data that stands for the regions where there is room for one."""
    whole = [name for name, v in mesh.cell_data.items() if all(b.dtype.kind in "iub" and b.ndim == 1 for b in v)]
    return next((name for name in REGION_TAGS if name in whole), whole[0] if whole else None)


def _finish_vtu(name: str, field_data: dict[str, Any], text: bool) -> None:
    """What meshio leaves to do: the field data, and text with all its digits (meshio's has eleven)."""
    if not text and not field_data:
        return
    tree = ET.parse(name)
    if text:
        for array in tree.iter("DataArray"):
            raw = base64.b64decode((array.text or "").strip())
            kind = meshio.vtu._vtu.vtu_to_numpy_type[array.get("type")]
            header = meshio.vtu._vtu.vtu_to_numpy_type[tree.getroot().get("header_type", "UInt32")]
            values = np.frombuffer(raw, kind, offset=np.dtype(header).itemsize)
            array.set("format", "ascii")
            array.text = " ".join(map(repr, values.tolist()))
    grid = tree.getroot().find("UnstructuredGrid")
    fields = ET.Element("FieldData")
    for key, value in field_data.items():
        flat = np.asarray(value)
        if flat.dtype.kind in "iuf" and flat.size:
            kind = meshio.vtu._vtu.numpy_to_vtu_type[flat.dtype]
            array = ET.SubElement(fields, "DataArray", type=kind, Name=key, format="ascii")
            array.set("NumberOfTuples", str(len(flat.reshape(-1))))
            array.text = " ".join(map(repr, flat.reshape(-1).tolist()))
    if grid is not None and len(fields):
        grid.insert(0, fields)
    tree.write(name, xml_declaration=True, encoding="utf-8")


@dataclass(frozen=True)
class _VtkHead:
    """A legacy VTK file's version, title, and field data, which meshio passes over."""

    version: str
    title: bytes
    binary: bool
    fields: bytes

    @classmethod
    def of(cls, data: bytes) -> "_VtkHead":
        lines = data.split(b"\n", 3)
        if len(lines) < 4:
            raise ValueError("its header is cut short")
        between = re.search(rb"\nDATASET\s+UNSTRUCTURED_GRID\s*?\n(.*?)(?:^|\n)POINTS ", data, re.S)
        version = lines[0].split()[-1].decode(errors="replace")
        return cls(version, lines[1], lines[2].strip().upper() == b"BINARY", between[1] if between else b"")

    def put_into(self, name: str) -> None:
        data = _bytes(Path(name))
        version, _, mode, rest = data.split(b"\n", 3)
        if self.fields.startswith(b"FIELD"):
            begin, points = rest.split(b"\n", 1)
            rest = begin + b"\n" + self.fields + b"\n" + points
        with open(name, "wb") as stream:
            stream.write(b"\n".join([version, self.title, mode, rest]))
