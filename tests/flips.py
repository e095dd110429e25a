"""Meshes to flip, the rules to flip them by, and what no flip may change."""

import meshes
import torch
from exact import boundary, directed_edges, edge_counts, total_area
from hypothesis import strategies as st

from torchmesh import FlipOptions, MeshBatch
from torchmesh.flipping import rules
from torchmesh.mesh import connectivity

RULES = {name: FlipOptions(rule=name) for name in rules.RULES} | {"paper": FlipOptions.paper()}
ALL = {
    **{f"scrambled {n}": (lambda n=n: meshes.scrambled(meshes.VALID[n](), 1)) for n in meshes.VALID},
    **meshes.TANGLED,
}

# Tangled from a little to beyond recognition.
SIZES, SEEDS = st.sampled_from([0.1, 0.3, 0.6, 1.0, 2.0]), st.integers(0, 10_000)


def random_mesh(size: float, seed: int) -> MeshBatch:
    makers = [
        lambda: meshes.jittered(5, 5, size, seed),
        lambda: meshes.disturbed(meshes.disc(9, 3), 0.25 * size, seed),
        lambda: meshes.disturbed(meshes.delaunay(30, seed), 0.3 * size, seed),
        lambda: meshes.disturbed(meshes.l_shape(3), 0.3 * size, seed),
    ]
    return makers[seed % 4]()


def interior_edges(mesh) -> set[frozenset]:
    return {edge for edge, count in edge_counts(mesh.triangles).items() if count == 2}


def assert_same_domain(before, after, info):
    """What no flip may change, whatever the rule."""
    assert torch.equal(after.points, before.points)
    assert torch.equal(after.fixed, before.fixed)
    assert after.triangles.shape == before.triangles.shape
    assert boundary(after.triangles) == boundary(before.triangles)
    assert max(directed_edges(after.triangles).values()) == 1
    assert max(edge_counts(after.triangles).values()) <= 2
    assert total_area(after) == total_area(before)
    assert torch.equal(after.twin, connectivity.twins(after.triangles))
    assert connectivity.euler_number(after.triangles, after.twin) == connectivity.euler_number(
        before.triangles, connectivity.twins(before.triangles)
    )
    assert {frozenset(e) for e in before.constrained_edges.tolist()} <= set(edge_counts(after.triangles))
