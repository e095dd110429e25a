import torch

from experiments.shared.lifted_content import TotalLiftedContent
from torchmesh.optimising.energies import slopes_and_curvatures


def jacobians(count: int = 200) -> tuple[torch.Tensor, torch.Tensor]:
    """Stretch (sum of squared entries) and determinant of random matrices."""
    j = torch.randn(count, 2, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    return j.square().sum((1, 2)), torch.linalg.det(j)


def test_lifted_content_tends_to_the_absolute_area():
    stretch, det = jacobians()
    torch.testing.assert_close(TotalLiftedContent(1e-12).value(stretch, det), det.abs(), rtol=0, atol=1e-5)
    assert bool((TotalLiftedContent(0.1).value(stretch, det) > det.abs()).all())


def test_slopes_are_the_derivatives_of_the_value():
    stretch, det = jacobians()
    energy = TotalLiftedContent(0.01)
    value, *slopes = energy.value_and_slopes(stretch, det)
    assert torch.equal(value, energy.value(stretch, det))
    torch.testing.assert_close(torch.stack(slopes), slopes_and_curvatures(energy, stretch, det)[0], rtol=1e-12, atol=0)
