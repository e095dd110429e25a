"""Meshes for PyVista (an extra of the package)."""

from typing import Any

import numpy as np
import torch

from ..errors import MissingDependencyError
from ..mesh.batch import MeshBatch, lift, triangle_mesh, vertex_mesh
from ..mesh.measure import quality, signed_minimum_angles


def to_pyvista(batch: MeshBatch) -> Any:
    """The batch as one `pyvista.PolyData` in space, with quality measures as cell data; needs the extra `pyvista`.

    Points keep their order and dtype and lie in the plane of space that each mesh was given in.

    cell data   area (T,) signed, in the unit of length squared; inverse_mean_ratio (T,), 1 for an equilateral
                triangle, infinite for a flat one; minimum_angle (T,) degrees, negative where the triangle is
                inverted; inverted (T,) bool; mesh (T,) the mesh of the batch that the triangle belongs to
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
    data = pyvista.PolyData.from_regular_faces(lift(batch).numpy(), np.ascontiguousarray(faces))
    data.cell_data["area"] = q.area.numpy()
    data.cell_data["inverse_mean_ratio"] = q.inverse_mean_ratio.numpy()
    data.cell_data["minimum_angle"] = signed_minimum_angles(batch, q)
    data.cell_data["inverted"] = torch.logical_not(q.upright).numpy()
    data.cell_data["mesh"] = triangle_mesh(batch).numpy()
    data.point_data["fixed"] = batch.fixed.numpy()
    data.point_data["mesh"] = vertex_mesh(batch).numpy()
    data.set_active_scalars("inverse_mean_ratio", preference="cell")
    return data
