"""XDMF files (.xdmf): single meshes here, time series in `files.time_series`."""

import contextlib
import re
from dataclasses import dataclass
from pathlib import Path

import meshio

from .format import ALL_BUT_POLYGONS, Document
from .meshio_formats import MeshioFormat


def _has_series(data: bytes) -> bool:
    return re.search(rb"CollectionType\s*=\s*[\"']Temporal", data) is not None


def _refuse_series(data: bytes) -> None:
    if _has_series(data):
        raise ValueError("it is a time series: read it by read_series, improve it by torchmesh batch")


@dataclass(frozen=True)
class XdmfFormat(MeshioFormat):
    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        # With its data as text in the one file, where meshio would put it into a second file (HDF5).
        meshio.xdmf.write(str(path), mesh, data_format="XML")


XDMF = XdmfFormat("xdmf", (".xdmf", ".xmf"), ALL_BUT_POLYGONS, inspect=_refuse_series)


def is_series(path: Path) -> bool:
    """Does the file hold a time series, as `time_series` reads it?  A file that cannot be read does not."""
    if path.suffix.lower() in XDMF.extensions:
        with contextlib.suppress(OSError):
            return _has_series(path.read_bytes())
    return False
