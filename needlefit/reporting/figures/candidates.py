"""Differences of log predictive density between candidates, group by group."""

from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import WIDTH, is_synthetic, label_origin, light_grid, plot
from needlefit.reporting.names import CANDIDATE_NAMES, GREY, INK, METHOD_COLOURS
from needlefit.reporting.tables import Row, records
from needlefit.validation.analyses.runner import AnalysisResult

_COLOURS = {
    "ahead": METHOD_COLOURS["constant_curvature"],
    "behind": METHOD_COLOURS["hand_tuned"],
    "tie": GREY,
}


def draw_candidates(answer: AnalysisResult, path: Path) -> Path:
    """Draw one row for each candidate but the reference."""
    frame = answer.frames["group_differences"].assign(held_out=held_out(answer), origin=answer.origin)
    return plot(path, frame, _paint)


def held_out(answer: AnalysisResult) -> str:
    """Return what is held out as one: a group of repeats, if any two needles are repeats, else a needle."""
    told = answer.frames["differences"]
    return "group of repeats" if told["group"].nunique() < told["insertion"].nunique() else "needle"


def _paint(frame: pd.DataFrame) -> Figure:
    rows = list(dict.fromkeys(frame["candidate"]))
    figure = Figure(figsize=(WIDTH, 0.9 + 0.36 * len(rows)))
    axes = figure.add_subplot()
    axes.axvline(0, color=INK, lw=0.8)
    for y, name in enumerate(rows):
        _row(axes, y, records(frame[frame["candidate"] == name]))
    axes.set_xscale("symlog", linthresh=1.0)
    _ticks(axes)
    axes.set_xlabel(
        f"log predictive density less the reference’s, each {frame['held_out'].iloc[0]} (symmetric logarithm)"
    )
    axes.set_yticks(range(len(rows)), [CANDIDATE_NAMES[name] for name in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    light_grid(axes, "x")
    label_origin(figure, is_synthetic(frame))
    return figure


def _row(axes: Axes, y: int, rows: list[Row]) -> None:
    """Draw needles or groups, and their mean with two standard errors."""
    (mean,) = (row for row in rows if row["group"] == "mean")
    colour = _COLOURS[mean["verdict"]]
    each = [row["difference"] for row in rows if row["group"] != "mean"]
    axes.plot(each, [y + 0.2] * len(each), "o", ms=2.5, color=GREY, alpha=0.7, mec="none")
    axes.plot([mean["low"], mean["high"]], [y, y], color=colour, lw=1.6)
    axes.plot(mean["difference"], y, "D", ms=5, color=colour, mec="white", mew=0.5, zorder=4)
    axes.annotate(
        mean["verdict"], (1.0, y), xycoords=("axes fraction", "data"), xytext=(4, 0),
        textcoords="offset points", va="center", color=colour,
    )  # fmt: skip


def _ticks(axes: Axes) -> None:
    """Write plain numbers at powers of ten."""
    low, high = axes.get_xlim()
    powers = [10.0**k for k in range(6)]
    ticks = [t for t in (*(-p for p in powers[::-1]), 0.0, *powers) if low <= t <= high]
    axes.set_xticks(ticks, [f"{tick:g}".replace("-", "−") for tick in ticks])
    axes.set_xticks([], minor=True)
