"""The page of a report that computes its needles: its modules, its data, and what it shows in a browser."""

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from page_files import ALL_STATES, change_page_data, open_offline, read_page_data, require_accessible
from pytest import approx
from test_page import NO_BROWSER, chromium  # noqa: F401 - a fixture
from test_viewer_placement import fitted

from needlefit.reporting import needle_page
from needlefit.reporting.document import compile_html
from needlefit.schemas.run_metadata import NeedleMetadata
from needlefit.studies.explorer import collect_explorer
from needlefit.studies.report import compose_run_report

pytestmark = pytest.mark.skipif(
    not needle_page.kernel_exists(), reason="a system compiler has built no WebAssembly"
)
ROOT = Path(__file__).parents[1]
MOST_BYTES = 1_500_000
HOSTILE = "</script><img src=x onerror=alert(1)>"


@pytest.fixture(scope="module")
def result(world):
    """A run with a second held-out insertion, a copy of the first with a hostile name."""
    run = world.restore("cross_validation")
    known = run.metadata
    first = known.folds[0].held_out[0]
    name, frames = first + HOSTILE, dict(run.frames)
    for key in ("errors", "shapes"):
        copy = frames[key][frames[key]["insertion"] == first].assign(insertion=name)
        frames[key] = pd.concat([frames[key], copy])
    stated = {
        key: {**getattr(known, key), name: getattr(known, key)[first]} for key in ("insertions", "layers")
    }
    return replace(run.with_metadata(**stated), frames=frames, dataset_title=HOSTILE)


@pytest.fixture(scope="module")
def page(result, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_bytes(compile_html(compose_run_report(result, {})))
    return path


@pytest.mark.skipif(not (ROOT / "node_modules/.bin/tsc").exists(), reason="`npm ci` has installed no tsc")
def test_the_bundle_is_that_of_the_modules_and_their_types_agree():
    subprocess.run(["npm", "run", "--silent", "check"], cwd=ROOT, check=True, timeout=300)


def test_the_page_holds_every_scored_insertion(page, result):
    text = page.read_text("utf-8")
    needles, errors = read_page_data(text)["needles"], result.frames["errors"]
    scored = errors.query("role == 'validate' and boundaries == 'measured' and method == 'fitted'")
    assert [one["scene"]["measured"]["id"] for one in needles] == scored["insertion"].tolist()
    assert [one["errors"]["te_mm"] for one in needles] == scored["te_mm"].tolist()
    judged = errors.query("role == 'validate' and boundaries == 'measured' and method == 'prediction'")
    judged = judged.set_index("insertion")["te_mm"]
    assert len(judged) == len(needles)
    for one in needles:
        measured = one["scene"]["measured"]
        assert measured["prediction"]["errors"]["te_mm"] == judged[measured["id"]]
        draws = one["scene"]["draws"]
        layers = len(one["scene"]["layer_names"])
        assert len(draws["mu"]) == layers * draws["sets"] and len(draws["strength"]) == draws["sets"] <= 200
    assert len(text) < MOST_BYTES and HOSTILE not in text
    assert not re.search(r"(src|href)=\"https?:", re.sub(r"<script.*?</script>", "", text, flags=re.DOTALL))


def test_each_insertion_of_the_page_has_its_needle(result):
    known = result.metadata
    thin = NeedleMetadata(length=140.0, flexural_rigidity=2e3, outer_diameter=0.7)
    needles = {"18G": known.dataset.needle, "22G": thin}
    page = collect_explorer(
        result.with_metadata(
            dataset=known.dataset.model_copy(update={"needle": None, "needles": needles}),
            insertions={
                name: stored.model_copy(update={"needle": "22G" if HOSTILE in name else "18G"})
                for name, stored in known.insertions.items()
            },
        )
    )
    found = {
        (
            HOSTILE in scene["measured"]["id"],
            scene["simulation"]["model"]["rigidity"],
            scene["length_mm"],
            scene["diameter_mm"],
        )
        for scene in (one["scene"] for one in page.needles)
    }
    assert found == {(False, known.dataset.needle.flexural_rigidity, 150.0, 1.27), (True, 2e3, 140.0, 0.7)}


@NO_BROWSER
def test_predictions_and_reports_of_runs_have_their_needles(world, result, chromium, tmp_path):  # noqa: F811
    predicted = world.restore("prediction")
    (needle,) = collect_explorer(predicted).needles
    forecast = predicted.frames["forecast"]
    assert needle["tip"] == approx(forecast["needle_predicted_mm"].iloc[-1], abs=1e-3)
    assert needle["scene"]["depth_mm"] == forecast["s_mm"].iloc[-1]
    assert needle["scene"]["draws"]["sets"] == len(next(iter(predicted.metadata.drawn.values())))
    page = tmp_path / "report.html"
    page.write_bytes(compile_html(compose_run_report(predicted, {})))
    with open_offline(chromium, page) as window:
        assert window.evaluate(ALL_STATES) == [1, 0]


@pytest.mark.sweep
@NO_BROWSER
@pytest.mark.usefixtures("few_draws")
@pytest.mark.parametrize(
    ("pose", "compared"),
    [
        *[("known", "plane"), ("direction", "plane"), ("free", "plane")],
        *[("known", "space"), ("direction", "space")],
    ],
)
def test_a_report_of_every_pose_computes_its_needles(pose, compared, chromium, tmp_path, monkeypatch):  # noqa: F811
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "report.html"
    results = fitted(tmp_path, pose, compared)
    path.write_bytes(compile_html(compose_run_report(results, {})))
    with open_offline(chromium, path) as window:
        count, largest = window.evaluate(ALL_STATES)
        assert count == len(read_page_data(path.read_text("utf-8"))["needles"]) > 0 and largest < 1e-12
        assert window.evaluate("needlefit.scene.measured.target.pose") == pose
        names = window.evaluate("needlefit.scene.measured.metrics.map(([name]) => name)")
        assert window.evaluate("needlefit.scene.measured.compared") == compared and len(names) == 3
        errors = results.frames["errors"]
        errors = errors.query("role == 'validate' and method == 'fitted' and boundaries == 'measured'")
        row = errors.set_index("insertion").loc[window.evaluate("needlefit.scene.measured.id")]
        found = [window.evaluate(f"needlefit.state.errors.{name}") for name in names]
        assert found == approx(row[names].tolist())
        assert "good" in window.get_attribute("#proof", "class")
        assert window.is_visible("#above") == (compared == "space")


@pytest.mark.sweep
@NO_BROWSER
@pytest.mark.parametrize("kind", ["place", "error"])
def test_a_stored_number_that_was_changed_fails_the_self_check(page, chromium, tmp_path, kind):  # noqa: F811
    def change(data):
        needle = data["needles"][0]
        values, key = {
            "place": (needle["scene"]["measured"]["stored"]["y"], 50),
            "error": (needle["errors"], "te_mm"),
        }[kind]
        values[key] += 0.001  # mm

    copy = tmp_path / "copy.html"
    copy.write_text(change_page_data(page.read_text("utf-8"), change), "utf-8")
    with open_offline(chromium, copy) as window:
        assert window.evaluate(ALL_STATES)[1] == approx(0.001)
        assert "bad" in window.get_attribute("#proof", "class") and window.is_visible("#proof")


@pytest.mark.sweep
@NO_BROWSER
@pytest.mark.parametrize("size", [(1440, 900), (390, 844)])
def test_the_page_is_accessible(page, chromium, size):  # noqa: F811
    width, height = size
    settings = {"viewport": {"width": width, "height": height}, "bypass_csp": True}
    with open_offline(chromium, page, **settings) as window:
        require_accessible(window)
        assert window.evaluate("document.documentElement.scrollWidth") <= width
        window.evaluate("document.getElementById('picture').scrollIntoView()")
        for part in ("#picture", "#flip"):  # both are in one window
            box = window.locator(part).bounding_box()
            assert box["y"] >= -1 and (box["y"] + box["height"] <= height + 1 or width < 400)


WIDTHS = (320, 390, 768, 1024, 1200, 1280, 1440)  # px of a window
PAGE_ONE = ".first .wide:has(table)"
CUT = """(tables) => [...document.querySelectorAll(tables)].filter((one) =>
  one.scrollWidth > one.clientWidth).map((one) => one.ariaLabel)"""


@NO_BROWSER
def test_no_table_of_page_one_is_wider_than_its_column(page, chromium):  # noqa: F811
    with open_offline(chromium, page) as window:
        assert window.locator(PAGE_ONE).count() >= 2
        for width in WIDTHS:
            window.set_viewport_size({"width": width, "height": 900})
            window.wait_for_timeout(100)
            assert window.evaluate(CUT, PAGE_ONE) == [], width
