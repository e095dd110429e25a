"""How good the improved meshes are, and how good their boundaries let them be, as a Markdown table.

    python experiments/quality.py            (needs gmsh, the extra `peers`)

Variants of the paper's domains tangled two to ten times harder, an airfoil turned in a graded mesh
and a cylinder moved four of its diameters in an O-mesh, under topology "flip" and "full".

limit  no mesh of that boundary has a lower maximum: at a boundary vertex with the angle alpha between
       edges of lengths a and b stands a fan of k triangles, whose sides in turn have some ratios
       and angles.  The inverse mean ratio of a triangle with the ratio r of two sides and the angle t
       between them is (r + 1/r - cos t) / (sqrt(3) sin t), the cosh of its hyperbolic distance from
       the equilateral one (r e^{it} as a point of the half plane); its sublevel sets are convex in
       (log r, t), so the best fan has all ratios (b/a)^(1/k) and all angles alpha / k; k is free.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import torch
import typer

import torchmesh as tm
from torchmesh import connectivity

MOST_TRIANGLES_AT_A_CORNER = 24


def boundary_limit(mesh: tm.MeshBatch) -> float:
    """The least maximum of the inverse mean ratio that any mesh with this boundary can have."""
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
    return float(torch.where(angle < math.pi, best, torch.inf).amin(1).max())


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


def gate(push: float) -> tm.MeshBatch:
    outline = [(0, 0), (0.85, 0), (0.85, 0.1), (1.15, 0.1), (1.15, 0), (2, 0), (2, 1), (0, 1)]
    mesh = polygon([(x, y, 0.05) for x, y in outline], [])

    def motion(p: torch.Tensor) -> torch.Tensor:
        notch = ((p[:, 0] - 1).abs() < 0.151) & (p[:, 1] < 0.101)
        p[notch, 1] *= 1 + push / 0.1
        return p

    return moved(mesh, motion)


def airfoil(degrees: float) -> tm.MeshBatch:
    """NACA 0012 in a far field of ten chords."""
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
        return p

    return moved(mesh, motion)


def cylinder(rings: int, sectors: int) -> tm.MeshBatch:
    """An O-mesh from radius 0.5 to 10, growing with the radius; the cylinder moves four diameters."""
    radius = 0.5 * 20 ** (torch.arange(rings + 1, dtype=torch.float64) / rings)
    angle = 2 * math.pi * torch.arange(sectors, dtype=torch.float64) / sectors
    points = torch.stack([torch.outer(radius, angle.cos()), torch.outer(radius, angle.sin())], 2).reshape(-1, 2)
    i, j = torch.meshgrid(torch.arange(rings), torch.arange(sectors), indexing="ij")
    a, b = (i * sectors + j).reshape(-1), (i * sectors + (j + 1) % sectors).reshape(-1)
    triangles = torch.cat([torch.stack([a, a + sectors, b + sectors], 1), torch.stack([a, b + sectors, b], 1)])
    mesh = tm.MeshBatch.from_arrays(points, triangles)

    def motion(p: torch.Tensor) -> torch.Tensor:
        p[p.norm(dim=1) < 0.501, 0] += 4
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


def row(name: str, tangled: tm.MeshBatch, topology: str) -> str:
    started = time.perf_counter()
    after, report = tm.improve(tangled, tm.ImproveOptions(topology=topology))
    seconds = time.perf_counter() - started
    q, sizes = report.quality, tm.size_conformity(after)
    angle = float(tm.minimum_angle(after))
    cells = [
        name, topology, f"{len(tangled.points):,}", f"{len(after.points):,}", str(int(tm.quality(tangled).inverted)),
        f"{float(q.mean):.3f}", f"{float(q.max):.2f}", f"{boundary_limit(tangled):.2f}", f"{angle:.1f}",
        f"{float(sizes.mean):.2f} ({float(sizes.low):.2f} - {float(sizes.high):.2f})",
        "yes" if bool(report.certified) else "no", f"{seconds:.2f}",
    ]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


def main(
    only: Annotated[str, typer.Option(help="Variants whose name has this text.")] = "",
    out: Annotated[Path | None, typer.Option(help="Write the table here too.", show_default=False)] = None,
) -> None:
    """Print the table."""
    torch.set_num_threads(1)
    lines = [
        "| variant | topology | vertices before | after | inverted | IMR average | maximum | limit of the boundary "
        "| minimum angle | edge length / size wanted: mean (5 - 95 percent) | certified | seconds |",
        "|" + "---|" * 12,
    ]
    print("\n".join(lines))
    for name, make in VARIANTS.items():
        if only in name:
            tangled = make()
            for topology in ("flip", "full"):
                lines.append(row(name, tangled, topology))
                print(lines[-1], flush=True)
    if out is not None:
        out.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    typer.run(main)
