"""The meshes in which there is an error are found, and no others."""

import torch
from meshes import disc, grid, ring

from torchmesh import join
from torchmesh.mesh.alone import errors_alone


def test_errors_have_the_rows_of_their_meshes():
    batch = join([grid(), ring(), disc()])
    seen = []

    def work(mesh, rows):
        seen.append(int(rows.sum()))
        assert torch.equal(mesh.points, batch.points[rows])
        if len(mesh.points) == len(ring().points):
            raise ValueError("a ring")

    errors = errors_alone(batch, work)
    assert {b: str(error) for b, error in errors.items()} == {1: "a ring"}
    assert seen == [len(m.points) for m in batch.split()]
    assert errors_alone(batch, lambda mesh, rows: None) == {}
