"""What figures count and measure, apart from how they look."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from reporting_results import stereo, study, with_draws, with_predictions

from needlefit.reporting import fonts
from needlefit.reporting.figures import style
from needlefit.studies.fit_figures import draw_predictive_check
from needlefit.studies.kinds.cross_validation import report

WHAT = {
    "predicted": ("xy", slice(None)),
    "insertions": ("x", slice(None)),
    "overlays": ("xy", slice(None)),
}
"""Which axes of which panels hold data; the others hold places: of groups, baselines, intervals,
parameters."""


def test_letters_that_no_font_has_are_written_as_their_numbers(tmp_path, monkeypatch):
    assert fonts.find_lacking("Nädel, игла, μ₁ − 针1") == {"针"}
    monkeypatch.setattr(fonts, "find_fonts", lambda _: {})  # whatever is installed
    assert fonts.spell("针A 针一") == "[U+9488]A [U+9488][U+4E00]"

    def paint():
        figure = Figure(figsize=(4, 2))
        axes = figure.add_subplot(title="针二")
        axes.set_yticks([0.0, 1.0], ["针一", "игла"])
        figure.draw_without_rendering()
        return figure

    drawn = style.draw(tmp_path / "a.svg", paint, "words that can be edited").read_text(encoding="utf-8")
    for name in ("[U+9488][U+4E00]", "[U+9488][U+4E8C]", "игла"):
        assert name in drawn
    assert "针" not in drawn


@pytest.fixture
def painted(monkeypatch):
    """Figures by the name of their file, as they are painted; their files are left empty."""
    found = {}

    def keep(path, paint):
        path.touch()
        found[path.stem] = paint()
        return path

    monkeypatch.setattr(style, "draw", keep)
    return found


def drawn(axes):
    """The points (N, 2) of lines, marks and bands that lie in the coordinates of the data."""
    for line in axes.get_lines():
        if line.get_transform() == axes.transData and len(line.get_xydata()):
            yield np.asarray(line.get_xydata(), dtype=float)
    for patch in axes.collections:
        if isinstance(patch, PolyCollection):
            yield np.concatenate([path.vertices for path in patch.get_paths()] or [np.empty((0, 2))])


def stands_in(table, values):
    """Which values are among the table's numbers."""
    known = np.sort(table.select_dtypes("number").to_numpy(dtype=float).ravel())
    known = known[np.isfinite(known)]
    at = np.clip(np.searchsorted(known, values), 1, len(known) - 1)
    near = np.minimum(np.abs(known[at] - values), np.abs(known[at - 1] - values))
    return near <= 1e-6 * np.maximum(1.0, np.abs(values))


@pytest.mark.parametrize(
    "results", [with_predictions(with_draws(study(5))), stereo()], ids=["study5", "stereo"]
)
def test_drawn_values_are_those_of_the_table(results, painted, tmp_path):
    report.REPORT.draw(results, tmp_path)
    pictures = {path.stem for path in tmp_path.glob("*.pdf")}
    assert pictures == set(painted) and "overlays" in pictures
    for name, figure in painted.items():
        table = pd.read_csv(tmp_path / f"{name}.csv")
        assert set(table["origin"]) == {results.origin}
        held, panels = WHAT[name]
        for points in (points for axes in figure.axes[panels] for points in drawn(axes)):
            for axis in held:
                values = points[np.isfinite(points).all(axis=1), "xy".index(axis)]
                values = values[~np.isin(values, (0, 1, 1e-3))]  # zero lines, tolerance, least excess drawn
                assert stands_in(table, values).all(), (name, axis)


def test_the_band_of_pit_values_is_that_of_independent_trials():
    """One specimen has none; two of several needles have limits between counts."""
    predictive = with_predictions(study(1)).frames["predictive"]
    single = predictive.assign(fold=predictive["insertion"], hole=predictive["insertion"])
    ends = {}
    for specimens in (1, 2, 7):
        named = single.assign(specimen=[f"p{n % specimens}" for n in range(len(single))])
        rows = draw_predictive_check(study(1).with_frames(predictive=named)).frame
        ends[specimens] = rows[rows["mark"] == "band"]
    assert len(ends[1]) == 0
    assert ends[2]["low"].iloc[[0, -1]].tolist() == [0, 0.25]
    assert ends[2]["high"].iloc[[0, -1]].tolist() == [0.75, 1]
    counts = 7 * ends[7]["high"]
    assert counts.tolist() == pytest.approx(counts.round().tolist())
