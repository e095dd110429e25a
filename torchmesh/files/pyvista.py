"""Meshes for PyVista (an extra of the package)."""

from typing import Any

import numpy as np
import torch

from ..errors import MissingDependencyError
from ..mesh.batch import MeshBatch, lift, triangle_mesh, vertex_mesh
from ..mesh.measure import quality, signed_minimum_angles, signed_narrowest_angles
from ..mesh.quads import quad_mesh
from ..mesh.typed import typed


@typed
def to_pyvista(batch: MeshBatch) -> Any:
    """The batch as one `pyvista.PolyData` in space, with quality measures as cell data; needs the extra `pyvista`.

    Points keep their order and dtype and lie in the plane of space that each mesh was given in.  The Q quads of all
    meshes follow the T triangles, and so do their values.

    cell data   area (T + Q,) signed, in the unit of length squared; inverse_mean_ratio (T + Q,), 1 for an equilateral
                triangle or a square, infinite for a flat one; minimum_angle (T + Q,) degrees, negative where it is
                inverted, of a quad how near a corner comes to 0 or 180 degrees; inverted (T + Q,) bool; mesh (T + Q,)
                the mesh of the batch that it belongs to
    point data  fixed (V,) bool; mesh (V,)

    Raises MissingDependencyError without pyvista.
    """
    try:
        import pyvista
    except ImportError:
        raise MissingDependencyError("to_pyvista needs pyvista: pip install 'torchmesh-untangle[pyvista]'") from None
    batch = batch.with_points(batch.points.detach()).to("cpu")
    q = quality(batch)
    faces = batch.triangles.numpy()
    quads = batch.quads.numpy()
    sizes = [np.concatenate([np.full((len(rows), 1), rows.shape[1]), rows], 1).reshape(-1) for rows in (faces, quads)]
    data = pyvista.PolyData(lift(batch).numpy(), np.concatenate(sizes))
    data.cell_data["area"] = torch.cat([q.area, q.quad_area]).numpy()
    data.cell_data["inverse_mean_ratio"] = torch.cat([q.inverse_mean_ratio, q.quad_inverse_mean_ratio]).numpy()
    angles = signed_minimum_angles(batch, q), signed_narrowest_angles(batch, q)
    data.cell_data["minimum_angle"] = np.concatenate(angles)
    data.cell_data["inverted"] = torch.logical_not(torch.cat([q.upright, q.quad_upright])).numpy()
    data.cell_data["mesh"] = torch.cat([triangle_mesh(batch), quad_mesh(batch)]).numpy()
    data.point_data["fixed"] = batch.fixed.numpy()
    data.point_data["mesh"] = vertex_mesh(batch).numpy()
    data.set_active_scalars("inverse_mean_ratio", preference="cell")
    return data
