"""What tests of the command line share: its outcome, files to work on, and independent measures of the results."""

import math
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import fields
import meshes
import meshio
import numpy as np
from exact import double_area

from experiments.robustness.attack import cracks
from torchmesh import MeshBatch, write


@dataclass(frozen=True)
class Outcome:
    """The exit status, standard output and standard error."""

    status: int
    out: str
    err: str


Call = Callable[..., Outcome]


def process(*arguments: object, folder: Path) -> Outcome:
    """`python -m torchmesh` with the arguments, run in `folder`."""
    command = [sys.executable, "-m", "torchmesh", *map(str, arguments)]
    environment = os.environ | {"PYTHONWARNINGS": "error::DeprecationWarning"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
    return Outcome(done.returncode, done.stdout, done.stderr)


def is_one_clear_line(done: Outcome, text: str) -> bool:
    """Whether it failed as bad input does: status 2, and one line on standard error that contains `text`."""
    return done.status == 2 and done.err.startswith("error: ") and done.err.count("\n") == 1 and text in done.err


def names(folder: Path) -> set[str]:
    """The names of all that lies below the folder."""
    return {p.name for p in folder.rglob("*")}


def inverted(path: Path) -> int:
    """Inverted triangles of a file, by meshio and exact rational arithmetic, not by torchmesh."""
    mesh = meshio.read(path)
    return sum(double_area(*mesh.points[row, :2]) <= 0 for row in mesh.cells_dict["triangle"])


def plate() -> tuple[np.ndarray, np.ndarray]:
    """The unit square of 10 x 10 cells, the middle 4 x 4 of them cut out."""
    points, triangles = meshes.grid_arrays(10, 10)
    inside = (np.abs(points[triangles].mean(1) - 0.5) < 0.2).all(1)
    used, triangles = np.unique(triangles[~inside], return_inverse=True)
    return points[used], triangles.reshape(-1, 3)


def crossed() -> meshio.Mesh:
    """A square one of whose corners was pulled through the opposite side: nothing can untangle it."""
    points, triangles = meshes.grid_arrays(6, 6)
    points[0] = 1.4
    return meshio.Mesh(points, [("triangle", triangles)])


# A file with a method for the benchmark.
METHOD = """
import torchmesh as tm
from torchmesh import bench

@bench.method("mine")
def mine(mesh):
    return tm.smooth(tm.untangle(mesh)[0])[0]
"""


def channel(rings: int = 6, quads: int = 2, around: int = 12) -> meshio.Mesh:
    """A plate round a hole: so many rings of quads on the hole, which is called body, then triangles."""
    angle = 2 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    points = np.concatenate([(1 + 0.5 * k) * circle for k in range(rings + 1)])
    i = np.arange(around)
    j = (i + 1) % around
    cells = [np.stack([i, i + around, j + around, j], 1) + k * around for k in range(rings)]
    rest = np.concatenate(cells[quads:] or [np.zeros((0, 4), int)])
    blocks = [
        ("line", np.stack([i, j], 1)),
        ("triangle", np.concatenate([rest[:, [0, 1, 2]], rest[:, [0, 2, 3]]])),
        ("quad", np.concatenate(cells[:quads])),
    ]
    blocks = [block for block in blocks if len(block[1])]
    groups = [np.full(len(data), 1 if kind == "line" else 2) for kind, data in blocks]
    return meshio.Mesh(
        points, blocks, cell_data={"gmsh:physical": groups, "gmsh:geometrical": groups},
        field_data={"body": np.array([1, 1]), "fluid": np.array([2, 2])},
    )  # fmt: skip


def run_of(count: int = 3) -> list[meshio.Mesh]:
    """A hole that moves through its mesh, step by step."""
    steps = []
    for step in range(count):
        mesh = meshes.moved_hole(2.0 * step)
        points = np.pad(mesh.points.numpy(), ((0, 0), (0, 1)))
        steps.append(meshio.Mesh(points, [("triangle", mesh.triangles.numpy())], point_data={"u": points[:, 0]}))
    return steps


def write_examples(folder: Path) -> None:
    """The files that the examples of the help texts name."""
    for name in ("tangled.vtu", "tangled.vtk", "tangled.msh"):
        write(folder / name, meshes.moved_hole())
    for part in ("a", "b"):
        (folder / "in" / part).mkdir(parents=True)
        write(folder / "in" / part / "mesh.vtu", meshes.jittered())
    write(folder / "moved.vtu", meshes.moved_hole())
    write(folder / "undeformed.vtu", MeshBatch.from_arrays(*meshes.holed_arrays()))
    tangled = meshes.moved_hole()
    write(folder / "stretched.vtu", tangled.with_points(tangled.points * tangled.points.new_tensor([4.0, 1.0])))
    write(folder / "regions.msh", meshes.dragged_interface())
    write(folder / "better.vtu", meshes.equilateral())
    channel().write(folder / "channel.msh", file_format="gmsh22", binary=False)
    fields.write_steps(folder / "run.xdmf", run_of())
    bed = meshes.moved_hole()
    heights = np.sin(3 * bed.points[:, :1].numpy())
    meshio.Mesh(np.hstack([bed.points.numpy(), heights]), [("triangle", bed.triangles.numpy())]).write(
        folder / "terrain.vtk"
    )
    write(folder / "scanned.stl", meshes.jittered())
    (folder / "my_method.py").write_text(METHOD)
    points, triangles = meshes.grid_arrays(4, 4)
    soup = np.pad(points[triangles].reshape(-1, 2), ((0, 0), (0, 1)))
    meshio.Mesh(soup, [("triangle", np.arange(len(soup)).reshape(-1, 3))]).write(folder / "scanned.vtk")
    points, triangles = cracks.two_lips(np.random.default_rng(0), flips=0)
    write(folder / "cracked.vtk", MeshBatch.from_arrays(points, triangles))
    points, triangles = plate()
    write(folder / "plate.msh", MeshBatch.from_arrays(points, triangles))
    write(folder / "plate.inp", MeshBatch.from_arrays(points, triangles))
    on_hole = (np.abs(points - 0.5).max(1) < 0.21)[:, None]
    displacement = on_hole * np.array([[0.1, 0.05, 0.0]])
    meshio.Mesh(points, [("triangle", triangles)], point_data={"displacement": displacement, "u": points[:, 0]}).write(
        folder / "plate.vtu"
    )


def write_bad(folder: Path) -> None:
    """Files that cannot be read, or that cannot be improved to a valid mesh."""
    crossed().write(folder / "crossed.vtu")
    (folder / "empty.vtu").touch()
    (folder / "folder.vtu").mkdir()
    (folder / "unknown.foo").write_text("hello\n")
    (folder / "broken.vtu").write_bytes((folder / "tangled.vtu").read_bytes()[:700])
    points, triangles = meshes.grid_arrays(3, 3)
    points = np.pad(points, ((0, 0), (0, 1)))
    points[5, 1] = math.nan
    meshio.Mesh(points, [("triangle", triangles)]).write(folder / "nan.vtk", file_format="vtk42", binary=False)
    meshio.Mesh(points[:4], [("line", np.array([[0, 1], [2, 3]]))]).write(folder / "lines.vtu")
    folded = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [0.2, -0.5, 0], [2, 1, 0.0]])
    cells = [("quad", np.array([[0, 1, 4, 3]])), ("triangle", np.array([[1, 2, 5], [1, 5, 4]]))]
    meshio.Mesh(folded, cells).write(folder / "folded.vtk", file_format="vtk42", binary=False)
