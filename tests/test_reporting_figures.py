"""What figures count and measure, apart from how they look."""

import numpy as np
import pandas as pd
import pytest
from reporting_results import stereo, study

from needlefit.reporting import figures, write
from needlefit.reporting.figures.residuals import off_normal
from needlefit.reporting.figures.waterfall import counted


def test_residuals_are_normal_to_the_measured_shape():
    along = np.linspace(0, 10, 11)
    x, y = 0.6 * along, 0.8 * along  # a straight needle, its left normal (-0.8, 0.6)
    shape = pd.DataFrame({"measured_x_mm": x, "measured_y_mm": y})
    moved = shape.assign(simulated_x_mm=x - 0.8 * 0.5 + 0.6 * 2, simulated_y_mm=y + 0.6 * 0.5 + 0.8 * 2)
    assert off_normal(moved) == pytest.approx(np.full(11, 0.5))  # 2 mm along it count for nothing


def test_starts_are_counted_as_each_search_had_them():
    assert counted(study(5).starts) == "8 starts in each of 2 searches"
    assert counted(stereo().starts) == "8 starts in each of 3 folds"
    assert counted(stereo().starts.query("fold == 1")) == "8 starts"


def test_aligned_shapes_are_shown_by_their_residuals_too(tmp_path):
    path = figures.residuals(stereo(), tmp_path / "residuals.pdf")
    assert path.read_bytes().startswith(b"%PDF")
    files = {path.name for path in write.write(stereo(), tmp_path / "stereo")}
    assert {"overlays.pdf", "residuals.pdf"} <= files
