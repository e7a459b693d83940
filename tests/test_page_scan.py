"""The page of a scan in a real browser: look, correct, reconstruct again, save."""

import re

import pytest
from test_cli import run
from test_page import FOUND, Server, chromium  # noqa: F401 - a fixture

from needlefit.datasets.read import read

pytestmark = [pytest.mark.slow, pytest.mark.skipif(FOUND is None, reason="no browser is installed")]

PATIENCE_MS = 90_000


@pytest.fixture
def server(tmp_path):
    running = Server(tmp_path, "sample_scan")
    yield running
    running.end()


def inserted(page) -> float:
    from playwright.sync_api import expect

    expect(page.locator("#verdict")).to_contain_text("inserted", timeout=PATIENCE_MS)
    return float(re.search(r"inserted ([\d.]+)", page.inner_text("#verdict"))[1])


def test_a_placed_tip_is_used_saved_and_repeated(server, chromium, tmp_path, monkeypatch):  # noqa: F811
    from playwright.sync_api import expect

    faults: list[str] = []
    page = chromium.new_page(viewport={"width": 1400, "height": 1000})
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
    page.goto(server.address)
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
    page.click("#again")
    expect(page.locator("#save")).to_be_enabled(timeout=PATIENCE_MS)
    shorter = inserted(page)
    assert shorter == pytest.approx(found - 2.0, abs=0.3)
    page.click("#save")
    page.wait_for_selector("#saved code", timeout=PATIENCE_MS)
    words = page.inner_text("#saved code").split()
    assert words[:2] == ["needlefit", "reconstruct"]
    page.keyboard.press("Control+z")
    expect(page.locator("#again")).to_be_enabled()
    assert not faults
    page.close()
    monkeypatch.chdir(tmp_path)
    assert run(*words[1:], "-q") == 0
    (insertion,) = read(tmp_path / "sample_dataset").insertions
    assert insertion.depth == pytest.approx(shorter, abs=0.006)
