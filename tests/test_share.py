"""A shared recording: one file that computes its needle in a browser, without server and network."""

import json
import math
import re
from pathlib import Path

import pytest
from page_files import ALL_STATES, open_offline, read_page_data
from test_cli import run
from test_page import NO_BROWSER, chromium  # noqa: F401 - a fixture
from test_viewer_recording import read

from needlefit.mechanics.scene import Scene
from needlefit.planning.steered_needle import (
    RecordedStep,
    Recording,
    SteeredNeedle,
    read_recording,
    write_recording,
)
from needlefit.reporting.needle_page import kernel_exists
from needlefit.viewer.opening import open_recording, open_target
from needlefit.viewer.page_needle import compose_page

HOSTILE = "</script><img src=x onerror=alert(1)> {{data}}"
RECORDING = Path(__file__).parent.parent / "docs/figures/steering.csv"
pytestmark = pytest.mark.skipif(not kernel_exists(), reason="a system compiler has built no WebAssembly")


def compose(path):
    """Return the page of a recording."""
    recording = read_recording(path)
    return compose_page(open_recording(recording), recording)


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    path = tmp_path_factory.mktemp("share") / "steering.html"
    path.write_text(compose(RECORDING), "utf-8")
    return path


@pytest.fixture(scope="module")
def tabulated(tmp_path_factory):
    """A recording under a law that is a table, whose parameters change, of a scene with a hostile title."""
    folder = tmp_path_factory.mktemp("gent")
    scene = (Path(__file__).parent.parent / "configs/scenes/phantom2.toml").read_text("utf-8")
    scene = re.sub(r"(?m)^alpha = .*$", "shape = { jm = 5.0 }", scene).replace(
        "depth_mm", 'law = "gent"\ndepth_mm', 1
    )
    scene = re.sub(r"(?m)^title = .*$", f"title = '{HOSTILE}'", scene)
    (folder / "gent.toml").write_text(scene, "utf-8")
    shown = open_target(str(folder / "gent.toml"))
    needle = SteeredNeedle(Scene.from_record(shown.record), shown.first_cell)
    steps = []
    for changes in read("1,depth_mm,,30\n2,jm,1,2\n3,jm,2,0.9\n4,jm,1,5\n5,depth_mm,,50"):
        tip, number = needle.apply(changes).shape.tip_lateral, len(steps) + 1
        steps.append(RecordedStep(number, 0.1 * number, changes, tip))
    write_recording(Recording(shown.make_head(), tuple(steps)), folder / "gent.csv")
    return folder / "gent.csv"


def test_the_file_holds_the_recording_and_no_address(shared):
    text = shared.read_text("utf-8")
    (needle,) = read_page_data(text)["needles"]
    recording = read_recording(RECORDING)
    assert [step[2] for step in needle["recording"]] == [step.tip_lateral for step in recording.steps]
    assert needle["scene"]["simulation"]["model"]["firstCell"] == recording.head.first_cell_mm
    assert not re.search(r"https?:(?!//www.w3.org/2000/svg)", text.replace("\\\n", ""))


def test_laws_that_are_tables_come_along(tabulated):
    text = compose(tabulated)
    (needle,) = read_page_data(text)["needles"]
    assert "<img" not in text and needle["scene"]["title"] == HOSTILE
    law = needle["scene"]["simulation"]["law"]
    assert law["terms"] is None
    assert [shape for shape, _ in law["tables"]] == [[[2, 5, 5, 5]], [[2, 0.9, 5, 5]], [[5, 0.9, 5, 5]]]


@NO_BROWSER
def test_the_depth_is_dragged_along_the_page_of_a_plan(chromium, tmp_path, capsys):  # noqa: F811
    assert run("plan phantom2 --target 45,2 --obstacle 25,3,0.8 --turns 0 --json --out", tmp_path) == 0
    plan = json.loads(capsys.readouterr().out)
    with open_offline(chromium, Path(plan["page"])) as page:
        count, largest = page.evaluate(ALL_STATES)
        assert count >= 45 and largest == 0
        assert page.evaluate("needlefit.scene.plan.target") == [45.0, 2.0]
        assert page.evaluate("needlefit.scene.plan.obstacles[0].slice(0, 3)") == [25.0, 3.0, 0.8]
        assert len(page.evaluate("needlefit.scene.plan.needles")) >= 1
        ends = page.evaluate("[needlefit.state.x.at(-1), needlefit.state.y.at(-1)]")
        for depth in (12.0, plan["steps"][-1]["depth_mm"]):
            page.locator("#scrub").fill(str(depth) if depth == 12.0 else page.get_attribute("#scrub", "max"))
            assert page.evaluate("needlefit.state.depth_mm") == pytest.approx(depth, abs=1.0)
        assert page.evaluate("[needlefit.state.x.at(-1), needlefit.state.y.at(-1)]") == ends
        assert math.dist(ends, (45.0, 2.0)) == pytest.approx(plan["nominal_miss_mm"], abs=1e-3)
