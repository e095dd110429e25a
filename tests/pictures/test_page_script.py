"""page_mesh.js, run without a browser: it reads the data, and paints and finds triangles."""

import json
import re
import shutil
import subprocess
from pathlib import Path

import meshes
import numpy as np
import pytest
from pictured import decoded, embedded, recorded

from torchmesh.pictures import page

ASSETS = Path(page.__file__).parent / "assets"
pytestmark = pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js")


def run_script(code: str, folder: Path) -> dict:
    """What `code`, put after page_mesh.js, assigns to `result`."""
    script = folder / "script.js"
    script.write_text(
        (ASSETS / "page_mesh.js").read_text()
        + f"\n(async () => {{ let result; {code}\n console.log(JSON.stringify(result)); }})();"
    )
    done = subprocess.run(["node", str(script)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_script_reads_what_was_encoded(tmp_path):
    page.report_page(tmp_path / "page.html", *recorded(meshes.moved_hole()))
    text = (tmp_path / "page.html").read_text()
    header, data = embedded(text)
    encoded = re.search(r'id="data">(.*?)</script>', text, re.DOTALL).group(1)
    result = run_script(
        f"""const stages = unpack({json.dumps(header)}, await inflate("{encoded}"));
        result = stages.map((s) => [s.grid, s.corners, s.codes, s.flags, s.walls].map((a) => Array.from(a)));""",
        tmp_path,
    )
    for read, expected in zip(result, decoded(header, data), strict=True):
        assert [np.array_equal(a, b) for a, b in zip(read, expected, strict=True)] == [True] * 5


def test_painted_triangles_cover_every_pixel_once(tmp_path):
    """A valid triangulation: no pixel of the square twice, none left out, none outside."""
    points, triangles = meshes.delaunay_arrays(60, 5)
    at = 50 + 40 * points
    result = run_script(
        f"""const points = {at.ravel().tolist()}, corners = {triangles.ravel().tolist()};
        result = new Array(100 * 100).fill(0);
        for (let t = 0; t < {len(triangles)}; t++) {{
          const pixels = new Int32Array(100 * 100);
          fillTriangle(pixels, 100, 100, ...cornersOf({{ points, corners }}, t), 1);
          for (let i = 0; i < pixels.length; i++) result[i] += pixels[i];
        }}""",
        tmp_path,
    )
    covered = np.array(result).reshape(100, 100)
    y, x = np.mgrid[0.5:100, 0.5:100]
    inside = np.zeros((100, 100), bool)
    for a, b, c in at[triangles]:
        sides = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        inside |= np.all([s > 0 for s in sides], 0)
    assert covered.max() == 1
    assert (covered == inside).mean() > 0.9999


def test_painting_beyond_the_edges_of_the_picture(tmp_path):
    big = 1e12
    result = run_script(
        f"""const pixels = new Int32Array(20 * 10);
        fillTriangle(pixels, 20, 10, {-big}, {-big}, {big}, {-big}, 0, {big}, 1);
        result = Array.from(pixels);""",
        tmp_path,
    )
    assert sum(result) == 200


def test_the_triangle_at_a_position(tmp_path):
    """An inverted one wins over those it covers; outside there is none."""
    result = run_script(
        """const stage = { count: 3, flags: [0b100], points: [0, 0, 10, 0, 0, 10, 10, 10, 9, 9],
          corners: [0, 1, 2, 1, 3, 2, 0, 2, 4] };
        result = [[2, 1], [9.5, 9.6], [4, 5], [11, 5]].map(([x, y]) => triangleAt(stage, x, y));""",
        tmp_path,
    )
    assert result == [0, 1, 2, -1]
