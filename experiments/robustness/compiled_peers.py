"""How long do compiled peers take where the triangles are kept, and how many meshes do they solve?

    python -m experiments.robustness.compiled_peers --foldover PROGRAM --lifted PROGRAM

PROGRAM is what their authors' code builds to; a peer that is not named is left out.

    --foldover  untangle2d of https://github.com/ssloy/invertible-maps (Garanzha, Kaporin, Kudryavtseva, Protais, Ray &
                Sokolov, Foldover-free maps in 50 lines of code, 2021), with https://github.com/ssloy/ultimaille
    --lifted    findInjective of https://github.com/duxingyi-charles/lifting_simplices_to_find_injectivity (Du et al.,
                Lifting simplices to find injectivity, 2020), with NLopt

The cases, of about 2,000 and 10,000 triangles: squares mapped onto bands of 1 to 4 bends, rings whose inner circle
turns by 60 to 180 degrees, and bent domains.  All begin at the uniform Laplacian solution, with the shapes of the valid
mesh they come from as rest shapes.  Exact signs decide what is valid.  Seconds are of processor time, one thread;
a program that takes more than `--limit` seconds is ended.

Each case and method is one line of compiled_peers.jsonl; a run that was stopped goes on where it was.  With `--readme`
the table is written into the README, with the day, the processor and the versions.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch

import torchmesh as tm
from experiments.robustness.kept_triangles import hard
from experiments.shared import arguments, feasible, tables
from experiments.shared.tangles import tangle
from experiments.speed import readme
from torchmesh.bench import exact_check

Array = np.ndarray
# This script, as the README's mark names it.
WRITER = "experiments/robustness/compiled_peers.py"
# Those of the authors' example, which ends as soon as no triangle is inverted.
OPTIONS = """form\nTutte\nalphaRatio\n1e-6\nalpha\n-1\nftol_abs\n1e-8\nftol_rel\n1e-8\nxtol_abs\n1e-8\nxtol_rel\n1e-8
algorithm\nLBFGS\nmaxeval\n10000\nstopCode\nall_good\nrecord\nvert\t0\nenergy\t0\nminArea\t0
"""
Case = tuple[str, tm.MeshBatch, Array]


def cases(triangles: int, cache: Path) -> Iterator[Case]:
    """Name, tangled mesh and rest points (V, 2)."""
    for bends in (1, 2, 3, 4):
        made = tangle("mapped", bends, triangles, 0.3, 0, cache)
        yield f"mapped-{triangles}-{bends}", made.tangled, made.undeformed.points.numpy()
    for degrees in (60, 120, 180):
        for inner in (0.3, 0.5):
            name = f"ring {inner}-{triangles}-{degrees}"
            mesh = feasible.meshed(feasible.ring(inner), np.random.default_rng(triangles), triangles)
            yield name, hard(name, cache), mesh.points.numpy()
    for seed in (0, 1):
        made = feasible.case(f"bent-{triangles}-{seed}-laplace")
        yield made.name, made.tangled, made.valid.points.numpy()


def ours(mesh: tm.MeshBatch, rest: Array, limit: float) -> tuple[Array, float]:
    surface = torch.from_numpy(np.concatenate([rest, np.zeros((len(rest), 1))], 1))
    targets = tm.target_from(surface, mesh.triangles)
    started = time.process_time()
    moved, _ = tm.untangle(mesh, targets=targets)
    return moved.points.numpy(), time.process_time() - started


def foldover(program: str, mesh: tm.MeshBatch, rest: Array, limit: float) -> tuple[Array, float]:
    with tempfile.TemporaryDirectory() as folder:
        lines = [f"v {x!r} {y!r} 0" for x, y in rest.tolist()]
        lines += [f"vt {x!r} {y!r}" for x, y in mesh.points.tolist()]
        lines += ["f " + " ".join(f"{v + 1}/{v + 1}" for v in face) for face in mesh.triangles.tolist()]
        (Path(folder) / "in.obj").write_text("\n".join(lines) + "\n")
        seconds = run([program, "in.obj", "out.obj"], folder, limit)
        rows = [line.split() for line in (Path(folder) / "out.obj").read_text().splitlines()]
        points = np.array([row[1:3] for row in rows if row and row[0] == "v"], float)
    return with_boundary(points, mesh), seconds


def lifted(program: str, mesh: tm.MeshBatch, rest: Array, limit: float) -> tuple[Array, float]:
    with tempfile.TemporaryDirectory() as folder:
        handles = mesh.fixed.nonzero().numpy()
        with (Path(folder) / "in").open("w") as file:
            for rows in (rest, mesh.points.numpy(), mesh.triangles.numpy(), handles):
                print(*(rows.shape if rows is not handles else [len(rows)]), file=file)
                file.writelines(" ".join(map(repr, row)) + "\n" for row in rows.tolist())
        (Path(folder) / "options").write_text(OPTIONS)
        seconds = run([program, "in", "options", "out"], folder, limit)
        words = (Path(folder) / "out").read_text().split()
        at = words.index("resV")
        count = int(words[at + 1])
        points = np.array(words[at + 3 : at + 3 + 2 * count], float).reshape(-1, 2)
    return with_boundary(points, mesh), seconds


def with_boundary(points: Array, mesh: tm.MeshBatch) -> Array:
    """The points with fixed vertices exactly where they were: files and scaling round them."""
    return np.where(mesh.fixed.numpy()[:, None], mesh.points.numpy(), points)


def run(command: list[str], folder: str, limit: float) -> float:
    """Run a program; the seconds of processor time that it took."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    subprocess.run(
        command, cwd=folder, check=False, env={**os.environ, "OMP_NUM_THREADS": "1"}, timeout=3 * limit,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (int(limit), int(limit))), **quiet,
    )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--foldover", help="the program untangle2d")
    parser.add_argument("--lifted", help="the program findInjective")
    parser.add_argument("--limit", type=float, default=60.0, help="seconds that a program may take")
    parser.add_argument("--readme", action="store_true", help="write the table into the README")
    arguments.add_sizes(parser, 2000, 10000)
    arguments.add_cache(parser)
    arguments.add_out(parser, "compiled_peers")
    given = arguments.parse(parser, argv)
    given.out.mkdir(parents=True, exist_ok=True)
    methods = {"torchmesh, untangle": ours}
    for name, program, way in (
        ("foldover-free maps (C++)", given.foldover, foldover),
        ("lifted content (C++)", given.lifted, lifted),
    ):
        if program:
            path = str(Path(program).resolve())
            methods[name] = lambda mesh, rest, limit, way=way, path=path: way(path, mesh, rest, limit)
    record = given.out / "compiled_peers.jsonl"
    rows = [json.loads(line) for line in record.read_text().splitlines()] if record.exists() else []
    done = {(row["case"], row["method"]) for row in rows}
    with record.open("a") as out:
        for triangles in given.triangles:
            for name, mesh, rest in cases(triangles, given.cache):
                for method, way in methods.items():
                    if (name, method) in done:
                        continue
                    row = {"case": name, "triangles": triangles, "method": method}
                    try:
                        points, seconds = way(mesh, rest, given.limit)
                        wrong = exact_check.faults(mesh, mesh.with_points(torch.from_numpy(points)))
                        row |= {"valid": not wrong, "seconds": round(seconds, 3)}
                    except (OSError, ValueError, subprocess.SubprocessError) as error:
                        row |= {
                            "valid": False,
                            "seconds": given.limit,
                            "note": f"{type(error).__name__}: {error}"[:200],
                        }
                    rows.append(row)
                    out.write(json.dumps(row) + "\n")
                    out.flush()
    rows = [row for row in rows if row["method"] in methods and row["triangles"] in given.triangles]
    print(table_of(rows))
    if given.readme:
        text = readme.written(readme.README.read_text(encoding="utf-8"), "peers", for_the_readme(rows, given), WRITER)
        readme.README.write_text(text, encoding="utf-8")
    return 0


def for_the_readme(rows: list[dict], given: argparse.Namespace) -> str:
    """The table, and above it the command and what it ran on."""
    peers = "".join(f" --{name} PROGRAM" for name in ("foldover", "lifted") if getattr(given, name))
    command = f"python -m experiments.robustness.compiled_peers{peers} --limit {given.limit:g}"
    count = len({row["case"] for row in rows}) // len(given.triangles)
    return readme.beside_peers(command, count, given.limit) + table_of(rows)


def table_of(rows: list[dict]) -> str:
    """Markdown: of each method how many are valid, and the median seconds of all cases."""
    sizes = sorted({row["triangles"] for row in rows})
    titles = ("method", *(t for n in sizes for t in (f"valid of {n:,} triangles", "seconds, median", "slowest")))
    lines = []
    for method in sorted({row["method"] for row in rows}, reverse=True):
        cells = [method]
        for n in sizes:
            some = [row for row in rows if row["method"] == method and row["triangles"] == n]
            seconds = [row["seconds"] for row in some] or [float("nan")]
            valid = sum(row["valid"] for row in some)
            cells += [f"{valid} of {len(some)}", f"{np.median(seconds):.2f}", f"{max(seconds):.1f}"]
        lines.append(cells)
    return tables.table(titles, lines)


if __name__ == "__main__":
    sys.exit(main())
