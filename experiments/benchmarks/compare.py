"""torchmesh and the peers that are installed, side by side on the same tangled meshes, as a Markdown table.

python -m pip install '.[peers]' && python experiments/benchmarks/compare.py --cache out/benchmarks
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import domains
import measuring
import numpy as np
import peers
import torch
import typer

import torchmesh as tm

TOOLS: dict[str, Callable[..., peers.Outcome]] = {"gmsh": peers.gmsh, "MFEM TMOP": peers.mfem, "mouette": peers.mouette}


def main(
    cache: Annotated[Path, typer.Option(help="Where the generated meshes are kept.")] = Path("out/benchmarks"),
    triangles: Annotated[int, typer.Option(help="About this many triangles a mesh.")] = 2200,
    batch: Annotated[int, typer.Option(help="Meshes in the batch of the last row.")] = 30,
    repeats: Annotated[int, typer.Option(help="The least time of so many runs.")] = 3,
) -> None:
    """Print a row for every domain and tool: seconds, inverted triangles left, inverse mean ratio."""
    measuring.one_thread()
    cache.mkdir(parents=True, exist_ok=True)
    print(f"{measuring.machine()}; one thread; least of {repeats} runs\n")
    print("| domain | triangles | inverted | tool | seconds | inverted left | IMR average | IMR maximum |")
    print("|---|---|---|---|---|---|---|---|")
    for case in domains.variants(3, triangles, cache):
        mesh = case.mesh
        head = f"| {case.name} | {len(mesh.triangles):,} | {int(tm.quality(mesh).inverted)} |"
        print(f"{head} torchmesh | {_ours(mesh, repeats)}")
        arrays = mesh.points.numpy(), mesh.triangles.numpy(), mesh.fixed.numpy()
        for name, tool in TOOLS.items():
            print(f"{head} {name} | {_peer(tool, arrays, repeats)}")
    meshes = [case.mesh for case in domains.variants(batch, triangles, cache)]
    joined = tm.join(meshes)
    inverted = int(tm.quality(joined).inverted.sum()) // batch
    print(f"| batch of {batch}, a mesh | {len(joined.triangles) // batch:,} | {inverted} | torchmesh | ", end="")
    print(_ours(joined, repeats))


def _ours(mesh: tm.MeshBatch, repeats: int) -> str:
    seconds = []
    for _ in range(repeats):
        with measuring.Stopwatch() as watch:
            better, _ = tm.improve(mesh)
        seconds.append(watch.seconds.wall)
    return _cells(better, min(seconds) / len(mesh))


def _peer(tool: Callable[..., peers.Outcome], arrays: tuple[np.ndarray, ...], repeats: int) -> str:
    try:
        outcomes = [tool(*arrays) for _ in range(repeats)]
    except peers.Missing as missing:
        return f"not installed: {missing} | | | |"
    except peers.Refused as refused:
        return f"refused: {refused} | | | |"
    best = min(outcomes, key=lambda o: o.seconds.wall)
    mesh = tm.MeshBatch.from_arrays(arrays[0], arrays[1]).with_points(torch.from_numpy(best.points))
    return _cells(mesh, best.seconds.wall)


def _cells(mesh: tm.MeshBatch, seconds: float) -> str:
    q = tm.quality(mesh)
    return f"{seconds:.3f} | {int(q.inverted.sum())} | {float(q.mean.mean()):.3f} | {float(q.max.max()):.2f} |"


if __name__ == "__main__":
    typer.run(main)
