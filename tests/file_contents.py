"""What the tests of files share: a grid in two regions, changes of it, and meshio's view of a file."""

import warnings
from pathlib import Path

import meshio
import numpy as np
import torch

from torchmesh import MeshBatch
from torchmesh.files.documents import load as load_document
from torchmesh.files.drafts import Draft
from torchmesh.files.formats.registry import FORMATS

N = 5  # vertices along a side of the small grid
LEFT, RIGHT = 1, 2  # its regions
ALL = [name for name in FORMATS if name != "exodus"]  # which needs netCDF4, an extra


SU2 = """% a comment
NDIME= 2
NELEM= 4
5 0 1 4 0
5 1 2 4 1
5 2 3 4 2
5 3 0 4 3
NPOIN= 5 5
0 0 0
1 0 1
1 1 2
0 1 3
0.5 0.25 4
NMARK= 2
MARKER_TAG= wall
MARKER_ELEMS= 2
3 0 1
3 1 2
MARKER_TAG= far_field % the rest
MARKER_ELEMS= 2
3 2 3
3 3 0
FFD_NBOX= 1
"""


def grid_arrays() -> tuple[np.ndarray, np.ndarray]:
    """A grid with coordinates that no short decimal fraction gives: every digit of a file is needed."""
    x, y = np.meshgrid(np.arange(N) / 3, np.arange(N) / 7)
    points = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], 1)
    q = (np.arange(N - 1)[:, None] * N + np.arange(N - 1)).ravel()
    return points, np.concatenate([np.stack([q, q + 1, q + N + 1], 1), np.stack([q, q + N + 1, q + N], 1)])


def grid(**changes) -> meshio.Mesh:
    """The grid in two regions, with line cells along a side and a field of each sort."""
    points, faces = grid_arrays()
    side = np.stack([np.arange(N - 1), np.arange(1, N)], 1)
    where = np.where(points[faces].mean(1)[:, 0] < 2 / 3, LEFT, RIGHT)
    content = {
        "point_data": {"u": np.arange(25) / 3, "v": np.arange(75).reshape(25, 3) / 7},
        "cell_data": {"region": [np.full(4, 5), where], "p": [np.zeros(4), np.arange(32) / 3]},
    }
    return meshio.Mesh(points, [("line", side), ("triangle", faces)], **(content | changes))


def save(path: Path, mesh: meshio.Mesh, **options) -> Path:
    """Writes a file: by meshio itself if `options` are given, which are its own."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if options:
            meshio.write(path, mesh, **options)
        else:
            Draft.of(path, mesh).save()
    return path


def flipped(mesh: MeshBatch) -> MeshBatch:
    """The mesh with the diagonal of the first square flipped, in rows 0 and 16."""
    faces = mesh.triangles.clone()
    faces[0], faces[16] = torch.tensor([0, 1, N]), torch.tensor([1, N + 1, N])
    return mesh.with_triangles(faces)


def moved(mesh: MeshBatch) -> MeshBatch:
    """The mesh with every free vertex moved by 0.01 in both directions."""
    return mesh.with_points(torch.where(mesh.fixed[:, None], mesh.points, mesh.points + 0.01))


def warned(record) -> str:
    """The texts of all warnings."""
    return "\n".join(str(w.message) for w in record)


def load(path: Path) -> meshio.Mesh:
    """What meshio's mesh holds of a file."""
    return load_document(path).mesh


def triangle_data(mesh: meshio.Mesh, name: str) -> np.ndarray:
    """The cell data of triangles, in file order."""
    return np.concatenate([v for b, v in zip(mesh.cells, mesh.cell_data[name], strict=True) if b.type == "triangle"])


def side_of(mesh: MeshBatch) -> np.ndarray:
    """LEFT or RIGHT for each triangle, by the position of its centre."""
    centres = mesh.points[mesh.triangles].mean(1)[:, 0]
    return np.where(centres.numpy() < 2 / 3, LEFT, RIGHT)


def rebuilt(mesh: MeshBatch, points: np.ndarray, faces: np.ndarray) -> MeshBatch:
    """A mesh of these points and faces that has the constrained edges of `mesh`, as topology "full" leaves them."""
    row = {tuple(p): i for i, p in enumerate(points.tolist())}
    edges = [[row[tuple(p)] for p in mesh.points[e].tolist()] for e in mesh.constrained_edges]
    return MeshBatch.from_arrays(points, faces, constrained_edges=edges)


def split_and_shuffled(mesh: MeshBatch, seed: int = 0) -> MeshBatch:
    """The mesh with triangle 0 split in three at a new vertex, and all rows of points and triangles shuffled."""
    rng = np.random.default_rng(seed)
    points, faces = mesh.points.numpy(), mesh.triangles.numpy()
    a, b, c = faces[0]
    points = np.concatenate([points, points[faces[0]].mean(0, keepdims=True)])
    faces = np.concatenate([faces[1:], [[a, b, 25], [b, c, 25], [c, a, 25]]])
    order = rng.permutation(len(points))
    return rebuilt(mesh, points[order], rng.permutation(np.argsort(order)[faces]))
