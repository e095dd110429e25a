"""Products with the Hessian against the dense matrix that autograd finds."""

import pytest
import torch
from energy_cases import ENERGIES
from meshes import disturbed, grid
from torch import Tensor

from torchmesh.mesh.triangle import Corners
from torchmesh.optimising.energies import Energy, UntangleBeta
from torchmesh.optimising.hessian import Hessian
from torchmesh.optimising.jacobian import equilateral, invariants

# The areas of the grid lie below and above this beta.
CASES = ENERGIES | {"untangle-beta": UntangleBeta(2.0)}
TARGET = equilateral(0.2)


def coordinates_of(mesh) -> tuple[Tensor, Tensor]:
    """All coordinates, x before y, and where the corners' stand in them."""
    count = len(mesh.points)
    rows = torch.stack([mesh.triangles[:, i // 2] + (i % 2) * count for i in range(6)])
    return mesh.points.T.reshape(-1).clone(), rows


def dense(energy: Energy, x: Tensor, rows: Tensor) -> tuple[Tensor, Tensor]:
    def total(x: Tensor) -> Tensor:
        return energy.value(*invariants(Corners(*x[rows]), TARGET)).sum()

    return torch.autograd.functional.jacobian(total, x), torch.autograd.functional.hessian(total, x)


@pytest.mark.parametrize("name", CASES)
def test_products_gradient_and_diagonal_are_autograds(name, generator):
    energy = CASES[name]
    x, rows = coordinates_of(disturbed(grid(4, 3), 0.01, 1))
    gradient, matrix = dense(energy, x, rows)
    assert float(matrix.abs().max()) > 0.1
    hessian = Hessian.at(x, rows, energy, TARGET)
    u = torch.randn(len(x), generator=generator, dtype=x.dtype)
    # Sums of some ten terms, in another order.
    size = float(matrix.abs().max())
    torch.testing.assert_close(hessian @ u, matrix @ u, rtol=0, atol=1e-13 * size * float(u.norm()))
    torch.testing.assert_close(hessian.gradient(), gradient, rtol=0, atol=1e-12 * size)
    torch.testing.assert_close(hessian.diagonal(), matrix.diagonal(), rtol=0, atol=1e-12 * size)
