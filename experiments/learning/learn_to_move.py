"""Train a small network to move meshes, three times: without a guard, with an untangle loss, with the layer.

    python -m experiments.learning.learn_to_move

A bar-shaped hole is to be moved and turned in its rectangle; the motion is given as six numbers.  The network says
where all vertices go, the hole's own included, except those of the rectangle.  It learns from meshes that the layer
made valid, and is measured on meshes of domains that it has never seen.

    no guard       mean squared distance to the wanted points
    untangle loss  the same, plus a weight times tm.losses.untangle_beta
    layer          the same distance, but of what tm.nn.Untangle makes of the output; the layer's gradient tells the
                   network what the hole's vertices do to all others.  The layer joins the training after a third of
                   the steps, and is in every measurement

Writes learn.png (the share of tangled outputs along the training, and one mesh three ways), learn.md and learn.json.
Two to three minutes on one core.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import torch
from torch import Tensor, nn

import torchmesh as tm
from experiments.learning.mover import Mover, Task
from experiments.shared import arguments, tables

WAYS = ("no guard", "untangle loss", "layer")


def train(way: str, train_set: Task, test_set: Task, steps: int, batch: int, weight: float) -> tuple[Mover, list[dict]]:
    """A network trained in one of the WAYS, and what it did on `test_set` along its training."""
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
        # The layer joins when the hole's outline has settled a little: from a crossed one nothing can be learnt.
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
    """The share of tangled outputs, inverted triangles a mesh, and the distance of vertices from those wanted."""
    points = output(network, task, layer)
    q = tm.quality(task.mesh.with_points(points))
    error = torch.linalg.vector_norm(points - task.wanted, dim=1) / task.size
    return {
        "tangled": float((q.inverted > 0).double().mean()),
        "inverted": float(q.inverted.double().mean()),
        "error": float(error.square().mean().sqrt()),
    }


def output(network: Mover, task: Task, layer: tm.nn.Untangle | None) -> Tensor:
    """(V, 2) the points that the network gives, through the layer if there is one."""
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
    titles = ("trained with", "tangled outputs", "inverted triangles a mesh", "error, edge lengths", "seconds")
    lines = []
    for r in rows:
        numbers = [f"{100 * r['tangled']:.0f} %", f"{r['inverted']:.2f}", f"{r['error']:.2f}", f"{r['seconds']:.0f}"]
        lines.append([r["way"], *numbers])
    return tables.table(titles, lines)


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    arguments.add_out(parser, "learn")
    parser.add_argument("--steps", type=int, default=150, help="training steps")
    parser.add_argument("--meshes", type=int, default=192, help="meshes to train on; a quarter as many to test on")
    parser.add_argument("--triangles", type=int, default=300, help="triangles of a mesh, about")
    parser.add_argument("--batch", type=int, default=8, help="meshes in a training step")
    parser.add_argument("--weight", type=float, default=50.0, help="weight of the untangle loss")
    given = arguments.parse(parser, argv)
    train_set = Task.draw(given.meshes, 1, given.triangles)
    test_set = Task.draw(given.meshes // 4, 2, given.triangles)
    logs, networks, rows = {}, {}, []
    for way in WAYS:
        started = time.perf_counter()
        networks[way], logs[way] = train(way, train_set, test_set, given.steps, given.batch, given.weight)
        rows.append(logs[way][-1] | {"seconds": time.perf_counter() - started})
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "learn.md").write_text(table(rows) + "\n", encoding="utf-8")
    (given.out / "learn.json").write_text(json.dumps({"last": rows, "logs": logs}, indent=1), encoding="utf-8")
    draw(given.out / "learn.png", logs, networks, test_set)
    print(table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
