"""Figure of predicted tip tracks: the tip at each reading, and the guide below it."""

from itertools import groupby
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, plot
from needlefit.reporting.labels import GREY, INK, medium_name, method_colour

_ROW_HEIGHT_IN = 1.75  # inches a row of runs
_MARGIN_FRACTION = 0.25  # share of the readings' range left free above and below; bands may leave it


def draw_tracks(readings: pd.DataFrame, path: Path) -> Path:
    """Draw every predicted run, one row of panels per medium."""
    return plot(path, readings, _paint_tracks)


def _paint_tracks(readings: pd.DataFrame) -> Figure:
    runs = list(dict.fromkeys(zip(readings["medium"], readings["run"], strict=True)))
    rows = [(medium, [run for _, run in some]) for medium, some in groupby(runs, key=lambda one: one[0])]
    most = max((len(names) for _, names in rows), default=1)
    figure = Figure(figsize=(TEXT_WIDTH_IN, _ROW_HEIGHT_IN * max(1, len(rows))))
    grid = figure.add_gridspec(2 * max(1, len(rows)), most, height_ratios=[3, 1] * max(1, len(rows)))
    for n, (medium, names) in enumerate(rows):
        group = readings[readings["medium"] == medium]
        low, high = _find_range(group)
        for k, name in enumerate(names):
            tip, guide = figure.add_subplot(grid[2 * n, k]), figure.add_subplot(grid[2 * n + 1, k])
            run = group[group["run"] == name]
            _draw_tip(tip, run)
            _draw_guide(guide, run)
            tip.set_ylim(low, high)
            guide.set_ylim(group["guide_mm"].min() - 1, group["guide_mm"].max() + 1)
            tip.set_title(_shorten_run_name(name, medium), loc="left", fontsize=6)
            _format_axes(tip, guide, medium_name(medium) if k == 0 else "", last=n == len(rows) - 1)
    return figure


def _find_range(group: pd.DataFrame) -> tuple[float, float]:
    """Return the range that all readings and medians of a medium need, mm."""
    values = np.concatenate([group["measured_mm"], group["median_mm"].dropna()])
    room = _MARGIN_FRACTION * (values.max() - values.min())
    return float(values.min() - room), float(values.max() + room)


def _draw_tip(axes: Axes, run: pd.DataFrame) -> None:
    for method, some in run.groupby("method", sort=False):
        scored_rows = some[some["scored"]]
        colour = method_colour(str(method))
        if method == "fitted":
            for level, alpha in ((95, 0.16), (50, 0.32)):
                ends = scored_rows[f"low_{level}_mm"], scored_rows[f"high_{level}_mm"]
                axes.fill_between(scored_rows["depth_mm"], *ends, color=colour, alpha=alpha, lw=0)
        axes.plot(
            scored_rows["depth_mm"],
            scored_rows["median_mm"],
            color=colour,
            lw=1.2 if method == "fitted" else 0.9,
        )
    measured = run[run["method"] == run["method"].iloc[0]]
    for scored, face in ((True, INK), (False, "none")):
        some = measured[measured["scored"] == scored]
        axes.plot(some["depth_mm"], some["measured_mm"], "o", ms=2, mfc=face, mec=INK, mew=0.5)


def _draw_guide(axes: Axes, run: pd.DataFrame) -> None:
    measured = run[run["method"] == run["method"].iloc[0]]
    axes.step(measured["depth_mm"], measured["guide_mm"], where="pre", color=GREY, lw=0.9)


def _shorten_run_name(name: str, medium: str) -> str:
    """Return a run's name without its medium's, which stands beside the row."""
    return (name.removeprefix(medium).strip("_-. ") or name).replace("_", " ")


def _format_axes(tip: Axes, guide: Axes, medium: str, last: bool) -> None:
    """Name axes; `medium` is given of the first run of its row."""
    first = bool(medium)
    guide.sharex(tip)
    tip.tick_params(labelbottom=False, labelleft=first)
    guide.tick_params(labelbottom=last, labelleft=first)
    draw_grid(tip, "y")
    if first:
        tip.set_ylabel(f"{medium}\ntip (mm)")
        guide.set_ylabel("guide (mm)")
    if last:
        guide.set_xlabel("depth (mm)")
