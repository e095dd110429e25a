"""Variants of the paper's domains tangled two to ten times harder, a turned airfoil, and a cylinder in an O-mesh.

gmsh triangulates the undeformed domains, and FEMWARP moves the interior with the boundary.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from functools import partial

import numpy as np
import torch

import torchmesh as tm
from experiments.shared import outlines
from torchmesh.bench.methods import gmsh_mesher

Array = np.ndarray


def _meshed(outer: Array, *holes: Array) -> tm.MeshBatch:
    """gmsh's mesh of a domain, with absolute sizes in its loops."""
    return tm.MeshBatch.from_arrays(*gmsh_mesher.triangulate([outer, *holes]))


def _moved(mesh: tm.MeshBatch, motion: Callable[[torch.Tensor], torch.Tensor]) -> tm.MeshBatch:
    return tm.femwarp(mesh, torch.where(mesh.fixed[:, None], motion(mesh.points.clone()), mesh.points))


def circle(distance: float, radius: float = 0.5, count: int = 24) -> tm.MeshBatch:
    """A round hole that moves to the right."""
    hole = outlines.circle(3, 4, radius, count, 2 * math.pi * radius / count)
    mesh = _meshed(outlines.rectangle(0, 0, 20, 8, 0.5), hole)

    def motion(p: torch.Tensor) -> torch.Tensor:
        p[torch.hypot(p[:, 0] - 3, p[:, 1] - 4) < 1.05 * radius, 0] += distance
        return p

    return _moved(mesh, motion)


def bar(distance: float, height: float = 0.5) -> tm.MeshBatch:
    """An upright bar that moves to the right."""
    low, high = 0.5 - height / 2, 0.5 + height / 2
    hole = outlines.rectangle(0.47, low, 0.53, high, 0.035)
    mesh = _meshed(outlines.rectangle(0, 0, 2, 1, 0.05), hole)

    def motion(p: torch.Tensor) -> torch.Tensor:
        p[(p[:, 0] > 0.46) & (p[:, 0] < 0.54) & (p[:, 1] > 0.15) & (p[:, 1] < 0.85), 0] += distance
        return p

    return _moved(mesh, motion)


def gate(push: float, x: float = 1.0, width: float = 0.3) -> tm.MeshBatch:
    """A notch in the floor at x, as wide as `width`, whose end is pushed up."""
    left, right = x - width / 2, x + width / 2
    outline = [(0, 0), (left, 0), (left, 0.1), (right, 0.1), (right, 0), (2, 0), (2, 1), (0, 1)]
    mesh = _meshed(outlines.sized(outline, 0.05))

    def motion(p: torch.Tensor) -> torch.Tensor:
        notch = ((p[:, 0] - x).abs() < width / 2 + 0.001) & (p[:, 1] < 0.101)
        p[notch, 1] *= 1 + push / 0.1
        return p

    return _moved(mesh, motion)


def holes(paths: list[tuple[float, float]], radius: float, count: int) -> tm.MeshBatch:
    """Round holes one above the other; each moves by its path (right, up)."""
    size = 2 * math.pi * radius / count
    centres = [(6.0, 8.0 * (i + 1) / (len(paths) + 1)) for i in range(len(paths))]
    holes = [outlines.circle(x, y, radius, count, size) for x, y in centres]
    mesh = _meshed(outlines.rectangle(0, 0, 20, 8, 0.5), *holes)

    def motion(p: torch.Tensor) -> torch.Tensor:
        start = p.clone()
        for (x, y), path in zip(centres, paths, strict=True):
            p[torch.hypot(start[:, 0] - x, start[:, 1] - y) < 1.05 * radius] += torch.tensor(path).to(p)
        return p

    return _moved(mesh, motion)


def slanting_bar(degrees: float, distance: float, length: float) -> tm.MeshBatch:
    """A bar that stands at `degrees` from upright and moves to the right."""
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    corners = [(-0.03, -length / 2), (0.03, -length / 2), (0.03, length / 2), (-0.03, length / 2)]
    hole = outlines.sized([(0.5 + cosine * x - sine * y, 0.5 + sine * x + cosine * y) for x, y in corners], 0.035)
    mesh = _meshed(outlines.rectangle(0, 0, 2, 1, 0.05), hole)

    def motion(p: torch.Tensor) -> torch.Tensor:
        x, y = p[:, 0] - 0.5, p[:, 1] - 0.5
        across, along = cosine * x + sine * y, cosine * y - sine * x
        p[(across.abs() < 0.031) & (along.abs() < length / 2 + 0.001), 0] += distance
        return p

    return _moved(mesh, motion)


def airfoil(degrees: float, distance: float = 0.0) -> tm.MeshBatch:
    """NACA 0012 in a far field of ten chords, turned by `degrees` and moved to the right by `distance` chords."""
    outline = []
    for i in range(60):
        t = 2 * math.pi * i / 60
        x = 0.5 * (1 + math.cos(t))
        half = outlines.half_thickness(x, 0.12)
        outline.append((x, half if t < math.pi else -half))
    mesh = _meshed(outlines.circle(0, 0, 10, 40, 1.5), outlines.sized(outline, 0.02))
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn = torch.tensor([[cosine, sine], [-sine, cosine]], dtype=torch.float64)
    centre = torch.tensor([0.5, 0.0], dtype=torch.float64)

    def motion(p: torch.Tensor) -> torch.Tensor:
        near = (p - centre).norm(dim=1) < 2
        p[near] = (p[near] - centre) @ turn + centre
        p[near, 0] += distance
        return p

    return _moved(mesh, motion)


def cylinder(rings: int, sectors: int, distance: float = 4.0, degrees: float = 0.0) -> tm.MeshBatch:
    """An O-mesh from radius 0.5 to 10 whose cells grow with the radius.

    The cylinder inside moves by `distance` diameters in the direction `degrees`.
    """
    radius = 0.5 * 20 ** (torch.arange(rings + 1, dtype=torch.float64) / rings)
    angle = 2 * math.pi * torch.arange(sectors, dtype=torch.float64) / sectors
    points = torch.stack([torch.outer(radius, angle.cos()), torch.outer(radius, angle.sin())], 2).reshape(-1, 2)
    i, j = torch.meshgrid(torch.arange(rings), torch.arange(sectors), indexing="ij")
    a, b = (i * sectors + j).reshape(-1), (i * sectors + (j + 1) % sectors).reshape(-1)
    triangles = torch.cat([torch.stack([a, a + sectors, b + sectors], 1), torch.stack([a, b + sectors, b], 1)])
    mesh = tm.MeshBatch.from_arrays(points, triangles)

    def motion(p: torch.Tensor) -> torch.Tensor:
        course = math.radians(degrees)
        p[p.norm(dim=1) < 0.501] += distance * torch.tensor([math.cos(course), math.sin(course)]).to(p)
        return p

    return _moved(mesh, motion)


VARIANTS: dict[str, Callable[[], tm.MeshBatch]] = {
    "circle, 4 diameters": lambda: circle(4.0),
    "circle, 8 diameters": lambda: circle(8.0),
    "small circle, 24 diameters": lambda: circle(12.0, 0.25, 16),
    "bar, 0.8": lambda: bar(0.8),
    "bar, 1.1": lambda: bar(1.1),
    "higher bar, 1.3": lambda: bar(1.3, 0.6),
    "gate, 0.3": lambda: gate(0.3),
    "gate, 0.5": lambda: gate(0.5),
    "gate, 0.7": lambda: gate(0.7),
    "airfoil, 60 degrees": lambda: airfoil(60),
    "airfoil, 120 degrees": lambda: airfoil(120),
    "airfoil, 180 degrees": lambda: airfoil(180),
    "cylinder, 7,680 triangles": lambda: cylinder(60, 64),
    "cylinder, 25,600 triangles": lambda: cylinder(100, 128),
}


def drawn(seed: int) -> dict[str, Callable[[], tm.MeshBatch]]:
    """Variants that the seed draws: holes that part, slanting bars, gates, airfoils and moving cylinders."""
    rng = random.Random(seed)
    between = rng.uniform
    makes: dict[str, Callable[[], tm.MeshBatch]] = {}
    for count in rng.sample(range(1, 6), 2):
        paths = [(between(-2, 9), between(-0.3, 0.3)) for _ in range(count)]
        makes[f"{count} holes"] = partial(holes, paths, between(0.2, 0.4), rng.randrange(12, 25))
    for turn in (between(0, 45), between(45, 90)):
        far = between(0.3, 0.9)
        makes[f"bar at {turn:.0f} degrees, {far:.2f}"] = partial(slanting_bar, turn, far, between(0.3, 0.5))
    for _ in range(2):
        push, at, width = between(0.2, 0.75), between(0.7, 1.3), between(0.2, 0.4)
        makes[f"gate of {width:.2f} at {at:.2f}, {push:.2f}"] = partial(gate, push, at, width)
    for _ in range(2):
        turn, far = between(-180, 180), between(-1, 1)
        makes[f"airfoil, {turn:.0f} degrees, {far:.2f} chords"] = partial(airfoil, turn, far)
    rings, sectors, far, course = rng.randrange(30, 60), rng.randrange(40, 80), between(2, 6), between(0, 360)
    makes[f"cylinder, {far:.1f} diameters to {course:.0f} degrees"] = partial(cylinder, rings, sectors, far, course)
    return makes
