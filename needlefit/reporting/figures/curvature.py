"""Draw curvatures along needles: readings of sensors, and what was predicted of them."""

import pandas as pd
from matplotlib.figure import Figure

from needlefit.inference.identifiability.directions import NORMAL_95_HALF_WIDTH_SD
from needlefit.reporting.figures.style import draw_grid, make_panels
from needlefit.reporting.labels import INK, SERIES_COLOURS


def draw(sensors: pd.DataFrame) -> Figure:
    """Draw curvatures over the distance from the entry, a panel for each needle and direction.

    `sensors` has the columns `insertion`, `direction`, `s_mm`, and in 1/m `measured`, `predicted` and `sd`,
    the standard deviation of a predicted reading.
    """
    groups = list(sensors.groupby(["insertion", "direction"], sort=False))
    figure, panels = make_panels(len(groups), 1.5)
    for axes, ((insertion, direction), some) in zip(panels.flat, groups, strict=False):
        rows = some.sort_values("s_mm")
        s, middle, half = rows["s_mm"], rows["predicted"], NORMAL_95_HALF_WIDTH_SD * rows["sd"]
        axes.fill_between(s, middle - half, middle + half, color=SERIES_COLOURS[0], alpha=0.3, lw=0)
        axes.plot(s, middle, color=SERIES_COLOURS[0], lw=1.2)
        axes.plot(s, rows["measured"], "o", color=INK, ms=2.5)
        axes.set_title(f"{insertion}, {direction}" if direction != "y" else str(insertion), loc="left")
        draw_grid(axes)
    for axes in panels[-1]:
        axes.set_xlabel("from the entry (mm)")
    for axes in panels[:, 0]:
        axes.set_ylabel("curvature (1/m)")
    return figure
