"""What figures count and measure, apart from how they look."""

import re

import numpy as np
import pandas as pd
import pytest
from reporting_results import stereo, study, with_draws, with_predictions

from needlefit.studies.kinds.cross_validation import figures
from needlefit.studies.kinds.cross_validation.facts import describe_counts
from needlefit.studies.kinds.cross_validation.figures import collect_curves, subtract_fit


def test_residuals_are_heights_above_the_fit_at_the_same_depth():
    """The fit is y = x / 10 to x = 10; a method lies 0.5 mm above it, at other depths and beyond its tip."""
    fit = pd.DataFrame({"curve": "fitted", "x_mm": [0.0, 4.0, 10.0], "y_mm": [0.0, 0.4, 1.0]})
    at = np.array([-1.0, 1.0, 7.0, 12.0])
    method = pd.DataFrame({"curve": "hand_tuned", "x_mm": at, "y_mm": 0.1 * at + 0.5})
    band = pd.DataFrame({"curve": "95 %", "x_mm": at, "low_mm": 0.1 * at - 1, "high_mm": 0.1 * at + 2})
    off = subtract_fit(pd.concat([fit, method, band]).assign(fold="all", insertion="one"))
    assert set(off["curve"]) == {"hand_tuned", "95 %"}
    assert off["y_mm"].dropna().tolist() == pytest.approx([0.5] * 4)
    assert off["low_mm"].dropna().tolist() == pytest.approx([-1.0] * 4)
    assert off["high_mm"].dropna().tolist() == pytest.approx([2.0] * 4)


def test_starts_are_counted_as_each_search_had_them():
    assert re.findall(r"\d+ \w+", describe_counts(study(5).frames["starts"])) == ["8 starts", "2 searches"]
    assert re.findall(r"\d+ \w+", describe_counts(stereo().frames["starts"])) == ["8 starts", "3 folds"]
    assert describe_counts(stereo().frames["starts"].query("fold == 1")) == "8 starts"


def test_bands_stay_at_the_needle_they_were_predicted_for():
    """Tilted by what the frames of score and prediction differ, a band keeps its distances to the needle."""
    results = with_predictions(with_draws(study(5)))
    tilted = results.frames["bands"].copy()
    for name in ("measured_mm", "low_95_mm", "high_95_mm", "low_50_mm", "high_50_mm"):
        tilted[name] += 0.01 * tilted["x_mm"]
    drawn, again = (
        collect_curves(one, "validate", ("fitted",)) for one in (results, results.with_frames(bands=tilted))
    )
    assert (drawn["curve"] == "95 %").any()
    for name in ("low_mm", "high_mm"):
        assert again[name].dropna().tolist() == pytest.approx(drawn[name].dropna().tolist())


def test_all_panels_have_the_stated_vertical_scale(monkeypatch, tmp_path):
    painted = []
    monkeypatch.setattr("needlefit.reporting.figures.style.draw", lambda path, paint: painted.append(paint()))
    for results in (study(5), stereo()):
        figures.draw_insertions(results, "validate")["overlays"].save(tmp_path / "overlays.pdf")
    shown = [axes for figure in painted for axes in figure.axes if axes.get_visible()]
    assert shown and {axes.get_aspect() for axes in shown} == {5.0, 20.0}
    assert [re.findall(r"× (\d+)", one.get_supylabel()) for one in painted] == [["20"], ["5"]]
