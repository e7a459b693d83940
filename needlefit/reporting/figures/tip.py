"""Draw tips alone: deflection over depth, and their predictions."""

import pandas as pd
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import draw_grid, make_panels
from needlefit.reporting.labels import INK, SERIES_COLOURS, medium_name


def draw(tips: pd.DataFrame) -> Figure:
    """Draw deflections over depth, a panel for each medium: measured, predicted, and their 95 % intervals.

    `tips` has the columns `medium`, `depth_mm`, `measured_mm`, `predicted_mm`, `low_mm` and `high_mm`; the
    last two are empty where nothing certified was predicted.
    """
    groups = list(tips.groupby("medium", sort=False))
    figure, panels = make_panels(len(groups), 1.9)
    for axes, (medium, rows) in zip(panels.flat, groups, strict=False):
        depth = rows["depth_mm"]
        axes.vlines(depth, rows["low_mm"], rows["high_mm"], color=SERIES_COLOURS[0], alpha=0.4, lw=3)
        axes.plot(depth, rows["predicted_mm"], "_", color=SERIES_COLOURS[0], ms=7)
        axes.plot(depth, rows["measured_mm"], "o", color=INK, ms=2.5)
        axes.set_title(medium_name(str(medium)), loc="left")
        axes.set_xlabel("depth (mm)")
        draw_grid(axes)
    for axes in panels[:, 0]:
        axes.set_ylabel("tip deflection (mm)")
    return figure
