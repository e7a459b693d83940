"""The page in a real browser, steered by pointer, keys and touch."""

import base64
import io
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from test_datasets_markups import markup, point, save

from needlefit.viewer.recording import read_recording, replay

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FOUND = next((path for name in BROWSERS if (path := shutil.which(name))), None)
pytestmark = pytest.mark.skipif(
    FOUND is None, reason=f"no browser is installed (none of {', '.join(BROWSERS)})"
)

PATIENCE = 15.0


class Server:
    """`needlefit view` in a process of its own."""

    def __init__(self, out, subject: str = "twin/phantom2-05") -> None:
        command = [sys.executable, "-m", "needlefit", "view", subject, "--no-browser", "--out", str(out)]
        self.folder = out / "view"
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.address = self.process.stdout.readline().strip()

    def end(self, how: int = signal.SIGTERM) -> None:
        self.process.send_signal(how)
        self.process.wait(20)
        self.process.stdout.close()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    running = Server(tmp_path_factory.mktemp("view"))
    yield running
    running.end()


@pytest.fixture(scope="module")
def chromium():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=FOUND, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@pytest.fixture
def page(server, chromium):
    """A window of its own, with a new needle."""
    with opened(chromium, server) as window:
        yield window


@contextmanager
def opened(chromium, server, **settings):
    """Yield a page in a context of its own; a fault of its scripts fails the test."""
    # a page that is asked for less motion begins at first contact
    begun = {"viewport": {"width": 1280, "height": 800}, "reduced_motion": "reduce"}
    context = chromium.new_context(**(begun | settings))
    page, faults = context.new_page(), []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(server.address)
    until(page, "state => state && window.needlefit.connected")
    page.click("[data-fit=whole]")  # the base too
    yield page
    context.close()
    assert faults == []


def until(page, true: str, seconds: float = PATIENCE):
    """Wait until a function of the page's state holds, and return the state."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if page.evaluate(f"({true})(window.needlefit?.state)"):
            return page.evaluate("window.needlefit.state")
        page.wait_for_timeout(20)
    raise AssertionError(f"never: {true}; {page.evaluate('window.needlefit.state')}")


def go_to(page, depth: float):
    page.fill("#speed", "1000")
    page.fill("#goto-depth", str(depth))
    page.press("#goto-depth", "Enter")
    return until(page, f"state => Math.abs(state.depth_mm - {depth}) < 1e-6 && !state.moving")


def enter(field, text: str) -> None:
    """Type into a field and press Enter; what the page wrote between selecting and typing is typed over."""
    deadline = time.monotonic() + PATIENCE
    field.fill(text)
    while field.input_value() != text and time.monotonic() < deadline:
        field.fill(text)
    field.press("Enter")


def place(page, what: str) -> tuple[float, float]:
    """Return where something of the state stands in the window, pixels."""
    script = """async (what) => {
        const { toPx, toPy } = await import("/page/view.js");
        const box = document.getElementById("canvas").getBoundingClientRect();
        const { bevelPlace } = await import("/page/handles.js");
        const { state } = window.needlefit;
        if (what === "arrow") return bevelPlace(state).turn.map((one, i) => one + [box.left, box.top][i]);
        const at = state[what] ?? state.guides[0];
        return [box.left + toPx(at.x), box.top + toPy(at.y)];
    }"""
    return tuple(page.evaluate(script, what))


def settle(page):
    """Wait until the state stays the same for half a second, and return it."""
    end, state = time.monotonic() + PATIENCE, None
    while time.monotonic() < end:
        before, state = state, page.evaluate("window.needlefit.state")
        if state == before:
            return state
        page.wait_for_timeout(500)
    raise AssertionError(f"never the same: {state}")


def drag(page, what: str, dx: float, dy: float) -> None:
    x, y = place(page, what)
    page.mouse.move(x, y)
    page.mouse.down()
    for n in range(1, 6):
        page.mouse.move(x + dx * n / 5, y + dy * n / 5)
    page.mouse.up()


def shown(page, text: str) -> None:
    """Wait until something that is seen says so."""
    page.get_by_text(text).first.wait_for(state="visible", timeout=1000 * PATIENCE)


def test_the_needle_goes_in_and_out_by_button_key_and_wheel(page) -> None:
    assert until(page, "state => true")["depth_mm"] == 0
    page.locator("#insert").hover()
    page.mouse.down()
    until(page, "state => state.depth_mm > 2")
    page.mouse.up()
    state = until(page, "state => !state.moving")
    page.focus("#canvas")
    page.keyboard.down("ArrowRight")
    state = until(page, f"state => state.depth_mm > {state['depth_mm'] + 2}")
    page.keyboard.up("ArrowRight")
    deep = until(page, "state => !state.moving")["depth_mm"]
    page.mouse.move(*place(page, "tip"))
    page.mouse.wheel(0, -100)
    wheeled = until(page, f"state => Math.abs(state.depth_mm - {deep}) > 0.5")["depth_mm"]
    page.keyboard.down("ArrowLeft")
    until(page, f"state => state.depth_mm < {wheeled - 1}")
    page.keyboard.up("ArrowLeft")
    until(page, "state => !state.moving")


@pytest.mark.sweep
def test_the_base_is_dragged_in_millimetres_and_one_undo_takes_it_back(page) -> None:
    go_to(page, 30)
    scale = page.evaluate("import('/page/view.js').then(({ view }) => view.scale)")
    drag(page, "base", 0, -5 * scale)
    state = until(page, "state => state.base.y > 4")
    assert state["base"]["y"] == pytest.approx(5, abs=1.5 / scale)
    assert state["y"][0] == pytest.approx(state["base"]["y"])
    page.keyboard.press("Control+z")
    until(page, "state => state.base.y === 0 && state.depth_mm === 30")
    page.keyboard.press("Control+y")
    until(page, f"state => state.base.y === {state['base']['y']}")


@pytest.mark.sweep
def test_the_bevel_turns_over_and_the_needle_with_it(page) -> None:
    side = go_to(page, 20)["bevel"]["side"]
    before = go_to(page, 25)["tip"]["rotation"]
    page.focus("#canvas")
    page.keyboard.press("f")
    assert until(page, f"state => state.bevel.side === {-side}")["tip"]["rotation"] == before
    after = go_to(page, 30)
    assert side * (after["tip"]["rotation"] - before) < 0


@pytest.mark.sweep
def test_a_guide_is_added_dragged_and_taken_away(page) -> None:
    go_to(page, 20)
    page.click("#add-guide")
    guide = until(page, "state => state.guides.length === 1")["guides"][0]
    drag(page, "guide", 0, -20)
    moved = until(page, "state => state.guides[0].y > 0.5")
    assert moved["guides"][0]["x"] == pytest.approx(guide["x"], abs=1)
    at = np.interp(moved["guides"][0]["x"], moved["x"], moved["y"])
    assert at == pytest.approx(moved["guides"][0]["y"], abs=0.02)
    page.get_by_role("button", name=re.compile("turns freely")).click()
    until(page, f"state => state.guides[0].turns_freely === {str(not guide['turns_freely']).lower()}")
    page.get_by_role("button", name=re.compile("[Rr]emove")).click()
    until(page, "state => state.guides.length === 0")


@pytest.mark.sweep
def test_the_errors_are_those_of_the_study_at_the_measured_depth(page) -> None:
    """And follow the sliders, which tell the whole insertion again."""
    page.fill("#speed", "1000")
    page.click("#goto-scene")
    state = until(page, "state => state.errors?.whole")
    measured = page.evaluate("window.needlefit.scene.measured")
    tip = np.array([state["tip"]["x"] - measured["x"][-1], state["tip"]["y"] - measured["y"][-1]])
    assert state["errors"]["te_mm"] == pytest.approx(np.linalg.norm(tip), abs=1e-3)
    shown(page, f"{state['errors']['te_mm']:.2f}")
    field = page.locator("#bevel-fields").get_by_label(re.compile("throughout")).first
    enter(field, "0.01")
    after = until(page, "state => state.bevel.offset_mm === 0.01")
    assert after["errors"]["te_mm"] != state["errors"]["te_mm"] and after["depth_mm"] == state["depth_mm"]


@pytest.mark.sweep
def test_a_replay_in_the_page_ends_with_the_same_needle(page) -> None:
    go_to(page, 12)
    drag(page, "base", 0, -20)
    state = go_to(page, 18)
    recording = page.evaluate("window.needlefit.scene.recording")
    page.select_option("#times", "5")
    page.click("#replay")
    until(page, f"() => window.needlefit.scene.recording !== '{recording}'")  # it may be over at once
    again = until(page, "state => !state.playing && state.depth_mm === 18")
    assert again["y"] == state["y"] and again["step"] == state["step"]


@pytest.mark.sweep
def test_a_refused_input_is_announced_and_nothing_moves(page) -> None:
    go_to(page, 20)
    page.fill("#goto-depth", "200")
    page.press("#goto-depth", "Enter")
    page.fill("#goto-depth", "20")
    page.press("#goto-depth", "Enter")
    until(page, "state => !state.moving")
    field = page.locator("#tissue-fields .number").first
    enter(field, "-5")
    page.locator("[role=alert]:not([hidden])", has_text=re.compile("mu|above 0")).first.wait_for()
    assert page.evaluate("window.needlefit.state.layers[0].mu_pa") > 0
    assert "-5 MPa" in page.inner_text("#refusal")
    page.wait_for_function("one => one.value !== '-5'", arg=field.element_handle())  # what is stands there
    enter(field, "0.4")  # what is right ends the message
    until(page, "state => Math.abs(state.layers[0].mu_pa - 4e5) < 1")
    assert page.inner_text("#refusal") == ""
    angle = page.locator("#base-fields .number").nth(1)
    enter(angle, "-1e9")
    page.locator("#refusal strong", has_text=re.compile("-90.0°")).wait_for()
    enter(angle, "0.5")
    until(page, "state => Math.abs(state.base.input_slope - 0.008727) < 1e-5")
    angle.press("Control+z")
    until(page, "state => state.base.input_slope === 0")
    page.locator("#refusal strong").wait_for(state="hidden")
    enter(angle, "-1e9")
    page.locator("#refusal strong").wait_for()
    page.click("#reset")
    until(page, "state => state.depth_mm === 0")
    page.locator("#refusal strong").wait_for(state="hidden")


@pytest.mark.sweep
def test_the_keys_of_the_page_work_wherever_they_are_not_needed(page) -> None:
    """A slider keeps its arrows, a number all that is typed; the rest is the page's."""
    side = go_to(page, 20)["bevel"]["side"]
    slider = page.locator("#base-fields .slider").first
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert until(page, "state => state.base.input_y !== 0")["depth_mm"] == 20
    page.keyboard.press("f")
    until(page, f"state => state.bevel.side === {-side}")
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    until(page, f"state => state.bevel.side === {side} && state.base.input_y === 0")
    page.fill("#speed", "")
    page.press("#speed", "Tab")
    shown(page, "1000 is kept")
    assert page.input_value("#speed") == "1000"


@pytest.mark.sweep
def test_keys_add_to_the_very_value_also_beyond_the_slider(page) -> None:
    held = go_to(page, 20)["tip"]["lateral_mm"]
    field = page.locator("#bevel-fields .number").first
    enter(field, "5")
    until(page, "state => state.bevel.offset_mm === 5")
    field.press("ArrowUp")
    page.focus("#canvas")
    page.keyboard.press("]")
    until(page, "state => Math.abs(state.bevel.offset_mm - 5.01) < 1e-9")
    page.keyboard.press("t")
    tip = until(page, "state => state.tip.held")["tip"]
    assert tip["lateral_mm"] == pytest.approx(held, abs=1e-12)


@pytest.mark.sweep
def test_of_two_arrow_keys_the_newest_counts_then_the_one_still_pressed(page) -> None:
    page.focus("#canvas")
    page.keyboard.down("ArrowRight")
    until(page, "state => state.depth_mm > 2 && state.moving > 0")
    page.keyboard.down("ArrowLeft")
    until(page, "state => state.moving < 0")
    page.keyboard.up("ArrowLeft")
    until(page, "state => state.moving > 0")
    page.keyboard.up("ArrowRight")
    until(page, "state => !state.moving")


@pytest.mark.sweep
def test_a_pasted_address_connects_and_a_missing_needle_is_reported(page) -> None:
    go_to(page, 5)
    address = page.url
    page.evaluate("location.hash = 'token=another'")
    shown(page, "token")
    page.evaluate("sessionStorage.setItem('needlefit.needle', 'gone')")
    page.goto(address)  # the hash alone differs: nothing is loaded
    shown(page, "new needle")
    until(page, "state => window.needlefit.connected && state.depth_mm === 0")


@pytest.mark.sweep
def test_band_validity_and_pause_messages_are_shown(page) -> None:
    go_to(page, 20)
    tell = """message => import('/page/store.js').then(({ now, take }) => {
        take(message.kind === 'state' ? { ...now.state, ...message } : message);
    })"""
    for edge in ([0.0, 1.0], []):  # and of no band none is left
        page.evaluate(tell, {"kind": "band", "step": 1, "x": edge, "low": edge, "high": edge})
        assert page.evaluate("window.needlefit.band !== null") is bool(edge)
    page.evaluate(
        tell, {"kind": "state", "max_slope": 0.4, "faults": ["slope 0.4 (limit 0.3)"], "paused": True}
    )
    shown(page, "slope 0.4 (limit 0.3)")
    shown(page, "Go on")
    assert "slope 0.4" in page.locator("#announced").text_content()


@pytest.mark.sweep
def test_a_disconnected_page_shows_it_and_reconnects_to_its_needle(server, chromium) -> None:
    context = chromium.new_context(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
    window = context.new_page()
    window.goto(server.address)
    until(window, "state => state && window.needlefit.connected")
    state = go_to(window, 15)
    window.evaluate(
        "window.lost = 0; import('/page/store.js').then(({ listen }) => "
        "listen('line', ({ open, why }) => open || (window.lost += why === 'lost')))"
    )
    window.evaluate(  # a message that is too long: the server hangs up
        "import('/page/connection.js').then(({ send }) => send({ do: 'x'.repeat(20000) }))"
    )
    until(window, "() => window.lost === 1")
    back = until(window, "state => window.needlefit.connected && state.depth_mm === 15")
    assert back["y"] == state["y"] and back["undo"]
    window.reload()
    assert until(window, "state => window.needlefit?.connected && state?.depth_mm === 15")["y"] == state["y"]
    assert window.get_attribute("[data-fit=tissue]", "aria-pressed") == "true"  # beside a measured needle
    context.close()


@pytest.mark.sweep
def test_a_killed_server_loses_no_step(tmp_path, chromium) -> None:
    server = Server(tmp_path, "study2")
    with opened(chromium, server) as page:
        state = go_to(page, 17)
        drag(page, "base", 0, -20)
        state = until(page, "state => state.base.y > 0.1")
        page.wait_for_timeout(200)
        state = page.evaluate("window.needlefit.state")
        server.end(signal.SIGKILL)
        shown(page, "Not connected")
    (path,) = server.folder.glob("*.csv")
    *_, last = replay(read_recording(path))
    assert last.recorded.number == state["step"] and last.tip_offset_mm == 0
    assert last.state.shape.tip_lateral == state["tip"]["lateral_mm"]


@pytest.mark.sweep
def test_two_windows_do_not_touch_each_other(page, server, chromium) -> None:
    with opened(chromium, server) as other:
        go_to(page, 10)
        go_to(other, 25)
        assert page.evaluate("window.needlefit.state.depth_mm") == 10
        names = [one.evaluate("window.needlefit.scene.recording") for one in (page, other)]
        assert names[0] != names[1]


@pytest.mark.sweep
def test_touch_drags_the_base(server, chromium) -> None:
    with opened(chromium, server, has_touch=True) as page:
        touch = page.context.new_cdp_session(page)
        x, y = place(page, "base")
        for n, kind in enumerate(("touchStart", "touchMove", "touchMove", "touchEnd")):
            points = [] if kind == "touchEnd" else [{"x": x, "y": y - 10 * n}]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        assert until(page, "state => state.base.y > 0.5")["step"] >= 1


@pytest.mark.sweep
def test_everything_that_can_be_used_has_a_name_and_a_place_in_the_order(page) -> None:
    page.click("#add-guide")
    until(page, "state => state.guides.length === 1")
    page.wait_for_timeout(300)
    tree = page.context.new_cdp_session(page).send("Accessibility.getFullAXTree")["nodes"]
    roles = {"button", "slider", "spinbutton", "textbox", "combobox", "application", "checkbox"}
    used = [node for node in tree if not node["ignored"] and node["role"]["value"] in roles]
    assert len(used) > 30
    assert [node for node in used if not node.get("name", {}).get("value", "").strip()] == []
    page.locator("body").click(position={"x": 2, "y": 2})
    reached = []
    for _ in range(12):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("[...document.querySelectorAll('*')].indexOf(document.activeElement)"))
    assert reached == sorted(reached) and len(set(reached)) == len(reached)


@pytest.mark.sweep
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_text_stands_out_in_both_colour_schemes(server, chromium, scheme: str) -> None:
    """Contrast of at least 4.5 to 1 (WCAG AA) of every text against what lies behind it."""
    with opened(chromium, server, color_scheme=scheme) as page:
        page.wait_for_timeout(300)
        rows = page.evaluate(CONTRASTS)
        assert len(rows) > 30
        assert [row for row in rows if row[1] < 4.5] == []
        dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert (sum(map(int, re.findall(r"\d+", dark)[:3])) < 200) == (scheme == "dark")


CONTRASTS = """() => {
    const luminance = (rgb) => {
        const [r, g, b] = rgb.map((c) => c / 255);
        const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
        return 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
    };
    const numbers = (text) => text.match(/[\\d.]+/g).map(Number);
    const behind = (element) => {
        for (let one = element; one; one = one.parentElement) {
            const colour = numbers(getComputedStyle(one).backgroundColor);
            if (colour.length === 3 || colour[3] === 1) return colour.slice(0, 3);
        }
        return [255, 255, 255];
    };
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    const rows = [];
    while (walker.nextNode()) {
        const element = walker.currentNode.parentElement;
        const text = walker.currentNode.textContent.trim();
        if (!text || !element.checkVisibility()) continue;
        if (element.closest(".unseen, .skip, :disabled, dialog, canvas")) continue;
        const colour = numbers(getComputedStyle(element).color).slice(0, 3);
        const [one, other] = [colour, behind(element)].map(luminance);
        rows.push([text, (Math.max(one, other) + 0.05) / (Math.min(one, other) + 0.05)]);
    }
    return rows;
}"""


@pytest.mark.sweep
def test_at_200_percent_nothing_is_cut_off(server, chromium) -> None:
    """A window of 1280 x 800 zoomed to 200 % has 640 x 400 pixels of the page's own."""
    settings = {"viewport": {"width": 640, "height": 400}, "device_scale_factor": 2}
    with opened(chromium, server, **settings) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 640
        for name in ("Insert", "Retract", "Flip bevel", "Undo", "Play scene", "Replay recording"):
            button = page.get_by_role("button", name=re.compile(name)).first
            button.scroll_into_view_if_needed()
            box = button.bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= 640, name
            picture = page.locator("#canvas").bounding_box()
            assert picture["y"] + picture["height"] > 100, f"the picture is out of sight at {name}"
        assert picture["width"] > 500 and picture["height"] > 150
        field = page.locator("#tissue-fields .number").nth(2)
        enter(field, "-5")
        message = page.locator("#refusal strong")
        message.wait_for()
        box, typed = message.bounding_box(), field.bounding_box()
        assert box["y"] >= 0 and box["y"] + box["height"] <= min(400, typed["y"])


@pytest.mark.sweep
def test_an_export_is_a_file(page) -> None:
    go_to(page, 10)
    with page.expect_download() as download:
        page.get_by_role("button", name=re.compile(r"inputs|recording.*csv", re.I)).first.click()
    path = download.value.path()
    *_, last = replay(read_recording(path))
    assert last.state.step.depth == 10


@pytest.mark.sweep
def test_the_saved_picture_is_the_one_shown(page) -> None:
    go_to(page, 20)
    settle(page)
    with page.expect_download() as download:
        page.get_by_role("button", name="picture, PNG").click()
    saved = matplotlib.image.imread(download.value.path())
    behind, before = (
        matplotlib.image.imread(io.BytesIO(base64.b64decode(data.partition(",")[2])))
        for data in page.evaluate(
            "['background', 'canvas'].map((id) => document.getElementById(id).toDataURL())"
        )
    )
    assert saved.shape == behind.shape
    share = before[..., 3:]
    np.testing.assert_allclose(
        saved[..., :3], before[..., :3] * share + behind[..., :3] * (1 - share), atol=0.02
    )


@pytest.mark.sweep
def test_a_new_page_shows_an_insertion_and_keeps_its_tip_in_sight(server, chromium) -> None:
    with opened(chromium, server, reduced_motion="no-preference") as window:
        page = window
        state = until(page, "state => state.depth_mm > 5 && !state.moving")
        depth = page.evaluate("window.needlefit.scene.measured.depth_mm")
        assert state["depth_mm"] == pytest.approx(0.6 * depth, abs=0.01)
        page.click("[data-fit=tissue]")
        sees = "import('/page/view.js').then(({ seesTip, view }) => [seesTip(), view.magnified])"
        assert page.evaluate(sees)[0] and page.evaluate(sees)[1] > 1
        drag(page, "tip", 0, -250)
        page.wait_for_timeout(300)
        assert page.evaluate(sees)[0]
        page.click("[data-show=true]")
        assert page.evaluate(sees)[1] == 1


@pytest.mark.sweep
def test_after_a_shift_one_button_on_the_picture_comes_back(page) -> None:
    page.click("[data-fit=tissue]")
    assert not page.is_visible("#refit")
    box = page.locator("#canvas").bounding_box()
    at = (box["x"] + 0.3 * box["width"], box["y"] + 0.2 * box["height"])
    page.mouse.move(*at)
    page.mouse.down()
    page.mouse.move(at[0] + 80, at[1] + 40, steps=4)
    page.mouse.up()
    page.click("#refit")
    assert page.evaluate("import('/page/view.js').then(({ view }) => view.fit)") == "tissue"
    assert not page.is_visible("#refit")


@pytest.mark.sweep
def test_until_it_is_drawn_the_picture_is_not_black(server, chromium) -> None:
    context = chromium.new_context()
    page = context.new_page()
    page.route("**/page/main.js", lambda route: route.abort())  # nothing is ever drawn
    page.goto(server.address)
    assert page.locator("#waiting").is_visible() and not page.locator("#background").is_visible()
    context.close()


@pytest.mark.sweep
def test_a_readout_is_defined_on_hover_and_focus(page) -> None:
    until(page, "state => true")
    page.hover("#readouts .term >> nth=1")
    shown(page, "Distance of the tip from the entry axis")
    page.mouse.move(5, 5)
    page.locator("#definition").wait_for(state="hidden")
    page.focus("#errors .term >> nth=0")
    assert page.inner_text("#definition") == page.evaluate("window.needlefit.scene.measured.metrics[0][3]")


@pytest.mark.sweep
def test_a_target_is_put_by_a_click_planned_for_and_reached(page) -> None:
    go_to(page, 5)
    page.click("[data-fit=tissue]")
    page.click("#put-target")
    script = """async () => {
        const { toPx, toPy } = await import("/page/view.js");
        const box = document.getElementById("canvas").getBoundingClientRect();
        return [box.left + toPx(35), box.top + toPy(0.6)];
    }"""
    page.mouse.click(*page.evaluate(script))
    until(page, "() => window.needlefit.aim.target && window.needlefit.aim.reach")
    assert page.evaluate("window.needlefit.aim.target") == pytest.approx([35, 0.6], abs=0.2)
    page.click("#make-plan")
    until(page, "() => window.needlefit.aim.plan", 60)
    page.click("#step-plan")
    first = until(page, "state => state.depth_mm > 5.5 && !state.playing")["depth_mm"]
    assert first == pytest.approx(page.evaluate("window.needlefit.aim.plan.steps[0][0]"))
    page.click("#run-plan")
    end = until(page, "state => state.depth_mm > 30 && !state.playing")
    miss = page.evaluate("import('/page/aim.js').then(({ tipError }) => tipError(window.needlefit.state))")
    planned = page.evaluate("window.needlefit.aim.plan.nominal_miss_mm")
    assert miss == pytest.approx(planned, abs=1e-3) and miss < 0.2
    assert page.evaluate("window.needlefit.aim.plan.left") is False
    page.keyboard.press("f")  # a hand leaves the plan
    until(page, "() => window.needlefit.aim.plan.left")
    page.click("#make-plan")  # behind the tip: refused
    shown(page, "the target lies at a depth")
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+z")
    until(page, f"state => state.depth_mm < {end['depth_mm'] - 1}")


GOAL = "goal => import('/page/aim.js').then(({ setAim }) => setAim(goal))"


@pytest.mark.sweep
def test_a_goal_can_be_undone_and_one_that_is_refused_is_taken_back(page) -> None:
    go_to(page, 5)
    page.evaluate(GOAL, {"target": [35, 0.5]})
    until(page, "() => window.needlefit.aim.reach")
    page.wait_for_timeout(1100)  # changes that follow sooner are undone together
    radius = page.locator("#target-fields .number").nth(2)
    enter(radius, "1.5")
    until(page, "() => window.needlefit.aim.radius === 1.5")
    radius.press("Control+z")
    until(page, "() => window.needlefit.aim.radius === 2")
    assert page.evaluate("window.needlefit.state.depth_mm") == 5
    page.keyboard.press("Control+y")
    until(page, "() => window.needlefit.aim.radius === 1.5")
    x = page.locator("#target-fields .number").first
    enter(x, "1e300")
    page.locator("#refusal strong").wait_for()
    until(page, "() => window.needlefit.aim.target[0] === 35")
    assert float(x.input_value()) == 35


@pytest.mark.sweep
def test_a_goal_that_changes_ends_the_search_for_a_plan(page) -> None:
    go_to(page, 5)
    page.evaluate(GOAL, {"target": [40, 0.5]})
    page.click("#make-plan")
    page.evaluate(GOAL, {"target": [41, 0.5]})
    until(page, "() => !document.getElementById('make-plan').disabled")
    assert page.evaluate("[window.needlefit.aim.planning, window.needlefit.aim.plan]") == [False, None]


@pytest.mark.sweep
def test_a_plan_that_shifts_the_entry_begins_there(page) -> None:
    page.fill("#speed", "1000")
    go_to(page, 20)
    page.evaluate(GOAL, {"target": [35, 5], "radius": 1})
    page.fill("#plan-entry", "6")
    page.click("#make-plan")
    plan = "window.needlefit.aim.plan"
    until(page, f"() => {plan}?.anew", 60)
    entry, miss = page.evaluate(f"[{plan}.entry_mm, {plan}.nominal_miss_mm]")
    assert 1 < entry <= 6.001 and miss < 0.1
    page.click("#run-plan")
    until(page, "state => state.depth_mm > 30 && !state.playing && window.needlefit.aim.target", 30)
    assert page.evaluate("window.needlefit.aim.target[1]") == pytest.approx(5 - entry)
    error = page.evaluate("import('/page/aim.js').then(({ tipError }) => tipError(window.needlefit.state))")
    assert error == pytest.approx(miss, abs=1e-3)
    assert page.evaluate("window.needlefit.scene.measured") is None
    assert page.input_value("#plan-entry") == "0"


@pytest.mark.sweep
def test_a_plan_that_fails_names_what_it_touches(page) -> None:
    go_to(page, 20)
    page.evaluate(GOAL, {"target": [40, -1], "obstacles": [[30, -0.6, 3, "bone"]]})
    page.click("#make-plan")
    plan = "window.needlefit.aim.plan"
    until(page, f"() => {plan}", 60)
    assert page.evaluate(f"[{plan}.hits, {plan}.touched.bone]") == [0, 1]
    assert "bone" in page.inner_text("#plan-note")


@pytest.mark.sweep
def test_by_keyboard_a_target_is_put_ahead_of_the_tip(page) -> None:
    go_to(page, 5)
    page.focus("#put-target")
    page.keyboard.press("Enter")
    until(page, "state => window.needlefit.aim.target?.[0] > state.depth_mm + 5")
    assert page.evaluate("document.activeElement.closest('#target-fields') !== null")
    page.click("#put-obstacle")
    page.keyboard.press("Escape")
    assert page.evaluate("[window.needlefit.aim.placing, window.needlefit.aim.obstacles.length]") == [None, 0]


@pytest.mark.sweep
def test_a_hand_is_compared_with_the_planner(page) -> None:
    page.fill("#speed", "1000")
    page.click("#challenge")
    until(page, "() => window.needlefit.aim.target && window.needlefit.aim.plan", 60)
    depth = page.evaluate("window.needlefit.aim.target[0]")
    go_to(page, round(depth, 2))
    page.click("#challenge")
    found = page.evaluate("window.needlefit.aim.challenge")
    assert found["hand"] >= 0 and (found["planner"] is None or found["planner"] < 3.0)
    shown(page, "You touch" if found["touched"] else f"You {found['hand']:.2f} mm")
    ((x, y, radius, _),) = page.evaluate("window.needlefit.aim.obstacles")
    assert 0.4 * depth - 1e-6 <= x <= 0.6 * depth + 1e-6
    state = page.evaluate("window.needlefit.state")
    along = np.linspace(-5, depth, 20_000)
    clearance = np.hypot(along - x, np.interp(along, state["x"], state["y"]) - y).min()
    assert found["touched"] == (clearance < radius)
    page.evaluate(f"import('/page/aim.js').then(({{ moveTo }}) => moveTo(0, {x}, {y + 5}))")
    until(page, "() => window.needlefit.aim.challenge === null")  # changed by hand: it is over


@pytest.mark.sweep
def test_markups_are_target_and_obstacles(page, tmp_path) -> None:
    """They lie in the scan's coordinates: of this needle its placement says where."""
    from needlefit.geometry.frames import Placement
    from needlefit.viewer.opening import open_target

    until(page, "state => state")
    placement = Placement.from_record(open_target("twin/phantom2-05").placement)
    points = placement.to_patient([[35.0, 1.0], [20.0, -2.0]]).tolist()
    path = save(
        tmp_path / "a.mrk.json",
        markup(points=[point(1, points[0], label="target"), point(2, points[1], label="vessel")]),
    )
    page.set_input_files("#markups", str(path))
    until(page, "() => window.needlefit.aim.target && window.needlefit.aim.obstacles.length === 1")
    aim = page.evaluate("[window.needlefit.aim.target, window.needlefit.aim.obstacles[0].slice(0, 2)]")
    assert np.array(aim) == pytest.approx(np.array([[35.0, 1.0], [20.0, -2.0]]), abs=1e-6)
    assert page.evaluate("window.needlefit.aim.obstacles[0][3]") == "vessel"
    page.get_by_role("button", name="Remove vessel").click()
    until(page, "() => window.needlefit.aim.obstacles.length === 0")


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.sweep)])
def test_axe_finds_no_violation(server, chromium, scheme: str) -> None:
    package = pytest.importorskip("axe_playwright_python")
    script = (Path(package.__file__).parent / "axe.min.js").read_text("utf-8")
    with opened(chromium, server, color_scheme=scheme) as page:
        page.click("#add-guide")
        page.evaluate(AIM)
        until(page, "state => state.guides.length === 1 && window.needlefit.aim.obstacles.length")
        page.evaluate("import('/page/tour.js').then(({ offer }) => offer())")
        page.wait_for_timeout(400)
        page.evaluate(script)
        found = page.evaluate("axe.run()")["violations"]
        page.click("#help")
        found += page.evaluate("axe.run('dialog')")["violations"]
    assert [(one["id"], [node["html"][:120] for node in one["nodes"]]) for one in found] == []


@pytest.mark.sweep
def test_fields_have_definitions_inside_the_window(page) -> None:
    terms = page.locator(".field .term")
    assert terms.count() >= 14  # b twice, mu and alpha of four layers, base, tip
    for n in (0, 2, 3):
        terms.nth(n).hover()
        page.locator("#definition").wait_for(state="visible")
        box = page.locator("#definition").bounding_box()
        assert box["y"] >= 0 and box["x"] + box["width"] <= 1280
        number = page.locator(".field .number").nth(n)
        assert number.get_attribute("aria-description") == page.inner_text("#definition") != ""


@pytest.mark.sweep
@pytest.mark.parametrize("size", [(390, 844), (844, 390), (1280, 800)])
def test_the_tour_covers_neither_the_picture_nor_what_it_asks_for(server, chromium, size) -> None:
    width, height = size
    with opened(chromium, server, viewport={"width": width, "height": height}, has_touch=True) as page:
        page.evaluate("import('/page/tour.js').then(({ offer }) => offer())")
        for _ in range(3):
            boxes = [page.locator(f"#{name}").bounding_box() for name in ("tour", "canvas", "flip", "insert")]
            for box in boxes:
                assert box["x"] >= 0 and box["x"] + box["width"] <= width
                assert box["y"] >= 0 and box["y"] + box["height"] <= height
            tour, *others = boxes
            for box in others:
                below, above = tour["y"] + tour["height"] <= box["y"], tour["y"] >= box["y"] + box["height"]
                assert below or above
            page.click("#tour-skip")


AIM = "import('/page/aim.js').then(({ setAim }) => setAim({ target: [40, 1], obstacles: [[20, 3, 1]] }))"


@pytest.mark.sweep
def test_everything_that_can_be_pressed_measures_24_pixels(page) -> None:
    page.click("#add-guide")
    page.evaluate(AIM)
    until(page, "state => state.guides.length === 1 && window.needlefit.aim.obstacles.length")
    page.wait_for_timeout(400)
    sizes = page.evaluate(
        """[...document.querySelectorAll("button, input, select")].filter((one) => one.checkVisibility())
        .map((one) => [one.id || one.className || one.textContent, one.getBoundingClientRect()])
        .map(([name, { width, height }]) => [name, width, height]).filter(([, width]) => width > 0)"""
    )
    assert len(sizes) > 40
    assert [one for one in sizes if min(one[1:]) < 24] == []


@pytest.mark.sweep
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_band_and_gaps_stand_out_from_every_layer(server, chromium, scheme: str) -> None:
    """Contrast of at least 3 to 1 (WCAG, graphical objects)."""

    def luminance(colour: str) -> float:
        parts = np.array([int(colour[n : n + 2], 16) / 255 for n in (1, 3, 5)])
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    with opened(chromium, server, color_scheme=scheme) as page:
        colours = page.evaluate("import('/page/painters/strokes.js').then(({ palette }) => ({ ...palette }))")
    for drawn in ("band", "gap", "plan", "bad"):
        for behind in ("soft", "stiff"):
            low, high = sorted(luminance(colours[name]) for name in (drawn, behind))
            assert (high + 0.05) / (low + 0.05) >= 3, (drawn, behind)


@pytest.mark.sweep
def test_undo_works_after_a_number_was_typed_and_parameters_say_they_were_changed(page) -> None:
    go_to(page, 20)
    field = page.locator("#tissue-fields .number").first
    before = field.input_value()
    enter(field, "0.7")
    until(page, "state => Math.abs(state.layers[0].mu_pa - 7e5) < 1")
    hand = page.locator("#tissue-fields .hand").first
    hand.wait_for(state="visible")
    assert "layer 1" in page.inner_text("#by-hand")
    field.press("Control+z")  # the field has the focus still
    until(page, "state => Math.abs(state.layers[0].mu_pa - 7e5) > 1")
    hand.wait_for(state="hidden")
    assert field.input_value() == before
    field.focus()
    page.keyboard.type("9")  # now the field undoes what is typed
    field.press("Control+z")
    assert page.evaluate("window.needlefit.state.depth_mm") == 20


@pytest.mark.sweep
def test_the_three_steps_to_try_follow_what_is_done_and_can_be_skipped(page) -> None:
    go_to(page, 10)
    page.evaluate("import('/page/tour.js').then(({ offer }) => offer())")
    page.locator("#tour").wait_for(state="visible")
    assert page.inner_text("#tour-text").startswith("1 of 3")
    side = page.evaluate("window.needlefit.state.bevel.side")
    drag(page, "arrow", 0, 70 * side)
    page.get_by_text("2 of 3").wait_for()
    assert page.evaluate("window.needlefit.state.bevel.side") == -side
    drag(page, "base", 0, -20)
    page.get_by_text("3 of 3").wait_for()
    state = settle(page)  # the step counts before the last order of the drag is answered
    drag(page, "base", 60, 3)
    page.locator("#tour").wait_for(state="hidden")
    after = page.evaluate("window.needlefit.state")
    assert after["depth_mm"] > 15 and after["base"]["input_y"] == state["base"]["input_y"]
    page.keyboard.press("Control+z")  # one drag, one undo
    until(page, "state => state.depth_mm === 10")
    page.evaluate("localStorage.clear()")
    page.evaluate("import('/page/tour.js').then(({ offer }) => offer())")
    page.keyboard.press("f")
    page.get_by_text("2 of 3").wait_for()
    page.click("#tour-skip")
    page.get_by_text("3 of 3").wait_for()
    page.click("#tour-end")
    page.locator("#tour").wait_for(state="hidden")
    page.evaluate("import('/page/tour.js').then(({ offer }) => offer())")  # not a second time by itself
    assert page.locator("#tour").is_hidden()


@pytest.mark.sweep
def test_the_smoothed_load_has_the_force_of_the_raw_one(page) -> None:
    go_to(page, 30)
    sums = page.evaluate(
        """import("/page/painters/needle.js").then(({ smooth }) => {
            const { x, n_per_mm: load } = window.needlefit.state.load;
            const add = (one, what) => one.slice(1).reduce((all, at, i) => all + what(at, one[i], i), 0);
            const sum = (one) => add(one, (at, to, i) => ((at + to) / 2) * (x[i + 1] - x[i]));
            const rough = (one) => add(one, (at, to) => Math.abs(at - to));
            const mean = smooth(x, load, window.needlefit.scene.spacing_mm);
            return [sum(load.map(Math.abs)), sum(load), sum(mean), rough(load), rough(mean)];
        })"""
    )
    size, raw, smoothed, rough, flat = sums
    assert abs(raw - smoothed) < 0.05 * size and flat < 0.5 * rough


@pytest.mark.sweep
def test_a_fit_on_the_page_lowers_the_error_and_its_ridge_is_drawn(page) -> None:
    page.fill("#speed", "1000")
    page.click("#goto-scene")
    before = until(page, "state => state.errors?.whole")["errors"]["ipe_mean_mm"]
    page.click("#fit-now")
    page.locator("#fit[aria-busy]").wait_for()
    page.locator("#ridge").wait_for(state="visible", timeout=60_000)
    page.locator("#fit:not([aria-busy])").wait_for()
    fitted = until(page, f"state => state.errors?.whole && state.errors.ipe_mean_mm < {before}")["errors"]
    assert fitted["te_mm"] < 0.3
    assert "fitted on this page" in page.inner_text("#note") and page.inner_text("#by-hand") == ""
    until(page, "() => window.needlefit.band?.x.length > 10")
    page.click("#fit-drag")
    script = """async () => {
        const { toPx, toPy } = await import("/page/view.js");
        const { points } = await import("/page/handles.js");
        const box = document.getElementById("canvas").getBoundingClientRect();
        const [x, y] = points.places()[3];
        return [box.left + toPx(x), box.top + toPy(y)];
    }"""
    page.click("[data-fit=tissue]")
    b = page.evaluate("window.needlefit.state.bevel.offset_mm")
    x, y = page.evaluate(script)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 10, steps=4)
    page.mouse.up()
    until(page, f"state => state.bevel.offset_mm !== {b}", 30)
    assert page.evaluate("import('/page/handles.js').then(({ points }) => points.offsets[3])") > 0
    page.locator("#fit-note", has_text="times the stated errors").wait_for()
    page.click("#fit-back")
    until(page, f"state => Math.abs(state.bevel.offset_mm / {b} - 1) < 1e-3", 30)


@pytest.mark.sweep
def test_reset_and_the_game_keep_the_fitted_parameters(page) -> None:
    page.click("#fit-now")
    page.locator("#ridge").wait_for(state="visible", timeout=60_000)
    fitted = page.evaluate("window.needlefit.state.layers.map((one) => one.mu_pa)")
    for button in ("#reset", "#challenge"):
        go_to(page, 10)
        page.click(button)
        state = until(page, "state => state.depth_mm === 0")
        assert [one["mu_pa"] for one in state["layers"]] == pytest.approx(fitted, rel=1e-12)


def test_all_shape_parameters_of_a_law_have_a_field(chromium, tmp_path) -> None:
    scene = tmp_path / "gent.toml"
    scene.write_text(
        'schema = 1\ndepth_mm = 20.0\nlaw = "gent"\n[needle]\nlength_mm = 150.0\nouter_diameter_mm = 1.27\n'
        'youngs_modulus_gpa = 80.0\n[bevel]\noffset_mm = 0.085\n[[layers]]\nname = "gel"\ntop_mm = 0.0\n'
        "mu_pa = 2e5\nshape = { jm = 2.0 }\n"
    )
    running = Server(tmp_path, str(scene))
    try:
        with opened(chromium, running) as page:
            page.wait_for_function(
                "document.querySelector('#tissue-fields input[aria-label=\"gel Jm\"]')?.value"
            )
            assert float(page.input_value('#tissue-fields input[aria-label="gel Jm"] >> nth=0')) == 2.0
    finally:
        running.end()
