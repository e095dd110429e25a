"""A mesh file that was read: its content, and the batch of one mesh that is made of it."""

import contextlib
import os
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from ..curving.middles import Middles
from ..errors import InvalidMeshError, MeshIOError
from ..mesh import connectivity
from ..mesh.batch import MeshBatch
from ..mesh.file_axes import told_in_space
from ..mesh.mixed_arrays import halves_of
from ..mesh.quads import halved
from ..mesh.validation import seen_from_above
from .content import Content
from .documents import load
from .formats.format import Document
from .longitudes import crosses_the_date_line
from .messages import in_one_line, warn
from .own_numbers import with_own_numbers
from .placed import CurvedSummary, Placed
from .pvd import is_pvd
from .surface import Surface

# Words of messages that speak of constrained edges.
_CONSTRAINED = re.compile(r"constrained edges? \[|its interfaces are held")


@dataclass(frozen=True, eq=False)
class Source:
    """A file that was read.  `write(..., like=source)` need not read it again.

    path      where it is
    document  all that is in it
    content   the same taken apart: what of it binds the triangles
    mesh      the batch of one that `read` gives
    surface   its heights, where the points lie in no plane of one height; None otherwise
    """

    path: Path
    document: Document
    content: Content
    mesh: MeshBatch
    surface: Surface | None = None

    @classmethod
    def open(cls, path: str | os.PathLike[str], regions: str | None = None) -> "Source":
        """Raises and warns as `read` does; `regions` is as for `read`, too."""
        path = as_path(path)
        if is_pvd(path):
            raise MeshIOError(f"{path}: it is a time series: read it by read_series")
        return cls.of(load(path), path, regions)

    @classmethod
    def of(cls, document: Document, path: Path, regions: str | None = None) -> "Source":
        """Raises InvalidMeshError and MeshIOError and warns as `read` does."""
        with in_one_line(path), _own_numbers_told(document):
            content = Content.of(document, path, regions)
            every = np.concatenate([content.rows[content.first], halves_of(torch.from_numpy(content.quads)).numpy()])
            surface = Surface.of(content.mesh.points, every, path, document.depths)
            made = cls(path, document, content, _batch(content, path, surface), surface)
            _ = made.middles  # what is wrong with them is said when the file is read
            return made

    def explained(self, text: str) -> str:
        """A message about the mesh: positions in space, rows as the file's own numbers, where constraints come from."""
        more = ""
        if _CONSTRAINED.search(text):
            regions, lines = self.content.bound_by_regions, "lines of the file" * self.content.bound_by_lines
            origin = ", and ".join(filter(None, [regions, lines]))
            choice = "; --regions NAME|none chooses what tells regions" if regions else ""
            more = f" (constrained edges are {origin}{choice})" if origin else ""
        if self.content.curved_quads.any():
            text = text.replace(": with quads='split' (--quads split) such quads become two triangles each", "")
        text = text if self.surface is not None else told_in_space(self.mesh, text)
        return with_own_numbers(text, self.document) + more

    @cached_property
    def middles(self) -> Middles | None:
        """The mid-side nodes of the file's triangles and quads, which are rows of `mesh.points`; None without any.

        Raises InvalidMeshError for nodes that belong to no or to several edges.
        """
        content = self.content
        if not content.kinds.curved:
            return None
        try:
            return Middles.of(
                content.rows[content.first], content.middles[content.first],
                content.quads, content.quad_middles[content.quad_first],
            )  # fmt: skip
        except InvalidMeshError as error:
            raise InvalidMeshError(f"{self.path}: {error}") from None

    @cached_property
    def curved(self) -> CurvedSummary | None:
        """Counts of the file's curved triangles and quads; None without any."""
        return None if self.middles is None else Placed(self.mesh, self.middles).summary()


@contextlib.contextmanager
def _own_numbers_told(document: Document) -> Iterator[None]:
    """Inside, an InvalidMeshError that names rows also gives the file's own numbers of them."""
    try:
        yield
    except InvalidMeshError as error:
        raise InvalidMeshError(with_own_numbers(str(error), document)) from None


def as_path(path: str | os.PathLike[str]) -> Path:
    """Raises MeshIOError for anything else."""
    try:
        return Path(path)
    except TypeError:
        raise MeshIOError(f"{path!r} is not a path") from None


def default_fixed(mesh: MeshBatch, pinned: np.ndarray | None = None) -> torch.Tensor:
    """(V,) bool: the vertices that `read` finds fixed in a file of this mesh without point data `fixed`.

    pinned  (V,) bool, vertices of cells that must not change shape
    """
    mesh, count = halved(mesh), len(mesh.points)
    fixed = connectivity.boundary_vertices(mesh.triangles, mesh.twin, count)
    fixed |= connectivity.vertex_triangle_counts(mesh.triangles, count) == 0
    return fixed if pinned is None else fixed | torch.from_numpy(pinned)


def _batch(content: Content, path: Path, surface: Surface | None) -> MeshBatch:
    """The triangles and quads of a file, in plan.  Errors and warnings of MeshBatch.from_arrays name the file."""
    fixed = content.pinned if content.fixed is None else content.pinned | content.fixed
    faces, quads = content.rows[content.first], content.quads
    points = content.mesh.points
    if surface is not None:
        points = surface.plan(points)
        if surface.axis != 2:  # neither side of such a plane is above
            frame = surface.frame[0]
            every = torch.cat([torch.from_numpy(faces), halves_of(torch.from_numpy(quads))])
            seen = seen_from_above(torch.from_numpy(points), every, frame)
            if not torch.equal(seen, every):
                faces, quads = faces[:, ::-1], quads[:, [0, 3, 2, 1]]
    try:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            mesh = MeshBatch.from_arrays(points, faces, fixed, content.constrained, quads=quads)
    except InvalidMeshError as error:
        raise InvalidMeshError(f"{path}: {error}") from None
    # Vertices of lines belong to no triangle, and nothing is wrong with them.
    lost = np.setdiff1d(np.flatnonzero(~content.elsewhere), np.concatenate([faces.ravel(), content.quads.ravel()]))
    texts = [str(w.message) for w in said if "belong to no triangle" not in str(w.message)]
    texts += [f"{len(lost)} vertices belong to no cell; they are kept"] if len(lost) else []
    told = crosses_the_date_line(points, np.concatenate([faces, quads[:, :3]]))
    texts += [told] if told else []
    for text in texts:
        warn(f"{path}: {text}")
    return mesh if surface is None else replace(mesh, frames=surface.frame)
