"""What `make bench` times: kernels, L-BFGS iterations, flips, `improve` alone and in a batch.  Nothing is asserted."""

import meshes
import numpy as np
import pytest
import torch

import torchmesh as tm
from torchmesh.learning.domains import moving
from torchmesh.mesh.means import vertex_size
from torchmesh.optimising.assembly import chunks_of, energy_and_forces
from torchmesh.optimising.energies import InverseMeanRatio, Regularised, UntangleBeta
from torchmesh.optimising.jacobian import equilateral
from torchmesh.optimising.lbfgs import minimise
from torchmesh.optimising.lbfgs_options import LbfgsOptions
from torchmesh.optimising.objective import MeshObjective, pack


def grid(cells: int, jitter: float = 0.15, seed: int = 0) -> tm.MeshBatch:
    """A square of 2 cells^2 triangles whose interior vertices are moved by up to `jitter` cells along either axis."""
    points, triangles = meshes.grid_arrays(cells, cells)
    inside = ((points > 0) & (points < 1)).all(1)
    noise = np.random.default_rng(seed).uniform(-jitter, jitter, points.shape) / cells
    return tm.MeshBatch.from_arrays(points + inside[:, None] * noise, triangles)


def objective_of(batch: tm.MeshBatch) -> tuple[MeshObjective, torch.Tensor]:
    packing = pack(batch.points, batch.triangles, ~batch.fixed, batch.point_offsets, batch.triangle_offsets)
    scale = packing.spread_vertices(vertex_size(batch))
    objective = MeshObjective(
        InverseMeanRatio(), equilateral(), packing.rows, packing.anchored, packing.block_offsets,
        packing.triangle_offsets, scale,
    )  # fmt: skip
    return objective, packing.unknowns


@pytest.mark.benchmark(group="kernels")
@pytest.mark.parametrize(
    "energy", [InverseMeanRatio(), UntangleBeta(0.1), Regularised(0.1)], ids=lambda e: type(e).__name__
)
@pytest.mark.parametrize("cells", [33, 440])
def test_kernel(benchmark, cells, energy):
    objective, unknowns = objective_of(grid(cells))
    coordinates = torch.cat([unknowns, objective.anchored])
    benchmark(energy_and_forces, coordinates, chunks_of(objective.rows, energy, equilateral()))


@pytest.mark.benchmark(group="minimiser")
@pytest.mark.parametrize(("cells", "count"), [(33, 1), (33, 60), (440, 1)])
def test_ten_lbfgs_iterations(benchmark, cells, count):
    objective, unknowns = objective_of(tm.join([grid(cells, seed=seed) for seed in range(count)]))
    options = LbfgsOptions(max_iterations=10, energy_tolerance=0, gradient_tolerance=0)
    benchmark.pedantic(minimise, (objective, unknowns, options), rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group="flips")
@pytest.mark.parametrize("cells", [33, 220])
def test_flip_to_delaunay(benchmark, cells):
    mesh = grid(cells, jitter=0.3)
    assert len(mesh.twin) == 3 * len(mesh.triangles)  # computed here, and not in the time measured
    benchmark.pedantic(tm.flip_to_delaunay, (mesh,), rounds=5, warmup_rounds=1)


@pytest.mark.benchmark(group="improve")
@pytest.mark.parametrize("name", ["circle", "bar", "gate"])
def test_improve_one(benchmark, name):
    _, tangled = moving(name)
    benchmark.pedantic(tm.improve, (tangled,), rounds=3, warmup_rounds=1)


@pytest.mark.benchmark(group="improve")
@pytest.mark.parametrize("count", [3, 30])
def test_improve_batch(benchmark, count):
    tangled = [moving(name)[1] for name in ("circle", "bar", "gate")]
    batch = tm.join(tangled * (count // 3))
    benchmark.pedantic(tm.improve, (batch,), rounds=2, warmup_rounds=0)


@pytest.mark.benchmark(group="layers")
@pytest.mark.parametrize("count", [16])
def test_layer_forward_and_backward(benchmark, count):
    batch = tm.join([grid(10, jitter=0.6, seed=seed) for seed in range(count)])
    layer = tm.nn.Untangle(batch)

    def train() -> None:
        layer(batch.points.clone().requires_grad_()).square().sum().backward()

    benchmark.pedantic(train, rounds=3, warmup_rounds=1)
