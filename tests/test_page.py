"""The page of `needlefit view` in a real browser, offline, steered by sliders and keys.

Conditions are JavaScript of `s`, the state of the needle, and `n`, what the page knows.
"""

import io
import shutil
import time
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.random import default_rng
from page_files import ALL_STATES, open_offline, require_accessible
from PIL import Image
from pytest import approx

from needlefit.mechanics.shape import list_planes
from needlefit.planning.steered_needle import read_recording, replay
from needlefit.reporting.needle_page import kernel_exists
from needlefit.viewer.opening import open_target
from needlefit.viewer.page_needle import compose_page

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FOUND = next((path for name in BROWSERS if (path := shutil.which(name))), None)
NO_BROWSER = pytest.mark.skipif(
    FOUND is None or not kernel_exists(),
    reason=f"no browser is installed (none of {', '.join(BROWSERS)}), or no kernel in WebAssembly",
)
pytestmark = NO_BROWSER
sweep = pytest.mark.sweep
PATIENCE = 15.0
SUBJECT = "twin/phantom2-05"


@pytest.fixture(scope="module")
def chromium():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=FOUND, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def subject(tmp_path_factory):
    return write(tmp_path_factory.mktemp("view"), SUBJECT)


def write(folder, name):
    path = folder / "page.html"
    path.write_text(compose_page(open_target(name)), "utf-8")
    return path


@contextmanager
def opened(chromium, path, **settings):
    """Yield a page with all of its parts unfolded and all layers of the picture on."""
    with open_offline(chromium, path, **settings) as page:
        page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        for chip in page.locator("[aria-pressed=false][data-show]:visible").element_handles():
            chip.click()
        yield page


@pytest.fixture
def page(subject, chromium):
    with opened(chromium, subject) as window:
        window.click("[data-fit=whole]")  # the base too
        yield window


def get(page, expression):
    """Return the value of a JavaScript expression of the page."""
    return page.evaluate(f"((n) => ((s) => ({expression}))(n.state))(window.needlefit)")


def until(page, true):
    """Wait until an expression holds, and return the state."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if get(page, true):
            return get(page, "s")
        page.wait_for_timeout(20)
    raise AssertionError(f"never: {true}; {get(page, 's')}")


def enter(field, text):
    field.fill(text)
    field.press("Enter")


DEPTH, MU = "#insertion-fields .number >> nth=0", "#tissue-fields .number >> nth=1"


def test_the_errors_are_those_of_the_study_at_the_measured_depth(page):
    state, measured = get(page, "s"), get(page, "n.scene.measured")
    assert state["errors"]["whole"] and state["depth_mm"] == measured["depth_mm"]
    tip = np.array([state["tip"]["x"] - measured["x"][-1], state["tip"]["y"] - measured["y"][-1]])
    assert state["errors"]["te_mm"] == approx(np.linalg.norm(tip), abs=1e-3)
    enter(page.locator(MU), "700")
    after = until(page, "Math.abs(s.layers[0].mu_pa - 7e5) < 1")
    assert abs(after["errors"]["te_mm"] - state["errors"]["te_mm"]) > 0.01
    enter(page.locator(MU), "-5")
    assert "-5 kPa" in page.inner_text("#refusal")
    page.focus("#picture")
    assert get(page, "s.layers[0].mu_pa") == after["layers"][0]["mu_pa"]
    assert float(page.input_value(MU)) == approx(700)


@sweep
def test_keys_and_buttons_have_their_effects_and_are_undone(page):
    begun = get(page, "s")
    page.focus("#picture")
    for key, true in (
        ("ArrowLeft", f"Math.abs(s.depth_mm - {begun['depth_mm'] - 1}) < 1e-9"),
        ("Shift+ArrowRight", f"Math.abs(s.depth_mm - {begun['depth_mm'] - 0.9}) < 1e-9"),
        ("f", f"s.bevel.side === {-begun['bevel']['side']}"),
        ("k", "n.pinned"),
        ("ArrowUp", "Math.abs(s.base.input_y - 0.1) < 1e-9 && n.pinned.y[0] === 0"),
        ("Control+z", "s.base.input_y === 0"),
        ("Control+y", "s.base.input_y > 0"),
    ):
        page.keyboard.press(key)
        until(page, true)
    while page.is_enabled("#undo"):
        page.click("#undo")
    again = get(page, "s")
    assert {**again, "step": 0} == {**begun, "step": 0}


def test_the_picture_is_shifted_zoomed_and_goes_back(page):
    """By drag, by wheel once it has the focus, by a double click; the inset lies in the window."""
    box, before = page.locator("#picture").bounding_box(), get(page, "n.view.scale")
    page.mouse.move(box["x"] + 300, box["y"] + 120)
    page.mouse.wheel(0, -300)
    page.wait_for_timeout(200)
    assert get(page, "n.view.scale") == before  # the page's own
    page.mouse.down()
    page.mouse.move(box["x"] + 340, box["y"] + 140, steps=4)
    page.mouse.up()
    assert get(page, "[n.view.scale, n.view.fit]") == [before, "moved"]
    page.mouse.wheel(0, -300)
    until(page, f"n.view.scale > {1.9 * before}")
    page.mouse.dblclick(box["x"] + 300, box["y"] + 120)
    until(page, "n.view.fit === 'tissue'")
    for size in ((1280, 800), (320, 640)):
        page.set_viewport_size(dict(zip(("width", "height"), size, strict=True)))
        page.wait_for_timeout(300)
        left, top, width, height = max(get(page, "n.labels"), key=lambda one: one[2] * one[3])
        window = get(page, "n.view.box")
        assert left >= window["left"] and left + width <= window["left"] + window["width"]
        assert top >= window["top"] and top + height <= window["top"] + window["height"]


BYTES = """(({x, u, slope, constraints}) => {
    const byte = (one) => one.toString(16).padStart(2, '0');
    return [x, u, slope, constraints].map((array) => Array.from(new Uint8Array(array.buffer), byte).join(''));
})(n.steered.session.shape)"""
DROP = """([name, text]) => {
    const files = new DataTransfer();
    files.items.add(new File([text], name));
    dispatchEvent(new DragEvent("drop", { dataTransfer: files, cancelable: true }));
}"""


def test_a_drive_is_saved_replayed_reloaded_and_dropped_to_the_same_bits(page):
    page.focus("#picture")
    for key in ("ArrowUp", "f", "ArrowLeft", "ArrowLeft", "r", "ArrowRight"):
        page.keyboard.press(key)
    until(page, "s.z")
    page.focus("#tissue-fields .slider >> nth=0")
    for key in ("ArrowRight", "PageUp"):
        page.keyboard.press(key)
    assert page.locator("#above").is_visible()
    state = get(page, "s")
    with page.expect_download() as download:
        page.click("#save-recording")
    recording = read_recording(Path(download.value.path()))
    *_, last = replayed = list(replay(recording))
    assert [one.tip_offset_mm for one in replayed] == [0.0] * len(replayed)
    shape = last.state.shape
    assert state["tip"]["z"] == approx(shape.tip_z)
    u, slope = list_planes(shape)
    arrays = (shape.x, u, slope, shape.constraints[:, : 1 + len(u)])
    expected = [np.ascontiguousarray(one).tobytes().hex() for one in arrays]
    assert get(page, BYTES) == expected
    page.wait_for_timeout(600)
    page.reload()
    until(page, f"n?.state?.depth_mm === {state['depth_mm']}")
    assert get(page, BYTES) == expected
    page.click("#back")
    until(page, "s.base.y === 0")
    text = Path(download.value.path()).read_text()
    page.evaluate(DROP, ["drive.csv", text])
    until(page, f"n.replay && s.depth_mm === {state['depth_mm']}")
    assert get(page, BYTES) == expected and page.locator("#transport").is_visible()
    page.evaluate(DROP, ["other.csv", text.replace("length_mm = ", "length_mm = 1")])
    page.locator("#refusal:not(:empty)").wait_for()
    assert get(page, BYTES) == expected


@sweep
def test_a_thousand_random_actions_are_without_a_fault(subject, chromium):
    """`open_offline` fails at an error of the page; the needle is always one that can be read."""
    rng = default_rng(1)
    keys = [
        *"frk123+-",
        "ArrowLeft",
        "ArrowRight",
        "ArrowUp",
        "ArrowDown",
        "Control+z",
        "Control+y",
    ]
    with opened(chromium, subject) as page:
        fields = page.locator("#panel .number")
        for _ in range(1000):
            match rng.integers(10):
                case 0:
                    field = fields.nth(int(rng.integers(fields.count())))
                    if field.is_visible():
                        enter(field, f"{rng.normal(0, 10 ** rng.uniform(-1, 3)):.4g}")
                case 1:
                    sliders = page.locator("#panel .slider")
                    sliders.nth(int(rng.integers(sliders.count()))).fill(str(rng.integers(1001)))
                case 2:
                    chips = page.locator("[data-show]:visible")
                    chips.nth(int(rng.integers(chips.count()))).click()
                case _:
                    page.focus("#picture")
                    page.keyboard.press(str(rng.choice(keys)))
        assert np.isfinite(get(page, "s.y")).all()


SCENES = sorted(path.stem for path in Path("configs/scenes").glob("*.toml"))


@pytest.mark.parametrize(
    "name", ["figure1", *(pytest.param(one, marks=sweep) for one in SCENES if one != "figure1")]
)
def test_every_shipped_scene_opens(chromium, tmp_path, name):
    with opened(chromium, write(tmp_path, name)) as page:
        assert page.evaluate(ALL_STATES) == [1, 0]
        assert page.inner_text("#refusal") == "" and get(page, "s.depth_mm === n.scene.depth_mm")


SIZES = [(1440, 900), (1280, 720), (390, 844), (320, 640)]
OVERFLOWS = """[...document.querySelectorAll("button, label, dt, dd, p, h2, legend")].filter((one) =>
    one.checkVisibility() && !one.closest(".unseen") && one.scrollWidth > one.clientWidth + 1
    && getComputedStyle(one).display !== "inline").map((one) => [one.id, one.textContent.slice(0, 30)])"""
SMALL = """[...document.querySelectorAll("button, input, select")].filter((one) => one.checkVisibility())
    .map((one) => [one.id || one.className, one.getBoundingClientRect()])
    .filter(([, { width, height }]) => width > 0 && Math.min(width, height) < 24).map(([name]) => name)"""


@pytest.mark.parametrize("size", [pytest.param(one, marks=sweep) if one[0] != 390 else one for one in SIZES])
def test_nothing_is_cut_off_or_covered_at_any_size(subject, chromium, size):
    """Labels lie apart and in the window; the needle uses its height; nothing runs off the page."""
    viewport = dict(zip(("width", "height"), size, strict=True))
    with opened(chromium, subject, viewport=viewport, has_touch=size[0] < 400) as page:
        for name in ("whole", "tissue", "tip"):
            page.click(f"[data-fit={name}]")
            page.wait_for_timeout(400)
            boxes = np.array(get(page, "n.labels"))
            window = get(page, "n.view.box")
            low, high = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
            assert (low >= [window["left"], window["top"]]).all()
            ends = [window["left"] + window["width"], window["top"] + window["height"]]
            assert (high <= ends).all()
            for n in range(len(boxes)):
                apart = (high[:n] <= low[n]).any(axis=1) | (low[:n] >= high[n]).any(axis=1)
                assert apart.all(), (name, boxes.tolist())
            if name == "tip":
                continue
            rises = "(Math.max(...s.y) - Math.min(...s.y)) * n.view.scale * n.view.magnified"
            until(page, f"{rises} > 0.25 * n.view.box.height")
        assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
        assert page.evaluate(OVERFLOWS) == [] and page.evaluate(SMALL) == []


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=sweep)])
def test_axe_finds_no_violation(subject, chromium, scheme):
    with opened(chromium, subject, color_scheme=scheme, bypass_csp=True) as page:
        require_accessible(page)


def save_figure(page, width, form):
    page.select_option("#figure-width", width)
    page.select_option("#figure-format", form)
    with page.expect_download() as download:
        page.click("#save-figure")
    return Path(download.value.path()).read_bytes()


@sweep
def test_a_saved_figure_has_its_width_and_light_paper(subject, chromium):
    """Text is text."""
    with opened(chromium, subject, color_scheme="dark") as page:
        drawing = ElementTree.fromstring(save_figure(page, "84", "svg"))
        assert drawing.get("width") == "84mm"
        texts = [one.text or "" for one in drawing.iter("{http://www.w3.org/2000/svg}text")]
        assert any(text.startswith("y (mm)") for text in texts)
        with Image.open(io.BytesIO(save_figure(page, "84", "png"))) as picture:
            assert picture.width == approx(84 / 25.4 * 300, abs=1)
            assert min(picture.convert("RGB").getpixel((2, picture.height - 2))) > 240  # on light paper
