"""The page of `report_page` in a browser: it does what it says, and asks for nothing."""

import re
from pathlib import Path

import meshes
import pytest
from browser import chromium
from pictured import embedded, recorded, two_faults

from torchmesh import MeshBatch, improve, quality, report_page


@pytest.fixture(scope="module")
def tangled() -> MeshBatch:
    return meshes.moved_hole()


@pytest.fixture(scope="module")
def written(tangled, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("page") / "page.html"
    report_page(path, *recorded(tangled), title="a hole </script> that moved")
    return path


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
        self.page.on("console", self.hear)
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())
        self.page.wait_for_selector("html[data-state]")

    def hear(self, message) -> None:
        """What the browser says, but for its advice on tests that read pixels."""
        if "willReadFrequently" not in message.text:
            self.trouble.append(message.text)

    def rest(self) -> None:
        """Wait until what was asked for is painted, edges included: they follow when nothing moves any more."""
        self.page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        self.page.wait_for_selector("html[data-moving='false']")

    def data(self, name: str) -> str:
        return self.page.evaluate(f"document.documentElement.dataset.{name}")

    def view(self) -> list[float]:
        self.rest()
        return [float(part) for part in self.data("view").split()]

    def details(self) -> str:
        return self.page.inner_text("#details")

    def vermilion(self, canvas: str = "canvas") -> int:
        """How many pixels of a canvas have a colour of inverted triangles: vermilion, or that of its stripes."""
        return self.pixels("#d55e00", canvas) + self.pixels("#7f3200", canvas)

    def pixels(self, colour: str, canvas: str = "canvas") -> int:
        """How many pixels of a canvas have this colour."""
        self.rest()
        return self.page.evaluate(
            """([id, colour]) => { const c = document.getElementById(id);
            const p = c.getContext("2d").getImageData(0, 0, c.width, c.height).data; let n = 0;
            const [r, g, b] = [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16));
            for (let i = 0; i < p.length; i += 4) n += p[i] === r && p[i + 1] === g && p[i + 2] === b;
            return n; }""",
            [canvas, colour],
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
    look.page.keyboard.down("Control")
    look.page.mouse.wheel(0, -300)
    look.page.keyboard.up("Control")
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


def test_play_steps_from_the_first_stage_on_until_it_is_stopped(look):
    look.page.evaluate(
        """() => { window.seen = []; const name = document.getElementById("stage-name");
        new MutationObserver(() => seen.push(name.textContent)).observe(name, { childList: true }); }"""
    )
    look.page.click("#play")
    look.page.wait_for_selector("#stage[aria-valuetext^='1. ']")
    look.page.click("#play")
    assert look.page.get_attribute("#play", "aria-pressed") == "false"
    assert [name[:3] for name in look.page.evaluate("seen")][:2] == ["0. ", "1. "]


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


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [390, 900, 1600])
def test_nothing_lies_beside_the_screen_in_both_schemes(browser, written, width, scheme):
    look = Look(browser, written, viewport={"width": width, "height": 900}, color_scheme=scheme)
    wide = "[...document.querySelectorAll('.table, #places, body')].every((e) => e.scrollWidth <= e.clientWidth + 1)"
    assert look.page.evaluate("document.documentElement.scrollWidth") <= width
    assert look.page.evaluate(wide)
    # Text stands out from the page: light on dark, or dark on light.
    ink, paper = (
        look.page.evaluate(f"getComputedStyle(document.documentElement).{what}")
        for what in ("color", "backgroundColor")
    )
    brightness = [sum(map(int, re.findall(r"\d+", colour)[:3])) for colour in (ink, paper)]
    assert (brightness[0] > brightness[1] + 350) == (scheme == "dark")
    assert abs(brightness[0] - brightness[1]) > 350
    corner = look.page.evaluate(
        "[...document.getElementById('canvas').getContext('2d').getImageData(2, 2, 1, 1).data].slice(0, 3)"
    )
    assert (sum(corner) < 150) == (scheme == "dark")
    assert look.trouble == []
    look.context.close()


def test_hovering_tells_row_and_quality(look):
    look.page.click("#worst")
    text = look.details()
    box = look.page.locator("#canvas").bounding_box()
    look.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    look.page.wait_for_selector("#tip:not([hidden])")
    row, ratio = re.match(r"Triangle (\d+) .*inverse mean ratio ([\d.]+)", text).groups()
    assert look.page.inner_text("#tip") == f"triangle {row}, IMR {ratio}"
    look.page.mouse.move(box["x"] + box["width"] / 2, box["y"] - 60)
    look.page.wait_for_selector("#tip[hidden]", state="attached")


def test_a_wheel_scrolls_the_page_past_the_picture(look):
    before = look.view()
    look.page.set_viewport_size({"width": 900, "height": 500})
    look.rest()
    before = look.view()
    look.page.locator("#canvas").scroll_into_view_if_needed()
    box = look.page.locator("#canvas").bounding_box()
    start = look.page.evaluate("scrollY")
    look.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    look.page.mouse.wheel(0, 200)
    for _ in range(40):
        if look.page.evaluate("scrollY") > start + 100:
            break
        look.page.wait_for_timeout(50)
    assert look.page.evaluate("scrollY") > start + 100
    assert look.view() == before


def test_two_fingers_scroll_the_page_and_a_pinch_zooms(browser, written):
    look = Look(browser, written, viewport={"width": 390, "height": 600}, is_mobile=True, has_touch=True)
    look.page.locator("#canvas").scroll_into_view_if_needed()
    box = look.page.locator("#canvas").bounding_box()
    session = look.context.new_cdp_session(look.page)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        places = [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(points)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": places})

    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    before, start = look.view(), look.page.evaluate("scrollY")
    touch("touchStart", (x - 40, y), (x + 40, y))
    for k in range(1, 11):
        touch("touchMove", (x - 40, y - 10 * k), (x + 40, y - 10 * k))
    touch("touchEnd")
    assert look.page.evaluate("scrollY") > start + 50
    assert look.view() == before
    box = look.page.locator("#canvas").bounding_box()
    y = box["y"] + box["height"] / 2
    touch("touchStart", (x - 30, y), (x + 30, y))
    for k in range(1, 11):
        touch("touchMove", (x - 30 - 8 * k, y), (x + 30 + 8 * k, y))
    touch("touchEnd")
    assert look.view()[2] > 1.3 * before[2]
    look.context.close()


def test_inverted_triangles_are_hatched(look):
    """In grey they are told by stripes: vermilion and dark, which no upright triangle has."""
    look.page.focus("#stage")
    look.page.keyboard.press("Home")
    look.page.click("#worst")
    look.rest()
    stripes, between = look.pixels("#7f3200"), look.pixels("#d55e00")
    assert stripes > 0.2 * between > 20
    assert between > 0.2 * stripes > 20


def test_places_that_are_left_are_gone_to(browser, tmp_path):
    mesh = two_faults()
    report_page(tmp_path / "left.html", [("before", mesh), ("after", mesh)])
    look = Look(browser, tmp_path / "left.html")
    whole = look.view()
    look.page.click("button[data-place='1']")
    near = look.view()
    assert near[2] > 1.5 * whole[2]
    look.page.click("button[data-place='0']")
    assert look.view()[:2] != near[:2]
    assert look.trouble == []
    look.context.close()


def test_interfaces_are_drawn_otherwise_than_edges(browser, tmp_path):
    mesh = meshes.dragged_interface()
    assert len(mesh.constrained_edges)
    bare = MeshBatch.from_arrays(mesh.points, mesh.triangles)
    pale = []
    for name, one in (("with", mesh), ("without", bare)):
        report_page(tmp_path / f"{name}.html", [("mesh", one)])
        look = Look(browser, tmp_path / f"{name}.html")
        look.rest()
        pale.append(
            look.page.evaluate(
                """() => { const c = document.getElementById("canvas");
            const p = c.getContext("2d").getImageData(0, 0, c.width, c.height).data; let n = 0;
            for (let i = 0; i < p.length; i += 4) n += p[i] < 40 && p[i + 1] < 40 && p[i + 2] < 40;
            return n; }"""
            )
        )
        look.context.close()
    assert pale[0] > pale[1] + 100
