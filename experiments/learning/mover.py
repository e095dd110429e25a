"""The task of learn_to_move.py, and the network that learns it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

import torchmesh as tm
from torchmesh.mesh.batch import vertex_mesh
from torchmesh.mesh.connectivity import edges
from torchmesh.mesh.means import vertex_size


@dataclass(frozen=True)
class Task:
    """Meshes at rest, the motion wanted of each and the valid meshes that it should lead to.

    mesh    B meshes at rest
    wanted  (V, 2) the positions that their vertices should reach
    code    (B, 6) the hole's centre, its shift, and the cosine (less 1) and the sine of its turn
    hole    (V,) bool: the vertices of the hole
    size    (V,) the mean length of the edges at each vertex
    """

    mesh: tm.MeshBatch
    wanted: Tensor
    code: Tensor
    hole: Tensor
    size: Tensor

    @classmethod
    def draw(cls, count: int, seed: int, triangles: int) -> Task:
        """`count` motions of random domains, without the few that no valid mesh with these triangles fits."""
        moved = tm.domains.generate(count, ["bar"], seed=seed, triangles=triangles, motions=4)
        layer = tm.nn.Untangle(moved.deformed, on_failure="keep")
        points = layer(moved.deformed.points)
        valid = layer.info.valid
        return cls.of(moved.undeformed.select(valid), moved.deformed.with_points(points).select(valid).points)

    @classmethod
    def of(cls, mesh: tm.MeshBatch, wanted: Tensor) -> Task:
        """From the meshes at rest and the positions wanted."""
        owner = vertex_mesh(mesh)
        low = torch.stack([wanted.new_full((len(mesh),), torch.inf).scatter_reduce(0, owner, c, "amin")
                           for c in mesh.points.T], 1)[owner]  # fmt: skip
        high = torch.stack([wanted.new_full((len(mesh),), -torch.inf).scatter_reduce(0, owner, c, "amax")
                            for c in mesh.points.T], 1)[owner]  # fmt: skip
        inside = ((mesh.points > low + 1e-9) & (mesh.points < high - 1e-9)).all(1)
        hole = mesh.fixed & inside

        def mean(values: Tensor) -> Tensor:
            sums = values.new_zeros((len(mesh), values.shape[1])).index_add(0, owner[hole], values[hole])
            return sums / torch.bincount(owner[hole], minlength=len(mesh))[:, None]

        start, end = mean(mesh.points), mean(wanted)
        p, q = mesh.points - start[owner], wanted - end[owner]
        turn = mean(torch.stack([(p * q).sum(1), p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]], 1))
        turn = turn / turn.norm(dim=1, keepdim=True) - turn.new_tensor([1.0, 0.0])
        return cls(mesh, wanted, torch.cat([start, end - start, turn], 1), hole, vertex_size(mesh))

    def part(self, chosen: Tensor) -> Task:
        """The meshes for which `chosen` (B,) is true."""
        mesh = self.mesh.select(chosen)
        keep = chosen[vertex_mesh(self.mesh)]
        return Task(mesh, self.wanted[keep], self.code[chosen], self.hole[keep], self.size[keep])


class Mover(nn.Module):
    """Displacements from positions and the code of the motion: a perceptron on each vertex, rounds with neighbours."""

    def __init__(self, width: int = 64, rounds: int = 4) -> None:
        super().__init__()
        self.enter = nn.Sequential(nn.Linear(12, width), nn.GELU(), nn.Linear(width, width), nn.GELU())
        self.rounds = nn.ModuleList(nn.Sequential(nn.Linear(2 * width, width), nn.GELU()) for _ in range(rounds))
        self.leave = nn.Linear(width, 2)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def forward(self, task: Task) -> Tensor:
        """(V, 2) the new positions; the vertices of the rectangle stay."""
        mesh = task.mesh
        owner = vertex_mesh(mesh)
        code = task.code[owner]
        rest = mesh.points - code[:, :2]
        distance = torch.stack([torch.hypot(*rest.T), (~task.hole & mesh.fixed).double()], 1)
        state = self.enter(torch.cat([mesh.points, rest, distance, code], 1).float())
        edge = edges(mesh.triangles, mesh.twin)
        tail, head = torch.cat([edge, edge.flip(1)]).T
        degree = torch.bincount(head, minlength=len(state)).clamp_min(1)[:, None]
        for around in self.rounds:
            mean = torch.zeros_like(state).index_add(0, head, state[tail]) / degree
            state = state + around(torch.cat([state, mean], 1))
        moves = (~mesh.fixed | task.hole)[:, None]
        return mesh.points + moves * self.leave(state).double()
