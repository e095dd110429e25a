"""Time series in one file: many steps, each with its own data and, where the boundary moves, its own mesh.

XDMF holds them as a temporal collection of grids, which ParaView, FEniCS and other programs write.  Steps that share
one mesh are one mesh of the batch:

    steps     0  1  2  3  4
    meshes    0  0  1  2  2        series.mesh_of_step
"""

import os
import tempfile
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..errors import InvalidMeshError, MeshIOError, MeshWarning
from ..mesh.batch import MeshBatch, join
from ..mesh.typed import typed
from ..mesh.vertex_map import VertexMap
from .atomic import replacing
from .drafts import Draft
from .field_transfer import FieldChoice, FieldSummary, FieldTransfer, check_choice, mesh_of_values
from .formats.format import Document
from .formats.registry import format_of
from .formats.xdmf import XDMF, is_series, write_mixed
from .formats.xdmf_steps import xdmf_steps
from .mesh_files import draft
from .messages import translated, warn
from .placed import CurvedSummary, Placed
from .pvd import is_pvd, pvd_steps, step_paths, write_pvd
from .riding import RidingTransfer, Step
from .source import Source
from .surface import HeightChoice

# Steps in which these agree, and the positions of vertices, share a mesh.
_SHARED = ("triangles", "quads", "fixed", "constrained_edges")


@dataclass(frozen=True, eq=False)
class Series:
    """The steps of a file.

    batch         the M meshes that differ
    times         (S,) the time of each step, in the file's unit
    mesh_of_step  (S,) for each step its mesh in the batch
    sources       (S,) what `write_series` needs to know of each step
    path          the file, if it was read from one
    """

    batch: MeshBatch
    times: list[float]
    mesh_of_step: list[int]
    sources: list[Source]
    path: Path | None = None

    def __len__(self) -> int:
        return len(self.times)

    def first_sources(self) -> list[Source]:
        """(M,) for each mesh of the batch the first step that has it."""
        return [self.sources[self.mesh_of_step.index(mesh)] for mesh in range(len(self.batch))]

    def only(self, step: int) -> "Series":
        """One step as a series of its own."""
        mesh = self.batch.split()[self.mesh_of_step[step]]
        return replace(self, batch=mesh, times=[self.times[step]], mesh_of_step=[0], sources=[self.sources[step]])

    def separated(self) -> "Series":
        """The same with a mesh of its own for each step."""
        if len(self.batch) == len(self.times):
            return self
        meshes = self.batch.split()
        return replace(
            self, batch=join([meshes[m] for m in self.mesh_of_step]), mesh_of_step=list(range(len(self.times)))
        )

    def names(self) -> list[str]:
        """(M,) for each mesh its steps in words: "step 2 (time 0.5)", "steps 3 to 5"."""
        names = []
        for mesh in range(len(self.batch)):
            steps = [step for step, m in enumerate(self.mesh_of_step) if m == mesh]
            run = steps == list(range(steps[0], steps[-1] + 1))
            if len(steps) == 1:
                names.append(f"step {steps[0]} (time {self.times[steps[0]]:g})")
            else:
                names.append(f"steps {steps[0]} to {steps[-1]}" if run else f"steps {', '.join(map(str, steps))}")
        return names


def read_series(path: str | os.PathLike[str], *, regions: str | None = None) -> Series:
    """The steps of an XDMF time series or a collection (.pvd); any other mesh file is a series of one step at time 0.

    Regions, lines and fixed vertices are found for each step as by `read`.  Steps whose vertices, triangles, fixed
    vertices and constrained edges agree share one mesh.  `regions` is as for `read`.

    Raises MeshIOError, InvalidMeshError and MissingDependencyError as `read` does, and names the step.
    """
    path = Path(path)
    if is_pvd(path):
        files = pvd_steps(path)
        return _series_of([time for time, _ in files], [Source.open(file, regions) for _, file in files], path)
    if not is_series(path):
        source = Source.open(path, regions)
        return Series(source.mesh, [0.0], [0], [source], path)
    steps, beside = xdmf_steps(path)
    sources: list[Source] = []
    for step, (_, mesh) in enumerate(steps):
        try:
            sources.append(Source.of(Document(mesh, XDMF.name, skipped=beside), path, regions))
        except InvalidMeshError as error:
            raise InvalidMeshError(f"step {step} of {error}") from None
    return _series_of([time for time, _ in steps], sources, path)


def _series_of(times: list[float], sources: list[Source], path: Path) -> "Series":
    """The series of these steps; those whose meshes agree in all that counts share one."""
    meshes: list[MeshBatch] = []
    number: dict[bytes, int] = {}
    mesh_of_step = []
    for source in sources:
        m = source.mesh
        key = b"".join(
            np.ascontiguousarray(a).tobytes() + str(a.shape).encode()
            for a in (source.content.mesh.points, *(getattr(m, name).numpy() for name in _SHARED))
        )
        if key not in number:
            number[key] = len(meshes)
            meshes.append(m)
        mesh_of_step.append(number[key])
    return Series(join(meshes), times, mesh_of_step, sources, path)


@typed
def write_series(
    path: str | os.PathLike[str],
    batch: MeshBatch,
    like: Series,
    vertex_maps: Sequence[VertexMap] | None = None,
    *,
    fields: FieldChoice = "carry",
    before: MeshBatch | None = None,
    height: HeightChoice = "interpolate",
) -> FieldSummary:
    """Writes the steps of `like` with the vertices and triangles of `batch`, whole or not at all.

    batch        as many meshes as `like.batch` has, in its order; data is carried over as by `write`
    vertex_maps  of remeshed meshes, one for each mesh of `batch` (`report.vertex_map.split(like.batch, batch)`):
                 point data is interpolated at inserted vertices; without them, point data is dropped there
    fields       as for `write`
    before       the meshes that have the values for "interpolate", as many as `like.batch` has; None: `like.batch`
    height       as for `write`

    Returns what became of the fields, which is nothing under "carry".

    A series of several steps is written as .xdmf, with its data as text in the one file, or as .pvd, with a numbered
    file beside it for each step, in the format that this had; a single step in any format.  Raises as `write` does.
    """
    made = draft_series(path, batch, like, vertex_maps, fields=fields, before=before, height=height)
    made.tell()
    made.save()
    return made.fields


def draft_series(
    path: str | os.PathLike[str],
    batch: MeshBatch,
    like: Series,
    vertex_maps: Sequence[VertexMap] | None = None,
    *,
    fields: FieldChoice = "carry",
    before: MeshBatch | None = None,
    height: HeightChoice = "interpolate",
    placed: Sequence[Placed | None] | None = None,
    steps: Sequence[Sequence[Step]] | None = None,
) -> "SeriesDraft":
    """The steps of `like`, ready to be written; arguments and errors are those of `write_series`.

    placed  the meshes of `batch` with their mid-side nodes; None: these are placed where the file has any
    steps   for each mesh the steps of a motion in which values ride with their vertices, on the way from `like.batch`
    """
    path = Path(path)
    meshes = batch.split()
    if len(meshes) != len(like.batch):
        raise InvalidMeshError(f"{path}: the series has {len(like.batch)} meshes, the batch has {len(meshes)}")
    if vertex_maps is not None and len(vertex_maps) != len(meshes):
        raise InvalidMeshError(f"{path}: there are {len(vertex_maps)} vertex maps for {len(meshes)} meshes")
    check_choice(fields)
    maps = [None] * len(meshes) if vertex_maps is None else vertex_maps
    transfers: list[FieldTransfer | None] = [None] * len(meshes)
    if fields != "carry":
        given = mesh_of_values(path, like.batch, before).split()
        transfers = [FieldTransfer(one, other, fields) for one, other in zip(given, meshes, strict=True)]
        if steps is not None:
            rows = zip(steps, given, meshes, strict=True)
            transfers = [RidingTransfer(own, one, other, fields) for own, one, other in rows]
    check_steps(path, len(like))
    paths = [path] * len(like)
    if is_pvd(path):
        followed = like.path is not None and is_pvd(like.path)
        extensions = [source.path.suffix if followed else ".vtu" for source in like.sources]
        paths = step_paths(path, extensions, like.path)
    nodes = [None] * len(meshes) if placed is None else placed
    each = zip(paths, like.mesh_of_step, like.sources, strict=True)
    drafts = [draft(at, meshes[m], source, maps[m], transfers[m], height, nodes[m]) for at, m, source in each]
    summary = sum((one.summary for one in transfers if one is not None), FieldSummary())
    return SeriesDraft(path, like.times, drafts, summary)


def check_steps(path: Path, steps: int) -> None:
    """Raises MeshIOError if a file of this name cannot hold so many steps."""
    if is_pvd(path):
        return
    form = format_of(path)
    if steps > 1 and form is not XDMF:
        raise MeshIOError(f"{path}: {form.name} files hold one step, the series has {steps}: write .xdmf or .pvd")


@dataclass(frozen=True, eq=False)
class SeriesDraft:
    """The steps of a file before they are written: their times, and a draft of each at the path of the whole file.

    fields  what became of the fields of all meshes together
    """

    path: Path
    times: list[float]
    steps: list[Draft]
    fields: FieldSummary

    @property
    def curved(self) -> CurvedSummary | None:
        """Counts of six-node triangles in all steps together; None without any."""
        found = [step.curved for step in self.steps if step.curved is not None]
        return CurvedSummary.of_all(found) if found else None

    @property
    def lost(self) -> list[str]:
        """Names for everything that some step will not hold."""
        return list(dict.fromkeys(name for step in self.steps for name in step.lost))

    def tell(self) -> None:
        """Gives MeshWarnings that name what is lost, each text once."""
        with warnings.catch_warnings(record=True) as remarks:
            warnings.simplefilter("always", MeshWarning)
            for step in self.steps:
                step.tell()
        for text in dict.fromkeys(str(r.message) for r in remarks):
            warn(text)

    def refuse(self) -> None:
        """Raises MeshIOError if anything is lost."""
        for step in self.steps:
            step.refuse()

    def save(self) -> None:
        """Writes the file, whole or not at all.  Raises MeshIOError."""
        if is_pvd(self.path):
            write_pvd(self.path, self.times, self.steps)
            return
        if len(self.steps) == 1:
            self.steps[0].save()
            return
        root = ET.Element("Xdmf", Version="3.0")
        collection = ET.SubElement(
            ET.SubElement(root, "Domain"), "Grid", Name="TimeSeries", GridType="Collection", CollectionType="Temporal"
        )
        with tempfile.TemporaryDirectory() as folder:
            one = Path(folder) / f"{self.path.stem}.xdmf"
            for number, (time, step) in enumerate(zip(self.times, self.steps, strict=True)):
                with translated(self.path, "write", XDMF.name):
                    write_mixed(one, step.content)
                collection.append(_as_step(one, number, time))
        with replacing(self.path) as made:
            ET.ElementTree(root).write(made, encoding="utf-8", xml_declaration=True)


def _as_step(path: Path, step: int, time: float) -> ET.Element:
    """The one grid of a file, as a step of a series."""
    grid = ET.parse(path).getroot().find("Domain/Grid")
    assert grid is not None
    grid.attrib.update({"Name": f"step {step}", "GridType": "Uniform"})
    grid.insert(0, ET.Element("Time", Value=repr(float(time))))
    return grid
