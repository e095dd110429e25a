"""Train the network of the benchmark (torchmesh/bench/network.py), and keep its weights from before and after.

    python -m experiments.learning.train_mover

It learns without examples: its loss is the regularised functional with the undeformed triangles as targets, on cases of
the family `moved` that are no part of the benchmark.  The weights go to experiments/learning/weights/mover.pt, where a
checkout's `torchmesh bench` finds them.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import torch

import torchmesh as tm
from experiments.shared import arguments
from torchmesh.bench.case import COUNT, Case
from torchmesh.bench.catalogue import families
from torchmesh.bench.network import Mover
from torchmesh.bench.weights import CHECKOUT


def examples(first: int, count: int) -> list[Case]:
    """Cases that follow those of the benchmark."""
    family = families()["moved"]
    return [family.case(COUNT + first + number) for number in range(count)]


def loss_of(network: Mover, cases: list[Case]) -> torch.Tensor:
    """The mean logarithm of the functional, so that no mesh outweighs the others."""
    rest = tm.join([case.undeformed for case in cases])
    goal = torch.cat([case.mesh.points for case in cases])
    points = network(rest, goal)
    return tm.losses.regularised(points, rest, eps=0.1, reference=True).log().mean()


@torch.no_grad()
def tangled(network: Mover, cases: list[Case]) -> tuple[float, float]:
    """The share of meshes that come out tangled, and the inverted triangles a mesh."""
    rest = tm.join([case.undeformed for case in cases])
    goal = torch.cat([case.mesh.points for case in cases])
    inverted = tm.quality(rest.with_points(network(rest, goal))).inverted.double()
    return float((inverted > 0).double().mean()), float(inverted.mean())


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--out", type=Path, default=CHECKOUT, help="the file of weights")
    parser.add_argument("--steps", type=int, default=600, help="training steps")
    parser.add_argument("--meshes", type=int, default=120, help="meshes to train on; a quarter as many to validate on")
    parser.add_argument("--batch", type=int, default=4, help="meshes in a training step")
    parser.add_argument("--seed", type=int, default=0, help="of the first weights and of the order of the meshes")
    given = arguments.parse(parser, argv)
    train, validate = examples(0, given.meshes), examples(given.meshes, max(1, given.meshes // 4))
    torch.manual_seed(given.seed)
    network = Mover()
    untrained = {name: value.clone() for name, value in network.state_dict().items()}
    # What is added to the harmonic displacement begins at zero.
    torch.nn.init.zeros_(network.leave.weight)
    torch.nn.init.zeros_(network.leave.bias)
    order = torch.Generator().manual_seed(given.seed)
    optimiser = torch.optim.Adam(network.parameters(), lr=2e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 3e-3, total_steps=given.steps)
    for step in range(given.steps):
        if step % max(1, given.steps // 6) == 0:
            share, inverted = tangled(network, validate)
            print(
                f"step {step}: {100 * share:.0f} % of the meshes not seen are tangled, {inverted:.1f} inverted a mesh"
            )
        some = torch.randint(len(train), (given.batch,), generator=order).tolist()
        loss = loss_of(network, [train[i] for i in some])
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimiser.step()
        schedule.step()
    share, inverted = tangled(network, validate)
    print(f"step {given.steps}: {100 * share:.0f} % tangled, {inverted:.1f} inverted a mesh")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"untrained": untrained, "trained": network.state_dict()}, given.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
