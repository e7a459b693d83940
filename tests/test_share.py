"""A shared recording: one file that computes its needle in a browser, without server and network."""

import re
from pathlib import Path

import pytest
from page_files import ALL_STATES, open_offline, read_page_data
from test_cli import run
from test_page import NO_BROWSER, chromium  # noqa: F401 - a fixture

from needlefit.reporting.needle_page import PageData, compose_file, kernel_exists
from needlefit.viewer.export import compose_share, export
from needlefit.viewer.recording import read_recording, replay

RECORDING = Path(__file__).parent.parent / "docs/figures/steering.csv"
pytestmark = pytest.mark.skipif(not kernel_exists(), reason="a system compiler has built no WebAssembly")


@pytest.fixture(scope="module")
def shared(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("share") / "steering.html"
    path.write_text(compose_share(read_recording(RECORDING)), "utf-8")
    return path


def test_the_file_holds_the_recording_and_no_address(shared) -> None:
    text = shared.read_text("utf-8")
    (needle,) = read_page_data(text)["needles"]
    recording = read_recording(RECORDING)
    assert [step[2] for step in needle["recording"]] == [step.tip_lateral for step in recording.steps]
    assert needle["scene"]["simulation"]["model"]["firstCell"] == recording.head.first_cell_mm
    assert not re.search(r"https?:", text)
    assert text.encode() == export(RECORDING, "share.html")


def test_hostile_names_are_escaped() -> None:
    hostile = "</script><img src=x onerror=alert(1)> {{data}}"
    data = PageData({"needlefit": hostile})
    text = compose_file(hostile, hostile, data)
    assert "<img" not in text and read_page_data(text)["needlefit"] == hostile


def test_a_scene_is_not_shared(tmp_path) -> None:
    assert run("simulate", "phantom2", "--html", str(tmp_path / "a.html")) == 2


@pytest.mark.sweep
@NO_BROWSER
def test_it_computes_every_recorded_state_and_can_be_steered(shared, chromium) -> None:  # noqa: F811
    states = list(replay(read_recording(RECORDING)))
    with open_offline(chromium, shared) as page:
        largest = max(one.tip_offset_mm for one in states)  # of this very replay
        assert page.evaluate(ALL_STATES) == [len(states) - 1, largest]
        assert page.evaluate("needlefit.state.tip.lateral_mm") == states[-1].state.shape.tip_lateral
        page.locator("#scrub").fill("10")
        page.wait_for_timeout(300)
        assert page.evaluate("needlefit.state.tip.lateral_mm") == states[10].state.shape.tip_lateral
        side = page.evaluate("needlefit.state.bevel.side")
        page.click("#flip")
        assert page.evaluate("needlefit.state.bevel.side") == -side
        page.focus("#canvas")
        before = page.evaluate("needlefit.state.depth_mm")
        page.keyboard.press("ArrowRight")
        assert page.evaluate("needlefit.state.depth_mm") == pytest.approx(before + 1)
        page.click("#back")
        page.wait_for_timeout(300)
        assert page.evaluate("needlefit.state.tip.lateral_mm") == states[-1].state.shape.tip_lateral
        page.get_by_role("button", name="Play").click()
        page.wait_for_timeout(1500)
        assert int(page.locator("#scrub").input_value()) > 0
