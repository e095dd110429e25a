"""A graph network of PyTorch Geometric that moves meshes: trained, validated, and its tangled outputs counted.

    python -m experiments.learning.gnn_example            (needs the extra `pyg`; about three minutes)

Bodies move in a channel.  The network sees the harmonic extension of the motion and learns what to add to it; the loss
is the regularised functional, whose targets are the undeformed triangles, so that nobody has to give examples.  Three
networks are compared on meshes that none has seen:

    no guard    learns to follow valid meshes that `improve` made; nothing keeps it from tangling
    the loss    learns the same with the untangling loss added
    the layer   the network with the loss, with `tm.nn.Untangle` behind it.  The layer's result depends on the boundary
                alone, which is given here, so that it reaches what is wanted whatever the network puts out

It writes a table, the rows as CSV, and a picture.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

import torchmesh as tm
from experiments.shared import arguments, tables

WAYS = ("no guard", "the loss", "the layer")


@dataclass(frozen=True)
class Data:
    """A batch of undeformed meshes, and (V, 2) the harmonic and the wanted positions of their vertices."""

    rest: tm.MeshBatch
    carried: Tensor
    wanted: Tensor


def data(count: int, seed: int, triangles: int) -> tm.datasets.InMemoryMeshes:
    """Pairs of undeformed and tangled meshes in memory; the meshes that no valid mesh with these triangles fits go."""
    moved = tm.domains.generate(count, ["bar", "circle"], seed=seed, triangles=triangles, motions=4)
    _, report = tm.improve(moved.deformed, tm.ImproveOptions(topology="keep"))
    return tm.datasets.InMemoryMeshes(tm.datasets.Pair(moved.undeformed[report.valid], moved.deformed[report.valid]))


def batches(meshes: tm.datasets.InMemoryMeshes, size: int, shuffle: bool) -> DataLoader:
    return DataLoader(
        meshes, batch_size=size, shuffle=shuffle, collate_fn=prepared, generator=torch.Generator().manual_seed(0)
    )


def prepared(pair: tm.datasets.Pair) -> Data:
    """What the network needs of a batch of pairs."""
    layer = tm.nn.Untangle(on_failure="keep", options=tm.nn.LayerOptions(tolerance=1e-6))
    with torch.no_grad():
        return Data(pair.undeformed, pair.deformed.points, layer(pair.deformed.points, pair.undeformed))


class Network(nn.Module):
    """Rounds of messages along the edges of a PyG batch."""

    def __init__(self, width: int = 48, rounds: int = 6) -> None:
        super().__init__()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of torch_geometric's own
            from torch_geometric.nn import GraphConv

        self.enter = nn.Sequential(nn.Linear(6, width), nn.GELU(), nn.Linear(width, width))
        self.rounds = nn.ModuleList(GraphConv(width, width, aggr="mean") for _ in range(rounds))
        self.leave = nn.Linear(width, 2)
        nn.init.zeros_(self.leave.weight)
        nn.init.zeros_(self.leave.bias)

    def forward(self, batch: Data) -> Tensor:
        """(V, 2) positions; fixed vertices are where the motion took them."""
        graphs = tm.to_pyg(batch.rest)
        moved = batch.carried - graphs.pos
        fixed = graphs.fixed[:, None].double()
        state = self.enter(torch.cat([graphs.pos, moved, moved.norm(dim=1, keepdim=True), fixed], 1).float())
        for messages in self.rounds:
            state = state + nn.functional.gelu(messages(state, graphs.edge_index))
        return torch.where(graphs.fixed[:, None], batch.carried, batch.carried + self.leave(state).double())


def train(way: str, given: object, train_on: DataLoader, validate_on: DataLoader) -> tuple[Network, list[dict]]:
    """A network trained one of the WAYS, and what it does on meshes not seen, epoch by epoch."""
    torch.manual_seed(given.seed)
    network = Network()
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    log = []
    for epoch in range(given.epochs + 1):
        log.append({"way": way, "epoch": epoch, **validate(network, validate_on, way == "the layer")})
        if epoch == given.epochs:
            break
        for batch in train_on:
            points = network(batch)
            loss = (points - batch.wanted).square().sum(1).mean() / batch.rest.points.var()
            if way != "no guard":
                loss = loss + given.weight * tm.losses.untangle_beta(points, batch.rest, beta=0.2).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
    return network, log


@torch.no_grad()
def validate(network: Network, meshes: DataLoader, guarded: bool) -> dict:
    """The share of tangled outputs, inverted triangles a mesh, and the mean distance from the wanted positions."""
    tangled = inverted = count = 0
    distance = []
    for batch in meshes:
        points = network(batch)
        if guarded:
            points = tm.nn.Untangle(on_failure="keep")(points, batch.rest)
        found = tm.quality(batch.rest.with_points(points)).inverted
        tangled, inverted, count = tangled + int((found > 0).sum()), inverted + int(found.sum()), count + len(found)
        distance.append((points - batch.wanted).norm(dim=1))
    return {"tangled": tangled / count, "inverted": inverted / count, "distance": float(torch.cat(distance).mean())}


def draw(path: Path, logs: dict[str, list[dict]]) -> None:
    """The share of tangled outputs along the training."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    for way in WAYS:
        axes.plot([r["epoch"] for r in logs[way]], [100 * r["tangled"] for r in logs[way]], marker="o", label=way)
    axes.set(xlabel="epoch", ylabel="tangled outputs, percent", ylim=(-3, 103), title="Meshes never seen")
    axes.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    arguments.add_out(parser, "gnn")
    parser.add_argument("--epochs", type=int, default=10, help="epochs of training")
    parser.add_argument("--meshes", type=int, default=96, help="meshes to train on; a third as many to validate on")
    parser.add_argument("--triangles", type=int, default=200, help="triangles of a mesh, about")
    parser.add_argument("--batch", type=int, default=8, help="meshes in a training step")
    parser.add_argument("--weight", type=float, default=5.0, help="weight of the untangling loss")
    parser.add_argument("--seed", type=int, default=0, help="of meshes and weights")
    given = arguments.parse(parser, argv)
    # Batches are prepared once, and not in every epoch.
    train_on = list(batches(data(given.meshes, 2 * given.seed + 1, given.triangles), given.batch, shuffle=True))
    validate_on = list(batches(data(max(1, given.meshes // 3), 2 * given.seed + 2, given.triangles), 16, shuffle=False))
    logs, rows = {}, []
    for way in WAYS:
        started = time.process_time()
        _, logs[way] = train(way, given, train_on, validate_on)
        rows.append(logs[way][-1] | {"seconds": time.process_time() - started})
    arguments.write_rows(given, "gnn", [row for way in WAYS for row in logs[way]])
    titles = ("trained with", "tangled outputs", "inverted triangles a mesh", "distance", "seconds")
    lines = [
        [r["way"], f"{100 * r['tangled']:.0f} %", f"{r['inverted']:.2f}", f"{r['distance']:.4f}", f"{r['seconds']:.0f}"]
        for r in rows
    ]
    text = tables.table(titles, lines)
    (given.out / "gnn.md").write_text(text + "\n", encoding="utf-8")
    draw(given.out / "gnn.png", logs)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
