"""A linear map has its transpose as gradient, and itself as the gradient of that."""

import torch

from torchmesh.optimising.linear_map import LinearMap


def test_gradients_of_every_order_are_those_of_the_matrix(generator):
    matrix = torch.randn((5, 3), generator=generator, dtype=torch.float64)

    def blind(m):
        return lambda values: m @ values.detach()

    linear = LinearMap(blind(matrix), blind(matrix.T))
    values = torch.randn((3, 2), generator=generator, dtype=torch.float64, requires_grad=True)
    assert torch.equal(linear(values), matrix @ values)
    assert torch.autograd.gradcheck(linear, (values,))
    assert torch.autograd.gradgradcheck(linear, (values,))
