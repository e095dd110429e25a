"""Make the meshes of the three domains of Kim 2017 in torchmesh/data, and print their numbers beside the paper's.

    python -m experiments.paper.make_meshes            (needs gmsh, the extra `peers`)

Meshes come from gmsh's "packing of parallelograms" algorithm, the one whose qualities (average 1.06, maximum 1.6 - 2)
resemble the paper's; then one weighted Laplace step follows (`Domain.relaxation`).  No vertex is moved otherwise, and
nothing is random.

Each file is a legacy ASCII VTK file of counter-clockwise triangles with point data `displacement` (V, 3), which says
where the boundary moves and is zero at interior vertices.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import meshio
import numpy as np
import scipy.sparse
import torch

import torchmesh as tm
from experiments.paper.domains import Domain, Row, moving_bar, moving_circle, moving_gate
from experiments.shared import arguments
from torchmesh.bench import boundary
from torchmesh.bench.methods import gmsh_mesher

Array = np.ndarray

DECIMALS = 7  # coordinates stay below 100, so they have at most nine significant digits


def triangulate(domain: Domain) -> tuple[Array, Array]:
    """Points (V, 2) and counter-clockwise triangles (T, 3); every vertex is used."""
    points, triangles = gmsh_mesher.triangulate(
        domain.loops,
        algorithm=gmsh_mesher.PACKING_OF_PARALLELOGRAMS,
        smoothing=0,  # the relaxation is done in _laplace_step, where one can see it
        unsplit=domain.unsplit,
    )
    return np.round(_laplace_step(points, triangles, domain.relaxation), DECIMALS), triangles


def _laplace_step(points: Array, triangles: Array, weight: float) -> Array:
    """Move interior vertices the fraction `weight` of the way to their neighbours' mean."""
    # Each edge of an interior vertex runs once in each direction, so its row counts every neighbour once.
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    count = len(points)
    neighbours = scipy.sparse.coo_matrix((np.ones(len(start)), (start, end)), (count, count)).tocsr()
    mean = neighbours @ points / neighbours.sum(axis=1)
    interior = ~_on_boundary(triangles, count)[:, None]
    return np.where(interior, (1 - weight) * points + weight * mean, points)


def write(path: Path, domain: Domain, points: Array, triangles: Array) -> None:
    """Write the undeformed mesh and, as point data, where its boundary goes."""
    boundary = _on_boundary(triangles, len(points))
    displacement = np.zeros((len(points), 3))
    displacement[boundary, :2] = domain.displacement(points[boundary])
    mesh = meshio.Mesh(
        np.pad(points, ((0, 0), (0, 1))),
        [("triangle", triangles)],
        point_data={"displacement": np.round(displacement, DECIMALS)},
    )
    mesh.write(path, file_format="vtk", binary=False)


def measure(path: Path) -> Row:
    """The numbers of a written file, as a reader of the file finds them."""
    data = meshio.read(path)
    mesh = tm.MeshBatch.from_arrays(data.points[:, :2], data.cells_dict["triangle"])
    target = mesh.points + torch.from_numpy(data.point_data["displacement"][:, :2])
    before, after = tm.quality(mesh), tm.quality(tm.femwarp(mesh, target))
    return Row(
        len(mesh.triangles), len(mesh.points),
        float(before.mean), float(before.max), int(after.inverted), float(after.mean), float(after.max),
    )  # fmt: skip


def _on_boundary(triangles: Array, count: int) -> Array:
    """(V,) bool: the vertices on the boundary."""
    on = np.zeros(count, dtype=bool)
    on[boundary.edges(torch.from_numpy(triangles)).numpy().ravel()] = True
    return on


def _line(label: str, row: Row) -> str:
    counts = "".join(f"{'-' if n is None else n:>10}" for n in (row.triangles, row.vertices))
    before = f"{row.initial_mean:8.3f} /{row.initial_max:6.3f}"
    after = f"{row.inverted:10d}{row.warped_mean:12.3f} /{row.warped_max:13.3f}"
    return f"{label:<14}{counts}{before}{after}"


def main(argv: Sequence[str] | None = None) -> int:
    parser = arguments.parser(__doc__)
    parser.add_argument("--out", type=Path, default=Path("torchmesh/data"), help="folder for the three files")
    given = arguments.parse(parser, argv)
    given.out.mkdir(parents=True, exist_ok=True)
    print(
        f"{'':<14}{'triangles':>10}{'vertices':>10}{'IMR avg / max':>16}"
        f"{'inverted':>10}{'IMR avg / max after FEMWARP':>28}"
    )
    for domain in (moving_circle(), moving_bar(), moving_gate()):
        path = given.out / f"{domain.name}.vtk"
        write(path, domain, *triangulate(domain))
        print(_line(domain.name, measure(path)))
        print(_line("  Kim 2017", domain.paper))
    return 0


if __name__ == "__main__":
    sys.exit(main())
