"""Read mesh files, improve their meshes as one batch, and write each file back with everything else that it holds.

    file -- open_mesh ----+                             +-- ImprovedFile.write --> file
    file -- read_series --+--> improve_series (a batch) +-- ImprovedFile.write --> file
                                                             fields, groups, lines, quads come along

`torchmesh improve`, `warp --improve`, `report`, `animate` and `batch` all go this way, so that none of them forgets
what the others carry: which vertices must not slide, and where the vertices of a remeshed mesh come from.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import torch

from ..errors import InvalidMeshError
from ..files.curved import replaced
from ..files.field_transfer import FieldChoice, FieldSummary, check_choice
from ..files.mesh_files import held
from ..files.placed import CurvedSummary, Placed
from ..files.split_quads import UNDIVIDED
from ..files.surface import HeightChoice, check_height
from ..files.time_series import Series, SeriesDraft, draft_series, read_series
from ..improving.options import ImproveOptions
from ..improving.pipeline import improve
from ..improving.report import Progress, Report
from ..mesh.batch import MeshBatch, join
from ..mesh.measure import Quality, quality
from ..mesh.vertex_map import VertexMap


def open_mesh(path: str | os.PathLike[str], regions: str | None = None) -> Series:
    """A file as the series of its steps, of which most files have one; raises and warns as `torchmesh.read` does.

    regions  what tells the regions, as for `torchmesh.read`
    """
    return read_series(path, regions=regions)


@dataclass(frozen=True, eq=False)
class ImprovedFile:
    """The improved meshes of one file, and what is needed to write them.

    given        the file as it was read
    meshes       (M,) its improved meshes, as many as `given.batch` has
    rows         the meshes of the file are these rows of `before` and of `report`
    before       the quality of the whole batch that was improved, as it was given
    report       the report of `improve` on the whole batch
    vertex_maps  (M,) where the vertices of each mesh come from; None where vertices keep number and order
    fields       what `write` does with the fields of the file
    height       what it does with the heights of a surface
    placed       (M,) the meshes with their mid-side nodes, of a file with curved elements; None for others
    """

    given: Series
    meshes: list[MeshBatch]
    rows: slice
    before: Quality
    report: Report
    vertex_maps: list[VertexMap] | None
    fields: FieldChoice = "interpolate"
    height: HeightChoice = "interpolate"
    placed: list[Placed | None] | None = None

    @property
    def curved(self) -> CurvedSummary | None:
        """Counts of the curved elements of all meshes together; None without any."""
        return curved_summary(self.meshes, self.placed)

    def message(self) -> str:
        """Why the improvement ended, of the first mesh that is not valid, or of the first one."""
        failed = (~self.report.valid[self.rows]).nonzero().squeeze(1).tolist()
        first = failed[0] if failed else 0
        which = f"{self.given.names()[first]}: " if len(self.meshes) > 1 else ""
        return which + self.report.messages[self.rows.start + first]

    def draft(self, path: str | os.PathLike[str]) -> SeriesDraft:
        """The file with the improved meshes in their steps, ready to be written; raises as `write_series` does.

        Fields are transferred from the meshes that were improved: what ride they had up to these is not undone.
        `report.lost` then names, for the meshes of this file, what the file will not hold.
        """
        made = draft_series(
            path, join(self.meshes), self.given, self.vertex_maps, fields=self.fields, height=self.height,
            placed=self.placed,
        )  # fmt: skip
        for b in range(self.rows.start, self.rows.stop):
            self.report.lost[b] = made.lost
        return made

    def write(self, path: str | os.PathLike[str]) -> FieldSummary:
        """Writes the file with the improved meshes in their steps, all or nothing; raises as `write_series` does.

        Returns what became of the fields.
        """
        made = self.draft(path)
        made.tell()
        made.save()
        return made.fields


def improve_series(
    files: Sequence[Series],
    options: ImproveOptions,
    *,
    fields: FieldChoice = "interpolate",
    height: HeightChoice = "interpolate",
    progress: Callable[[Progress], None] | None = None,
    observe: Callable[[str, MeshBatch], None] | None = None,
) -> list[ImprovedFile]:
    """Improves the meshes of several files as one batch; the result has one entry for each file, in order.

    files     the meshes to improve are each file's `batch`, whose points may differ from those in the file;
              all batches have one dtype
    fields    what becomes of the fields of the files, and
    height    of the heights of surfaces: see `write`
    options   as for `improve`; under boundary="slide" those vertices are held that `held` names for each file
    progress, observe  as for `improve`

    Raises as `improve` does; ValueError for unknown `fields` or `height`.
    """
    check_choice(fields)
    check_height(height)
    if options.quads == "split":
        _refuse_curved_quads(files)
    batch = join([file.batch for file in files])
    before = quality(batch)
    slides = options.slides or (options.at_interfaces == "free" and _curved(files))
    hold = torch.cat([_held(file) for file in files]) if slides else None
    walls = partial(_walls, files)
    after, report = improve(batch, options, progress=progress, observe=observe, hold=hold, walls=walls)
    _explain(files, report)
    meshes = after.split()
    maps = None if report.vertex_map is None else report.vertex_map.split(batch, after)
    improved, first = [], 0
    for file in files:
        rows = slice(first, first + len(file.batch))
        first = rows.stop
        own = None if maps is None else maps[rows]
        made, placed = with_nodes(file, meshes[rows], own)
        improved.append(ImprovedFile(file, made, rows, before, report, own, fields, height, placed))
    return improved


def _explain(files: Sequence[Series], report: Report) -> None:
    """Messages say what their files call the rows that they name, and what constrained edges come from."""
    first = 0
    for file in files:
        for mesh in range(len(file.batch)):
            source = file.sources[file.mesh_of_step.index(mesh)]
            report.messages[first + mesh] = source.explained(report.messages[first + mesh])
        first += len(file.batch)


def _curved(files: Sequence[Series]) -> bool:
    """Has any file triangles or quads with mid-side nodes?"""
    return any(source.middles is not None for file in files for source in file.sources)


def _refuse_curved_quads(files: Sequence[Series]) -> None:
    """Raises InvalidMeshError, naming the file, where quads have mid-side nodes."""
    for file in files:
        for source in file.first_sources():
            if source.content.curved_quads.any():
                raise InvalidMeshError(f"{source.path}: {UNDIVIDED}")


def with_nodes(
    file: Series, meshes: list[MeshBatch], maps: list[VertexMap] | None, *, mends: bool = True
) -> tuple[list[MeshBatch], list[Placed | None] | None]:
    """The meshes of a file with mid-side nodes placed, where it has any; and these, None for a file without any.

    maps   from the rows of the file to those of the meshes, if they are others; they get the rows of nodes, too
    mends  are nodes inside moved where a triangle would be inverted
    """
    if not _curved([file]):
        return meshes, None
    given, placed, made = file.batch.split(), [], []
    for m, (mesh, source) in enumerate(zip(meshes, file.first_sources(), strict=True)):
        one = None
        if source.middles is not None:
            one = replaced(source, mesh, None if maps is None else maps[m], given[m], mends=mends)
            if maps is not None and one.vertex_map is not None:
                maps[m] = one.vertex_map
        placed.append(one)
        made.append(mesh if one is None else one.mesh)
    return made, placed


def curved_summary(meshes: Sequence[MeshBatch], placed: Sequence[Placed | None] | None) -> CurvedSummary | None:
    """Counts of the curved elements of meshes together; None without any."""
    if placed is None:
        return None
    rest = [mesh for mesh, one in zip(meshes, placed, strict=True) if one is None]
    found = [one.summary() for one in placed if one is not None]
    return CurvedSummary.of_all(found + [CurvedSummary.of_straight(m) for m in rest])


def curved_counts(file: Series) -> CurvedSummary | None:
    """Counts of the curved elements of the meshes of a file together, as they are in it; None without any."""
    return curved_summary([s.mesh for s in file.first_sources()], with_given_nodes(file))


def with_given_nodes(file: Series) -> list[Placed | None] | None:
    """The meshes of a file with their mid-side nodes as they are in it; None for a file without any."""
    if not _curved([file]):
        return None
    return [None if s.middles is None else Placed(s.mesh, s.middles) for s in file.first_sources()]


def _held(file: Series) -> torch.Tensor:
    """(V,) bool for all meshes of a file: the vertices that must not slide, by the first step that has each mesh."""
    first_steps = [file.mesh_of_step.index(mesh) for mesh in range(len(file.batch))]
    return torch.cat([held(file.sources[step]) for step in first_steps])


def _walls(files: Sequence[Series]) -> dict[str, torch.Tensor]:
    """The named walls of several files, as rows of vertices of their joined batch."""
    from ..files.walls import walls_of

    walls: dict[str, list[torch.Tensor]] = {}
    first = 0
    for file in files:
        for mesh, start in enumerate(file.batch.point_offsets[:-1].tolist()):
            for name, edges in walls_of(file.sources[file.mesh_of_step.index(mesh)]).items():
                walls.setdefault(name, []).append(edges + first + start)
        first += len(file.batch.points)
    return {name: torch.cat(edges) for name, edges in walls.items()}
