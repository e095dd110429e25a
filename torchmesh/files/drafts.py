"""Files that are ready to be written: what will be in them, and what of the file that they follow will not.

Everything that is lost is known before the first byte is written, so that a caller may still decide against it.
"""

from dataclasses import dataclass
from pathlib import Path

import meshio

from ..errors import MeshIOError
from .atomic import full_disk_named, real_target, replacing
from .formats.format import Document
from .formats.registry import format_of
from .messages import translated, warn
from .placed import CurvedSummary


@dataclass(frozen=True, eq=False)
class Draft:
    """A mesh file before it is written.

    path       where it will be
    content    what the format can hold of the mesh and of the file that is followed
    like       the file that it follows, if that has the same format
    same_rows  has the mesh the points and cells of `like`, row by row
    patched    is `like` changed in place
    source     the path of the file that is followed
    dropped    names for what of that file has no place in the new mesh or in the new format
    unheld     names for what the format cannot hold of the rest
    stale      names for values at nodes that moved, which stay as they were in a file that is changed in place
    remarks    what is written otherwise than in the file that is followed, and nothing is lost by it
    curved     counts of six-node triangles; None without any
    """

    path: Path
    content: meshio.Mesh
    like: Document | None
    same_rows: bool
    patched: bool = False
    source: Path | None = None
    dropped: tuple[str, ...] = ()
    unheld: tuple[str, ...] = ()
    stale: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    curved: CurvedSummary | None = None

    @classmethod
    def of(
        cls,
        path: Path,
        mesh: meshio.Mesh,
        like: Document | None = None,
        same_rows: bool = False,
        source: Path | None = None,
        dropped: tuple[str, ...] = (),
        stale: tuple[str, ...] = (),
    ) -> "Draft":
        """The file follows `like` where that has the same format: in text or binary, version, and content that meshio's
        mesh cannot hold.  Content that is tied to rows is taken only under `same_rows`.

        Raises MeshIOError for a path that cannot be written, and for a file that is changed in place and cannot be.
        """
        form = format_of(path, like)
        real_target(path)
        like = like if like is not None and like.format == form.name else None
        if like is not None and form.patches(like):
            if not same_rows:
                raise MeshIOError(
                    f"{path}: {form.name} files are changed in place, and this mesh has other vertices, or elements in "
                    f"other regions, than {source}; without topology 'full', or in another format, it can be written"
                )
            return cls(path, mesh, like, same_rows, True, source, dropped, (), stale)
        fitted, unheld = form.fit(mesh)
        converted = [] if like is not None and same_rows else form.conversions(mesh)
        remarks = (*form.remarks(like, same_rows), *converted)
        return cls(path, fitted, like, same_rows, False, source, dropped, tuple(sorted(unheld)), (), remarks)

    @property
    def lost(self) -> list[str]:
        """Names for everything that the file will not hold, or not as it should be."""
        stale = [f"values of {name} that moved" for name in self.stale]
        return list(dict.fromkeys([*self.dropped, *self.unheld, *stale]))

    def tell(self) -> None:
        """Gives MeshWarnings that name what is lost, and what is written otherwise."""
        if self.dropped:
            warn(f"{self.path}: not carried over from {self.source}: {', '.join(self.dropped)}")
        if self.unheld:
            form = format_of(self.path, self.like).name
            warn(f"{self.path}: {form} files do not hold {', '.join(self.unheld)}; dropped")
        if self.stale:
            warn(f"{self.path}: values at nodes that moved stay as they were: {', '.join(self.stale)}")
        for remark in self.remarks:
            warn(f"{self.path}: {remark}")

    def refuse(self) -> None:
        """Raises MeshIOError if anything is lost."""
        held = dict.fromkeys([*self.dropped, *self.unheld])
        reasons = [f"it would not hold {', '.join(held)}"] if held else []
        if self.stale:
            reasons.append(f"values at nodes that moved would stay as they were: {', '.join(self.stale)}")
        if reasons:
            raise MeshIOError(f"{self.path}: not written, because {', and '.join(reasons)} (strict)")

    def save(self) -> None:
        """Writes the file, whole or not at all.  Raises MeshIOError."""
        form = format_of(self.path, self.like)
        name, path = form.name, self.path
        with translated(path, "write", name), replacing(path) as made, full_disk_named(made.parent):
            if self.patched and self.like is not None:
                form.patch(made, self.content, self.like)
            else:
                form.write(made, self.content, self.like, self.same_rows)
