"""Extensions of the boundary's motion into the mesh: they know the undeformed mesh, which the others do not.

The displacement of the fixed vertices is extended to the others, on the undeformed mesh.  Where only the interior is
tangled, as by jitter, the boundary's displacement is zero, and these methods give the undeformed mesh back.
"""

from typing import TYPE_CHECKING, Any

from ..answers import Refused, Result
from ..registry import method

if TYPE_CHECKING:
    import numpy as np

    from ...mesh.batch import MeshBatch


def _known(mesh: "MeshBatch", undeformed: "MeshBatch") -> "tuple[np.ndarray, np.ndarray]":
    """(V,) bool the vertices whose displacement is given, and (V, 2) the displacements of all."""
    from ...mesh.interfaces import holding

    if len(mesh.quads):
        raise Refused("it takes triangles only")
    if len(mesh.points) != len(undeformed.points):
        raise Refused("the mesh has other vertices than the undeformed one")
    return holding(mesh).fixed.numpy(), (mesh.points - undeformed.points).numpy()


def _moved(undeformed: "MeshBatch", displacement: "np.ndarray", mesh: "MeshBatch", known: "np.ndarray") -> Result:
    """The undeformed mesh displaced; its fixed vertices have the positions of `mesh` to the bit."""
    import torch

    points = torch.where(
        torch.from_numpy(known)[:, None], mesh.points, undeformed.points + torch.from_numpy(displacement)
    )
    return Result(undeformed.with_points(points))


def _fem(undeformed: "MeshBatch") -> Any:
    """The undeformed mesh in scikit-fem."""
    import skfem

    return skfem.MeshTri(undeformed.points.numpy().T.copy(), undeformed.triangles.numpy().T.copy())


@method("harmonic", undeformed=True, libraries=("skfem",))
def harmonic(mesh: "MeshBatch", undeformed: "MeshBatch") -> Result:
    """Laplace's equation for each component of the displacement, P1 elements (FEMWARP: Shontz & Vavasis 2010)."""
    import numpy as np
    import skfem
    from skfem.models.poisson import laplace

    known, given = _known(mesh, undeformed)
    basis = skfem.Basis(_fem(undeformed), skfem.ElementTriP1())
    stiffness = laplace.assemble(basis)
    rows = np.flatnonzero(known)
    parts = [skfem.solve(*skfem.condense(stiffness, x=given[:, c].copy(), D=rows)) for c in (0, 1)]
    return _moved(undeformed, np.stack(parts, 1), mesh, known)


@method("biharmonic", undeformed=True, libraries=("skfem",))
def biharmonic(mesh: "MeshBatch", undeformed: "MeshBatch") -> Result:
    """The biharmonic equation for each component, with no normal derivative at the boundary, Morley elements.

    Source of the elements: Morley, The triangular equilibrium element in the solution of plate bending problems,
    Aeronautical Quarterly 19, 1968.
    """
    import numpy as np
    import skfem
    from skfem.helpers import dd, ddot

    known, given = _known(mesh, undeformed)
    made = _fem(undeformed)
    basis = skfem.Basis(made, skfem.ElementTriMorley())

    @skfem.BilinearForm
    def bending(u: Any, v: Any, _: Any) -> Any:
        return ddot(dd(u), dd(v))

    stiffness = bending.assemble(basis)
    rows = np.concatenate([basis.nodal_dofs[0, known], basis.facet_dofs[0, made.boundary_facets()]])
    parts = []
    for c in (0, 1):
        x = np.zeros(basis.N)
        x[basis.nodal_dofs[0, known]] = given[known, c]
        parts.append(skfem.solve(*skfem.condense(stiffness, x=x, D=rows))[basis.nodal_dofs[0]])
    return _moved(undeformed, np.stack(parts, 1), mesh, known)


@method("elastic", undeformed=True, libraries=("skfem",))
def elastic(mesh: "MeshBatch", undeformed: "MeshBatch") -> Result:
    """Linear elasticity (Poisson's ratio 0.3), each element stiffer by the inverse of its area, P1 elements.

    Source: Stein, Tezduyar & Benney, Mesh moving techniques for fluid-structure interactions with large displacements,
    Journal of Applied Mechanics 70, 2003.
    """
    import numpy as np
    import skfem
    from skfem.helpers import ddot, eye, sym_grad, trace

    known, given = _known(mesh, undeformed)
    made = _fem(undeformed)
    basis = skfem.Basis(made, skfem.ElementVector(skfem.ElementTriP1()))
    corner = made.p[:, made.t]
    area = 0.5 * np.abs(
        (corner[0, 1] - corner[0, 0]) * (corner[1, 2] - corner[1, 0])
        - (corner[1, 1] - corner[1, 0]) * (corner[0, 2] - corner[0, 0])
    )
    stiff = (area.mean() / area)[:, None] * np.ones((1, basis.X.shape[1]))
    # Lame's constants of a plane strain with Young's modulus 1.
    ratio = 0.3
    first, second = ratio / ((1 + ratio) * (1 - 2 * ratio)), 0.5 / (1 + ratio)

    @skfem.BilinearForm
    def strain_energy(u: Any, v: Any, w: Any) -> Any:
        strain = sym_grad(u)
        stress = 2 * second * strain + first * eye(trace(strain), 2)
        return w["stiff"] * ddot(stress, sym_grad(v))

    stiffness = strain_energy.assemble(basis, stiff=stiff)
    x = np.zeros(basis.N)
    x[basis.nodal_dofs] = given.T
    rows = basis.nodal_dofs[:, known].ravel()
    solution = skfem.solve(*skfem.condense(stiffness, x=x, D=rows))
    return _moved(undeformed, solution[basis.nodal_dofs].T, mesh, known)


@method("rbf", undeformed=True)
def rbf(mesh: "MeshBatch", undeformed: "MeshBatch") -> Result:
    """Thin plate splines through the displacements of the fixed vertices, by scipy.

    Source: de Boer, van der Schoot & Bijl, Mesh deformation based on radial basis function interpolation, Computers and
    Structures 85, 2007.
    """
    import numpy as np
    from scipy.interpolate import RBFInterpolator

    known, given = _known(mesh, undeformed)
    at = undeformed.points.numpy()
    spline = RBFInterpolator(at[known], given[known], kernel="thin_plate_spline")
    displacement = np.array(given)
    displacement[~known] = spline(at[~known])
    return _moved(undeformed, displacement, mesh, known)
