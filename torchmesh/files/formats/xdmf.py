"""XDMF files (.xdmf): single meshes here, time series in `files.time_series`."""

import contextlib
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import meshio

from ..swelling import check_hdf5
from .format import ALL_BUT_POLYGONS, Document
from .meshio_formats import MeshioFormat
from .skipped import in_xml


def _has_series(data: bytes) -> bool:
    return re.search(rb"CollectionType\s*=\s*[\"']Temporal", data) is not None


def _refuse_series(data: bytes) -> None:
    if _has_series(data):
        raise ValueError("it is a time series: read it by read_series")


@dataclass(frozen=True)
class XdmfFormat(MeshioFormat):
    def parse(self, path: Path, data: bytes) -> meshio.Mesh:
        check_data_files(path)
        return super().parse(path, data)

    def write(self, path: Path, mesh: meshio.Mesh, like: Document | None, same_rows: bool) -> None:
        # With its data as text in the one file, where meshio would put it into a second file (HDF5).
        meshio.xdmf.write(str(path), mesh, data_format="XML")


XDMF = XdmfFormat(
    "xdmf", (".xdmf", ".xmf"), ALL_BUT_POLYGONS, check=_refuse_series, skipped=partial(in_xml, form="xdmf")
)


def check_data_files(path: Path) -> None:
    """Raises ValueError if a file that holds data of an XDMF file is none, or swells when it is read."""
    names: dict[str, set[str]] = {"HDF": set(), "Binary": set()}
    for _, item in ET.iterparse(path):
        if item.tag == "DataItem" and item.get("Format") in names:
            names[item.get("Format", "")].add((item.text or "").strip())
    # meshio looks for HDF5 beside the XDMF file, and for binary files in the working directory.
    hdf5 = {path.resolve().parent / name.partition(":")[0] for name in names["HDF"]}
    for other in sorted(hdf5 | {Path(name) for name in names["Binary"]}):
        if not other.is_file():
            raise ValueError(f"its data should lie in {other.name}, which is no file")
    for other in hdf5:
        check_hdf5(other)


def is_series(path: Path) -> bool:
    """Does the file hold a time series, as `time_series` reads it?  A file that cannot be read does not."""
    if path.suffix.lower() in XDMF.extensions:
        with contextlib.suppress(OSError):
            return _has_series(path.read_bytes())
    return False
