"""A small trained network that moves meshes, alone and with the layer `nn.Untangle` behind it."""

from typing import TYPE_CHECKING

from ..answers import Refused, Result
from ..registry import method

if TYPE_CHECKING:
    from torch import Tensor

    from ...mesh.batch import MeshBatch


def _moved(mesh: "MeshBatch", undeformed: "MeshBatch") -> "Tensor":
    """(V, 2) where the trained network puts the vertices."""
    import torch

    from ..network import load

    if len(mesh.quads):
        raise Refused("it takes triangles only")
    if len(mesh.points) != len(undeformed.points):
        raise Refused("the mesh has other vertices than the undeformed one")
    network = load("trained")
    with torch.no_grad():
        return network(undeformed, mesh.points)


@method("network", undeformed=True, weights=True)
def network(mesh: "MeshBatch", undeformed: "MeshBatch") -> Result:
    """The trained network of network.py alone."""
    return Result(mesh.with_points(_moved(mesh, undeformed)))


@method("network-layer", undeformed=True, weights=True)
def network_with_layer(mesh: "MeshBatch", undeformed: "MeshBatch") -> Result:
    """The same network with `nn.Untangle` behind it."""
    from ...learning.nn import Untangle

    return Result(mesh.with_points(Untangle(on_failure="keep")(_moved(mesh, undeformed), mesh)))
