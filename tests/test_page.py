"""The page in a real browser, steered by pointer, keys and touch.

Conditions are JavaScript of `s`, the state of the needle, `n`, what the page knows, and `aim`.
"""

import io
import re
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from needlefit.mechanics.shape import list_planes
from needlefit.planning.recording import read_recording, replay

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FOUND = next((path for name in BROWSERS if (path := shutil.which(name))), None)
NO_BROWSER = pytest.mark.skipif(
    FOUND is None, reason=f"no browser is installed (none of {', '.join(BROWSERS)})"
)
pytestmark = NO_BROWSER
sweep = pytest.mark.sweep
PATIENCE = 15.0


class Server:
    """`needlefit view` in a process of its own."""

    def __init__(self, out, subject: str = "twin/phantom2-05", *options: str, folder=None) -> None:
        words = ("view", subject, "--no-browser", "--out", str(out), *options)
        command = [sys.executable, "-m", "needlefit", *words]
        self.folder = out / "view"
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=folder
        )
        self.address = self.process.stdout.readline().strip()

    def end(self) -> None:
        self.process.terminate()
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


UNFOLD = """() => {
    const everything = document.getElementById("everything");
    if (everything.ariaExpanded !== "true") everything.click();
    for (const one of document.querySelectorAll("aside details")) one.open = true;
}"""


@contextmanager
def opened(chromium, server, *, inserted: bool = False, **settings):
    """Yield a page in a context of its own; a fault of its scripts fails the test.

    Unless the needle is to be `inserted`, as the page shows it first, it is taken back to first contact.
    """
    begun = {"viewport": {"width": 1280, "height": 800}, "reduced_motion": "reduce"}
    context = chromium.new_context(**(begun | settings))
    page, faults = context.new_page(), []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(server.address)
    until(page, "s && n.connected")
    if (begun | settings)["reduced_motion"] == "reduce" and not inserted:
        until(page, "s.undo")
        if get(page, "s.step === n.scene.simulation.steps.length"):
            page.click("#undo")
            until(page, "s.depth_mm === 0")
    page.click("[data-fit=whole]")  # the base too
    page.evaluate(UNFOLD)
    yield page
    context.close()
    assert faults == []


def get(page, expression: str):
    """Return the value of a JavaScript expression of the page."""
    names = "((n) => ((s, aim, kept, part, heightAt) =>"
    known = "n?.state, n?.aim, window.kept, (one) => document.querySelector(one), window.heightAt"
    return page.evaluate(f"{names} ({expression}))({known}))(window.needlefit)")


def call(page, module: str, expression: str):
    """Return the value of an expression in which `m` is a module of the page."""
    return page.evaluate(f"import('/page/{module}.js').then((m) => ({expression}))")


def until(page, true: str, seconds: float = PATIENCE):
    """Wait until an expression holds, and return the state."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if get(page, true):
            return get(page, "s")
        page.wait_for_timeout(20)
    raise AssertionError(f"never: {true}; {get(page, 's')}")


def do(page, *steps) -> dict:
    """Carry out steps: each a verb, its arguments, and the condition that follows; return the last state."""
    own = {"go to": go_to, "drag": drag, "pull": pull, "aim": aim_at, "shows": shown}
    for verb, *arguments, true in steps:
        if verb == "keep":
            page.evaluate("window.kept = window.needlefit.state")
        elif verb in own:
            own[verb](page, *arguments)
        elif verb == "enter":
            enter(page.locator(arguments[0]).first, arguments[1])
        elif verb in ("down", "up", "key"):
            getattr(page.keyboard, verb.replace("key", "press"))(*arguments)
        else:
            getattr(page, verb)(*arguments)
        state = until(page, true, 60)  # a plan or a fit takes long on a busy machine
    return state


def go_to(page, depth: float):
    page.fill("#speed", "1000")
    page.fill("#goto-depth", str(depth))
    page.press("#goto-depth", "Enter")
    return until(page, f"Math.abs(s.depth_mm - {depth}) < 1e-6 && !s.moving")


def enter(field, text: str) -> None:
    """Type into a field and press Enter; what the page wrote between selecting and typing is typed over."""
    deadline = time.monotonic() + PATIENCE
    field.fill(text)
    while field.input_value() != text and time.monotonic() < deadline:
        field.fill(text)
    field.press("Enter")


def on_picture(page, x: float, y: float) -> list[float]:
    """Return where a place of the constraint frame, mm, stands in the window, pixels."""
    box = page.locator("#canvas").bounding_box()
    px, py = call(page, "view", f"[m.toPx({x}), m.toPy({y})]")
    return [box["x"] + px, box["y"] + py]


def place(page, what: str) -> list[float]:
    """Return where something of the state stands in the window, pixels."""
    if what == "arrow":
        box, (px, py) = (
            page.locator("#canvas").bounding_box(),
            call(page, "handles", "m.bevelPlace(needlefit.state).turn"),
        )
        return [box["x"] + px, box["y"] + py]
    return on_picture(page, *get(page, f"(({{x, y}}) => [x, y])(s['{what}'] ?? s.guides[0])"))


def settle(page):
    """Wait until the state stays the same for half a second, and return it."""
    end, state = time.monotonic() + PATIENCE, None
    while time.monotonic() < end:
        before, state = state, get(page, "s")
        if state == before:
            return state
        page.wait_for_timeout(500)
    raise AssertionError(f"never the same: {state}")


def pull(page, x: float, y: float, dx: float, dy: float) -> None:
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + dx, y + dy, steps=5)
    page.mouse.up()


def drag(page, what: str, dx: float, dy: float) -> None:
    pull(page, *place(page, what), dx, dy)


def shown(page, text: str) -> None:
    """Wait until something that is seen says so."""
    page.get_by_text(text).first.wait_for(state="visible", timeout=1000 * PATIENCE)


def aim_at(page, goal: str) -> None:
    call(page, "aim", f"m.setAim({goal})")


def plan(page):
    """Ask for a plan, wait for it, and return it."""
    page.click("#make-plan")
    until(page, "aim.plan", 60)
    return get(page, "aim.plan")


def find_violations(page, part: str = "") -> list:
    """Return what axe finds on the page."""
    package = pytest.importorskip("axe_playwright_python")
    page.evaluate((Path(package.__file__).parent / "axe.min.js").read_text("utf-8"))
    found = page.evaluate(f"axe.run({part})")["violations"]
    return [(one["id"], [node["html"][:120] for node in one["nodes"]]) for one in found]


def test_the_needle_goes_in_and_out_by_button_key_and_wheel(page) -> None:
    assert get(page, "s.depth_mm") == 0
    page.locator("#insert").hover()
    page.mouse.down()
    until(page, "s.depth_mm > 2")
    page.mouse.up()
    depth = until(page, "!s.moving")["depth_mm"]
    page.focus("#canvas")
    keys = ("down", "ArrowRight", f"s.depth_mm > {depth + 2}"), ("up", "ArrowRight", "!s.moving")
    deep = do(page, *keys)["depth_mm"]
    page.mouse.move(*place(page, "tip"))
    page.mouse.wheel(0, -100)
    wheeled = until(page, f"Math.abs(s.depth_mm - {deep}) > 0.5")["depth_mm"]
    do(page, ("down", "ArrowLeft", f"s.depth_mm < {wheeled - 1}"), ("up", "ArrowLeft", "!s.moving"))


MU, GOAL_X, HAND = "#tissue-fields .number", "#target-fields .number", "part('#tissue-fields .hand')"
BASE_ANGLE, RADIUS = "#base-fields .field >> nth=1 >> .number", "#target-fields .field >> nth=2 >> .number"
REFUSED, CALM = "part('#refusal strong')", "!part('#refusal strong')"
SAME_MU = "s.layers.every(({ mu_pa: mu }, i) => Math.abs(mu / kept.layers[i].mu_pa - 1) < 1e-12)"
SEQUENCES = {
    "the bevel turns over and the needle with it": [
        ("go to", 25, "true"),
        ("keep", "true"),
        ("focus", "#canvas", "true"),
        ("key", "f", "s.bevel.side === -kept.bevel.side && s.tip.rotation === kept.tip.rotation"),
        ("go to", 30, "kept.bevel.side * (s.tip.rotation - kept.tip.rotation) < 0"),
    ],
    "a guide is added, dragged and taken away": [
        ("go to", 20, "true"),
        ("click", "#add-guide", "s.guides.length === 1"),
        ("keep", "true"),
        ("drag", "guide", 0, -20, "s.guides[0].y > 0.5 && Math.abs(s.guides[0].x - kept.guides[0].x) < 1"),
        ("focus", "#canvas", "Math.abs(heightAt(s, s.guides[0].x) - s.guides[0].y) < 0.02"),
        ("click", "#guides .free", "s.guides[0].turns_freely !== kept.guides[0].turns_freely"),
        ("click", "#guides .remove", "s.guides.length === 0"),
    ],
    "a slider keeps its arrows, a number all that is typed; the other keys are the page's": [
        ("go to", 20, "true"),
        ("keep", "true"),
        ("focus", "#base-fields .slider >> nth=0", "true"),
        ("key", "ArrowRight", "s.base.input_y !== 0 && s.depth_mm === 20"),
        ("key", "f", "s.bevel.side === -kept.bevel.side"),
        ("key", "Control+z", "s.bevel.side === kept.bevel.side"),
        ("key", "Control+z", "s.base.input_y === 0"),
        ("fill", "#speed", "", "true"),
        ("key", "Tab", "part('#speed').value === '1000'"),
        ("shows", "1000 is kept", "true"),
    ],
    "a refused input is announced, and nothing moves; what is right ends the message": [
        ("fill", "#goto-depth", "200", "true"),
        ("key", "Enter", "s.depth_mm === 0"),
        ("go to", 20, "true"),
        ("enter", MU, "-5", f"{REFUSED} && part('#refusal').textContent.includes('-5 kPa')"),
        ("focus", "#canvas", f"s.layers[0].mu_pa > 0 && part('{MU}').value !== '-5'"),  # what is stands there
        ("enter", MU, "400", f"Math.abs(s.layers[0].mu_pa - 4e5) < 1 && {CALM}"),
        ("enter", BASE_ANGLE, "-1e9", f"{REFUSED}?.textContent.includes('-90.0°')"),
        ("enter", BASE_ANGLE, "0.5", "Math.abs(s.base.input_slope - 0.008727) < 1e-5"),
        ("key", "Control+z", f"s.base.input_slope === 0 && {CALM}"),
        ("enter", BASE_ANGLE, "-1e9", REFUSED),
        ("click", "#reset", f"s.depth_mm === 0 && {CALM}"),
    ],
    "undo works after a number was typed, and parameters say that they were changed": [
        ("go to", 20, "true"),
        ("keep", "true"),
        ("enter", MU, "700", f"Math.abs(s.layers[0].mu_pa - 7e5) < 1 && !{HAND}.hidden"),
        ("focus", f"{MU} >> nth=0", "part('#tissue-fields .hand:not([hidden])')"),
        ("key", "Control+z", f"s.layers[0].mu_pa === kept.layers[0].mu_pa && {HAND}.hidden"),
        ("focus", f"{MU} >> nth=0", f"Math.abs((part('{MU}').value * 1e3) / s.layers[0].mu_pa - 1) < 1e-3"),
        ("key", "9", "true"),
        ("key", "Control+z", "s.depth_mm === 20"),  # now the field undoes what is typed
    ],
    "a goal that is refused is taken back": [
        ("go to", 5, "true"),
        ("aim", "{ target: [35, 0.5] }", "aim.target"),
        ("enter", RADIUS, "1.5", "aim.radius === 1.5"),
        ("enter", GOAL_X, "1e300", REFUSED),
        ("focus", "#canvas", f"aim.target[0] === 35 && Number(part('{GOAL_X}').value) === 35"),
    ],
    "a plan that fails names what it touches": [
        ("go to", 20, "true"),
        ("aim", "{ target: [40, -1], obstacles: [[30, -0.6, 3]] }", "!part('#make-plan').disabled"),
        ("click", "#make-plan", "aim.plan?.hits === 0 && aim.plan.touched['obstacle 1'] === 1"),
        ("focus", "#canvas", "part('#plan-note').textContent.includes('obstacle 1')"),
    ],
    "by keyboard a target is put ahead of the tip": [
        ("go to", 5, "true"),
        ("focus", "#put-target", "true"),
        (
            "key",
            "Enter",
            "aim.target?.[0] > s.depth_mm + 5 && document.activeElement.closest('#target-fields')",
        ),
        ("click", "#put-obstacle", "aim.placing"),
        ("key", "Escape", "aim.placing === null && aim.obstacles.length === 0"),
    ],
    "reset keeps the parameters": [
        ("enter", MU, "700", "Math.abs(s.layers[0].mu_pa - 7e5) < 1"),
        ("keep", "true"),
        ("go to", 10, "true"),
        ("click", "#reset", f"s.depth_mm === 0 && {SAME_MU}"),
    ],
}


@sweep
@pytest.mark.parametrize("sequence", SEQUENCES)
def test_a_sequence_of_inputs_has_its_effects(page, sequence: str) -> None:
    call(page, "quantities", "window.heightAt = m.heightAt, 0")
    do(page, *SEQUENCES[sequence])


@sweep
def test_the_base_is_dragged_in_millimetres_and_one_undo_takes_it_back(page) -> None:
    go_to(page, 30)
    across = call(page, "view", "m.view.scale * m.view.magnified")
    state = do(page, ("drag", "base", 0, -2 * across, "s.base.y > 1.8"))
    assert state["base"]["y"] == pytest.approx(2, abs=1.5 / across)
    assert state["y"][0] == pytest.approx(state["base"]["y"])
    undone, again = "s.base.y === 0 && s.depth_mm === 30", f"s.base.y === {state['base']['y']}"
    do(page, ("key", "Control+z", undone), ("key", "Control+y", again))


@sweep
def test_a_pasted_address_connects_and_a_missing_needle_is_reported(page) -> None:
    go_to(page, 5)
    address = page.url
    with page.expect_event("load"):  # the page is loaded again with it
        page.evaluate("location.hash = 'token=another'")
    shown(page, "token")
    page.evaluate("sessionStorage.setItem('needlefit.needle', 'gone')")
    with page.expect_event("load"):
        page.evaluate(f"location.hash = '{address.partition('#')[2]}'")
    shown(page, "new needle")
    until(page, "n?.connected && s?.depth_mm === n.scene.depth_mm")  # a new one, inserted


@sweep
def test_the_errors_are_those_of_the_study_at_the_measured_depth(page) -> None:
    """And follow the sliders, which tell the whole insertion again."""
    page.fill("#speed", "1000")
    state = do(page, ("click", "#play", "s.errors?.whole && !s.playing"))
    measured = get(page, "n.scene.measured")
    tip = np.array([state["tip"]["x"] - measured["x"][-1], state["tip"]["y"] - measured["y"][-1]])
    assert state["errors"]["te_mm"] == pytest.approx(np.linalg.norm(tip), abs=1e-3)
    shown(page, f"{state['errors']['te_mm']:.3f}")
    ahead = do(page, ("enter", "#bevel-fields .number", "0.01", "s.bevel.offset_mm === 0.01"))
    assert ahead["errors"]["te_mm"] == pytest.approx(state["errors"]["te_mm"], abs=1e-6)
    after = do(
        page, ("click", "#throughout", f"Math.abs(s.errors.te_mm - {ahead['errors']['te_mm']}) > 0.01")
    )
    assert after["errors"]["te_mm"] != state["errors"]["te_mm"] and after["depth_mm"] == state["depth_mm"]


@sweep
def test_a_disconnected_page_says_so_and_has_its_needle_again_once_it_is_loaded(server, chromium) -> None:
    with opened(chromium, server) as page:
        state = go_to(page, 15)
        call(page, "connection", "m.settle()")
        call(page, "connection", "m.send({ do: 'x'.repeat(100000) })")  # too long: the server hangs up
        until(page, "!n.connected")
        shown(page, "Not connected")
        page.click("#banner-act")
        back = until(page, "n?.connected && s?.depth_mm === 15")
        assert back["y"] == state["y"] and back["undo"]
        assert page.get_attribute("[data-fit=tissue]", "aria-pressed") == "true"  # beside a measured needle


@sweep
def test_touch_drags_the_base(server, chromium) -> None:
    with opened(chromium, server, has_touch=True) as page:
        touch = page.context.new_cdp_session(page)
        x, y = place(page, "base")
        for n, kind in enumerate(("touchStart", "touchMove", "touchMove", "touchEnd")):
            points = [] if kind == "touchEnd" else [{"x": x, "y": y - 10 * n}]
            touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
        assert until(page, "s.base.y > 0.5")["step"] >= 1


@pytest.fixture
def full_page(page):
    """A page with a guide, a target and an obstacle."""
    page.click("#add-guide")
    aim_at(page, "{ target: [40, 1], obstacles: [[20, 3, 1]] }")
    until(page, "s.guides.length === 1 && aim.obstacles.length")
    page.wait_for_timeout(400)
    return page


@sweep
def test_everything_that_can_be_used_has_a_place_in_the_order_and_24_pixels(full_page) -> None:
    page = full_page
    page.locator("body").click(position={"x": 2, "y": 2})
    reached = []
    for _ in range(12):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("[...document.querySelectorAll('*')].indexOf(document.activeElement)"))
    assert reached == sorted(reached) and len(set(reached)) == len(reached)
    sizes = page.evaluate(
        """[...document.querySelectorAll("button, input, select")].filter((one) => one.checkVisibility())
        .map((one) => [one.id || one.className || one.textContent, one.getBoundingClientRect()])
        .map(([name, { width, height }]) => [name, width, height]).filter(([, width]) => width > 0)"""
    )
    assert len(sizes) > 40
    assert [one for one in sizes if min(one[1:]) < 24] == []


def contrast(one: str, other: str) -> float:
    """Return the contrast (WCAG) of two colours, `#rrggbb`."""

    def luminance(colour: str) -> float:
        parts = np.array([int(part, 16) for part in re.findall(r"[\da-f]{2}", colour[:7])]) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    low, high = sorted(map(luminance, (one, other)))
    return (high + 0.05) / (low + 0.05)


@sweep
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_bands_and_gaps_stand_out_in_both_colour_schemes(server, chromium, scheme: str) -> None:
    """Contrast of at least 3 to 1 (WCAG AA) of what is drawn on each layer; that of texts is axe's."""
    with opened(chromium, server, color_scheme=scheme) as page:
        page.wait_for_timeout(300)
        colours = call(page, "painters/strokes", "{ ...m.palette }")
        dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (sum(map(int, re.findall(r"\d+", dark)[:3])) < 200) == (scheme == "dark")
    for drawn in ("band", "gap", "plan", "bad", "ghost", "needle"):
        for behind in ("soft", "stiff"):
            assert contrast(colours[drawn], colours[behind]) >= 3, (drawn, behind)
    channels = {name: [int(part, 16) for part in re.findall("..", colours[name][1:7])] for name in colours}
    assert np.ptp(channels["needle"]) < 20 and np.ptp(channels["band"]) > 100  # grey, and a colour
    pairs = [("band", "needle"), ("band", "load"), ("tip", "load"), ("ghost", "needle")]
    assert min(np.linalg.norm(np.subtract(channels[a], channels[b])) for a, b in pairs) > 60


@sweep
def test_at_200_percent_nothing_is_cut_off(server, chromium) -> None:
    """A window of 1280 x 800 zoomed to 200 % has 640 x 400 pixels of the page's own."""
    settings = {"viewport": {"width": 640, "height": 400}, "device_scale_factor": 2}
    with opened(chromium, server, **settings) as page:
        assert page.evaluate("document.documentElement.scrollWidth") <= 640
        for name in ("Insert", "Retract", "Flip bevel", "Undo", "Play scene"):
            button = page.get_by_role("button", name=re.compile(name)).first
            button.scroll_into_view_if_needed()
            box = button.bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= 640, name
            picture = page.locator("#canvas").bounding_box()
            assert picture["y"] + picture["height"] > 100, f"the picture is out of sight at {name}"
        assert picture["width"] > 500 and picture["height"] == 240
        assert call(page, "view", "m.view.box.height") > 120  # between names and ticks
        field, message = page.locator("#tissue-fields .number").nth(2), page.locator("#refusal strong")
        enter(field, "-5")
        message.wait_for()
        box, typed = message.bounding_box(), field.bounding_box()
        assert box["y"] >= 0 and box["y"] + box["height"] <= min(400, typed["y"])


BYTES = """import('/page/trial.js').then(({trial}) => {
    const byte = (one) => one.toString(16).padStart(2, '0');
    const hex = (array) => Array.from(new Uint8Array(array.buffer), byte).join('');
    const {x, u, slope, constraints} = trial.steered.session.shape;
    return [x, u, slope, constraints].map(hex);
})"""


def test_a_drive_is_recorded_and_replayed_to_the_same_bits(page, server) -> None:
    """By keys, pointer, wheel and sliders, undone and redone; a page that is reloaded finds its needle."""
    side = go_to(page, 20)["bevel"]["side"]
    page.fill("#speed", "50")  # so that a slow frame is no jump of centimetres
    drag(page, "base", 0, -20)
    do(page, ("focus", "#canvas", "true"), ("key", "f", f"s.bevel.side === {-side}"))
    assert page.locator("#above").is_hidden() and get(page, "s.z") is None
    do(page, ("keep", "true"), ("key", "r", "s.z && s.bevel.roll_deg === (kept.bevel.roll_deg + 10) % 360"))
    page.focus("#tissue-fields .slider >> nth=0")
    for key in ("ArrowRight", "ArrowRight", "PageUp"):
        do(page, ("keep", "true"), ("key", key, "s.step > kept.step"))
    do(page, ("click", "#add-guide", "s.guides.length === 1"), ("click", "#undo", "!s.guides.length"))
    do(page, ("click", "#redo", "s.guides.length === 1"), ("click", "#undo", "!s.guides.length"))
    page.mouse.move(*place(page, "tip"))
    page.mouse.wheel(0, -300)
    until(page, "Math.abs(s.depth_mm - 23) < 1e-6")
    do(
        page,
        ("focus", "#canvas", "true"),
        ("down", "ArrowRight", "s.depth_mm > 26"),
        ("up", "ArrowRight", "!s.moving"),
    )
    state = settle(page)
    while call(page, "trial", "m.trial.outbox.length"):
        page.wait_for_timeout(20)
    recording = read_recording(server.folder / get(page, "n.scene.recording"))
    *_, last = replayed = list(replay(recording))
    assert [one.tip_offset_mm for one in replayed] == [0.0] * (state["step"] + 1)
    shape = last.state.shape
    assert page.locator("#above").is_visible() and state["tip"]["z"] == pytest.approx(shape.tip_z)
    u, slope = list_planes(shape)
    arrays = (shape.x, u, slope, shape.constraints[:, : 1 + len(u)])
    assert page.evaluate(BYTES) == [np.ascontiguousarray(one).tobytes().hex() for one in arrays]
    page.reload()
    until(page, f"s?.step === {state['step']}")
    assert page.evaluate(BYTES) == [np.ascontiguousarray(one).tobytes().hex() for one in arrays]
    do(page, ("click", "#undo", "Math.abs(s.depth_mm - 23) < 1e-6"), ("click", "#redo", "s.depth_mm > 26"))


@sweep
def test_a_new_page_shows_an_insertion_and_keeps_its_tip_in_sight(server, chromium) -> None:
    with opened(chromium, server, reduced_motion="no-preference") as page:
        state = until(page, "s.depth_mm > 5 && !s.playing")
        assert state["depth_mm"] == pytest.approx(get(page, "n.scene.measured.depth_mm"), abs=0.01)
        page.click("[data-fit=tissue]")
        assert call(page, "view", "m.seesTip() && m.view.magnified > 1")
        drag(page, "tip", 0, -250)
        page.wait_for_timeout(300)
        assert call(page, "view", "m.seesTip()") and "by hand" in page.inner_text("#title")


SCENES = sorted(path.stem for path in Path("configs/scenes").glob("*.toml"))


@pytest.mark.parametrize(
    "name", ["figure1", *(pytest.param(one, marks=sweep) for one in SCENES if one != "figure1")]
)
def test_every_shipped_scene_opens_without_a_refusal(chromium, tmp_path, name: str) -> None:
    opens_without_a_refusal(chromium, Server(tmp_path, name))


@sweep
@pytest.mark.parametrize("kind", ["cross_validation", "fit"])
def test_every_kind_of_run_opens_without_a_refusal(chromium, tmp_path, world, kind: str) -> None:
    run = world.find(kind)
    opens_without_a_refusal(chromium, Server(tmp_path, str(run), folder=world.folder))


def opens_without_a_refusal(chromium, running: Server) -> None:
    """Its steps are carried out to their end, and nothing was refused on the way."""
    try:
        with opened(chromium, running, reduced_motion="no-preference") as page:
            until(page, "s.depth_mm > n.scene.depth_mm - 1e-6 && !s.playing", 60)
            assert page.inner_text("#refusal") == "" and "by hand" not in page.inner_text("#title")
    finally:
        running.end()


def try_scene(page, number: int) -> None:
    """Choose one of the scenes of one sentence; wait until its needle is pinned and its control is there."""
    page.locator("#scene-list button").nth(number).click()
    page.locator("#scene-control > *").first.wait_for()
    until(page, "n.pinned && !s.playing")


@sweep
@pytest.mark.parametrize("name", SCENES)
def test_scenes_of_one_sentence_are_refused_in_no_shipped_scene(chromium, tmp_path, name: str) -> None:
    running = Server(tmp_path, name)
    try:
        with opened(chromium, running) as page:
            page.wait_for_timeout(1000)  # those that its needle shows
            for number in range(page.locator("#scene-list button").count()):
                try_scene(page, number)
                page.wait_for_timeout(200)
                assert page.inner_text("#refusal") == "" and page.inner_text("#see")
                assert get(page, "s.depth_mm === n.scene.depth_mm && n.pinned.depth === s.depth_mm"), number
    finally:
        running.end()


def test_a_turned_bevel_a_stiffer_layer_and_the_ridge_are_one_control_each(chromium, tmp_path) -> None:
    running = Server(tmp_path, "phantom2_fitted")
    try:
        with opened(chromium, running) as page:
            page.click("#everything")
            page.locator("#scene-list button").nth(2).wait_for()
            assert page.is_hidden("#bevel-fields")
            try_scene(page, 0)
            side = get(page, "n.scene.simulation.steps[0].bevel.side")
            assert get(page, "s.bevel.side") == -side
            slopes = np.diff(get(page, "s.y.filter((_, i) => s.x[i] >= 0)"))
            first, last = np.diff(slopes[:10]).mean(), np.diff(slopes[-10:]).mean()
            assert first * last < 0  # an S
            enter(page.locator("#scene-control .number"), "15")
            turned = until(page, "s.depth_mm > 53 && Math.abs(s.y.at(-1) - n.pinned.y.at(-1)) > 1")
            assert turned["depths"] and get(page, "n.pinned.y.at(-1)") != turned["y"][-1]
            page.locator("#scene-control .slider").press("ArrowRight")
            until(page, "Number(part('#scene-control .number').value) === 16")  # mm, a step of the number
            assert page.get_attribute("#scene-control .slider", "aria-valuetext") == "16.0 mm"
            try_scene(page, 1)
            layer = get(
                page, "s.layers.findIndex(({mu_pa: mu}, i) => mu > 9 * n.scene.fitted.layers[i].mu_pa)"
            )
            assert layer >= 0
            before, after, total = (
                float(one) for one in re.findall(r"[\d.]+(?= (?:to|N))", page.inner_text("#see"))
            )
            assert after > before and total >= after
            try_scene(page, 2)
            drag_along_the_ridge(page, lambda: get(page, "s"))
    finally:
        running.end()


def drag_along_the_ridge(page, read) -> None:
    """Move the point by keys across the valley and back, then along it: the tip moves much, then little."""
    plane = page.locator(".ridge")
    plane.wait_for()
    fitted = read()
    plane.focus()

    def move(key: str, times: int) -> float:
        for _ in range(times):
            page.keyboard.press(key)
            page.wait_for_timeout(60)
        page.wait_for_timeout(300)
        return abs(read()["tip"]["lateral_mm"] - fitted["tip"]["lateral_mm"])

    across = move("ArrowRight", 3)
    assert move("ArrowLeft", 3) == pytest.approx(0.0, abs=1e-3)
    along = move("ArrowDown", 5)  # less of the modulus for more of b
    state = read()
    assert state["bevel"]["offset_mm"] > 1.005 * fitted["bevel"]["offset_mm"]
    assert state["layers"] != fitted["layers"] and along < 0.6 * across
    b, *_ = re.findall(r"[\d.]+", plane.get_attribute("aria-valuetext"))
    assert float(b) == pytest.approx(state["bevel"]["offset_mm"], abs=5e-4)
    box = plane.bounding_box()
    pull(page, box["x"] + 0.4 * box["width"], box["y"] + 0.4 * box["height"], 30, 20)
    page.wait_for_timeout(300)
    assert read()["bevel"]["offset_mm"] != state["bevel"]["offset_mm"]


SIZES = [(1440, 900), (1280, 720), (390, 844)]
OVERFLOWS = """[...document.querySelectorAll("button, label, dt, dd, p, h2, legend")].filter((one) =>
    one.checkVisibility() && !one.closest(".unseen, dialog") && one.scrollWidth > one.clientWidth + 1
    && getComputedStyle(one).display !== "inline").map((one) => [one.id, one.textContent.slice(0, 30)])"""


@pytest.mark.parametrize("size", [pytest.param(one, marks=sweep) if one[0] > 400 else one for one in SIZES])
def test_nothing_is_cut_off_or_covered_at_any_size(server, chromium, size) -> None:
    """Labels lie apart and in the window; the needle uses its height; nothing runs off the page."""
    viewport = dict(zip(("width", "height"), size, strict=True))
    with opened(chromium, server, viewport=viewport, has_touch=size[0] < 400) as page:
        go_to(page, 53)
        aim_at(page, "{ target: [50, -4], obstacles: [[44, -3, 1]] }")
        until(page, "aim.obstacles.length")
        for name in ("whole", "tissue", "tip"):
            page.click(f"[data-fit={name}]")
            page.wait_for_timeout(400)
            boxes = np.array(call(page, "painters/strokes", "m.takenBoxes()"))
            window = call(page, "view", "m.view.box")
            low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
            labels = boxes[:, 2] != boxes[:, 3]  # not the knob of the bevel, which is square
            assert (low[labels] >= [window["left"], window["top"]]).all()
            ends = [window["left"] + window["width"], window["top"] + window["height"]]
            assert (high[labels] <= ends).all()
            for n in range(len(boxes)):
                apart = (high[:n] <= low[n]).any(axis=1) | (low[:n] >= high[n]).any(axis=1)
                assert apart.all(), (name, boxes.tolist())
            if name == "tip":
                continue
            seen = call(page, "view", "[m.view.magnified, needlefit.state.y.map(m.toPy), m.view.scale]")
            assert seen[0] >= 2 and np.ptp(seen[1]) > 0.25 * window["height"]
            assert 60 / (seen[0] * seen[2]) < 6.5  # mm that a drag of 60 px moves the base across
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        assert page.evaluate(OVERFLOWS) == []
        for button in ("#insert", "#retract", "#flip", "#halt", "#pin", "#help"):
            box = page.locator(button).bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= size[0], button


MOST_CONTROLS = 20  # before *Everything*, in the order of the keyboard
BEFORE = """[...document.querySelectorAll("button, input, select, summary, [tabindex='0']")].filter((one) =>
  one.offsetParent && one.tabIndex >= 0).findIndex((one) => one.id === "everything")"""


def test_the_first_screen_has_the_needle_and_what_to_try(server, chromium) -> None:
    context = chromium.new_context(viewport={"width": 1280, "height": 800}, reduced_motion="reduce")
    page = context.new_page()
    page.goto(server.address)
    until(page, "s && s.depth_mm === n.scene.depth_mm", 30)
    page.locator("#scene-list button").first.wait_for()
    assert 0 < page.evaluate(BEFORE) <= MOST_CONTROLS
    for part in ("#readouts", ".chips", ".transport"):
        assert page.is_hidden(part)
    page.emulate_media(media="print")
    assert page.is_visible("#canvas") and page.is_visible("#readouts") and page.is_hidden("#panel")
    assert page.locator("#described").bounding_box()["height"] > 10
    page.emulate_media(media="screen")
    page.set_viewport_size({"width": 390, "height": 844})
    page.locator("#scene-list button").first.click()
    page.locator("#scene-control .slider").wait_for()
    picture, control = (page.locator(one).bounding_box() for one in ("#picture", "#scene-control"))
    assert 0 <= control["y"] - picture["y"] - picture["height"] < 120  # px: what to see stands between
    context.close()


@sweep
def test_a_saved_figure_shows_the_needle_of_the_page(page) -> None:
    """Its depth and forces; in the width of a printed page, its text as text."""
    go_to(page, 45.3)
    until(page, "n.forces.step === s.step && n.connected", 30)
    saved = {}
    for name in ("SVG", "PDF", "PNG"):
        with page.expect_download() as download:
            page.get_by_role("button", name=f"figure, {name}").click()
        saved[name] = download.value.path().read_bytes()
    drawing = ElementTree.fromstring(saved["SVG"])
    assert float(drawing.get("width").removesuffix("pt")) == pytest.approx(174 / 25.4 * 72)
    texts = ["".join(one.itertext()) for one in drawing.iter("{http://www.w3.org/2000/svg}text")]
    (about,) = (
        "".join(one.itertext()) for one in drawing.iter("{http://purl.org/dc/elements/1.1/}description")
    )
    force, base = page.evaluate("[needlefit.forces.y.at(-1), needlefit.state.forces.base_n]")
    described = re.search(r"Tip force ([+−][\d.]+) N", page.text_content("#described"))[1]
    assert float(described.replace("−", "-")) == pytest.approx(force, abs=6e-3)  # since the forces have come
    for one in (about, " ".join(texts)):
        found = [float(text.replace("−", "-")) for text in re.findall(r"(?:force|base) ([+−][\d.]+) N", one)]
        assert sorted(found) == pytest.approx(sorted([force, base]), abs=6e-4)
    assert "45.3 mm deep" in about
    assert saved["PDF"][:4] == b"%PDF"
    with Image.open(io.BytesIO(saved["PNG"])) as picture:
        assert picture.width == pytest.approx(174 / 25.4 * 300, abs=1)


@sweep
def test_a_pinned_needle_stays_and_the_strip_reads_both(page) -> None:
    pinned = go_to(page, 30)
    page.focus("#canvas")
    do(page, ("key", "k", "n.pinned && part('#pin').ariaPressed === 'true'"))
    state = do(
        page, ("key", "f", "s.bevel.side !== n.state.side"), ("go to", 45, "n.pinned.depth < s.depth_mm")
    )
    assert get(page, "n.pinned.y.at(-1)") == pinned["y"][-1] != state["y"][-1]
    page.focus("#strip-canvas")
    page.keyboard.press("Home")
    for _ in range(20):
        page.keyboard.press("ArrowRight")
    assert get(page, "n.marked") == 20 and get(page, "s.depth_mm") == 45
    path = get(page, "n.pinned.path")
    y = np.interp(20, path["x"], path["y"])
    text = page.get_attribute("#strip-canvas", "aria-valuetext")
    values = [float(one.replace("−", "-")) for one in re.findall(r"tip y ([−+]?[\d.]+)", text)]
    assert len(values) == 2 and values[1] == pytest.approx(y, abs=0.006)
    until(page, "n.forces.step === s.step && n.pinned.forces.x.length >= 30")
    text = page.get_attribute("#strip-canvas", "aria-valuetext")
    assert len(re.findall(r"tip force [−+]?[\d.]+ N", text)) == 2
    assert float(page.inner_text("#readouts dd >> nth=4").split()[0].replace("−", "-")) == pytest.approx(
        get(page, "n.forces.y.at(-1)"), abs=5.1e-4
    )
    assert get(page, "n.forces.y.slice(0, 30)") == pytest.approx(
        get(page, "n.pinned.forces.y.slice(0, 30)"), abs=1e-6
    )  # the flip came after them
    do(page, ("key", "Enter", "Math.abs(s.depth_mm - 20) < 1e-6 && !s.moving"))
    page.click("#pin")
    assert get(page, "n.pinned") is None


@sweep
def test_a_target_is_put_by_a_click_planned_for_and_reached(page) -> None:
    go_to(page, 5)
    page.click("[data-fit=tissue]")
    page.click("#put-target")
    page.mouse.click(*on_picture(page, 35, 0.6))
    until(page, "aim.target")
    assert get(page, "aim.target") == pytest.approx([35, 0.6], abs=0.2)
    found = plan(page)
    end = do(page, ("click", "#run-plan", "s.depth_mm > 30 && !s.playing"))
    miss = call(page, "aim", "m.tipError(needlefit.state)")
    assert miss == pytest.approx(found["nominal_miss_mm"], abs=1e-3) and miss < 0.2
    assert get(page, "aim.plan.left") is False
    do(page, ("key", "f", "aim.plan.left"))  # a hand leaves the plan
    page.click("#make-plan")  # behind the tip: refused
    shown(page, "the target lies at a depth")
    page.keyboard.press("Control+z")
    do(page, ("key", "Control+z", f"s.depth_mm < {end['depth_mm'] - 1}"))


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=sweep)])
def test_axe_finds_no_violation(full_page, scheme: str) -> None:
    full_page.emulate_media(color_scheme=scheme)
    full_page.wait_for_timeout(400)
    assert find_violations(full_page) == []
    full_page.click("#help")
    assert find_violations(full_page, "'dialog'") == []


KEEP_TEXTS = """() => {
    const { prototype } = CanvasRenderingContext2D, { fillText } = prototype;
    window.texts = [];
    prototype.fillText = function (text, ...place) {
        window.texts.push(text);
        fillText.call(this, text, ...place);
    };
}"""


def test_all_layers_of_a_law_have_fields_and_names(chromium, tmp_path) -> None:
    scene, field = tmp_path / "gent.toml", '#shape-fields input[aria-label="Jm gel"]'
    scene.write_text(
        'schema = 1\ndepth_mm = 20.0\nlaw = "gent"\n[needle]\nlength_mm = 150.0\nouter_diameter_mm = 1.27\n'
        'youngs_modulus_gpa = 80.0\n[bevel]\noffset_mm = 0.085\n[[layers]]\nname = "gel"\ntop_mm = 0.0\n'
        "mu_pa = 2e5\nshape = { jm = 2.0 }\n"
        '[[layers]]\nname = "subcutaneous fat"\ntop_mm = 3.0\nmu_pa = 1e5\nshape = { jm = 2.0 }\n'
    )
    running = Server(tmp_path, str(scene))
    try:
        with opened(chromium, running) as page:
            until(page, f"document.querySelector('{field}')?.value")
            assert float(page.input_value(f"{field} >> nth=0")) == 2.0
            page.evaluate(KEEP_TEXTS)
            page.click("[data-fit=tissue]")
            page.wait_for_timeout(300)
            assert {"gel", "subcutaneous fat"} < set(page.evaluate("window.texts"))
    finally:
        running.end()
