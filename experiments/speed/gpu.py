"""What does a GPU bring?  Flips, smoothing, `improve` and the layer, there and on the processor, self-checking.

    python -m experiments.speed.gpu                (under five minutes; on another device: --device cuda:1)

Every result of the device is compared with that of the processor: as many meshes valid, and average inverse mean ratios
within 0.01.  The exit status is 1 where they differ, and 2 where there is no such device.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable, Sequence

import torch

import torchmesh as tm
from experiments.shared import arguments, tables

# What is measured: from a batch of tangled meshes, or of valid ones, to meshes.
Work = Callable[[tm.MeshBatch], tm.MeshBatch]


def works() -> dict[str, tuple[bool, Work]]:
    """By name: whether it takes tangled meshes, and the work."""
    keep = tm.ImproveOptions(topology="keep", workers=1)
    return {
        "flip_to_delaunay": (False, lambda mesh: tm.flip_to_delaunay(mesh)[0]),
        "smooth": (False, lambda mesh: tm.smooth(mesh)[0]),
        "nn.Smooth, forward and backward": (False, trained),
        "improve, triangles kept": (True, lambda mesh: tm.improve(mesh, keep)[0]),
        "improve": (True, lambda mesh: tm.improve(mesh, tm.ImproveOptions(workers=1))[0]),
    }


def trained(mesh: tm.MeshBatch) -> tm.MeshBatch:
    """The layer's output, after its gradient was asked for."""
    points = mesh.points.clone().requires_grad_()
    out = tm.nn.Smooth(mesh, on_failure="keep")(points)
    out.square().sum().backward()
    return mesh.with_points(out.detach())


def timed(work: Work, mesh: tm.MeshBatch) -> tuple[float, tm.MeshBatch]:
    """Seconds of wall time until the device is done, and the result."""
    synchronise(mesh.points.device)
    started = time.perf_counter()
    after = work(mesh)
    synchronise(mesh.points.device)
    return time.perf_counter() - started, after


def synchronise(device: torch.device) -> None:
    if device.type != "cpu":
        getattr(torch, device.type).synchronize(device)


def compare(name: str, work: Work, mesh: tm.MeshBatch, device: torch.device) -> dict:
    """A row: seconds on both, and whether they agree."""
    there = mesh.to(device)
    work(there[:1])  # what is loaded and compiled at first use
    seconds, ours = timed(work, mesh)
    elsewhere, theirs = timed(work, there)
    one, other = tm.quality(ours), tm.quality(theirs.to("cpu"))
    valid = int((one.inverted == 0).sum()), int((other.inverted == 0).sum())
    both = (one.inverted == 0) & (other.inverted == 0)
    apart = float((one.mean - other.mean).abs()[both].max()) if bool(both.any()) else 0.0
    return {
        "work": name, "meshes": len(mesh), "triangles": len(mesh.triangles), "processor": seconds, "device": elsewhere,
        "valid": valid[0], "valid there": valid[1], "means apart": apart,
        "agree": valid[0] == valid[1] and apart < 0.01,
    }  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    arguments.add_out(parser, "gpu")
    parser.add_argument("--device", default="cuda", help="the device that is compared with the processor")
    parser.add_argument("--meshes", type=int, nargs="+", default=[16, 256], help="meshes in a batch")
    parser.add_argument("--triangles", type=int, default=1000, help="triangles of a mesh, about")
    parser.add_argument("--patience", type=float, default=240.0, help="no further row is begun after so many seconds")
    given = arguments.parse(parser, argv)
    try:
        torch.zeros(1, device=given.device)
    except (RuntimeError, AssertionError) as error:
        print(f"error: no device {given.device}: {str(error).splitlines()[0]}", file=sys.stderr)
        return 2
    started, rows = time.perf_counter(), []
    made = tm.domains.generate(16, ("holes", "bar"), triangles=given.triangles, seed=1, tangled=1.0, motions=4)
    for count in given.meshes:
        pick = [i % len(made) for i in range(count)]
        meshes = {True: made.deformed[pick], False: made.undeformed[pick]}
        for name, (tangled, work) in works().items():
            if time.perf_counter() - started > given.patience:
                print(f"left out for time: {name}, {count} meshes", file=sys.stderr)
                continue
            mesh = dataclasses.replace(meshes[tangled], _twin=None)
            rows.append(compare(name, work, mesh, torch.device(given.device)))
    arguments.write_rows(given, "gpu", rows)
    titles = ("work", "meshes", "triangles", "processor, s", "device, s", "ratio", "valid", "means apart", "agree")
    print(tables.table(titles, [
        [r["work"], str(r["meshes"]), f"{r['triangles']:,}", f"{r['processor']:.3f}", f"{r['device']:.3f}",
         f"{r['device'] / r['processor']:.2f}", f"{r['valid']} and {r['valid there']}", f"{r['means apart']:.4f}",
         "yes" if r["agree"] else "NO"] for r in rows
    ]))  # fmt: skip
    return int(not all(r["agree"] for r in rows))


if __name__ == "__main__":
    sys.exit(main())
