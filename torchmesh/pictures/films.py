"""A film of a mesh in its stages, for talks and papers: gif, or mp4 where imageio-ffmpeg is installed.

    stages --scenes--> pictures (whole mesh, close-up, one colour scale) --Pillow or ffmpeg--> file

Where only vertices moved from one stage to the next, the film lets them glide there along straight lines.  Flips and
re-triangulations are cuts.
"""

import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..errors import InvalidMeshError, MeshIOError, MissingDependencyError
from ..files.atomic import check_target, replacing
from ..mesh.batch import MeshBatch
from ..mesh.measure import quality as measure
from .captions import panel_title
from .curves import Curves
from .mesh_plot import plot_mesh, require_matplotlib
from .regions import view_of, within, worst_region
from .sheet import Sheet

FILM_EXTENSIONS = (".gif", ".mp4")

# Seconds: how long the first stage, those between and the last one stay, and each picture of a motion.
_FIRST, _BETWEEN, _LAST, _MOTION = 1.5, 0.5, 3.0, 0.06

# A motion has at most so many pictures, and fewer if the fastest vertex would go fewer pixels than this in each.
_GLIDE, _STRIDE = 6, 8.0

# Pictures in a second of an mp4, of which a stage that stays has many.
_MP4_RATE = 50

_DOTS_PER_INCH = 80


def check_film_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a film can be written there.  Callers ask before long work.

    Raises MeshIOError for an unknown extension, a directory, or a path in a directory that does not exist, and
    MissingDependencyError without matplotlib or, for mp4, without imageio-ffmpeg.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in FILM_EXTENSIONS:
        what = f"the extension {path.suffix!r} is no film's" if suffix else "it has no extension"
        raise MeshIOError(f"{path}: {what}; use one of {' '.join(FILM_EXTENSIONS)}")
    check_target(path)
    require_matplotlib()
    if suffix == ".mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError:
            raise MissingDependencyError(
                "mp4 needs imageio-ffmpeg (pip install imageio-ffmpeg); a .gif needs nothing more"
            ) from None
    return path


def animate(
    path: str | os.PathLike[str],
    stages: Sequence[tuple[str, MeshBatch]],
    *,
    title: str | None = None,
    curves: Sequence[Curves | None] | None = None,
) -> None:
    """Write a film of a mesh in its stages: whole on the left, the worst region of the first stage on the right.

    path    .gif or .mp4; written whole or not at all
    stages  names and meshes, each a batch of one, in order: what `improve(mesh, observe=...)` calls with
    title   stands above the pictures; None: nothing
    curves  of each stage the curved sides of its elements (`pictures.curves.Curves`); None: there are none

    Raises InvalidMeshError if there is no stage or one is a batch of several; MeshIOError, and
    MissingDependencyError naming what to install.
    """
    path = check_film_path(path)
    stages = list(stages)
    bent = [None] * len(stages) if curves is None else list(curves)
    if not stages:
        raise InvalidMeshError("a film needs at least one stage: a name and a mesh")
    for name, mesh in stages:
        if len(mesh) != 1:
            raise InvalidMeshError(
                f"stage {name!r} is a batch of {len(mesh)} meshes and a film shows one: improve each of batch.split()"
            )
    camera = _Camera(stages[0][1], stages[-1][1], title)
    scenes = _scenes(stages, bent, camera.pixels_per_unit)
    pictures = ((camera.picture(name, mesh, sides), seconds) for name, mesh, sides, seconds in scenes)
    with replacing(path) as whole:
        if path.suffix.lower() == ".gif":
            _write_gif(whole, pictures)
        else:
            _write_mp4(whole, pictures)


def _scenes(
    stages: Sequence[tuple[str, MeshBatch]], curves: Sequence[Curves | None], pixels_per_unit: float
) -> Iterator[tuple[str, MeshBatch, Curves | None, float]]:
    """Every picture of the film: the stage's name with its number, mesh and curved sides, and the seconds it stays.

    While vertices glide, all sides are straight.
    """
    for i, ((name, mesh), sides) in enumerate(zip(stages, curves, strict=True)):
        label = f"{i}. {name}"
        if i:
            last = stages[i - 1][1]
            for points in _glide(last, mesh, pixels_per_unit):
                yield label, mesh.with_points(points), None, _MOTION
        yield label, mesh, sides, _FIRST if i == 0 else _LAST if i == len(stages) - 1 else _BETWEEN


def _glide(before: MeshBatch, after: MeshBatch, pixels_per_unit: float) -> list[torch.Tensor]:
    """Points (V, 2) at equal steps from before to after, without the ends; none where the triangles differ."""
    if before.triangles.shape != after.triangles.shape or not torch.equal(before.triangles, after.triangles):
        return []
    way = after.points - before.points
    pixels = pixels_per_unit * float(torch.linalg.vector_norm(way, dim=1).max())
    count = min(_GLIDE, math.ceil(pixels / _STRIDE))
    return [before.points + k / count * way for k in range(1, count)]


class _Camera:
    """The sheet that every picture of one film is drawn on: only the meshes and a title change from one to the next.

    pixels_per_unit  of the close-up, in which motions are seen best, for one length unit of the mesh
    """

    def __init__(self, first: MeshBatch, last: MeshBatch, title: str | None) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.view = view_of(first, last)
        self.sheet = Sheet(self.view, rows=1, title=title or " ")
        panel = self.sheet.panel
        self.close_up = within(worst_region(first, measure(first), panel[1] / panel[0]), self.view)
        self.pixels_per_unit = _DOTS_PER_INCH * panel[0] / (self.close_up[2] - self.close_up[0])
        self.whole, self.near = self.sheet.axes(0, 0), self.sheet.axes(0, 1)
        self.near.set_title("close-up of the red rectangle", fontsize=10)
        self.sheet.figure.set_dpi(_DOTS_PER_INCH)
        self.canvas = FigureCanvasAgg(self.sheet.figure)
        self.background: Any = None

    def picture(self, name: str, mesh: MeshBatch, curves: Curves | None = None) -> np.ndarray:
        """The pixels (height, width, 3) uint8; height and width are even, as video codecs want."""
        q = measure(mesh) if curves is None else curves.judged(measure(mesh))
        fill = plot_mesh(self.whole, mesh, q, self.view, frame=self.close_up, curves=curves)
        self.whole.set_title(panel_title(f"{name}:", q, self.sheet.panel[0]), fontsize=10)
        plot_mesh(self.near, mesh, q, self.close_up, curves=curves)
        changing = [[*ax.collections, *ax.lines, *ax.patches] for ax in (self.whole, self.near)]
        if self.background is None:
            self.sheet.colour_bar(fill)
            self._keep_background([*changing[0], *changing[1], self.whole.title])
        self.canvas.restore_region(self.background)
        for ax, artists in zip((self.whole, self.near), changing, strict=True):
            for artist in sorted(artists, key=lambda a: a.get_zorder()):
                ax.draw_artist(artist)
                artist.remove()
            for spine in ax.spines.values():
                ax.draw_artist(spine)
        self.whole.draw_artist(self.whole.title)
        pixels = np.asarray(self.canvas.buffer_rgba())[..., :3]
        height, width = pixels.shape[0] // 2 * 2, pixels.shape[1] // 2 * 2
        return pixels[:height, :width].copy()

    def _keep_background(self, changing: list[Any]) -> None:
        """Draw axes, ticks, key and labels once: they never change, and drawing them takes most of a picture's time."""
        for artist in changing:
            artist.set_visible(False)
        self.canvas.draw()
        self.background = self.canvas.copy_from_bbox(self.sheet.figure.bbox)
        for artist in changing:
            artist.set_visible(True)


def _write_gif(path: Path, pictures: Iterator[tuple[np.ndarray, float]]) -> None:
    from PIL import Image

    images, milliseconds = [], []
    palette = None
    for picture, seconds in pictures:
        image = Image.fromarray(picture)
        # All pictures use the palette of the first one, which has all colours of the scale; else colours would flicker.
        palette = palette or image.quantize(256, dither=Image.Dither.NONE)
        images.append(image.quantize(palette=palette, dither=Image.Dither.NONE))
        milliseconds.append(round(1000 * seconds))
    images[0].save(
        path, format="GIF", save_all=True, append_images=images[1:], duration=milliseconds, loop=0, optimize=False
    )


def _write_mp4(path: Path, pictures: Iterator[tuple[np.ndarray, float]]) -> None:
    import imageio_ffmpeg

    writer = None
    try:
        for picture, seconds in pictures:
            if writer is None:
                size = picture.shape[1], picture.shape[0]
                writer = imageio_ffmpeg.write_frames(str(path), size, fps=_MP4_RATE, quality=7, macro_block_size=2)
                writer.send(None)
            for _ in range(max(1, round(seconds * _MP4_RATE))):
                writer.send(picture)
    finally:
        if writer is not None:
            writer.close()
