"""What figures count and measure, apart from how they look."""

import pandas as pd
import pytest
from matplotlib.figure import Figure
from reporting_results import study, with_frames, with_predictions

from needlefit.reporting import fonts
from needlefit.reporting.figures import style, tip_track
from needlefit.studies import fit_figures
from needlefit.studies.fit_figures import draw_predictive_check
from needlefit.studies.run import FitFrames


def test_letters_that_no_font_has_are_written_as_their_numbers(monkeypatch):
    assert fonts.find_lacking("Nädel, игла, μ₁ − 针1") == {"针"}
    monkeypatch.setattr(fonts, "find_fonts", lambda _: {})  # whatever is installed
    assert fonts.spell("针A 针一") == "[U+9488]A [U+9488][U+4E00]"

    def paint():
        figure = Figure(figsize=(4, 2))
        axes = figure.add_subplot(title="针二")
        axes.set_yticks([0.0, 1.0], ["针一", "игла"])
        figure.draw_without_rendering()
        return figure

    drawn = style.paint_bytes(paint, ".svg").decode()
    for name in ("[U+9488][U+4E00]", "[U+9488][U+4E8C]", "игла"):
        assert name in drawn
    assert "针" not in drawn


def test_the_band_of_pit_values_is_that_of_independent_trials():
    """One specimen has none; two of several needles have limits between counts."""
    predictive = with_predictions(study(1)).frames["predictive"]
    single = predictive.assign(fold=predictive["insertion"], hole=predictive["insertion"])
    ends = {}
    for specimens in (1, 2, 7):
        named = single.assign(specimen=[f"p{n % specimens}" for n in range(len(single))])
        rows = draw_predictive_check(with_frames(study(1), predictive=named)).frame
        ends[specimens] = rows[rows["mark"] == "band"]
    assert len(ends[1]) == 0
    assert ends[2]["low"].iloc[[0, -1]].tolist() == [0, 0.25]
    assert ends[2]["high"].iloc[[0, -1]].tolist() == [0.75, 1]
    counts = 7 * ends[7]["high"]
    assert counts.tolist() == pytest.approx(counts.round().tolist())


def test_of_many_insertions_panels_are_drawn_at_equal_steps_of_the_rank_of_their_errors(monkeypatch):
    run = study(5)
    errors = FitFrames.of(run).select_errors(method="fitted").sort_values("te_mm")
    monkeypatch.setattr(fit_figures, "MAX_PANELS", 3)
    drawing = fit_figures.draw_overlays(run)
    ranked = list(zip(errors["fold"], errors["insertion"], strict=True))
    assert len(ranked) == 9 and set(drawing.options["heads"]) == {ranked[0], ranked[4], ranked[8]}
    assert set(drawing.frame["insertion"]) == {ranked[n][1] for n in (0, 4, 8)}


def test_many_runs_of_tip_tracks_stand_in_rows_of_as_many_panels_as_a_page_is_wide_for():
    names = [f"gel-{n}" for n in range(7)]
    reading = {"medium": "gel", "direction": "y", "method": "prediction", "scored": True}
    rows = [{**reading, "run": name, "depth_mm": 10.0 * n} for name in names for n in range(1, 4)]
    numbers = ("guide", "measured", "predicted", "low_50", "high_50", "low_95", "high_95")
    readings = pd.DataFrame(rows).assign(**{f"{name}_mm": 0.5 for name in numbers})
    readings["measured_mm"] = readings["depth_mm"] / 10
    figure = tip_track.draw(readings, names[:6])
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]
    assert titles == [str(n) for n in range(6)]
    assert [axes.get_subplotspec().colspan.start for axes in figure.axes[::2]] == [0, 1, 2, 3, 0, 1]
