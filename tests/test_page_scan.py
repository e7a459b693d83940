"""The page of a scan in a real browser: look, correct, reconstruct again, save."""

import re
from contextlib import contextmanager

import pandas as pd
import pytest
from test_cli import run
from test_page import NO_BROWSER, Server, chromium, find_violations  # noqa: F401 - a fixture

from needlefit.datasets.read import read

pytestmark = [pytest.mark.sweep, NO_BROWSER]

PATIENCE_MS = 90_000


def expect(part):
    from playwright.sync_api import expect

    return expect(part)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    running = Server(tmp_path_factory.mktemp("view"), "sample_scan")
    yield running
    running.end()


@contextmanager
def opened(chromium, server, **settings):  # noqa: F811
    """Yield the page of the scan as found; a fault of its scripts fails the test."""
    context = chromium.new_context(**({"viewport": {"width": 1280, "height": 800}} | settings))
    page, faults = context.new_page(), []
    page.on("pageerror", lambda error: faults.append(str(error)))

    def note(message):  # a refused correction is no fault
        if message.type == "error" and "status of 422" not in message.text:
            faults.append(message.text)

    page.on("console", note)
    page.goto(server.address)
    inserted(page)
    if page.is_enabled("#clear"):
        page.click("#clear")
        page.click("#again")
        inserted(page)
    yield page
    context.close()
    assert faults == []


def remove_balls(page) -> int:
    count = 0
    while page.locator("[aria-label='remove ball 1']").count():
        page.click("[aria-label='remove ball 1']")
        count += 1
    return count


def inserted(page) -> float:
    expect(page.locator("#verdict")).to_contain_text("inserted", timeout=PATIENCE_MS)
    return float(re.search(r"inserted ([\d.]+)", page.inner_text("#verdict"))[1])


def test_a_placed_tip_is_used_saved_and_repeated(server, chromium, tmp_path, monkeypatch):  # noqa: F811
    with opened(chromium, server) as page:
        found = inserted(page)
        assert page.locator("#views canvas").count() == 4
        assert page.is_disabled("#again") and page.is_disabled("#save")
        page.keyboard.press("t")
        canvas = page.locator("figure.needle canvas")
        box = canvas.bounding_box()
        # the slice begins where the needle does
        length = page.evaluate(
            "fetch('/scan/describe', {method: 'POST', body: '{}', headers: {Authorization: 'Bearer ' + "
            "sessionStorage.getItem('needlefit.token')}}).then(a => a.json()).then(d => [d.inserted.length, "
            "d.course.points.length * d.course.pixel])"
        )
        canvas.click(position={"x": box["width"] * (length[0] - 2.0) / length[1], "y": box["height"] / 2})
        expect(page.locator(".waiting")).to_be_visible()
        page.click("#again")
        expect(page.locator("#save")).to_be_enabled(timeout=PATIENCE_MS)
        shorter = inserted(page)
        assert shorter == pytest.approx(found - 2.0, abs=0.3)
        page.click("#save")
        page.wait_for_selector("#verdict code", timeout=PATIENCE_MS)
        words = page.inner_text("#verdict code").split()
        assert words[:2] == ["needlefit", "reconstruct"]
        page.keyboard.press("Control+z")
        expect(page.locator("#again")).to_be_enabled()
    monkeypatch.chdir(tmp_path)
    assert run(*words[1:], "-q") == 0
    (insertion,) = read(tmp_path / "sample_dataset").insertions
    assert insertion.depth == pytest.approx(shorter, abs=0.006)
    assert pd.read_csv(tmp_path / "sample_dataset" / "remarks.csv")["note"].str.contains("tip").any()


def test_without_balls_the_page_names_what_is_needed_and_goes_on(server, chromium):  # noqa: F811
    with opened(chromium, server) as page:
        count = remove_balls(page)
        page.click("#again")
        expect(page.locator("#verdict")).to_contain_text("3", timeout=PATIENCE_MS)
        expect(page.locator("#verdict")).to_have_class("refused")
        expect(page.locator("#again")).to_be_enabled()
        for _ in range(count):
            page.click("#undo")
        assert page.is_disabled("#again") and page.locator("#views canvas").count() == 4


def test_a_tip_is_placed_by_keys_alone(server, chromium):  # noqa: F811
    with opened(chromium, server) as page:
        page.focus("figure.coronal canvas")
        page.keyboard.press("t")
        places = []
        for _ in range(2):
            page.keyboard.press("ArrowDown")
            places.append(re.findall(r"[LPS] (-?[\d.]+)", page.inner_text("#hint")))
        assert float(places[0][2]) - float(places[1][2]) == pytest.approx(0.46, abs=0.11)
        page.keyboard.press("Enter")
        expect(page.locator("#again")).to_be_enabled()
        assert page.is_disabled("[data-tool=contact]")  # the table states the entry


@pytest.mark.parametrize(
    "settings", [{}, {"color_scheme": "dark"}, {"viewport": {"width": 390, "height": 844}}]
)
def test_axe_finds_no_violation(server, chromium, settings):  # noqa: F811
    with opened(chromium, server, **settings) as page:
        found = find_violations(page)
        remove_balls(page)
        page.click("#again")
        page.wait_for_selector("#verdict.refused", timeout=PATIENCE_MS)
        found += find_violations(page)
        small = page.evaluate(
            """[...document.querySelectorAll("button, input, select")].filter((one) => one.checkVisibility())
            .map((one) => [one.outerHTML, one.getBoundingClientRect()])
            .filter(([, { width, height }]) => Math.min(width, height) < 24).map(([name]) => name)"""
        )
        wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
    assert found == small == [] and wide <= 0
