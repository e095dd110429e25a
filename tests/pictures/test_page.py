"""The page of `report_page`: what is in it, that it asks for nothing, and, in a browser, that it does what it says."""

import base64
import json
import re
import shutil
import subprocess
import zlib
from pathlib import Path

import meshes
import numpy as np
import pytest
from browser import chromium

from torchmesh import InvalidMeshError, MeshBatch, MeshIOError, improve, join, quality
from torchmesh.pictures import page, page_data
from torchmesh.pictures.page import PALETTE, report_page

DATA = Path(page.__file__).parent / "assets"


def recorded(mesh: MeshBatch):
    stages: list[tuple[str, MeshBatch]] = []
    _, report = improve(mesh, observe=lambda name, batch: stages.append((name, batch)))
    return stages, report


def embedded(text: str) -> tuple[dict, bytes]:
    header = re.search(r'<script type="application/json" id="header">(.*?)</script>', text, re.DOTALL).group(1)
    data = re.search(r'<script type="text/plain" id="data">(.*?)</script>', text, re.DOTALL).group(1)
    return json.loads(header), zlib.decompress(base64.b64decode(data))


def decoded(header: dict, data: bytes) -> list[list[np.ndarray]]:
    """Points, triangles, codes and flags of each stage: the format as its description has it, read slowly."""
    stages: list[list[np.ndarray]] = []
    offset = 0
    for entry in header["stages"]:
        v, t = entry["vertices"], entry["triangles"]
        stage = []
        for k, (width, count) in enumerate([(4, 2 * v), (4, 3 * t), (2, t), (1, (t + 7) // 8)]):
            planes = np.frombuffer(data, np.uint8, width * count, offset).reshape(width, count).astype(np.uint64)
            offset += width * count
            values = sum(planes[b] << np.uint64(8 * b) for b in range(width))
            if stages and len(stages[-1][k]) == count:
                values = values ^ stages[-1][k]
            stage.append(values)
        stages.append(stage)
    assert offset == len(data)
    return stages


@pytest.fixture(scope="module")
def tangled() -> MeshBatch:
    return meshes.moved_hole()


@pytest.fixture(scope="module")
def written(tangled, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("page") / "page.html"
    report_page(path, *recorded(tangled), title="a hole </script> that moved")
    return path


def test_the_data_are_the_stages(tangled, written):
    stages, _ = recorded(tangled)
    header, data = embedded(written.read_text())
    size = float((tangled.points.amax(0) - tangled.points.amin(0)).max())
    assert len(header["stages"]) == len(stages)
    for (_, mesh), (grid, triangles, codes, flags) in zip(stages, decoded(header, data), strict=True):
        points = header["origin"] + header["step"] * grid.reshape(-1, 2).astype(float)
        assert np.abs(points - mesh.points.numpy()).max() <= 1e-9 * size
        assert (triangles.reshape(-1, 3) == mesh.triangles.numpy()).all()
        q = quality(mesh)
        ratio = 2.0 ** (codes.astype(float) / header["codesADoubling"])
        assert ratio == pytest.approx(q.inverse_mean_ratio.numpy(), rel=2e-4)
        inverted = np.unpackbits(flags.astype(np.uint8), bitorder="little")[: len(mesh.triangles)]
        assert (inverted == ~q.upright.numpy()).all()


def test_stages_may_differ_in_their_counts():
    pair = [meshes.grid(3, 3), meshes.grid(5, 4)]
    encoded = page_data.encode([(mesh, quality(mesh)) for mesh in pair])
    data = zlib.decompress(base64.b64decode(encoded.text))
    for mesh, (grid, triangles, _, _) in zip(pair, decoded(encoded.header, data), strict=True):
        points = encoded.header["origin"] + encoded.header["step"] * grid.reshape(-1, 2).astype(float)
        assert points == pytest.approx(mesh.points.numpy(), abs=1e-9)
        assert (triangles.reshape(-1, 3) == mesh.triangles.numpy()).all()


def test_codes_of_equilateral_huge_and_flat_triangles():
    codes = page_data.codes(np.array([1.0, 0.999, 2.0, 1e300, np.inf]))
    assert codes.tolist() == [0, 0, page_data.CODES_A_DOUBLING, page_data.INFINITE_CODE - 1, page_data.INFINITE_CODE]


def test_the_page_holds_the_tables_and_asks_for_nothing(tangled, written):
    text = written.read_text()
    stages, report = recorded(tangled)
    assert "default-src 'none'" in text
    assert not re.search(r"""(src|href|action)\s*=\s*["'](?!data:,)|@import|url\(|fetch\(|XMLHttp|https?://""", text)
    for step in report.steps[0]:
        assert f"<td>{step.mean:.3f}</td>" in text
    assert text.count("<tr data-stage=") == len(stages)
    for title in ("triangles", "vertices", "inverted", "IMR average", "IMR maximum", "smallest angle (degrees)"):
        assert f'<th scope="row">{title}</th>' in text
    assert "Certified valid" in text
    assert text.count('<svg class="histogram"') == 2
    assert written.stat().st_size < 200_000


def test_names_cannot_break_out_of_the_page(tmp_path):
    name = '</script><b a="1">&'
    report_page(tmp_path / "page.html", [(name, meshes.grid()), ("after", meshes.grid())], title=name, note=name)
    text = (tmp_path / "page.html").read_text()
    assert "<b a" not in text
    assert text.count("</script>") == 3
    assert embedded(text)[0]["stages"][0]["name"] == f"0. {name}"


def test_before_and_after_alone(tmp_path):
    report_page(tmp_path / "page.html", [("before", meshes.moved_hole()), ("after", meshes.grid())])
    text = (tmp_path / "page.html").read_text()
    assert "<title>page</title>" in text
    assert "seconds" not in text
    assert text.count("<tr data-stage=") == 2


def test_one_stage_is_enough(tmp_path):
    report_page(tmp_path / "page.html", [("mesh", meshes.grid())])
    header, _ = embedded((tmp_path / "page.html").read_text())
    assert [entry["name"] for entry in header["stages"]] == ["0. mesh"]


def test_a_mesh_with_a_flat_triangle(tmp_path):
    flat = MeshBatch.from_arrays([[0, 0], [1, 0], [2, 0], [1, 1.0]], [[0, 1, 2], [0, 2, 3]])
    report_page(tmp_path / "page.html", [("flat", flat)])
    text = (tmp_path / "page.html").read_text()
    header, data = embedded(text)
    assert decoded(header, data)[0][2][0] == page_data.INFINITE_CODE
    assert "<td>inf</td>" in text


def test_a_point_and_a_line(tmp_path):
    for points in ([[3, 4], [3, 4], [3, 4.0]], [[0, 0], [1, 0], [2, 0.0]]):
        report_page(tmp_path / "page.html", [("mesh", MeshBatch.from_arrays(points, [[0, 1, 2]]))])


def test_too_many_stages_are_thinned_out_but_not_in_the_table(tangled, tmp_path, monkeypatch):
    stages = [(f"way {i}", tangled) for i in range(9)] + [
        (f"way {i}", MeshBatch.from_arrays(*meshes.holed_arrays())) for i in range(9, 20)
    ]
    monkeypatch.setattr(page, "_TRIANGLES_SHOWN", 5 * len(tangled.triangles))
    report_page(tmp_path / "page.html", stages)
    text = (tmp_path / "page.html").read_text()
    header, _ = embedded(text)
    shown = [int(entry["name"].split(".")[0]) for entry in header["stages"]]
    assert len(shown) == 5
    assert {0, 9, 19} <= set(shown), "the ends and the first that is valid"
    assert shown == sorted(shown)
    assert text.count('<th scope="row">') == 7 + 20
    assert text.count("<tr data-stage=") == 5


def test_bad_stages(tangled, tmp_path):
    path = tmp_path / "page.html"
    with pytest.raises(InvalidMeshError, match="at least one stage"):
        report_page(path, [])
    with pytest.raises(InvalidMeshError, match="'both' is a batch of 2 meshes"):
        report_page(path, [("both", join([tangled, tangled]))])
    stages, report = recorded(tangled)
    with pytest.raises(ValueError, match="its steps are not the stages given"):
        report_page(path, stages[1:], report)
    with pytest.raises(MeshIOError, match="does not exist"):
        report_page(tmp_path / "nowhere" / "page.html", stages)
    assert not list(tmp_path.iterdir())


def test_colours_are_those_of_the_pictures():
    colormaps = pytest.importorskip("matplotlib").colormaps
    from matplotlib.colors import to_rgb

    for i, colour in enumerate(PALETTE):
        assert colormaps["YlGnBu"](i / 8)[:3] == pytest.approx(to_rgb(colour), abs=0.01)


# --- the script, without a browser ---------------------------------------------------------------------

node = pytest.mark.skipif(shutil.which("node") is None, reason="needs Node.js")


def run_script(code: str, folder: Path) -> dict:
    """What `code`, put after page_mesh.js, assigns to `result`."""
    script = folder / "script.js"
    script.write_text(
        (DATA / "page_mesh.js").read_text()
        + f"\n(async () => {{ let result; {code}\n console.log(JSON.stringify(result)); }})();"
    )
    done = subprocess.run(["node", str(script)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@node
def test_the_script_reads_what_was_packed(written, tmp_path):
    text = written.read_text()
    header, data = embedded(text)
    encoded = re.search(r'id="data">(.*?)</script>', text, re.DOTALL).group(1)
    result = run_script(
        f"""const stages = unpack({json.dumps(header)}, await inflate("{encoded}"));
        result = stages.map((s) => [s.grid, s.corners, s.codes, s.flags].map((a) => Array.from(a)));""",
        tmp_path,
    )
    for read, expected in zip(result, decoded(header, data), strict=True):
        assert [np.array_equal(a, b) for a, b in zip(read, expected, strict=True)] == [True] * 4


@node
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


@node
def test_painting_beyond_the_edges_of_the_picture(tmp_path):
    big = 1e12
    result = run_script(
        f"""const pixels = new Int32Array(20 * 10);
        fillTriangle(pixels, 20, 10, {-big}, {-big}, {big}, {-big}, 0, {big}, 1);
        result = Array.from(pixels);""",
        tmp_path,
    )
    assert sum(result) == 200


@node
def test_the_triangle_under_a_place(tmp_path):
    """An inverted one wins over those it covers; outside there is none."""
    result = run_script(
        """const stage = { count: 3, flags: [0b100], points: [0, 0, 10, 0, 0, 10, 10, 10, 9, 9],
          corners: [0, 1, 2, 1, 3, 2, 0, 2, 4] };
        result = [[2, 1], [9.5, 9.6], [4, 5], [11, 5]].map(([x, y]) => triangleAt(stage, x, y));""",
        tmp_path,
    )
    assert result == [0, 1, 2, -1]


# --- the page, in a browser ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def browser():
    with chromium() as running:
        yield running


class Look:
    """A page in the browser, and what went wrong or out from it."""

    def __init__(self, browser, path: Path, **settings) -> None:
        self.context = browser.new_context(**({"viewport": {"width": 1280, "height": 900}} | settings))
        self.page = self.context.new_page()
        self.trouble: list[str] = []
        self.requests: list[str] = []
        self.page.on("pageerror", lambda error: self.trouble.append(str(error)))
        self.page.on("console", lambda message: self.trouble.append(message.text))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-state]")

    def rest(self) -> None:
        """Until what was asked for is painted."""
        self.page.wait_for_timeout(250)

    def data(self, name: str) -> str:
        return self.page.evaluate(f"document.documentElement.dataset.{name}")

    def view(self) -> list[float]:
        self.rest()
        return [float(part) for part in self.data("view").split()]

    def details(self) -> str:
        return self.page.inner_text("#details")

    def vermilion(self, canvas: str = "canvas") -> int:
        """How many pixels of a canvas have the colour of inverted triangles."""
        self.rest()
        return self.page.evaluate(
            """(id) => { const c = document.getElementById(id);
            const p = c.getContext("2d").getImageData(0, 0, c.width, c.height).data; let n = 0;
            for (let i = 0; i < p.length; i += 4) n += p[i] === 0xd5 && p[i + 1] === 0x5e && p[i + 2] === 0;
            return n; }""",
            canvas,
        )


@pytest.fixture
def look(browser, written):
    opened = Look(browser, written)
    yield opened
    assert opened.trouble == []
    assert opened.requests == [written.as_uri()]
    opened.context.close()


def test_it_opens_at_the_end_with_before_beside(look, tangled):
    assert look.data("state") == "ready"
    assert look.page.inner_text("h1") == "a hole </script> that moved"
    assert look.vermilion("canvas") == 0
    assert look.vermilion("canvas-before") > 300
    assert int(look.data("seen")) == len(tangled.triangles)
    assert "0 inverted" in look.page.inner_text("#stage-name")


def test_the_slider_and_the_keys_step_through_the_stages(look, tangled):
    count = int(quality(tangled).inverted[0])
    look.page.focus("#stage")
    look.page.keyboard.press("Home")
    assert f"{count} inverted" in look.page.inner_text("#stage-name")
    assert look.vermilion() > 300
    look.page.focus("#canvas")
    look.page.keyboard.press(".")
    assert look.page.inner_text("#stage-name").startswith("1. ")
    look.page.keyboard.press(",")
    assert look.page.inner_text("#stage-name").startswith("0. ")
    look.page.click("tr[data-stage='2'] button")
    assert look.page.inner_text("#stage-name").startswith("2. ")
    assert look.page.get_attribute("tr[data-stage='2']", "aria-current") == "true"


def test_a_click_tells_the_triangle(look, tangled):
    """The picture's geometry undone: the middle of a triangle, as a place on the screen, gives that triangle."""
    after, report = improve(tangled)
    row = 17
    x, y = after.points[after.triangles[row]].mean(0).tolist()
    header, _ = embedded(Path(look.page.url.removeprefix("file://")).read_text())
    vx, vy, scale = look.view()
    box = look.page.locator("#canvas").bounding_box()
    px = ((x - header["origin"][0]) / header["step"] - vx) * scale + box["width"] / 2
    py = -((y - header["origin"][1]) / header["step"] - vy) * scale + box["height"] / 2
    look.page.mouse.click(box["x"] + px, box["y"] + py)
    text = look.details()
    assert text.startswith(f"Triangle {row} ")
    ratio = float(re.search(r"inverse mean ratio ([\d.]+)", text).group(1))
    assert ratio == pytest.approx(float(report.quality.inverse_mean_ratio[row]), rel=1e-3)
    area = float(re.search(r"area ([-\d.e]+)", text).group(1))
    assert area == pytest.approx(float(report.quality.area[row]), rel=1e-2)
    vertices = re.findall(r"(\d+) \(([-\d.e]+), ([-\d.e]+)\)", text)
    assert [int(v) for v, _, _ in vertices] == after.triangles[row].tolist()
    for v, x, y in vertices:
        assert [float(x), float(y)] == pytest.approx(after.points[int(v)].tolist(), abs=1e-5)
    look.page.mouse.click(box["x"] + 3, box["y"] + 3)
    assert look.details() == "Click a triangle for its row and shape."


def test_a_click_on_the_picture_before_tells_an_inverted_triangle(look):
    look.page.click("#worst")
    look.page.keyboard.press("Escape")
    look.page.focus("#stage")
    look.page.keyboard.press("Home")
    look.page.click("#worst")
    assert "inverted" in look.details()
    row = look.page.input_value("#row")
    look.page.keyboard.press("Escape")
    look.page.focus("#stage")
    look.page.keyboard.press("End")
    box = look.page.locator("#canvas-before").bounding_box()
    look.page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert "inverted (stage 0. initial)" in look.details()
    assert look.page.input_value("#row") != "" != row


def test_wheel_drag_and_buttons_move_the_view(look):
    x, y, scale = look.view()
    box = look.page.locator("#canvas").bounding_box()
    middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    look.page.mouse.move(*middle)
    look.page.mouse.wheel(0, -300)
    assert look.view()[:2] == pytest.approx([x, y], rel=1e-2)
    assert look.view()[2] > 1.3 * scale
    before = look.view()
    look.page.mouse.down()
    look.page.mouse.move(middle[0] + 60, middle[1] + 30, steps=4)
    look.page.mouse.up()
    after = look.view()
    assert [(after[0] - before[0]) * after[2], (after[1] - before[1]) * after[2]] == pytest.approx([-60, 30], abs=1)
    assert look.details().startswith("Click"), "a drag is no click"
    look.page.click("#in")
    assert look.view()[2] == pytest.approx(1.5 * after[2])
    look.page.click("#out")
    look.page.click("#fit")
    assert look.view() == pytest.approx([x, y, scale])


def test_everything_works_from_the_keyboard(look):
    x, y, scale = look.view()
    look.page.focus("#canvas")
    for key in ("+", "+", "-", "ArrowLeft", "ArrowUp"):
        look.page.keyboard.press(key)
    moved = look.view()
    assert moved[2] == pytest.approx(1.5 * scale)
    assert moved[0] < x
    assert moved[1] > y
    look.page.keyboard.press("0")
    assert look.view() == pytest.approx([x, y, scale])
    look.page.keyboard.press("n")
    first = look.details()
    assert first.startswith("Triangle ")
    look.page.keyboard.press("n")
    assert look.details() != first
    look.page.keyboard.press("p")
    assert look.details() == first
    look.page.keyboard.press("Enter")
    assert look.details() == first, "the triangle in the middle is the one that was gone to"
    look.page.keyboard.press("Escape")
    assert look.details().startswith("Click")
    order = []
    look.page.focus("#previous")
    for _ in range(13):
        order.append(look.page.evaluate("document.activeElement.id"))
        look.page.keyboard.press("Tab")
    assert {"previous", "stage", "next", "play", "out", "in", "fit", "worst", "beside", "row", "canvas"} <= set(order)


def test_a_row_can_be_asked_for(look):
    look.page.fill("#row", "5")
    look.page.keyboard.press("Enter")
    assert look.details().startswith("Triangle 5 ")
    look.page.evaluate("document.getElementById('row').value = 99999999")
    look.page.evaluate("document.getElementById('goto').dispatchEvent(new Event('submit', {cancelable: true}))")
    assert look.details().startswith("Triangle 5 ")


def test_play_runs_to_the_end(look):
    look.page.click("#play")
    assert look.page.inner_text("#stage-name").startswith("0. ")
    look.page.wait_for_timeout(900)
    assert look.page.inner_text("#stage-name").startswith("1. ")
    look.page.click("#play")
    assert look.page.get_attribute("#play", "aria-pressed") == "false"


def test_on_a_phone_it_fits_and_answers_touch(browser, written):
    look = Look(browser, written, viewport={"width": 360, "height": 740}, device_scale_factor=3, is_mobile=True,
                has_touch=True)  # fmt: skip
    assert look.page.evaluate("document.documentElement.scrollWidth") <= 360
    assert not look.page.is_visible("#canvas-before")
    box = look.page.locator("#canvas").bounding_box()
    assert box["height"] >= 250
    look.page.locator("#canvas").scroll_into_view_if_needed()
    box = look.page.locator("#canvas").bounding_box()
    look.page.touchscreen.tap(box["x"] + 0.2 * box["width"], box["y"] + box["height"] / 2)
    assert look.details().startswith("Triangle ")
    for control in ("previous", "next", "in", "out", "fit", "worst"):
        size = look.page.locator(f"#{control}").bounding_box()
        assert min(size["width"], size["height"]) >= 28
    assert look.trouble == []
    look.context.close()


def test_fifty_thousand_triangles_in_a_browser(browser, tmp_path):
    """Small enough to send, painted whole, and read to the last triangle."""
    mesh = meshes.jittered(160, 160, 0.4)
    path = tmp_path / "large.html"
    report_page(path, [("before", mesh), ("after", meshes.grid(160, 160))])
    assert path.stat().st_size < 2_000_000
    look = Look(browser, path)
    look.rest()
    assert int(look.data("seen")) == len(mesh.triangles) == 51_200
    look.page.fill("#row", "51199")
    look.page.keyboard.press("Enter")
    assert look.details().startswith("Triangle 51199")
    assert look.trouble == []
    look.context.close()


def test_a_browser_that_is_too_old_says_so(browser, written):
    context = browser.new_context()
    context.add_init_script("delete globalThis.DecompressionStream")
    opened = context.new_page()
    opened.goto(written.as_uri())
    opened.wait_for_selector("html[data-state='failed']")
    assert "too old" in opened.inner_text("#trouble")
    assert opened.is_visible("table")
    context.close()
