"""The forms of figures: each is a function of a tidy frame, whatever kind of study it comes from."""

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures import Panel
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid
from needlefit.reporting.labels import GREY, INK

SERIES_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
"""Of series without a colour of their own (Okabe and Ito)."""

MAX_NAMED_SERIES = 8
"""More series than these are not named one by one."""

MAX_DOTS = 60
"""Dots of a series that are drawn, about."""


def colour_series(frame: pd.DataFrame, by: str) -> Iterator[tuple[str, str, pd.DataFrame]]:
    """Yield a colour, the name and the rows of each series."""
    for n, (name, rows) in enumerate(frame.groupby(by, sort=False)):
        yield SERIES_COLOURS[n % len(SERIES_COLOURS)], str(name), rows


def curves(
    frame: pd.DataFrame,
    x: str,
    by: str,
    panels: Sequence[Panel],
    x_label: str = "",
    falling: bool = False,
    size: tuple[float, float] = (0.6 * TEXT_WIDTH_IN, 3.3),
) -> Figure:
    """Draw columns over the column `x`, a colour for each value of `by`; `falling`: large x at the left."""
    figure = Figure(figsize=size)
    drawn = figure.subplots(len(panels), 1, height_ratios=[one.share for one in panels], sharex=True)
    for axes, panel in zip(np.atleast_1d(drawn), panels, strict=True):
        for colour, name, rows in colour_series(frame, by):
            if panel.dots:
                some = rows.iloc[:: max(1, len(rows) // MAX_DOTS)]
                axes.plot(
                    some[x], panel.scale * some[panel.dots], "o", color=colour, ms=2.4, mfc="none", mew=0.6
                )
            if panel.line:
                line = rows.sort_values(x)
                axes.plot(line[x], panel.scale * line[panel.line], color=colour, lw=1.1, label=name)
        if panel.zero:
            axes.axhline(0.0, color=INK, lw=0.5)
        axes.set_ylabel(panel.label)
        draw_grid(axes, "y")
    last = np.atleast_1d(drawn)[-1]
    last.set_xlabel(x_label or x)
    if falling:
        last.invert_xaxis()
    _name_series(np.atleast_1d(drawn)[0], frame[by].nunique())
    return figure


def _name_series(axes: Axes, count: int) -> None:
    if 1 < count <= MAX_NAMED_SERIES:
        axes.legend(fontsize=6.5, handlelength=1.2, labelspacing=0.3)


_FLOOR, _BAR = -8.0, 0.3
"""Log likelihood at which profiles are cut off; height of a bar below."""


def profiles_by_series(frame: pd.DataFrame, x: str, by: str, label: str, prior: str = "") -> Figure:
    """Draw the profile log likelihoods of a parameter, one for each value of `by`, with their 95 % regions.

    `frame` has the columns `log_likelihood` (0 at the peak) and `in_95_region`; the rows of the series
    `prior` are the ends of the prior, ± one SD.
    """
    figure = Figure(figsize=(0.6 * TEXT_WIDTH_IN, 3.0))
    axes = figure.add_subplot()
    series, ends = frame[frame[by] != prior], frame.loc[frame[by] == prior, x]
    inside, count = series["in_95_region"].astype(bool), series[by].nunique()
    for n, (colour, name, rows) in enumerate(colour_series(series, by)):
        shown = rows["log_likelihood"].where(rows["log_likelihood"] >= _FLOOR)
        axes.plot(rows[x], shown, color=colour, lw=1.1, label=name)
        bar = np.full(len(rows), _FLOOR - _BAR * (n + 0.5))
        axes.plot(rows[x].where(inside[rows.index]), bar, color=colour, lw=2, solid_capstyle="butt")
    axes.set_title(f"profile log likelihood of {label}; bars: 95 % region", loc="left")
    axes.set_ylim(_FLOOR - _BAR * (count + 0.5), 0.6)
    region = [*series.loc[inside, x], *ends]
    margin = 0.5 * (max(region) - min(region)) + 0.1
    axes.set_xlim(min(region) - margin, max(region) + margin)
    axes.set_xlabel(label)
    if len(ends):
        axes.axvspan(ends.min(), ends.max(), color=GREY, alpha=0.2, lw=0, label="prior, ± one SD")
    _name_series(axes, count + len(ends))
    draw_grid(axes, "y")
    return figure
