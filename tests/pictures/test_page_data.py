"""The stages that a page carries: what is decoded is what was encoded."""

import base64
import zlib

import meshes
import numpy as np
import pytest
from pictured import decoded, embedded, recorded

from torchmesh import quality, report_page
from torchmesh.pictures import page_data


def test_the_data_are_the_stages(tmp_path):
    tangled = meshes.moved_hole()
    stages, report = recorded(tangled)
    report_page(tmp_path / "page.html", stages, report)
    header, data = embedded((tmp_path / "page.html").read_text())
    size = float((tangled.points.amax(0) - tangled.points.amin(0)).max())
    assert len(header["stages"]) == len(stages)
    for (_, mesh), (grid, triangles, codes, flags, interfaces) in zip(stages, decoded(header, data), strict=True):
        points = header["origin"] + header["step"] * grid.reshape(-1, 2).astype(float)
        assert np.abs(points - mesh.points.numpy()).max() <= 1e-9 * size
        assert (triangles.reshape(-1, 3) == mesh.triangles.numpy()).all()
        q = quality(mesh)
        ratio = 2.0 ** (codes.astype(float) / header["codesADoubling"])
        assert ratio == pytest.approx(q.inverse_mean_ratio.numpy(), rel=2e-4)
        inverted = np.unpackbits(flags.astype(np.uint8), bitorder="little")[: len(mesh.triangles)]
        assert (inverted == ~q.upright.numpy()).all()
        assert (interfaces.reshape(-1, 2) == mesh.constrained_edges.numpy()).all()


def test_stages_may_differ_in_their_counts():
    pair = [meshes.grid(3, 3), meshes.grid(5, 4)]
    encoded = page_data.encode([(mesh, quality(mesh)) for mesh in pair])
    data = zlib.decompress(base64.b64decode(encoded.text))
    for mesh, (grid, triangles, *_) in zip(pair, decoded(encoded.header, data), strict=True):
        points = encoded.header["origin"] + encoded.header["step"] * grid.reshape(-1, 2).astype(float)
        assert points == pytest.approx(mesh.points.numpy(), abs=1e-9)
        assert (triangles.reshape(-1, 3) == mesh.triangles.numpy()).all()


def test_codes_of_equilateral_huge_and_flat_triangles():
    codes = page_data.codes(np.array([1.0, 0.999, 2.0, 1e300, np.inf]))
    assert codes.tolist() == [0, 0, page_data.CODES_A_DOUBLING, page_data.INFINITE_CODE - 1, page_data.INFINITE_CODE]
