"""What the caller of `improve` gave, whole, beside which the state of the work is kept."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

from torch import Tensor

from ..mesh.batch import MeshBatch
from ..mesh.interfaces import Interfaces
from ..mesh.means import local_widths


@dataclass(frozen=True, eq=False)
class Given:
    """What the caller gave.

    mesh       the batch
    reference  the same meshes undeformed, or None
    sizes      (V,) the edge lengths asked for, or None
    stays      (V,) bool, the vertices that do not move: fixed or on interfaces, and not sliding
    interfaces  what becomes of the vertices on interfaces
    walls      gives, by name, edges (K, 2) that messages call so: layers over them are told by these names
    layers     (V,) bool, the vertices of layers that are held, with the walls below; None: no layer is held
    tether     how many local widths vertices may move in meshes that are tethered
    quad_shapes  (4Q, 2, 2) what the corners of quads aim at; None: the corner of a square
    anchors    (V, 2) the positions from which that is measured; None: those of `mesh`
    anchor_widths  (V,) the local widths there; None: those of `mesh`
    """

    mesh: MeshBatch
    reference: MeshBatch | None
    sizes: Tensor | None
    stays: Tensor
    interfaces: Interfaces
    walls: Callable[[], Mapping[str, Tensor]] = dict
    layers: Tensor | None = None
    tether: float = 1.0
    quad_shapes: Tensor | None = None
    anchors: Tensor | None = None
    anchor_widths: Tensor | None = None

    @cached_property
    def widths(self) -> Tensor:
        """(V,) how wide the mesh is at each vertex, the mean length of its edges there."""
        return local_widths(self.mesh) if self.anchor_widths is None else self.anchor_widths
