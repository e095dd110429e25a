"""The stages of a mesh's improvement, for the commands that show them.

Nothing here imports torch before it is needed.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from . import console
from .errors import UsageError
from .shared_options import use_threads

if TYPE_CHECKING:
    from ..batches.file_improvement import ImprovedFile
    from ..files.surface import HeightChoice
    from ..files.time_series import Series
    from ..improving.options import ImproveOptions
    from ..improving.report import Report
    from ..mesh.batch import MeshBatch


@dataclass(frozen=True, eq=False)
class Observed:
    """An improvement that was watched.

    stages    the name of each stage, and the mesh after it; "initial" and the mesh as given come first
    improved  the file with the mesh at the end
    """

    stages: "list[tuple[str, MeshBatch]]"
    improved: "ImprovedFile"

    @property
    def after(self) -> "MeshBatch":
        """The mesh at the end."""
        return self.improved.meshes[0]

    @property
    def report(self) -> "Report":
        return self.improved.report


def observe(given: "Series", options: "ImproveOptions", quiet: bool) -> Observed:
    """Improves the one mesh of a file as `torchmesh improve` does, with the same result, and keeps the stages."""
    from ..batches.file_improvement import improve_series

    use_threads(1)
    stages: list[tuple[str, MeshBatch]] = []
    with console.progress(quiet) as show:
        (improved,) = improve_series(
            [given], options, progress=show, observe=lambda stage, batch: stages.append((stage, batch))
        )
    return Observed(stages, improved)


def improve_all(
    given: "Series", options: "ImproveOptions", quiet: bool, height: "HeightChoice" = "interpolate"
) -> "ImprovedFile":
    """Improves all meshes of a file as `torchmesh improve` does; `height` as for `write`."""
    from ..batches.file_improvement import improve_series

    use_threads(1)
    with console.progress(quiet) as show:
        return improve_series([given], options, height=height, progress=show)[0]


def step_to_show(given: "Series", step: int | None) -> int:
    """The step of a file to show: the one asked for, or that with most inverted triangles; raises UsageError."""
    from ..mesh.measure import quality

    if step is None:
        return given.mesh_of_step.index(int(quality(given.batch).inverted.argmax()))
    if step >= len(given):
        last = len(given) - 1
        raise UsageError(f"--step {step}: {given.sources[0].path} has steps from 0 to {last}")
    return step
