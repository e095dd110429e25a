"""What the tests of dialects share: a square whose inner vertex was pushed out, as files of programs write it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from decks import changed_lines
from file_contents import rebuilt

import torchmesh as tm
from torchmesh.files.source import Source
from torchmesh.files.walls import walls_of

# The square as VTK's XML, with a name, a time and a field.
VTU = """<?xml version="1.0"?>
<!-- made by hand -->
<VTKFile type="UnstructuredGrid" version="2.2" byte_order="LittleEndian">
<UnstructuredGrid>
<FieldData><DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">0.5</DataArray></FieldData>
<Piece NumberOfPoints="5" NumberOfCells="4">
<PointData Scalars="rank"><DataArray type="Int32" Name="rank" format="ascii">0 1 2 3 4</DataArray></PointData>
<Points><DataArray type="Float64" NumberOfComponents="3" RangeMin="0" RangeMax="1.49" format="ascii">
0 0 0 1 0 0 1 1 0 0 1 0 1.4 0.5 0
</DataArray></Points>
<Cells>
<DataArray type="Int32" Name="connectivity" format="ascii">0 1 4 1 2 4 2 3 4 3 0 4</DataArray>
<DataArray type="Int32" Name="offsets" format="ascii">3 6 9 12</DataArray>
<DataArray type="Int8" Name="types" format="ascii">5 5 5 5</DataArray>
</Cells>
</Piece>
</UnstructuredGrid>
</VTKFile>
"""


def improved(source: Path, target: Path, topology: str = "flip") -> list[tuple[str, str]]:
    """Improves a file into another one, which is valid and has the same walls; gives the pairs of lines that differ."""
    before = Source.open(source)
    assert len(before.mesh.triangles) == 4
    mesh, report = tm.improve(before.mesh, tm.ImproveOptions(topology=topology))
    tm.write(target, mesh, like=before)
    after = Source.open(target)
    assert bool(report.valid.all())
    assert np.array_equal(after.mesh.triangles, mesh.triangles)
    assert np.array_equal(after.mesh.points, mesh.points)
    assert {name: len(edges) for name, edges in walls_of(after).items()} == {
        name: len(edges) for name, edges in walls_of(before).items()
    }
    return changed_lines(source, target)


def turned(source: Path, target: Path) -> list[tuple[str, str]]:
    """Writes the file with its first two triangles in one another's place; gives the pairs of lines that differ."""
    mesh = tm.read(source)
    faces = mesh.triangles[[1, 0, *range(2, len(mesh.triangles))]]
    tm.write(target, tm.MeshBatch.from_arrays(mesh.points, faces, mesh.fixed, mesh.constrained_edges), like=source)
    return changed_lines(source, target)


def divided(source: Path) -> tuple[tm.MeshBatch, np.ndarray]:
    """The mesh of a file with its first triangle divided by a new vertex, and where that vertex is."""
    mesh = tm.read(source)
    a, b, c = mesh.triangles[0].tolist()
    centre = mesh.points[[a, b, c]].mean(0).numpy()
    points = np.concatenate([mesh.points.numpy(), centre[None]])
    d = len(points) - 1
    faces = np.concatenate([mesh.triangles.numpy()[1:], [[a, b, d], [b, c, d], [c, a, d]]])
    return replace(rebuilt(mesh, points, faces), frames=mesh.frames), centre


def named(source: Path) -> dict[str, list[list[int]]]:
    """The edges of each wall that the file names."""
    return {name: sorted(map(sorted, edges.tolist())) for name, edges in walls_of(Source.open(source)).items()}
