"""A network that moves a mesh after its boundary.

It adds to the harmonic extension of the boundary's displacement what it has learnt (compare Haubner, Hellan, Zeinhofer
& Kuchta, Learning mesh motion techniques with application to fluid-structure interaction, 2024).  Training is in
experiments/learning/train_mover.py; the weights lie beside it, and are no part of an installation.
"""

import functools
from pathlib import Path

import torch
from torch import Tensor, nn

from ..mesh.batch import MeshBatch
from ..mesh.connectivity import edges
from ..mesh.interfaces import holding
from ..mesh.means import vertex_size
from ..warping.femwarp import femwarp
from .weights import weights_file

# What the network sees at a vertex: the harmonic displacement in local widths (2), how the displacements of its
# neighbours differ from it (4: mean and mean square), whether it is fixed, and the logarithm of its size.
_FEATURES = 8


class Mover(nn.Module):
    """From an undeformed mesh and the positions of its boundary to positions of all vertices.

    width, rounds  of its layers, and of messages between neighbours
    gain           a factor on what it adds to the harmonic displacement
    """

    def __init__(self, width: int = 48, rounds: int = 6) -> None:
        super().__init__()
        self.gain = 1.0
        self.enter = nn.Sequential(nn.Linear(_FEATURES, width), nn.GELU(), nn.Linear(width, width), nn.GELU())
        self.rounds = nn.ModuleList(
            nn.Sequential(nn.Linear(2 * width + 4, width), nn.GELU(), nn.Linear(width, width)) for _ in range(rounds)
        )
        self.leave = nn.Linear(width, 2)

    def forward(self, undeformed: MeshBatch, boundary: Tensor) -> Tensor:
        """(V, 2) float64 positions.

        boundary  (V, 2) float64, of which the rows of fixed vertices count
        """
        fixed = holding(undeformed).fixed
        carried = femwarp(undeformed, boundary).points
        size = vertex_size(undeformed)[:, None]
        edge = edges(undeformed.triangles, undeformed.twin)
        tail, head = torch.cat([edge, edge.flip(1)]).T
        degree = torch.bincount(head, minlength=len(size)).clamp_min(1)[:, None]

        def mean(values: Tensor) -> Tensor:
            """(V, C) the means over the neighbours of each vertex of values (H, C) at half-edges."""
            return torch.zeros((len(size), values.shape[1]), dtype=values.dtype).index_add(0, head, values) / degree

        shift = (carried - undeformed.points) / size
        change = shift[tail] - shift[head]
        seen = [shift, mean(change), mean(change.square()), fixed[:, None].double(), size.log() - size.log().mean()]
        state = self.enter(torch.cat([squashed(torch.cat(seen[:3], 1)), *seen[3:]], 1).float())
        # The direction of each edge before and after, in local widths.
        sides = [(p[tail] - p[head]) / size[head] for p in (undeformed.points, carried)]
        along = squashed(torch.cat(sides, 1)).float()
        for around in self.rounds:
            messages = around(torch.cat([state[head], state[tail], along], 1))
            state = state + mean(messages)
        added = self.gain * size * self.leave(state).double()
        return torch.where(fixed[:, None], boundary, carried + added)


def squashed(values: Tensor) -> Tensor:
    """Values of any size brought between -8 and 8 or so, in proportion where they are small."""
    return values.asinh()


def load(which: str) -> Mover:
    """The network with its "untrained" or "trained" weights; the caller may set its gain.  Raises Missing."""
    return _loaded(which, weights_file())


@functools.cache
def _loaded(which: str, path: Path) -> Mover:
    states = torch.load(path, weights_only=True)
    network = Mover()
    network.load_state_dict(states[which])
    return network.eval()
