"""Train a small network to move meshes, three times: without a guard, with an untangle loss, with the layer.

A bar-shaped hole is to be moved and turned in its rectangle; the motion is given as six numbers.
The network says where every vertex goes but those of the rectangle, the hole's own included, and
learns from meshes that the layer made valid.  What it puts out is measured on meshes of domains it
has never seen.

    no guard       mean squared distance to the wanted points
    untangle loss  the same, plus a weight times tm.losses.untangle_beta
    layer          the same distance, but of what tm.nn.Untangle makes of the output; the layer's
                   gradient tells the network what the hole's vertices do to all others.  It joins the
                   training after a third of the steps, and is in every measurement

    python experiments/learn_to_move.py --out out/learn

Writes learn.png (the share of tangled outputs along the training, and one mesh three ways),
learn.md and learn.json.  Two to three minutes on one core.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import torch
import typer
from torch import Tensor, nn

import torchmesh as tm
from torchmesh.mesh.batch import vertex_mesh
from torchmesh.mesh.connectivity import edges, twins
from torchmesh.mesh.neighbourhoods import vertex_size

WAYS = ("no guard", "untangle loss", "layer")


@dataclass(frozen=True)
class Task:
    """Meshes at rest, the motion wanted of each and the valid meshes that it should lead to.

    mesh    B meshes at rest                 wanted  (V, 2) where their vertices should go
    code    (B, 6) the hole's middle, its shift, and the cosine and sine of its turn, less those at rest
    hole    (V,) bool                        size    (V,) length of the edges round each vertex
    """

    mesh: tm.MeshBatch
    wanted: Tensor
    code: Tensor
    hole: Tensor
    size: Tensor

    @classmethod
    def draw(cls, count: int, seed: int, triangles: int) -> Task:
        """`count` motions of random domains; the few that no valid mesh of these triangles fits are left out."""
        moved = tm.domains.generate(count, ["bar"], seed=seed, triangles=triangles, motions=4)
        layer = tm.nn.Untangle(moved.deformed, on_failure="keep")
        points = layer(moved.deformed.points)
        valid = layer.info.valid
        return cls.of(moved.undeformed.select(valid), moved.deformed.with_points(points).select(valid).points)

    @classmethod
    def of(cls, mesh: tm.MeshBatch, wanted: Tensor) -> Task:
        """From the meshes at rest and the points wanted."""
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
        """The meshes whose (B,) bool is true."""
        mesh = self.mesh.select(chosen)
        keep = chosen[vertex_mesh(self.mesh)]
        return Task(mesh, self.wanted[keep], self.code[chosen], self.hole[keep], self.size[keep])


class Mover(nn.Module):
    """Displacements from places and the motion's code: a perceptron on each vertex, rounds with neighbours."""

    def __init__(self, width: int = 64, rounds: int = 4) -> None:
        super().__init__()
        self.enter = nn.Sequential(nn.Linear(12, width), nn.GELU(), nn.Linear(width, width), nn.GELU())
        self.rounds = nn.ModuleList(nn.Sequential(nn.Linear(2 * width, width), nn.GELU()) for _ in range(rounds))
        self.leave = nn.Linear(width, 2)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def forward(self, task: Task) -> Tensor:
        """(V, 2) where the vertices go; those of the rectangle stay."""
        mesh = task.mesh
        owner = vertex_mesh(mesh)
        code = task.code[owner]
        rest = mesh.points - code[:, :2]
        distance = torch.stack([torch.hypot(*rest.T), (~task.hole & mesh.fixed).double()], 1)
        state = self.enter(torch.cat([mesh.points, rest, distance, code], 1).float())
        edge = edges(mesh.triangles, twins(mesh.triangles))
        tail, head = torch.cat([edge, edge.flip(1)]).T
        degree = torch.bincount(head, minlength=len(state)).clamp_min(1)[:, None]
        for around in self.rounds:
            mean = torch.zeros_like(state).index_add(0, head, state[tail]) / degree
            state = state + around(torch.cat([state, mean], 1))
        moves = (~mesh.fixed | task.hole)[:, None]
        return mesh.points + moves * self.leave(state).double()


def train(way: str, train_set: Task, test_set: Task, steps: int, batch: int, weight: float) -> tuple[Mover, list[dict]]:
    """A network trained one of the three WAYS, and what it did on `test_set` along its training."""
    torch.manual_seed(0)
    chooser = torch.Generator().manual_seed(0)
    network = Mover()
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    layer = tm.nn.Untangle(options=tm.nn.LayerOptions(tolerance=1e-6), on_failure="keep")
    log = []
    for step in range(steps + 1):
        if step % max(1, steps // 6) == 0:
            log.append({"way": way, "step": step, **measure(network, test_set, layer if way == "layer" else None)})
        if step == steps:
            break
        chosen = torch.zeros(len(train_set.mesh), dtype=torch.bool)
        chosen[torch.randperm(len(chosen), generator=chooser)[:batch]] = True
        task = train_set.part(chosen)
        points = network(task)
        # The layer joins when the hole's outline has settled a little: of a crossed one nothing can be learnt.
        if way == "layer" and step >= steps // 3:
            points = layer(points, task.mesh)
        loss = (((points - task.wanted) / task.size[:, None]) ** 2).sum(1).mean()
        if way == "untangle loss":
            loss = loss + weight * tm.losses.untangle_beta(points, task.mesh, beta=0.1).mean()
        optimiser.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        schedule.step()
    return network, log


@torch.no_grad()
def measure(network: Mover, task: Task, layer: tm.nn.Untangle | None) -> dict:
    """The share of tangled outputs, inverted triangles a mesh, and how far vertices are from where they should be."""
    points = output(network, task, layer)
    q = tm.quality(task.mesh.with_points(points))
    error = torch.linalg.vector_norm(points - task.wanted, dim=1) / task.size
    return {
        "tangled": float((q.inverted > 0).double().mean()),
        "inverted": float(q.inverted.double().mean()),
        "error": float(error.square().mean().sqrt()),
    }


def output(network: Mover, task: Task, layer: tm.nn.Untangle | None) -> Tensor:
    """(V, 2) the network's points, through the layer if there is one."""
    points = network(task)
    return points if layer is None else layer(points, task.mesh)


def draw(path: Path, logs: dict[str, list[dict]], networks: dict[str, Mover], task: Task) -> None:
    """The share of tangled outputs along the training, and the mesh that no guard tangles most."""
    import matplotlib.pyplot as plt

    from torchmesh.pictures.mesh_plot import plot_mesh

    layer = tm.nn.Untangle(on_failure="keep")
    with torch.no_grad():
        points = {way: output(networks[way], task, layer if way == "layer" else None) for way in WAYS}
    counts = tm.quality(task.mesh.with_points(points["no guard"])).inverted
    worst = int(counts.argmax())
    figure, axes = plt.subplot_mosaic([["a", "b"], ["c", "d"]], figsize=(11, 6.5), layout="constrained")
    for way in WAYS:
        axes["a"].plot([r["step"] for r in logs[way]], [100 * r["tangled"] for r in logs[way]], marker="o", label=way)
    axes["a"].set(xlabel="training step", ylabel="tangled outputs, percent", ylim=(-3, 103), title="Domains never seen")
    axes["a"].legend()
    for name, way in zip("bcd", WAYS, strict=True):
        mesh = task.mesh.with_points(points[way]).split()[worst]
        q = tm.quality(mesh)
        plot_mesh(axes[name], mesh, q)
        axes[name].set_title(f"{way}: {int(q.inverted[0])} inverted")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def table(rows: list[dict]) -> str:
    """The last row of each way, as Markdown."""
    lines = [
        "| trained with | tangled outputs | inverted triangles a mesh | error, edge lengths | seconds |",
        "|---|---|---|---|---|",
    ]
    for r in rows:
        lines.append(
            f"| {r['way']} | {100 * r['tangled']:.0f} % | {r['inverted']:.2f} | {r['error']:.2f} | {r['seconds']:.0f} |"
        )
    return "\n".join(lines)


def main(
    out: Annotated[Path, typer.Option(help="Folder for the picture and the tables.")] = Path("out/learn"),
    steps: Annotated[int, typer.Option(help="Training steps.")] = 150,
    meshes: Annotated[int, typer.Option(help="Meshes to train on; a quarter as many to test on.")] = 192,
    triangles: Annotated[int, typer.Option(help="Triangles of a mesh, about.")] = 300,
    batch: Annotated[int, typer.Option(help="Meshes in a training step.")] = 8,
    weight: Annotated[float, typer.Option(help="Weight of the untangle loss.")] = 50.0,
) -> None:
    """Train three ways and show how many outputs are tangled."""
    torch.set_num_threads(1)
    train_set, test_set = Task.draw(meshes, 1, triangles), Task.draw(meshes // 4, 2, triangles)
    logs, networks, rows = {}, {}, []
    for way in WAYS:
        started = time.perf_counter()
        networks[way], logs[way] = train(way, train_set, test_set, steps, batch, weight)
        rows.append(logs[way][-1] | {"seconds": time.perf_counter() - started})
    out.mkdir(parents=True, exist_ok=True)
    (out / "learn.md").write_text(table(rows) + "\n", encoding="utf-8")
    (out / "learn.json").write_text(json.dumps({"last": rows, "logs": logs}, indent=1), encoding="utf-8")
    draw(out / "learn.png", logs, networks, test_set)
    typer.echo(table(rows))


if __name__ == "__main__":
    typer.run(main)
