"""How good the improved meshes are, and how good their boundaries let them be, as a Markdown table.

    python experiments/quality.py            (needs gmsh, the extra `peers`)

Variants of the paper's domains tangled two to ten times harder, an airfoil turned in a graded mesh
and a cylinder moved four of its diameters in an O-mesh, under topology "flip" and "full".  With --seed N, variants
of those that N draws: several holes, slanting bars, other gates, turns and courses.

limit  no mesh of that boundary has a lower maximum, or a larger minimum angle: at a boundary vertex with the
       angle alpha between edges of lengths a and b stands a fan of k triangles, whose sides in turn have
       some ratios r and angles t.  For both measures the triangles that are good enough make a
       convex set in (log r, t), so the best fan has all ratios (b/a)^(1/k) and all angles alpha / k; k is free.
       The inverse mean ratio of a triangle is (r + 1/r - cos t) / (sqrt(3) sin t), the cosh of its
       hyperbolic distance from the equilateral one (r e^{it} as a point of the half plane).  Its angles
       are t and, opposite the shorter side, arctan(sin t / (r - cos t)), r >= 1, which exceeds theta where
       log r < log sin(t + theta) - log sin(theta), a concave function of t.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import torch
import typer

import torchmesh as tm
from torchmesh.mesh import connectivity

MOST_TRIANGLES_AT_A_CORNER = 24
TOPOLOGIES: tuple[Literal["flip", "full"], ...] = ("flip", "full")


class Limits(NamedTuple):
    """The least maximum of the inverse mean ratio and the largest minimum angle, in degrees."""

    ratio: float
    angle: float


def boundary_limits(mesh: tm.MeshBatch) -> Limits:
    """How good any mesh with this boundary can be."""
    rim = connectivity.boundary_edges(mesh.triangles, connectivity.twins(mesh.triangles))
    order = rim[:, 0].argsort()
    following = torch.full((len(mesh.points),), -1)
    following[rim[order, 0]] = rim[order, 1]
    here, onward = rim.unbind(1)
    beyond = following[onward]
    back, out = mesh.points[here] - mesh.points[onward], mesh.points[beyond] - mesh.points[onward]
    # The mesh is on the left of its boundary: the angle from the edge out, counter-clockwise to the edge back.
    turn = torch.atan2(out[:, 0] * back[:, 1] - out[:, 1] * back[:, 0], (out * back).sum(1))
    alpha = torch.where(turn > 0, turn, turn + 2 * math.pi)
    ratio = (back.norm(dim=1) / out.norm(dim=1)).log().abs()
    k = torch.arange(1, MOST_TRIANGLES_AT_A_CORNER + 1)
    angle, step = alpha[:, None] / k, ratio[:, None] / k
    best = (2 * step.cosh() - angle.cos()) / (math.sqrt(3) * angle.sin())
    other = torch.atan2(angle.sin(), step.exp() - angle.cos())
    fits = angle < math.pi
    widest = torch.where(fits, torch.minimum(angle, other), 0.0).amax(1).min()
    return Limits(float(torch.where(fits, best, torch.inf).amin(1).max()), math.degrees(float(widest)))


def polygon(outer: list, holes: list) -> tm.MeshBatch:
    """gmsh's mesh of a polygon; loops of (x, y, size)."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    loops = []
    for loop in [outer, *holes]:
        corner = [gmsh.model.geo.addPoint(x, y, 0, size) for x, y, size in loop]
        lines = [gmsh.model.geo.addLine(a, b) for a, b in zip(corner, [*corner[1:], corner[0]], strict=True)]
        loops.append(gmsh.model.geo.addCurveLoop(lines))
    gmsh.model.geo.addPlaneSurface(loops)
    gmsh.model.geo.synchronize()
    gmsh.model.mesh.generate(2)
    tags, places, _ = gmsh.model.mesh.getNodes()
    row = {int(tag): i for i, tag in enumerate(tags)}
    corners = [row[int(tag)] for tag in gmsh.model.mesh.getElements(2)[2][0]]
    gmsh.finalize()
    return tm.MeshBatch.from_arrays(places.reshape(-1, 3)[:, :2], torch.tensor(corners).reshape(-1, 3))


def rectangle(width: float, height: float, size: float) -> list:
    return [(0, 0, size), (width, 0, size), (width, height, size), (0, height, size)]


def round_loop(x: float, y: float, radius: float, count: int, size: float) -> list:
    angles = [2 * math.pi * i / count for i in range(count)]
    return [(x + radius * math.cos(t), y + radius * math.sin(t), size) for t in angles]


def moved(mesh: tm.MeshBatch, motion: Callable[[torch.Tensor], torch.Tensor]) -> tm.MeshBatch:
    return tm.femwarp(mesh, torch.where(mesh.fixed[:, None], motion(mesh.points.clone()), mesh.points))


def circle(distance: float, radius: float = 0.5, count: int = 24) -> tm.MeshBatch:
    hole = round_loop(3, 4, radius, count, 2 * math.pi * radius / count)
    mesh = polygon(rectangle(20, 8, 0.5), [hole])

    def motion(p: torch.Tensor) -> torch.Tensor:
        p[torch.hypot(p[:, 0] - 3, p[:, 1] - 4) < 1.05 * radius, 0] += distance
        return p

    return moved(mesh, motion)


def bar(distance: float, height: float = 0.5) -> tm.MeshBatch:
    low, high = 0.5 - height / 2, 0.5 + height / 2
    hole = [(0.47, low, 0.035), (0.53, low, 0.035), (0.53, high, 0.035), (0.47, high, 0.035)]
    mesh = polygon(rectangle(2, 1, 0.05), [hole])

    def motion(p: torch.Tensor) -> torch.Tensor:
        p[(p[:, 0] > 0.46) & (p[:, 0] < 0.54) & (p[:, 1] > 0.15) & (p[:, 1] < 0.85), 0] += distance
        return p

    return moved(mesh, motion)


def gate(push: float, x: float = 1.0, width: float = 0.3) -> tm.MeshBatch:
    left, right = x - width / 2, x + width / 2
    outline = [(0, 0), (left, 0), (left, 0.1), (right, 0.1), (right, 0), (2, 0), (2, 1), (0, 1)]
    mesh = polygon([(x, y, 0.05) for x, y in outline], [])

    def motion(p: torch.Tensor) -> torch.Tensor:
        notch = ((p[:, 0] - x).abs() < width / 2 + 0.001) & (p[:, 1] < 0.101)
        p[notch, 1] *= 1 + push / 0.1
        return p

    return moved(mesh, motion)


def holes(paths: list[tuple[float, float]], radius: float, count: int) -> tm.MeshBatch:
    """Round holes one above the other, each of which moves by its path (right, up)."""
    size = 2 * math.pi * radius / count
    centres = [(6.0, 8.0 * (i + 1) / (len(paths) + 1)) for i in range(len(paths))]
    mesh = polygon(rectangle(20, 8, 0.5), [round_loop(x, y, radius, count, size) for x, y in centres])

    def motion(p: torch.Tensor) -> torch.Tensor:
        start = p.clone()
        for (x, y), path in zip(centres, paths, strict=True):
            p[torch.hypot(start[:, 0] - x, start[:, 1] - y) < 1.05 * radius] += torch.tensor(path).to(p)
        return p

    return moved(mesh, motion)


def slanting_bar(degrees: float, distance: float, length: float) -> tm.MeshBatch:
    """A bar that stands at so many degrees from upright, and moves to the right."""
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    corners = [(-0.03, -length / 2), (0.03, -length / 2), (0.03, length / 2), (-0.03, length / 2)]
    hole = [(0.5 + cosine * x - sine * y, 0.5 + sine * x + cosine * y, 0.035) for x, y in corners]
    mesh = polygon(rectangle(2, 1, 0.05), [hole])

    def motion(p: torch.Tensor) -> torch.Tensor:
        x, y = p[:, 0] - 0.5, p[:, 1] - 0.5
        across, along = cosine * x + sine * y, cosine * y - sine * x
        p[(across.abs() < 0.031) & (along.abs() < length / 2 + 0.001), 0] += distance
        return p

    return moved(mesh, motion)


def airfoil(degrees: float, distance: float = 0.0) -> tm.MeshBatch:
    """NACA 0012 in a far field of ten chords, turned and moved to the right by so many chords."""
    outline = []
    for i in range(60):
        t = 2 * math.pi * i / 60
        x = 0.5 * (1 + math.cos(t))
        half = 0.6 * (0.2969 * math.sqrt(x) - 0.126 * x - 0.3516 * x**2 + 0.2843 * x**3 - 0.1036 * x**4)
        outline.append((x, half if t < math.pi else -half, 0.02))
    mesh = polygon(round_loop(0, 0, 10, 40, 1.5), [outline])
    cosine, sine = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    turn = torch.tensor([[cosine, sine], [-sine, cosine]], dtype=torch.float64)
    centre = torch.tensor([0.5, 0.0], dtype=torch.float64)

    def motion(p: torch.Tensor) -> torch.Tensor:
        near = (p - centre).norm(dim=1) < 2
        p[near] = (p[near] - centre) @ turn + centre
        p[near, 0] += distance
        return p

    return moved(mesh, motion)


def cylinder(rings: int, sectors: int, distance: float = 4.0, degrees: float = 0.0) -> tm.MeshBatch:
    """An O-mesh from radius 0.5 to 10, growing with the radius; the cylinder moves so many diameters that way."""
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

    return moved(mesh, motion)


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
    """Variants that the seed draws: holes that part, slanting bars, gates, airfoils and cylinders on their way."""
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


def row(name: str, tangled: tm.MeshBatch, topology: Literal["flip", "full"]) -> str:
    after, report = tm.improve(tangled, tm.ImproveOptions(topology=topology))
    q, sizes = report.quality, tm.size_conformity(after)
    angle, limits = float(tm.minimum_angle(after)), boundary_limits(after)
    cells = [
        name, topology, f"{len(tangled.points):,}", f"{len(after.points):,}", str(int(tm.quality(tangled).inverted)),
        f"{float(q.mean):.3f}", f"{float(q.max):.2f} ({limits.ratio:.2f})", f"{angle:.1f} ({limits.angle:.1f})",
        f"{float(sizes.mean):.2f} ({float(sizes.low):.2f} - {float(sizes.high):.2f})",
        "yes" if bool(report.certified) else "no",
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def main(
    only: Annotated[str, typer.Option(help="Variants whose name has this text.")] = "",
    seed: Annotated[
        int | None, typer.Option(help="In place of the variants named here, some that this seed draws.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the table here too.", show_default=False)] = None,
) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    variants = VARIANTS if seed is None else drawn(seed)
    chosen = {name: make for name, make in variants.items() if only in name}
    if not chosen:
        raise typer.BadParameter(f"no variant's name has {only!r}; there are {', '.join(variants)}")
    lines = [
        "| variant | topology | vertices before | after | inverted | IMR average | maximum (limit) "
        "| minimum angle (limit) | edge length / size wanted: mean (5 - 95 percent) | certified |",
        "|" + "---|" * 10,
    ]
    print("\n".join(lines))
    for name, make in chosen.items():
        tangled = make()
        for topology in TOPOLOGIES:
            lines.append(row(name, tangled, topology))
            print(lines[-1], flush=True)
    if out is not None:
        out.write_text("\n".join(lines) + "\n", encoding="utf-8")


app = typer.Typer()
app.command()(main)

if __name__ == "__main__":
    app()
