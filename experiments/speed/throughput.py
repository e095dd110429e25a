"""Throughput of `improve_files` on generated meshes against workers and batch budget: a table, a record, a plot.

    python -m experiments.speed.throughput     # 10,000 meshes of about 500 triangles; an hour on 2 cores
    python -m experiments.speed.throughput --meshes 600 --sample 200 --out /tmp/throughput

The meshes are those of `tm.domains.stream` (every family, four of five tangled), written as .vtu files, once.  A
sample of them runs with each number of workers and each budget, and with one process of as many threads as there are
processors; then all of them run with the best number and budget.  Rates include everything: the start of the processes,
reading, improving and writing.
"""

import argparse
import json
import os
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import torch

from experiments.shared import arguments, tables
from torchmesh import ImproveOptions, domains, improve_files, write
from torchmesh.batches.batches import Job, improve_jobs
from torchmesh.batches.runs import processors

GENERATED_AT_ONCE = 128


def generate(folder: Path, count: int, triangles: int) -> list[Path]:
    """`count` mesh files, in folders of a thousand; they are made unless all are there."""
    paths = [folder / f"{n // 1000:03}" / f"{n:06}.vtu" for n in range(count)]
    if all(path.exists() for path in paths):
        return paths
    stream = domains.stream(batch=GENERATED_AT_ONCE, seed=2017, triangles=triangles)
    for start in range(0, count, GENERATED_AT_ONCE):
        batch = next(stream)
        for path, mesh in zip(paths[start : start + GENERATED_AT_ONCE], batch.split(), strict=False):
            path.parent.mkdir(parents=True, exist_ok=True)
            write(path, mesh)
    return paths


def measure(paths: list[Path], out: Path, workers: int, budget: int, engine: str = "local") -> dict:
    """One run, the start of its processes included: meshes and triangles a second, and how it ended."""
    shutil.rmtree(out, ignore_errors=True)
    started = time.perf_counter()
    results = list(improve_files(paths, out, workers=workers, budget=budget, engine=engine))
    return _row(engine, workers, 1, budget, results, time.perf_counter() - started, out)


def _row(engine: str, workers: int, threads: int, budget: int, results: list, seconds: float, out: Path) -> dict:
    shutil.rmtree(out, ignore_errors=True)
    for result in results:
        if result.error is not None:  # a mesh that fails takes little time and would count as speed
            raise SystemExit(f"no measurement: {result.error}")
    return {
        "engine": engine,
        "workers": workers,
        "threads": threads,
        "budget": budget,
        "meshes": len(results),
        "tangled before": sum(r.inverted_before > 0 for r in results),
        "not valid after": sum(not r.valid for r in results),
        "seconds": seconds,
        "meshes a second": len(results) / seconds,
        "triangles a second": sum(r.triangles for r in results) / seconds,
    }


def measure_threads(paths: list[Path], out: Path, threads: int, budget: int) -> dict:
    """The same in this one process, in which torch computes with several threads."""
    shutil.rmtree(out, ignore_errors=True)
    jobs = [Job(p.name, str(p), str(out / p.name), str(out / ".staging"), p.stat().st_size) for p in paths]
    torch.set_num_threads(threads)
    started = time.perf_counter()
    results = list(improve_jobs(jobs, ImproveOptions(), budget))
    seconds = time.perf_counter() - started
    torch.set_num_threads(1)
    return _row("threads", 1, threads, budget, results, seconds, out)


def table(rows: list[dict]) -> str:
    """Markdown."""
    names = ("engine", "workers", "threads", "budget", "meshes", "seconds", "meshes a second", "triangles a second")
    return tables.table(names, ([_shown(row[name]) for name in names] for row in rows)) + "\n"


def _shown(value: object) -> str:
    return f"{value:,.4g}" if isinstance(value, float) else str(value)


def plot(rows: list[dict], path: Path, title: str) -> None:
    """Meshes a second against the budget, and against the workers."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained", sharey=True)
    local = [row for row in rows if row["engine"] == "local"]
    for count in sorted({row["workers"] for row in local}):
        line = sorted((row["budget"], row["meshes a second"]) for row in local if row["workers"] == count)
        left.plot(*zip(*line, strict=True), "o-", label=f"{count} worker{'s' * (count > 1)}")
    for row in rows:
        if row["engine"] == "threads":
            left.plot(row["budget"], row["meshes a second"], "kx")
            left.annotate(f"one process, {row['threads']} threads", (row["budget"], row["meshes a second"]),
                          textcoords="offset points", xytext=(0, -12), ha="right", fontsize=8)  # fmt: skip
    left.set(xscale="log", xlabel="batch budget (vertices)", ylabel="throughput (meshes/s)")
    # The budgets alone: the marks between them of a logarithmic axis would write over each other.
    budgets = sorted({row["budget"] for row in rows})
    left.set_xticks(budgets, [f"{budget:,}" for budget in budgets])
    left.minorticks_off()
    left.set_title("against the batch budget")
    left.legend()
    for budget in sorted({row["budget"] for row in local}):
        line = sorted((row["workers"], row["meshes a second"]) for row in local if row["budget"] == budget)
        right.plot(*zip(*line, strict=True), "o-", label=f"{budget:,} vertices")
    right.set(xlabel="workers (processes of one thread)", xticks=sorted({row["workers"] for row in local}))
    right.set_title("against the workers")
    right.legend(title="batch budget", fontsize=8)
    for axes in (left, right):
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    figure.suptitle(title)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def options() -> argparse.ArgumentParser:
    parser = arguments.parser(__doc__)
    parser.add_argument("--meshes", type=int, default=10_000, help="meshes of the last run")
    parser.add_argument("--sample", type=int, default=1000, help="meshes for each number of workers and budget")
    parser.add_argument("--triangles", type=int, default=500, help="triangles of a mesh, about")
    parser.add_argument(
        "--workers", type=int, nargs="+", help="numbers of processes; 1, 2, 4 ... all processors if none"
    )
    parser.add_argument(
        "--budgets", type=int, nargs="+", default=[1, 1000, 3000, 10_000, 30_000, 100_000], help="vertices in a batch"
    )
    arguments.add_out(parser, "throughput")
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    given = arguments.parse(options(), argv)
    counts = given.workers or sorted({min(2**k, processors()) for k in range(processors().bit_length() + 1)})

    given.out.mkdir(parents=True, exist_ok=True)
    started = time.perf_counter()
    paths = generate(given.out / f"in-{given.triangles}", given.meshes, given.triangles)
    print(f"{len(paths):,} meshes generated and written in {time.perf_counter() - started:.0f} s", flush=True)
    sample, results = paths[: given.sample], given.out / "results"
    rows = []
    for budget in given.budgets:
        for workers in counts:
            rows.append(measure(sample, results, workers, budget))
            print(table(rows).splitlines()[-1], flush=True)
    best = max(rows, key=lambda row: row["meshes a second"])
    rows.append(measure_threads(sample, results, processors(), best["budget"]))
    print(table(rows).splitlines()[-1], flush=True)
    title = f"torchmesh batch: {len(sample):,} generated meshes of about {given.triangles:,} triangles"
    plot(rows, given.out / "throughput.png", title)
    if len(paths) > len(sample):
        rows.append(measure(paths, results, best["workers"], best["budget"]))
    (given.out / "throughput.md").write_text(table(rows))
    record = {"processors": processors(), "load": os.getloadavg() if hasattr(os, "getloadavg") else None, "rows": rows}
    (given.out / "throughput.json").write_text(json.dumps(record, indent=2) + "\n")
    print(table(rows), end="")
    print({key: rows[-1].get(key) for key in ("meshes", "tangled before", "not valid after")})
    return 0


if __name__ == "__main__":
    sys.exit(main())
