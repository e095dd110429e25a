"""The steps of an XDMF time series.

Grid, CollectionType="Temporal"         Grid "u", CollectionType="Temporal"       one for each function, as FEniCSx
  Grid, Time 0, mesh, fields              Grid, Time 0, mesh, field u             writes them: their fields are put
  Grid, Time 1, mesh, fields            Grid "p", CollectionType="Temporal"       together, step by step
  ...                                     Grid, Time 0, mesh, field p
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import meshio
import numpy as np

from ...errors import MeshIOError
from ..messages import translated
from .xdmf import XDMF, check_data_files
from .xdmf_mixed import read_grid

_Steps = list[tuple[float, meshio.Mesh]]


def xdmf_steps(path: Path) -> tuple[_Steps, tuple[str, ...]]:
    """Time and mesh of each step, and names for what stands beside the series and is not read.

    meshio reads each grid of the collection as if it were a file of its own.  Raises MeshIOError.
    """
    with translated(path, "read", XDMF.name):
        check_data_files(path)
        domain = ET.parse(path).getroot().find("Domain")
        if domain is None:
            raise ValueError("it has no Domain")
        collections = [g for g in domain.iter("Grid") if g.get("CollectionType") == "Temporal"]
        beside = [g for g in domain.findall("Grid") if g not in collections and g.find("Attribute") is not None]
        steps = _steps(path, domain, collections[0]) if collections else []
        for other in collections[1:]:
            _add(steps, _steps(path, domain, other), other.get("Name", ""))
    if not steps:
        raise MeshIOError(f"{path}: its time series has no steps")
    return steps, tuple(f"the grid {grid.get('Name', '')!r}" for grid in beside)


def _steps(path: Path, domain: ET.Element, collection: ET.Element) -> _Steps:
    steps = []
    for number, grid in enumerate(collection.findall("Grid")):
        if grid.get("GridType", "Uniform") != "Uniform":
            raise ValueError(f"step {number} is a collection of grids; give each part its own file")
        time = grid.find("Time")
        value = float(time.get("Value", number)) if time is not None else float(number)
        mesh = read_grid(path, domain, grid)
        if mesh.points is None or not mesh.cells:
            raise ValueError(f"step {number} has no Geometry or no Topology")
        steps.append((value, mesh))
    return steps


def _add(steps: _Steps, others: _Steps, name: str) -> None:
    """Gives the fields of other steps to the steps.  Raises ValueError where times or meshes differ."""
    if [time for time, _ in steps] != [time for time, _ in others]:
        raise ValueError(f"its time series {name!r} has other times than the first one; give each its own file")
    for number, ((_, mesh), (_, other)) in enumerate(zip(steps, others, strict=True)):
        same = len(mesh.cells) == len(other.cells) and np.array_equal(mesh.points, other.points)
        for one, two in zip(mesh.cells, other.cells, strict=False):
            same &= one.type == two.type and np.array_equal(one.data, two.data)
        if not same:
            raise ValueError(f"step {number} of its time series {name!r} has another mesh than the first one")
        for mine, more in ((mesh.point_data, other.point_data), (mesh.cell_data, other.cell_data)):
            mine.update({key if key not in mine else f"{name}:{key}": values for key, values in more.items()})
