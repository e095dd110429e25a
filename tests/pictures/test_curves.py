"""Curved sides in pictures and on the page: parabolas through the nodes, and no wrong colour beside them."""

import base64
import zlib

import curved_meshes as cm
import meshio
import numpy as np
import pytest
import torch

from torchmesh.files.curved import given
from torchmesh.files.source import Source
from torchmesh.mesh.measure import quality
from torchmesh.pictures.curves import Curves
from torchmesh.pictures.page_data import encode
from torchmesh.pictures.regions import corner_points


@pytest.fixture
def ring(tmp_path):
    points, six = cm.annulus()
    meshio.Mesh(points, [("triangle6", six)]).write(tmp_path / "ring.vtu")
    return Source.open(tmp_path / "ring.vtu")


def test_lines_go_through_the_nodes_and_outlines_bend_outwards_and_inwards(ring):
    curves = Curves.of(given(ring))
    points = ring.mesh.points.numpy()
    assert len(curves.edges) == 24, "the edges on the two circles"
    for line, (u, v) in zip(curves.lines(points, curves.edges), curves.edges.tolist(), strict=True):
        assert (line[0] == points[u]).all()
        assert (line[-1] == points[v]).all()
        radius = np.hypot(*line.T)
        assert np.ptp(radius) < 2e-3, "so near does a parabola come to the circle"
    flat = curves.lines(points, curves.edges[:, ::-1])[0]
    assert (flat[0] == points[curves.edges[0, 1]]).all()
    outlines = curves.outlines(ring.mesh, corner_points(ring.mesh))
    areas = [np.abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2 for x, y in (o.T for o in outlines)]
    assert sum(areas) == pytest.approx(np.pi * (1 - 0.4**2), rel=2e-3)


def test_a_triangle_that_is_inverted_as_a_curved_one_counts_as_inverted(ring):
    points = ring.mesh.points.clone()
    node = int(ring.middles.nodes[0])
    points[node] = 0.0  # far beyond the opposite side
    placed = given(ring, ring.mesh.with_points(points))
    q = quality(placed.mesh)
    judged = Curves.of(placed).judged(q)
    assert (int(q.inverted[0]), int(judged.inverted[0])) == (0, int(placed.inverted.sum()))
    assert torch.equal(judged.upright, torch.from_numpy(~placed.inverted))


def test_straight_sides_are_no_curves(tmp_path):
    points, six = cm.with_nodes(np.array([[0, 0], [1, 0], [0, 1.0]]), np.array([[0, 1, 2]]))
    meshio.Mesh(points, [("triangle6", six)]).write(tmp_path / "a.vtu")
    assert Curves.of(given(Source.open(tmp_path / "a.vtu"))) is None
    assert Curves.of(None) is None


def test_the_page_has_the_control_points(ring):
    curves = Curves.of(given(ring))
    encoded = encode([(ring.mesh, quality(ring.mesh))], [curves])
    (stage,) = encoded.header["stages"]
    assert stage["curves"] == 24
    raw = np.frombuffer(zlib.decompress(base64.b64decode(encoded.text)), np.uint8)[-2 * 24 * 4 :].reshape(4, -1)
    grid = (raw.astype(np.uint32) << (8 * np.arange(4, dtype=np.uint32))[:, None]).sum(0).reshape(-1, 2)
    found = grid * encoded.header["step"] + encoded.header["origin"]
    assert np.allclose(found, curves.controls, rtol=0, atol=1e-8)
