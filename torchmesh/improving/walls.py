"""The walls whose layers are asked to follow them: their names, and what is said where no layer stands along them."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ..layering.layers import LayerOptions
from ..mesh.batch import MeshBatch


def names_of_walls(layer: str | Sequence[str] | None) -> tuple[str, ...]:
    """The names of the walls that `layer` names; TypeError for anything but a name or several."""
    names: tuple[Any, ...] = () if layer is None else (layer,)
    if isinstance(layer, Sequence) and not isinstance(layer, str):
        names = tuple(layer)
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"layer must be the name of a wall, such as 'hole:1', or several names, not {name!r}")
    return names


def no_layer(batch: MeshBatch, b: int, along: Tensor, names: tuple[str, ...]) -> str:
    """Says that mesh b has no layer along the walls of these names, whose vertices are `along` (V,) bool."""
    where = ", ".join(names)
    if len(batch.quads):
        rows = slice(*batch.triangle_offsets[b : b + 2].tolist())
        sides = torch.stack([batch.triangles[rows], batch.triangles[rows].roll(-1, 1)], 2)
        on_it = (batch.twin.reshape(-1, 3)[rows] < 0) & along[sides].all(2) & batch.of_quads[rows, None]
        if bool(on_it.any()):
            return (
                f"along {where} stand quads, and no layer of thin triangles. Quads need no layer=: they aim at the "
                "shapes that they had before the motion; rigid=mask carries them exactly where their wall does not bend"
            )
    return f"there is no layer along {where}: no {LayerOptions().rows} rows or more of thin triangles stand there"
