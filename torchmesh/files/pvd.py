"""ParaView's collections (.pvd): the steps of a time series as mesh files, with their times.

run.pvd  -->  time 0.0  run_0000.vtu
              time 0.1  run_0001.vtu
"""

import itertools
import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..errors import MeshIOError
from .atomic import replacing
from .drafts import Draft
from .messages import translated

PVD = ".pvd"


def is_pvd(path: Path) -> bool:
    """Has the path the extension of a collection?"""
    return path.suffix.lower() == PVD


def pvd_steps(path: Path) -> list[tuple[float, Path]]:
    """Time and file of each step, in the order of time.  Raises MeshIOError."""
    if not path.is_file():
        raise MeshIOError(f"{path}: {'is a directory' if path.is_dir() else 'there is no such file'}")
    with translated(path, "read", "pvd"):
        root = ET.parse(path).getroot()
        sets = [element for element in root.iter() if element.tag.rpartition("}")[2] == "DataSet"]
        steps = []
        for number, one in enumerate(sets):
            file = one.get("file")
            if not file:
                raise ValueError(f"DataSet {number} names no file")
            steps.append((float(one.get("timestep", number)), path.parent / file))
        steps.sort(key=lambda step: step[0])
        for (time, _), (following, _) in itertools.pairwise(steps):
            if time == following:
                raise ValueError(f"time {time:g} has several parts; give each part a collection of its own")
    if not steps:
        raise MeshIOError(f"{path}: its collection has no steps")
    return steps


def step_paths(path: Path, extensions: Sequence[str], given: Path | None) -> list[Path]:
    """Where the steps of a collection at `path` go: beside it, numbered.

    extensions  of the steps
    given       the collection that was read; if it is `path`, its own files are taken
    """
    if given is not None and is_pvd(given) and path.exists() and os.path.samefile(path, given):
        return [file for _, file in pvd_steps(path)]
    width = max(4, len(str(len(extensions) - 1)))
    return [path.with_name(f"{path.stem}_{k:0{width}}{extension}") for k, extension in enumerate(extensions)]


def write_pvd(path: Path, times: Sequence[float], steps: Sequence[Draft]) -> None:
    """Writes the steps at their paths, and the collection that names them, all or none; raises MeshIOError."""
    root = ET.Element("VTKFile", type="Collection", version="0.1")
    collection = ET.SubElement(root, "Collection")
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".torchmesh-") as folder, replacing(path) as made:
        for k, step in enumerate(steps):
            replace(step, path=Path(folder) / f"{k}{step.path.suffix}").save()
        for k, (time, step) in enumerate(zip(times, steps, strict=True)):
            os.replace(Path(folder) / f"{k}{step.path.suffix}", step.path)
            file = os.path.relpath(step.path, path.parent).replace(os.sep, "/")
            ET.SubElement(collection, "DataSet", timestep=repr(float(time)), group="", part="0", file=file)
        ET.indent(root)
        ET.ElementTree(root).write(made, encoding="utf-8", xml_declaration=True)
