"""Quads that nothing can mend while they are quads: flips leave their edges, and a corner of theirs is held."""

from collections.abc import Iterator

import numpy as np

from ..mesh.batch import MeshBatch
from ..triangulating.arrays import signs
from .problems import Finding, ProblemKind, position_of, text_of


def fixed_quads(mesh: MeshBatch) -> Iterator[Finding]:
    """The quads of one mesh with a corner that is not upright, where it and its two neighbours are fixed."""
    points = mesh.points.detach().to("cpu").double().numpy()
    quads, fixed = mesh.quads.cpu().numpy(), mesh.fixed.cpu().numpy()
    bad = np.zeros(len(quads), bool)
    for k in range(4):
        corner = np.roll(quads, -k, 1)[:, :3]
        held = fixed[corner].all(1)
        bad[held] |= signs(points, *corner[held].T) <= 0
    for row in np.flatnonzero(bad).tolist():
        place = position_of(points[quads[row]].mean(0))
        corners = quads[row].tolist()
        text = f"quads row {row} {corners} at {text_of(place)} has a corner of three fixed vertices that is not upright"
        yield Finding(ProblemKind.FIXED_QUAD, text, tuple(corners), place)


def is_half(finding: Finding, mesh: MeshBatch) -> bool:
    """Is this of a half of a quad, and no triangle of the mesh?"""
    if finding.kind is not ProblemKind.FIXED_TRIANGLE:
        return False
    rows = mesh.triangles[mesh.of_quads].sort(1).values.tolist()
    return sorted(finding.vertices) in rows
