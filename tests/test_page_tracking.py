"""The page of a tracked needle in a real browser: the estimate, what freezes it, and its release."""

import socket
import time

import numpy as np
import pytest
from openigtlink_cases import connect, pack, tip_path, transform
from test_page import NO_BROWSER, Server, chromium, find_violations  # noqa: F401 - a fixture

pytestmark = [pytest.mark.sweep, NO_BROWSER]


@pytest.fixture
def served(tmp_path):
    """Yield the address of a page, and a connection that receives nothing but sends poses."""
    (tmp_path / "tracker.toml").write_text(f"schema = 1\ntracker_to_ras = {np.eye(4).tolist()}\n")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    tracker = ("--openigtlink", str(port), "--tracker", str(tmp_path / "tracker.toml"))
    running = Server(tmp_path, "phantom2", *tracker)
    with connect(port) as link:
        yield running.address, link
    running.end()


def test_the_estimate_is_shown_frozen_by_a_jump_and_released(served, chromium):  # noqa: F811
    from playwright.sync_api import expect

    address, link = served
    page, faults = chromium.new_page(viewport={"width": 1280, "height": 900}), []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto(address)
    expect(page.locator("#research")).to_be_visible()
    for tip in tip_path()[:30]:
        link.sendall(pack("Tip", transform(tip)))
        time.sleep(0.06)
        page.wait_for_timeout(1)
    link.sendall(pack("Tip", transform(tip_path()[55])))
    expect(page.locator("#tracking-frozen")).to_contain_text("jumped")
    expect(page.locator("#frozen")).to_be_visible()
    assert page.evaluate("window.needlefit.state.depth_mm") == pytest.approx(30, abs=1)  # not begun by itself
    assert page.locator("#tracking-estimate div").count() == 5
    assert page.inner_text("#by-hand") == ""
    assert find_violations(page) == []
    page.click("#tracking-release")
    link.sendall(pack("Tip", transform(tip_path()[30])))
    expect(page.locator("#tracking-frozen")).not_to_contain_text("jumped")
    page.click("#tracking-forget")
    expect(page.locator("#tracking-note")).to_contain_text(" 0 tip readings")
    page.close()
    assert faults == []
