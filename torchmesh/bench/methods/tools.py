"""Other tools, each by its own library: they see the tangled mesh alone, as ours do.

Only the call of a tool's own optimiser is timed, not the way of the mesh into the tool's data structures; that favours
them.  Where a tool cannot hold what the mesh holds, it is not asked.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

from ..answers import Refused, Result
from ..registry import method

if TYPE_CHECKING:
    from torch import Tensor

    from ...mesh.batch import MeshBatch
    from .outcome import Outcome

Tool = Callable[..., "Outcome"]


def _kept(mesh: "MeshBatch", tool: Tool, holds: bool) -> Result:
    """The mesh with the positions that the tool gives its vertices.

    holds  whether the tool can hold interior vertices
    """
    import torch

    from ...mesh.connectivity import boundary_vertices
    from ...mesh.interfaces import holding

    _refuse_quads(mesh)
    fixed = holding(mesh).fixed
    inner = fixed & ~boundary_vertices(mesh.triangles, mesh.twin, len(mesh.points))
    inner[_unused(mesh)] = False
    if not holds and bool(inner.any()):
        raise Refused("it cannot hold vertices inside the mesh")
    outcome = tool(mesh.points.numpy(), mesh.triangles.numpy(), fixed.numpy())
    return Result(mesh.with_points(torch.from_numpy(outcome.points)), outcome.seconds, outcome.note)


def _refuse_quads(mesh: "MeshBatch") -> None:
    if len(mesh.quads):
        raise Refused("it takes triangles only")


def _unused(mesh: "MeshBatch") -> "Tensor":
    """(V,) bool: the vertices that no triangle has, which nothing moves."""
    import torch

    used = torch.zeros(len(mesh.points), dtype=torch.bool)
    used[mesh.triangles.reshape(-1)] = True
    return ~used


@method("gmsh-untangle", libraries=("gmsh",))
def gmsh_untangle(mesh: "MeshBatch") -> Result:
    """gmsh's UntangleMeshGeometry."""
    from .gmsh_winslow import gmsh

    return _kept(mesh, gmsh, holds=False)


@method("gmsh-anew", libraries=("gmsh",))
def gmsh_anew(mesh: "MeshBatch") -> Result:
    """The inside of the boundary meshed anew by gmsh (Frontal-Delaunay), with the sizes of the boundary's edges."""
    import numpy as np

    from ...mesh.batch import MeshBatch
    from .. import boundary
    from ..stopwatch import Stopwatch
    from .gmsh_mesher import triangulate

    _refuse_quads(mesh)
    if len(mesh.constrained_edges):
        raise Refused("the interfaces between regions would be lost")
    points = mesh.points.numpy()
    loops = sorted(
        (loop.numpy() for loop in boundary.loops(mesh.triangles)), key=lambda v: -boundary.polygon_area(points[v])
    )
    sized = []
    for loop in loops:
        at = points[loop]
        side = np.linalg.norm(np.roll(at, -1, 0) - at, axis=1)
        sized.append(np.insert(at, 2, 0.5 * (side + np.roll(side, 1)), 1))
    with Stopwatch() as watch:
        made, faces = triangulate(sized, unsplit=range(len(sized)))
    return Result(MeshBatch.from_arrays(made, faces), watch.seconds)


@method("mfem-tmop", libraries=("mfem",))
def mfem_tmop(mesh: "MeshBatch") -> Result:
    """MFEM's TMOP with a shifted barrier."""
    from .mfem_tmop import mfem

    return _kept(mesh, mfem, holds=False)


@method("mouette", libraries=("mouette",))
def mouette_winslow(mesh: "MeshBatch") -> Result:
    """mouette's WinslowInjectiveEmbedding."""
    from .mouette_winslow import mouette

    return _kept(mesh, mouette, holds=False)


@method("regularised")
def regularised(mesh: "MeshBatch") -> Result:
    """The regularised functional of Garanzha et al. 2021 as published, with scipy's L-BFGS."""
    from .foldover_free_maps import foldover_free

    return _kept(mesh, foldover_free, holds=True)
