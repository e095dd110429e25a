"""Which triangles nothing can change."""

import meshes
import torch

from torchmesh import MeshBatch
from torchmesh.mesh.connectivity import edges
from torchmesh.mesh.frozen import frozen_triangles


def grid_with(fixed, constrained) -> MeshBatch:
    mesh = meshes.grid()
    return MeshBatch.from_arrays(mesh.points, mesh.triangles, fixed, constrained)


def test_triangles_whose_corners_and_edges_stay_are_frozen():
    mesh = meshes.grid()
    every = torch.ones_like(mesh.fixed)
    inner = edges(mesh.triangles, mesh.twin)
    inner = inner[~mesh.fixed[inner].all(1)]
    low = mesh.points[:, 1] < float(mesh.points[:, 1].median())
    some = inner[low[inner].all(1)]
    frozen = frozen_triangles(grid_with(low, some))
    assert frozen.any()
    # The slow twin: every side is one of the constrained edges or has its triangle on one side only.
    sides = {tuple(sorted(e)) for e in some.tolist()}
    count: dict[tuple[int, int], int] = {}
    for t in mesh.triangles.tolist():
        for k in range(3):
            side = tuple(sorted((t[k], t[(k + 1) % 3])))
            count[side] = count.get(side, 0) + 1
    fixed = low | mesh.fixed
    for row, t in enumerate(mesh.triangles.tolist()):
        mine = [tuple(sorted((t[k], t[(k + 1) % 3]))) for k in range(3)]
        stays = all(side in sides or count[side] == 1 for side in mine) and any(side in sides for side in mine)
        assert bool(frozen[row]) == (stays and bool(fixed[t].all()))
    # A free corner, or an edge that may flip, is enough.
    assert not frozen_triangles(grid_with(None, some))[frozen & ~mesh.fixed[mesh.triangles].all(1)].any()
    assert not frozen_triangles(grid_with(every, None)).any()
