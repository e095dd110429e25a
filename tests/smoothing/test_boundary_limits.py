"""No fan of triangles at a boundary vertex is better than its limit, and the best of many comes up to it."""

import math

import pytest
import torch

import torchmesh as tm
from torchmesh.smoothing.boundary_limits import fan_limits


@pytest.mark.parametrize("degrees", [20, 60, 90, 200, 300])
@pytest.mark.parametrize("ratio", [1.0, 1.7, 6.0])
def test_no_fan_of_boundary_triangles_passes_its_limit(degrees, ratio):
    alpha, generator = math.radians(degrees), torch.Generator().manual_seed(degrees)
    fans = []
    for k in range(1, 7):
        rows = [[0, i + 1, i + 2] for i in range(k)]
        fan = tm.MeshBatch.from_arrays(torch.zeros(k + 2, 2, dtype=torch.float64), rows)
        for trial in range(40):
            # Between sides of lengths 1 and `ratio`: equal shares at first, then any.
            part = torch.rand(k, generator=generator, dtype=torch.float64) if trial else torch.ones(k).double()
            step = torch.rand(k, generator=generator, dtype=torch.float64) if trial else torch.ones(k).double()
            turn = torch.nn.functional.pad((alpha * part / part.sum()).cumsum(0), (1, 0))
            length = torch.nn.functional.pad((math.log(ratio) * step / step.sum()).cumsum(0), (1, 0)).exp()
            if float((turn[1:] - turn[:-1]).max()) > 3.1:
                continue
            boundary = torch.stack([length * turn.cos(), length * turn.sin()], 1)
            points = torch.cat([torch.zeros(1, 2, dtype=torch.float64), boundary])
            fans.append(fan.with_points(points))
    assert len(fans) > 50
    batch = tm.join(fans)
    limit, least = (v[batch.point_offsets[:-1]] for v in fan_limits(batch, torch.ones(len(batch.points)).bool()))
    angle, shape = tm.minimum_angle(batch).deg2rad(), tm.quality(batch).max
    # Sums of a few angles and ratios, rounded.
    assert bool((angle <= limit + 1e-12).all())
    assert bool((shape >= least * (1 - 1e-12)).all())
    assert float(angle.max()) == pytest.approx(float(limit[-1]), rel=1e-9)
    assert float(shape.min()) == pytest.approx(float(least[-1]), rel=1e-9)
