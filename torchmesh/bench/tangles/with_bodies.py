"""A body in a channel that is moved, one in a far field that is turned, and a body that goes to and fro.

 ____________________________        .-----.
|   _                        |     .'   _   '.
|  (_)  - - - - - ->         |     |   /_/ )  |
|____________________________|      '.      .'
      moved, sequence                 '-----'  turned
"""

import math

import numpy as np
import torch

from ...learning.outlines import naca, regular_polygon
from ...mesh.batch import MeshBatch
from ...triangulating.mesher import Outline
from ...warping.femwarp import femwarp
from ..case import Drawn, Family
from .drawing import ellipse, is_simple, meshed, size, turn

# The channel, in lengths of the body, and where the body starts in it.
LENGTH, HEIGHT, START = 16.0, 6.0, np.array([2.0, 3.0])

# How many steps a sequence has.
STEPS = 8


def channel(rng: np.random.Generator) -> tuple[MeshBatch, np.ndarray, dict] | None:
    """The undeformed mesh of a channel with a body, the loop of each boundary vertex (1: the body), and what was drawn.

    The body is an ellipse of any direction; around it the mesh is finer.
    """
    aspect, grading, tilt = rng.uniform(1, 4), rng.uniform(0.15, 0.8), rng.uniform(0, 180)
    body = ellipse(aspect) @ turn(tilt).numpy() + START
    walls = np.array([[0.0, 0], [LENGTH, 0], [LENGTH, HEIGHT], [0, HEIGHT]])
    triangles = size(rng)
    made = meshed(Outline((walls, body), (1.0, grading)), triangles, rng)
    if made is None:
        return None
    return *made, {"aspect": round(aspect, 3), "grading": round(grading, 3)}


def moved(rng: np.random.Generator, lengths: float) -> Drawn | None:
    """A body moved by so many of its lengths along the channel, a little aside, and turned."""
    made = channel(rng)
    if made is None:
        return None
    mesh, loop, details = made
    angle, up = rng.uniform(-180, 180), rng.uniform(-1, 1)
    goal = place(mesh, loop, lengths, up, angle)
    if not is_simple(goal, loop):
        return None
    return Drawn(mesh, femwarp(mesh, goal).points, details=details | {"angle": round(angle, 1)})


def place(mesh: MeshBatch, loop: np.ndarray, along: float, up: float, angle: float) -> torch.Tensor:
    """(V, 2) the points with the body, the vertices of loop 1, moved and turned about its centre."""
    body = np.flatnonzero(loop == 1)
    start = torch.from_numpy(START)
    points = mesh.points.clone()
    there = start + torch.tensor([along, up], dtype=torch.float64)
    points[body] = (points[body] - start) @ turn(angle) + there
    return points


def sequence(rng: np.random.Generator, lengths: float) -> Drawn | None:
    """A body that goes to and fro in the channel and turns, by so many of its lengths in a step at most."""
    made = channel(rng)
    if made is None:
        return None
    mesh, loop, details = made
    reach = min(lengths * STEPS / math.pi, LENGTH - 2 * START[0])
    swing, up = rng.uniform(-90, 90), rng.uniform(-0.5, 0.5)
    path = []
    for step in range(1, STEPS + 1):
        phase = 2 * math.pi * step / STEPS
        goal = place(mesh, loop, reach * (1 - math.cos(phase)) / 2, up * math.sin(phase), swing * math.sin(phase))
        if not is_simple(goal, loop):
            return None
        path.append(goal)
    return Drawn(mesh, femwarp(mesh, path[0]).points, tuple(path[1:]), details | {"steps": STEPS})


def turned(rng: np.random.Generator, degrees: float) -> Drawn | None:
    """An airfoil or an ellipse in a round far field, turned about its middle, one way round or the other."""
    aspect, grading = rng.uniform(2, 8), rng.uniform(0.08, 0.3)
    if rng.integers(2):
        body, kind = naca(rng.uniform(0, 0.05), rng.uniform(0.3, 0.5), 1 / aspect)[::-1], "airfoil"
    else:
        body, kind = ellipse(aspect), "ellipse"
    made = meshed(Outline((3 * regular_polygon(48), body), (1.0, grading)), size(rng), rng)
    if made is None:
        return None
    mesh, loop = made
    angle = degrees * float(rng.choice([-1, 1]))
    goal = mesh.points.clone()
    rows = np.flatnonzero(loop == 1)
    goal[rows] = goal[rows] @ turn(angle)
    if not is_simple(goal, loop):
        return None
    details = {"body": kind, "aspect": round(aspect, 3), "grading": round(grading, 3)}
    return Drawn(mesh, femwarp(mesh, goal).points, details=details)


FAMILIES = (
    Family("moved", moved, (1, 2, 4, 6, 8, 12), "lengths moved", "a body moved through a channel and turned"),
    Family("turned", turned, (30, 60, 90, 120, 150, 180), "degrees turned", "a body turned in a round far field"),
    Family("sequence", sequence, (0.25, 0.5, 1, 2), "lengths a step", "eight steps of a body that goes to and fro"),
)
