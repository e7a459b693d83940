"""A shared recording: one file, which plays in a browser without a server and asks for nothing."""

import json
import re
from pathlib import Path

import pytest
from test_cli import run
from test_page import NO_BROWSER, chromium  # noqa: F401 - a fixture

from needlefit.viewer.export import MAX_SHARED_STATES, compose_share, export
from needlefit.viewer.recording import read_recording, replay

RECORDING = Path(__file__).parent.parent / "docs/figures/steering.csv"


@pytest.fixture(scope="module")
def shared(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("share") / "steering.html"
    path.write_text(compose_share(read_recording(RECORDING)), "utf-8")
    return path


def test_the_file_holds_the_states_of_the_recording(shared) -> None:
    text = shared.read_text("utf-8")
    data = json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1])
    steps = list(replay(read_recording(RECORDING)))
    assert len(data["states"]) == len(steps) <= MAX_SHARED_STATES
    for n in (0, 40, -1):
        state, band = data["states"][n]
        assert state["tip"]["lateral_mm"] == steps[n].state.shape.tip_lateral and band is None
    assert "http:" not in re.sub(r"http://www\.w3\.org\S*", "", text) and "https:" not in text
    assert text.encode() == export(RECORDING, "share.html")


def test_a_scene_is_not_shared(tmp_path) -> None:
    assert run("simulate", "phantom2", "--html", str(tmp_path / "a.html")) == 2


@pytest.mark.sweep
@NO_BROWSER
def test_it_plays_from_a_file_without_requests(shared, chromium) -> None:  # noqa: F811
    page = chromium.new_page(viewport={"width": 1000, "height": 800})
    asked, faults = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.on("console", lambda message: message.type == "error" and faults.append(message.text))
    page.goto(shared.as_uri())
    slider, last = page.locator("#scrub"), len(list(replay(read_recording(RECORDING)))) - 1
    page.get_by_role("button", name="Pause").click()  # it plays by itself
    slider.fill(str(last))
    depth, synthetic = page.evaluate("[window.needlefit.state.depth_mm, window.needlefit.scene.synthetic]")
    assert f"{depth:.2f}" in page.inner_text("#readouts")
    assert page.locator("#synthetic").is_visible() is synthetic
    assert page.locator("#inputs .term", has_text=re.compile("^b$")).count() == 1
    slider.fill("10")
    assert page.evaluate("window.needlefit.state.depth_mm") < depth
    page.hover("#readouts .term >> nth=0")
    page.locator("#definition").wait_for(state="visible")
    assert page.evaluate(
        "(() => { const c = document.getElementById('canvas').getContext('2d');"
        " const { width, height } = c.canvas;"
        " return c.getImageData(0, 0, width, height).data.some((one) => one > 0); })()"
    )  # something is drawn
    page.get_by_role("button", name="Play").click()
    page.wait_for_timeout(1500)
    assert int(slider.input_value()) > 10
    page.close()
    assert faults == [] and {url.partition(":")[0] for url in asked} <= {"file", "data"}
    assert sum(url.startswith("file:") for url in asked) == 1
