"""Outlines meshed with as many triangles as are asked for, also where narrow parts would rather have more.

The mesher puts several triangles across every narrow part and a dozen edges round every hole.  Where that makes more
triangles than are asked for, parts and holes get fewer, step by step, and small sizes become larger.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..triangulating.mesher import MesherOptions, MeshingError, Outline, mesh_outline

# The number of triangles is as asked if it is wrong by less than this part.
WITHIN = 0.1


@dataclass(frozen=True)
class Coarser:
    """One step.

    options    of the mesher
    gradation  the factor on how fast sizes grow with the distance from the outline
    smallest   no size along the outline is below this part of the largest
    """

    options: MesherOptions
    gradation: float
    smallest: float

    def mesh(self, outline: Outline, triangles: int, rng: np.random.Generator) -> "Made":
        """What `mesh_outline` makes of the outline with these sizes."""
        low = self.smallest * max(outline.sizes)
        sizes = tuple(max(size, low) for size in outline.sizes)
        coarser = replace(outline, sizes=sizes, gradation=self.gradation * outline.gradation)
        return mesh_outline(coarser, triangles, rng, self.options)


# The steps; with the last one 120 triangles were met in every family.
STEPS = (
    Coarser(MesherOptions(edges_per_loop=8, cells_across=2.0, scale_rounds=12), 1.0, 0.0),
    Coarser(MesherOptions(edges_per_loop=6, cells_across=1.5, scale_rounds=12), 2.0, 0.4),
    Coarser(MesherOptions(edges_per_loop=6, cells_across=1.0, scale_rounds=12), 2.5, 0.6),
    Coarser(MesherOptions(edges_per_loop=4, cells_across=0.7, scale_rounds=12, clearance=0.6), 3.0, 0.8),
)

# So often the best of these steps is tried again.
_AGAIN = 4

# What `mesh_outline` gives: points, triangles, and the loop of each vertex on the outline.
Made = tuple[np.ndarray, np.ndarray, np.ndarray]


def mesh_as_asked(outline: Outline, triangles: int, rng: np.random.Generator) -> tuple[Made, bool]:
    """The mesh with `triangles` triangles, or as near as it comes, and whether it is coarser than the mesher wants.

    Raises MeshingError as `mesh_outline` does.
    """
    state = rng.bit_generator.state
    best, found = mesh_outline(outline, triangles, rng), None
    steps: list[Coarser | None] = [*STEPS, *[None] * _AGAIN]
    for step in steps:
        if _error(best, triangles) <= WITHIN:
            break
        asked = triangles
        if step is not None:
            rng.bit_generator.state = state
        else:  # the best so far once more, on another lattice, and corrected by what it missed
            step, asked = found, round(triangles * triangles / len(best[1]))
        try:
            made = mesh_outline(outline, asked, rng) if step is None else step.mesh(outline, asked, rng)
        except MeshingError:
            continue
        if _error(made, triangles) < _error(best, triangles):
            best, found = made, step
    return best, found is not None


def _error(made: Made, triangles: int) -> float:
    """By what part of the number asked for the number of triangles is wrong."""
    return abs(len(made[1]) / triangles - 1)
