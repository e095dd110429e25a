"""One method on one case: called, timed and judged, step by step where the case is a sequence."""

import contextlib
import dataclasses
import functools
import math
from typing import Any

import torch

from ..mesh.batch import MeshBatch
from ..warping.femwarp import femwarp
from .answers import Missing, Refused, Result
from .case import Case
from .judging import Verdict, judge
from .registry import Method
from .stopwatch import Seconds, Stopwatch


@functools.cache
def warm(method: Method) -> None:
    """Call the method once on a small mesh, so that no case pays for what is imported or compiled at first use."""
    at = torch.linspace(0, 1, 6, dtype=torch.float64)
    row = torch.arange(36).reshape(6, 6)
    a, b, c, d = (part.reshape(-1) for part in (row[:-1, :-1], row[1:, :-1], row[1:, 1:], row[:-1, 1:]))
    faces = torch.cat([torch.stack([a, b, c], 1), torch.stack([a, c, d], 1)])
    undeformed = MeshBatch.from_arrays(torch.cartesian_prod(at, at), faces)
    points = undeformed.points.clone()
    points[14] += 0.5
    with contextlib.suppress(Exception):
        method.function(undeformed.with_points(points), *([undeformed] if method.undeformed else []))


def solve(case: Case, method: Method) -> dict[str, Any]:
    """The columns of a row that tell what the method made of the case.

    outcome  "valid", "invalid", "refused" (by the method), "missing" (a library or weights), or "error"
    """
    done = Seconds(0.0, 0.0)
    given, note = case.mesh, ""
    for step in range(1 + len(case.path)):
        try:
            method.check()
            warm(method)
            handed = [copied(mesh) for mesh in ([given, case.undeformed] if method.undeformed else [given])]
            with Stopwatch() as watch:
                answer = method.function(*handed)
        except Missing as why:
            return _without(case, "missing", str(why))
        except Refused as why:
            return _without(case, "refused", str(why), steps_valid=step)
        except Exception as error:
            return _without(case, "error", f"{type(error).__name__}: {error}"[:300], steps_valid=step)
        seconds = watch.seconds
        if isinstance(answer, Result):
            seconds = answer.seconds if isinstance(answer.seconds, Seconds) else seconds
            note, answer = answer.note or note, answer.mesh
        done = done + seconds
        verdict = judge(given, answer)
        if not verdict.valid or step == len(case.path):
            return _columns(case, verdict, done, note, step + int(verdict.valid))
        given = advanced(answer, case, step)
    raise AssertionError("a case has a step at least")


def copied(mesh: MeshBatch) -> MeshBatch:
    """The mesh with tensors of its own, so that a method that writes into them spoils nothing for the others."""
    names = [f.name for f in dataclasses.fields(mesh) if not f.name.startswith("_")]
    return dataclasses.replace(mesh, **{name: getattr(mesh, name).clone() for name in names}, _twin=None)


def advanced(answer: MeshBatch, case: Case, step: int) -> MeshBatch:
    """A valid answer after the next step of the path: its boundary moves on, and its interior follows by FEMWARP.

    step  the number of the answer's step, from 0

    Vertices may have other rows than those of the case: the boundary's are found by their positions.
    """
    fixed = case.mesh.fixed
    positions = (case.mesh.points, *case.path)
    now, then = (positions[step + k][fixed].tolist() for k in (0, 1))
    after = dict(zip(map(tuple, now), then, strict=True))
    here = [tuple(position) for position in answer.points.tolist()]
    goal = torch.tensor([after.get(position, position) for position in here], dtype=answer.points.dtype)
    return femwarp(answer, goal, hold=torch.tensor([position in after for position in here]))


def _columns(case: Case, verdict: Verdict, seconds: Seconds, note: str, steps_valid: int) -> dict[str, Any]:
    """A verdict as columns; numbers of an invalid mesh that mean nothing are left out."""
    row: dict[str, Any] = vars(verdict) | {"outcome": "valid" if verdict.valid else "invalid", "note": note}
    if not verdict.valid:
        row |= {"mean": None, "max": None, "minimum_angle": None}
    row = {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()}
    return row | {
        "seconds": seconds.cpu, "wall_seconds": seconds.wall, "steps": 1 + len(case.path), "steps_valid": steps_valid,
    }  # fmt: skip


def _without(case: Case, outcome: str, fault: str, steps_valid: int = 0) -> dict[str, Any]:
    """The columns where there is no mesh to judge."""
    return {
        "valid": False, "outcome": outcome, "fault": " ".join(fault.split()),
        "steps": 1 + len(case.path), "steps_valid": steps_valid,
    }  # fmt: skip
