"""Hostile meshes: is what is said of them true, is what can be mended mended, and soon?

    hard domain (a witness) --- vertices anywhere, flips, a transform ---> mesh --- improve ---> a fault, or ""

Faults are: an exception, an inverted triangle in a mesh said to be valid, another boundary, "impossible" of a mesh of
which a valid one is at hand, such a mesh not mended (with the triangles kept only if it has them, and then it may be
stalled), more than two seconds under the default options, another result in a batch than alone.
"""

import time
import warnings
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch

import torchmesh as tm
from torchmesh.bench.exact_check import directed, faults, inverted

from . import tangles
from .domains import DOMAINS
from .impossible import IMPOSSIBLE

# Seconds of processor time that a mesh may take under the default options, and the triangles that it may have at most.
SECONDS = 2.0
TRIANGLES = 2_900

KINDS = DOMAINS | IMPOSSIBLE
OPTIONS: dict[str, tm.ImproveOptions] = {
    "default": tm.ImproveOptions(workers=1),
    "fast": tm.ImproveOptions.fast(workers=1),
    "keep": tm.ImproveOptions(topology="keep", workers=1),
    "full": tm.ImproveOptions(topology="full", workers=1),
    "slide": tm.ImproveOptions(boundary="slide", workers=1),
    "uniform sizes": tm.ImproveOptions(remesh=tm.RemeshOptions(sizes="uniform"), workers=1),
}
# Half of the trials have the default options, and one in so many is repeated in a batch.
_DEFAULT, _IN_BATCH = 0.5, 4


@dataclass(frozen=True, eq=False)
class Trial:
    """One mesh to be improved.

    name     how its vertices were thrown, and the options
    witness  a valid mesh of the same boundary, vertices and number of triangles; None: none is known
    kept     whether the witness has the same triangles, so that a valid mesh exists under "keep", too
    options  the name of its options
    """

    name: str
    mesh: tm.MeshBatch
    witness: tm.MeshBatch | None
    kept: bool
    options: str

    @classmethod
    def of(cls, seed: int, kind: str, number: int) -> "Trial | None":
        """The trial of that number; None where no mesh came of it."""
        rng = np.random.default_rng([seed, zlib.crc32(kind.encode()), number])
        most = rng.choice([60, 400, TRIANGLES])
        made = KINDS[kind](rng, int(np.exp(rng.uniform(np.log(6), np.log(most)))))
        if made is None or not 2 <= len(made[1]) < TRIANGLES:
            return None
        points, faces, edges = made
        throw, moved = str(rng.choice(list(tangles.THROWS))), tangles.transform(rng)
        chances = [_DEFAULT, *[(1 - _DEFAULT) / (len(OPTIONS) - 1)] * (len(OPTIONS) - 1)]
        options = str(rng.choice(list(OPTIONS), p=chances))
        try:
            witness = _mesh(moved(points), faces, edges)
            held = witness.fixed.numpy().copy()
            held[edges] = True  # interfaces stay where they are, unless the options say otherwise
            free = np.flatnonzero(~held)
            given = points.copy()
            given[free] = tangles.THROWS[throw](rng, points, free)
            other = faces if len(edges) else tangles.flipped(rng, faces)
            mesh = _mesh(moved(given), other, edges)
        except tm.InvalidMeshError:  # positions beyond the range, or flips that pinch the surface
            return None
        sound = not inverted(witness.points.numpy(), witness.triangles.numpy())
        return cls(f"{throw}, {options}", mesh, witness if sound else None, other is faces, options)

    def fault(self) -> str:
        """What goes wrong; "" if nothing does."""
        begun = time.process_time()
        after, report = tm.improve(self.mesh, OPTIONS[self.options])
        seconds = time.process_time() - begun
        wrong = self.misjudged(after, report)
        if wrong or seconds < SECONDS or self.options not in ("default", "fast"):
            return wrong
        begun = time.process_time()  # other work on the machine may have slowed it down
        tm.improve(self.mesh, OPTIONS[self.options])
        seconds = min(seconds, time.process_time() - begun)
        return f"{seconds:.1f} s" if seconds > SECONDS else ""

    def misjudged(self, after: tm.MeshBatch, report: tm.Report) -> str:
        """What is wrong with an outcome; "" if nothing is."""
        if not bool(after.points.isfinite().all()):
            return "coordinates that are not finite"
        left = inverted(after.points.numpy(), after.triangles.numpy())
        if bool(report.valid) != (left == 0):
            return f"said to be {'valid' if left else 'tangled'}, and {left} triangles are inverted or flat"
        if max(directed(after.triangles.numpy()).values()) > 1:
            return "an edge has two triangles on one side"
        if not left:
            if not bool(report.certified):
                return "valid but not certified"
            return "" if OPTIONS[self.options].slides else "; ".join(faults(self.mesh, after))
        status, keeps = tm.Status(int(report.status)), self.options == "keep"
        if self.witness is None or (keeps and (not self.kept or status == tm.Status.STALLED)):
            return ""
        return f"not mended, {left} of {len(after.triangles)} inverted: {status.name}, {report.messages[0][:120]}"

    def otherwise_in_a_batch(self, other: tm.MeshBatch) -> str:
        """Whether the mesh after `other` in a batch has another result than alone; "" if not."""
        options = OPTIONS[self.options]
        alone, joined = (
            tm.improve(self.mesh, options)[0],
            tm.improve(tm.join([other, self.mesh]), options)[0].split()[1],
        )
        same = torch.equal(alone.points, joined.points) and torch.equal(alone.triangles, joined.triangles)
        return "" if same else "another result in a batch than alone"


def _mesh(points: np.ndarray, triangles: np.ndarray, edges: np.ndarray) -> tm.MeshBatch:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", tm.MeshWarning)  # boundaries that are inside out turn the triangles
        return tm.MeshBatch.from_arrays(points, triangles, constrained_edges=edges)


def examine(seed: int, kind: str, number: int) -> tuple[str, str] | None:
    """What a trial was of, and its fault; None where no mesh came of it."""
    trial = Trial.of(seed, kind, number)
    if trial is None:
        return None
    name = f"{kind} {number} ({trial.name}, {len(trial.mesh.triangles)} triangles)"
    try:
        fault = trial.fault()
        other = None if fault or number % _IN_BATCH else Trial.of(seed, kind, number + 1)
        if other is not None and len(trial.mesh.triangles) < 500:
            fault = trial.otherwise_in_a_batch(other.mesh)
    except Exception as error:
        fault = f"{type(error).__name__}: {error}"
    return name, " ".join(fault.split())


def trials(seed: int, kinds: list[str] | None = None, start: int = 0) -> Iterator[tuple[str, str]]:
    """Name and fault of one trial after the other, without end; `kinds` in turn, from the trial `start` on."""
    unknown = set(kinds or ()) - set(KINDS)
    if unknown:
        raise ValueError(f"no kinds of meshes: {', '.join(sorted(unknown))}; there are {', '.join(KINDS)}")
    while True:
        for kind in kinds or KINDS:
            done = examine(seed, kind, start)
            if done is not None:
                yield done
        start += 1
