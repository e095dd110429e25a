"""A mesh whose vertices change in number under topology "full", with point data whose new values are known.

The field `height` is a linear function of the position, and `number` counts the vertices.  Where vertices are added,
heights are interpolated and numbers are copied from vertices that were there before.
"""

from pathlib import Path

import meshio
import numpy as np
from scipy.spatial import Delaunay


def coarse(spacings: int = 5) -> meshio.Mesh:
    """The unit square with so many edges on each side and three vertices inside: fewer than its boundary asks for."""
    along, zero = np.arange(spacings) / spacings, np.zeros(spacings)
    sides = [(along, zero), (zero + 1, along), (1 - along, zero + 1), (zero, 1 - along)]
    inside = np.array([[0.5, 0.52], [0.48, 0.3], [0.3, 0.6]])
    points = np.concatenate([*(np.stack(side, 1) for side in sides), inside])
    triangles = Delaunay(points).simplices.astype(np.int64)
    a, b, c = points[triangles].transpose(1, 0, 2)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    triangles[area < 0] = triangles[area < 0, ::-1]
    triangles = triangles[np.abs(area) > 1e-9]  # Delaunay may join points of one side
    data = {"height": 1 + points[:, 0] + 2 * points[:, 1], "number": np.arange(len(points))}
    return meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), [("triangle", triangles)], point_data=data)


def write_coarse(path: Path) -> meshio.Mesh:
    mesh = coarse()
    mesh.write(path)
    return mesh


def write_steps(path: Path, steps: list[meshio.Mesh]) -> None:
    """An XDMF time series, each step with a mesh of its own."""
    import xml.etree.ElementTree as ET

    root = ET.Element("Xdmf", Version="3.0")
    kind = {"GridType": "Collection", "CollectionType": "Temporal"}
    collection = ET.SubElement(ET.SubElement(root, "Domain"), "Grid", kind)
    for time, mesh in enumerate(steps):
        one = path.with_name("one-step.xdmf")
        mesh.write(one, data_format="XML")
        grid = ET.parse(one).getroot().find("Domain/Grid")
        grid.insert(0, ET.Element("Time", Value=str(time)))
        collection.append(grid)
        one.unlink()
    ET.ElementTree(root).write(path)


def read_steps(path: Path) -> list[meshio.Mesh]:
    """The steps, without the reader of torchmesh."""
    import xml.etree.ElementTree as ET

    found = []
    for number, grid in enumerate(ET.parse(path).getroot().findall("Domain/Grid/Grid")):
        one = path.with_name(f"step-{number}.xdmf")
        root = ET.Element("Xdmf", Version="3.0")
        grid.remove(grid.find("Time"))
        ET.SubElement(root, "Domain").append(grid)
        ET.ElementTree(root).write(one)
        found.append(meshio.read(one))
        one.unlink()
    return found


def assert_carried(before: meshio.Mesh, after: meshio.Mesh) -> None:
    """The mesh has got other vertices, and every value of its fields is one that the old values allow."""
    assert set(after.point_data) >= {"height", "number"}
    numbers, heights = after.point_data["number"], after.point_data["height"]
    assert numbers.dtype.kind in "iu"
    # As many may have come as have gone.
    assert sorted(numbers.tolist()) != list(range(len(before.points)))
    assert set(numbers.tolist()) <= set(range(len(before.points)))
    assert heights.min() >= before.point_data["height"].min()
    assert heights.max() <= before.point_data["height"].max()
    still = {tuple(point): row for row, point in enumerate(before.points.tolist())}
    rows = [(still[tuple(point)], row) for row, point in enumerate(after.points.tolist()) if tuple(point) in still]
    assert len(rows) > 10, "the boundary stays"
    old, new = np.array(rows).T
    assert (numbers[new] == old).all()
    assert (heights[new] == before.point_data["height"][old]).all()
