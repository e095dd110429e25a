"""What does each stage of `improve` cost, and what does it bring?  And how much of the time is in compiled loops?

    python -m experiments.speed.stages

The meshes are circle, bar and gate of Kim 2017, deformed harder than there, no two alike, as one batch and one by one.
The table has for each stage the processor time of one thread in milliseconds a mesh, the part of it inside compiled
loops, and what the stage changed, summed over a mesh's rounds and averaged over the meshes: the inverted triangles that
it took away, and by how much it lowered the average and the maximum of the inverse mean ratio of meshes without any.
The time inside compiled loops is a bound: the same loops, called by nothing, would take as long.
"""

from __future__ import annotations

import importlib
import itertools
import math
import pkgutil
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from unittest import mock

import torch

import torchmesh as tm
from experiments.shared import arguments, clocks, domains, tables
from torchmesh import kernels
from torchmesh.improving.runner import Runner
from torchmesh.kernels import library

HEAD = ["stage", "ms a mesh", "in compiled loops", "inverted taken away", "average lowered by", "maximum lowered by"]
BETWEEN = "between the stages"


@dataclass
class Costs:
    """Seconds of processor time by stage: of all work, and of the part inside compiled loops."""

    seconds: Counter[str] = field(default_factory=Counter)
    inside: Counter[str] = field(default_factory=Counter)
    stage: str = BETWEEN

    def of_loop(self, loop: Callable[..., int]) -> Callable[..., int]:
        """`loop`, whose time is counted."""

        def timed(*given: object) -> int:
            began = time.process_time()
            try:
                return loop(*given)
            finally:
                self.inside[self.stage] += time.process_time() - began

        return timed

    def run(self, runner: Runner, name: str, *given: object) -> object:
        """`Runner.__call__`, whose time is counted."""
        before, self.stage, began = self.stage, name, time.process_time()
        try:
            return _RUN(runner, name, *given)
        finally:
            self.seconds[name] += time.process_time() - began
            self.stage = before


_RUN = Runner.__call__


@contextmanager
def counted() -> Iterator[Costs]:
    """Inside, stages and compiled loops are timed."""
    costs, call, function = Costs(), library.call, library.function
    # A function is looked up once and called often.
    timed = {"call": costs.of_loop(call), "function": lambda *of: costs.of_loop(function(*of))}
    modules = [importlib.import_module(f"{kernels.__name__}.{m.name}") for m in pkgutil.iter_modules(kernels.__path__)
               if not m.name.startswith("_")]  # fmt: skip
    patches = [mock.patch.object(module, name, new) for module in modules for name, new in timed.items()
               if hasattr(module, name)]  # fmt: skip
    patches.append(mock.patch.object(Runner, "__call__", lambda *given: costs.run(*given)))
    for patch in patches:
        patch.start()
    try:
        yield costs
    finally:
        for patch in patches:
            patch.stop()


def gains(reports: Sequence[tm.Report]) -> dict[str, list[float]]:
    """By stage the inverted triangles taken away, and by how much average and maximum fell, summed over the meshes."""
    found: dict[str, list[float]] = {}
    for steps in (rows for report in reports for rows in report.steps):
        for before, after in itertools.pairwise(steps):
            sums = found.setdefault(after.stage, [0.0, 0.0, 0.0])
            sums[0] += before.inverted - after.inverted
            if math.isfinite(before.mean) and math.isfinite(after.mean) and not before.inverted + after.inverted:
                sums[1] += before.mean - after.mean
                sums[2] += before.max - after.max
    return found


def measured(meshes: Sequence[tm.MeshBatch], repeats: int) -> tuple[list[list[str]], float, float]:
    """The rows of the table for calls with these batches, and milliseconds a mesh: all, and inside compiled loops."""
    count = sum(len(mesh) for mesh in meshes)
    options, best = tm.ImproveOptions(workers=1), None
    for _ in range(repeats):
        with counted() as costs:
            began = time.process_time()
            reports = [tm.improve(mesh, options)[1] for mesh in meshes]
            whole = time.process_time() - began
        best = min(best or (math.inf, costs), (whole, costs), key=lambda run: run[0])
    whole, costs = best
    brought = gains(reports)
    costs.seconds[BETWEEN] = whole - sum(costs.seconds.values())
    ms = 1e3 / count
    rows = []
    for name, seconds in costs.seconds.most_common():
        gained = [f"{value / count:.3g}" for value in brought.get(name, [])] or ["", "", ""]
        rows.append([name, f"{ms * seconds:.2f}", f"{ms * costs.inside[name]:.2f}", *gained])
    inside = sum(costs.inside.values())
    rows.append(["all", f"{ms * whole:.2f}", f"{ms * inside:.2f}", "", "", ""])
    return rows, ms * whole, ms * inside


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    arguments.add_cache(parser)
    arguments.add_sizes(parser, 2200)
    parser.add_argument("--meshes", type=int, default=60, help="meshes of the batch")
    parser.add_argument("--single", type=int, default=6, help="so many of them one by one, too")
    parser.add_argument("--repeats", type=int, default=3, help="runs of which the fastest counts")
    given = arguments.parse(parser, argv)
    meshes = [case.mesh for case in domains.variants(given.meshes, given.triangles[0], given.cache)]
    for title, batches in ((f"{len(meshes)} meshes in one batch", [tm.join(meshes)]),
                           (f"{given.single} meshes one by one", meshes[: given.single])):  # fmt: skip
        rows, whole, inside = measured(batches, given.repeats)
        print(f"\n{title}, about {given.triangles[0]:,} triangles each\n\n{tables.table(HEAD, rows)}\n")
        print(f"Compiled loops take {inside:.1f} of {whole:.1f} ms a mesh: no faster calls of them go below that.")
    print(f"\n{clocks.machine()}; torch {torch.__version__}; one thread, processor time")
    return 0


if __name__ == "__main__":
    sys.exit(main())
