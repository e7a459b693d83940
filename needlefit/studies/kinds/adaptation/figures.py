"""Figure of errors on held-out needles against the number of insertions in the fit."""

import math
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, plot
from needlefit.reporting.labels import APPROACH_COLOURS, APPROACH_NAMES, INK
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.run import Run
from needlefit.studies.score import list_length_metrics


def draw_curves(result: Run, path: Path) -> Path:
    """Draw tip error, in-plane error, CRPS and coverage, one line per prior."""
    return plot(path, result.frames["adaptation"].assign(origin=result.origin), _paint_curves)


def _paint_curves(frame: pd.DataFrame) -> Figure:
    rows = to_records(frame)
    metrics = list_length_metrics()
    shown = {metric.name: f"{metric.label} (mm)" for metric in metrics}
    shown |= {"tip_crps_mm": "CRPS of the tip (mm)", "tip_in_95": "tips in their 95 % interval"}
    lines = math.ceil(len(shown) / 2)
    figure = Figure(figsize=(TEXT_WIDTH_IN, 2.2 * lines))
    panels = figure.subplots(lines, 2, sharex=True).ravel()
    for axes, (name, words) in zip(panels, shown.items(), strict=False):
        for approach in APPROACH_NAMES:
            _paint_line(
                axes, [row for row in rows if row["method"] == approach], name, APPROACH_COLOURS[approach]
            )
        axes.set_ylabel(words)
        draw_grid(axes, "y")
        if name == "tip_in_95":
            axes.axhline(0.95, color=INK, lw=0.9, ls=(0, (2, 1.5)))
            axes.set_ylim(-0.05, 1.05)
        else:
            axes.set_yscale("log")
            _set_ticks(axes)
    for axes in panels[len(shown) :]:
        axes.set_visible(False)
    for axes, metric in zip(panels, metrics, strict=False):
        floor = rows[0][f"floor_{metric.name}"]
        axes.axhline(floor, color=INK, lw=0.9, ls=(0, (2, 1.5)))
        at = {"xytext": (-1, 2), "textcoords": "offset points", "fontsize": 6.5}
        axes.annotate("noise floor", (axes.get_xlim()[1], floor), ha="right", color=INK, **at)
    for axes in panels[-2:]:
        axes.set_xlabel("insertions into the new medium")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    _label_lines(panels[0], rows)
    return figure


def _paint_line(axes: Axes, rows: list[Row], name: str, colour: str) -> None:
    n = [row["n"] for row in rows]
    mean = [row[name] for row in rows]
    least, most = (name.replace("_mm", f"_{end}_mm") for end in ("min", "max"))
    if least != name and least in rows[0]:
        low, high = ([row[end] for row in rows] for end in (least, most))
        axes.fill_between(n, low, high, color=colour, alpha=0.18, lw=0)
    axes.plot(n, mean, "o-", ms=3.5, lw=1.2, color=colour, mec="white", mew=0.4, zorder=3)


def _set_ticks(axes: Axes) -> None:
    """Write plain numbers, as many as a decade needs to be read."""
    low, high = axes.get_ylim()
    steps = (1, 2, 5) if high > 20 * low else (1, 2, 3, 5, 7)
    ticks = [t for power in range(-3, 3) for t in (k * 10.0**power for k in steps) if low <= t <= high]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_yticks([], minor=True)


def _label_lines(axes: Axes, rows: list[Row]) -> None:
    """Name every line over its last point."""
    for approach, name in APPROACH_NAMES.items():
        axes.plot([], [], "o-", ms=3.5, lw=1.2, color=APPROACH_COLOURS[approach], label=name)
    axes.figure.legend(loc="outside upper left", ncols=3, handletextpad=0.4, columnspacing=1.4)
