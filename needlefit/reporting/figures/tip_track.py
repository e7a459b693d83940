"""Draw tip tracks: readings of the tip and of the guide over depth, and their predictions."""

from collections.abc import Collection

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.forms import MAX_PANEL_COLUMNS, lighten
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid
from needlefit.reporting.labels import GREY, INK, medium_name, method_colour
from needlefit.reporting.table_files import select_rows


def draw(readings: pd.DataFrame, runs: Collection[str]) -> Figure:
    """Draw predicted runs of tip tracks, rows of panels for each medium (in space: and direction).

    They show the tip, and below it the guide.

    `readings` has the columns of the frame `readings` of such a study; `runs` are those that are drawn.
    """
    readings = readings[readings["run"].isin(runs)]
    titles = readings["medium"].map(medium_name) + "\ntip"
    if readings["direction"].nunique() > 1:
        titles += " along " + readings["direction"]
    readings = readings.assign(panels=titles)
    panels = readings.groupby("panels", sort=False)
    media = {str(name): list(dict.fromkeys(some["run"])) for name, some in panels}
    across = min(MAX_PANEL_COLUMNS, max(map(len, media.values()), default=1))
    rows = [
        (medium, names[start : start + across])
        for medium, names in media.items()
        for start in range(0, len(names), across)
    ]
    down = max(1, len(rows))
    figure = Figure(figsize=(TEXT_WIDTH_IN, 1.75 * down))
    grid = figure.add_gridspec(2 * down, across, height_ratios=[3, 1] * down)
    for n, (medium, names) in enumerate(rows):
        group = select_rows(readings, panels=medium)
        values = np.concatenate([group["measured_mm"], group["predicted_mm"].dropna()])
        room = 0.25 * (values.max() - values.min())  # bands may leave it
        for k, name in enumerate(names):
            tip = figure.add_subplot(grid[2 * n, k])
            guide = figure.add_subplot(grid[2 * n + 1, k], sharex=tip)
            run = select_rows(group, run=name)
            _draw_readings(tip, run)
            described = select_rows(run, method=run["method"].iloc[0])
            guide.step(described["depth_mm"], described["guide_mm"], where="pre", color=GREY, lw=0.9)
            tip.set_ylim(values.min() - room, values.max() + room)
            guide.set_ylim(group["guide_mm"].min() - 1, group["guide_mm"].max() + 1)
            short = str(name).removeprefix(str(run["medium"].iloc[0])).strip("_-. ") or str(name)
            tip.set_title(short.replace("_", " "), loc="left", fontsize=6)
            tip.tick_params(labelbottom=False, labelleft=k == 0)
            guide.tick_params(labelbottom=n == down - 1, labelleft=k == 0)
            draw_grid(tip)
            if k == 0:
                tip.set_ylabel(f"{medium} (mm)")
                guide.set_ylabel("guide\n(mm)")
            if n == down - 1:
                guide.set_xlabel("depth (mm)")
    return figure


def _draw_readings(axes: Axes, run: pd.DataFrame) -> None:
    for method, some in run[run["scored"]].groupby("method", sort=False):
        colour, ours = method_colour(str(method)), method == "prediction"
        for level, share in ((95, 0.84), (50, 0.68)) if ours else ():
            ends = some[f"low_{level}_mm"], some[f"high_{level}_mm"]
            axes.fill_between(some["depth_mm"], *ends, color=lighten(colour, share), lw=0)
        axes.plot(some["depth_mm"], some["predicted_mm"], color=colour, lw=1.2 if ours else 0.9)
    measured = select_rows(run, method=run["method"].iloc[0])
    for scored, face in ((True, INK), (False, "none")):
        some = select_rows(measured, scored=scored)
        axes.plot(some["depth_mm"], some["measured_mm"], "o", ms=2, mfc=face, mec=INK, mew=0.5)
