"""Figure of profile likelihoods: one panel per parameter, with the parabola of the Fisher information."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.figures.style import COLUMN_WIDTH_IN, choose_width, plot
from needlefit.reporting.interval_text import NO_INTERVAL, choose_interval_unit, typeset_interval
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS, PAPER_COLOUR
from needlefit.reporting.number_format import format_number, typeset
from needlefit.reporting.table_files import Row, to_records

Floats = NDArray[np.float64]

MAX_PANEL_COLUMNS = 4
"""Greatest number of panels in a row."""

MAX_TICKS = 4
"""Greatest number of labelled ticks on a logarithmic axis."""

MAX_DEVIANCE = 6.5
"""Upper end of the panels' deviance axis."""

PROFILE_COLOUR, PARABOLA_COLOUR, WARNING_COLOUR = (
    METHOD_COLOURS["fitted"],
    METHOD_COLOURS["hand_tuned"],
    PAPER_COLOUR,
)


def draw_profiles(identification: pd.DataFrame, profiles: pd.DataFrame, origin: str, path: Path) -> Path:
    """Draw the deviance over each parameter, its 95 % interval, and the parabola of the Fisher information.

    The table has the computed points, between which the curve is the cubic of their slopes, and with each
    of them what is known of its parameter.
    """
    about = identification[[*_PANEL_KEYS, *(name for name in _VERDICT_COLUMNS if name not in _PANEL_KEYS)]]
    frame = profiles.merge(about, on=list(_PANEL_KEYS), how="left", sort=False).assign(origin=origin)
    return plot(path, frame, _paint)


_PANEL_KEYS = ("fold", "parameter")
_VERDICT_COLUMNS = (
    *("status", "fisher_sd", "low", "high", "end_low", "end_high", "rise"),
    *("interval_low", "interval_high", "draw_source", "bound_low", "bound_high"),
)
"""Columns of the identification that the figure shows."""


def _paint(profiles: pd.DataFrame) -> Figure:
    every = to_records(profiles.drop_duplicates(list(_PANEL_KEYS))[[*_PANEL_KEYS, *_VERDICT_COLUMNS]])
    rows = [row for row in every if row["status"] != "fixed" or not _is_flat(row)] or every
    width = choose_width()
    across = _count_columns(len(rows)) if width > COLUMN_WIDTH_IN else min(2, len(rows))
    down = math.ceil(len(rows) / across)
    figure = Figure(figsize=(width, 0.3 + 1.25 * down))
    panels = figure.subplots(down, across, squeeze=False, sharey=True)
    for n, axes in enumerate(panels.flat):
        if n >= len(rows):
            axes.axis("off")
            continue
        row = rows[n]
        points = profiles[(profiles["fold"] == row["fold"]) & (profiles["parameter"] == row["parameter"])]
        _paint_panel(axes, row, points)
        if n % across == 0:
            axes.set_ylabel("deviance")
    _draw_legend(figure, panels[0, across - 1], float(profiles["threshold"].iloc[0]))
    return figure


def _count_columns(count: int) -> int:
    """Return how many panels stand in a row, so that the last row is as full as can be."""
    if count <= MAX_PANEL_COLUMNS:
        return max(1, count)
    return min(range(MAX_PANEL_COLUMNS, MAX_PANEL_COLUMNS - 2, -1), key=lambda wide: (-count % wide, -wide))


def _paint_panel(axes: Axes, row: Row, points: pd.DataFrame) -> None:
    name = str(row["parameter"])
    forward = np.log if is_logarithmic(name) else np.asarray
    back = np.exp if is_logarithmic(name) else np.asarray
    at = forward(points["value"].to_numpy(dtype=np.float64))
    deviance = points["deviance"].to_numpy(dtype=np.float64)
    best = float(at[int(np.argmin(deviance))])
    threshold = float(points["threshold"].iloc[0])
    if is_logarithmic(name):
        axes.set_xscale("log")
    if len(at) < 2:  # nothing but the optimum could be computed
        axes.set_title(_panel_title(row), loc="left", color=INK)
        return
    fine = np.linspace(at[0], at[-1], 400)
    curve = CubicHermiteSpline(at, deviance, points["slope"])(fine)
    _paint_interval(axes, row, (back(fine), curve), threshold)
    _paint_parabola(axes, back, (at, best, row["fisher_sd"]))
    axes.plot(back(fine), curve, color=PROFILE_COLOUR, lw=1.3, zorder=3)
    axes.plot(back(at), deviance, "o", ms=2.6, color=PROFILE_COLOUR, mew=0, zorder=4)
    axes.axhline(threshold, color=GREY, lw=0.6, ls=(0, (3, 2)))
    _format_axes(axes, row, back(at[[0, -1]]))


def _paint_interval(axes: Axes, row: Row, curve: tuple[Floats, Floats], threshold: float) -> None:
    """Shade the 95 % interval of the tables; of a profile alone, what is within the threshold."""
    where, deviance = curve
    inside = deviance <= threshold
    if _is_of_draws(row):
        inside = (where >= row["interval_low"]) & (where <= row["interval_high"])
    axes.fill_between(where, 0, MAX_DEVIANCE, where=list(inside), color=PROFILE_COLOUR, alpha=0.1, lw=0)


def _paint_parabola(
    axes: Axes, back: Callable[[Floats], Floats], known: tuple[Floats, float, float | None]
) -> None:
    """Draw what the information at the optimum would have the deviance be."""
    at, best, sd = known
    if sd is None:
        return
    fine = np.linspace(at[0], at[-1], 400)
    axes.plot(
        back(fine), ((fine - best) / sd) ** 2, color=PARABOLA_COLOUR, lw=0.9, ls=(0, (4, 1.5)), zorder=2
    )


def _format_axes(axes: Axes, row: Row, ends: Floats) -> None:
    name = str(row["parameter"])
    axes.set_ylim(0, MAX_DEVIANCE)
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.set_xlim(float(ends[0]), float(ends[1]))
    if is_logarithmic(name):
        ticks = choose_log_ticks(float(ends[0]), float(ends[1]))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(ticks, [_format_tick(tick / _choose_unit(row)[1]) for tick in ticks])
    else:
        axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    axes.set_title(_panel_title(row), loc="left", color=INK, pad=14)
    axes.text(
        0,
        1.035,
        _describe_state(row),
        transform=axes.transAxes,
        va="bottom",
        color=_choose_colour(row),
    )


def _choose_unit(row: Row) -> tuple[str, float]:
    return choose_interval_unit(row, row["low"], row["high"])


def _panel_title(row: Row) -> str:
    return _choose_unit(row)[0] + (", freed" if row["status"] == "fixed" else "")


def _describe_state(row: Row) -> str:
    low, high = row["end_low"] == "closed", row["end_high"] == "closed"
    if _is_of_draws(row) or (low and high):
        return typeset_interval(row, _choose_unit(row)[1])
    if "lost" in (row["end_low"], row["end_high"]):
        return "could not be followed to its end"
    if not low and not high:
        return f"{'flat' if _is_flat(row) else 'open'}: not identifiable"
    unit = _choose_unit(row)[1]
    end = f"above {_format_tick(row['low'] / unit)}" if low else f"below {_format_tick(row['high'] / unit)}"
    return f"{end}, open"


def _is_of_draws(row: Row) -> bool:
    return row["draw_source"] not in (None, "", "profile")


def _is_flat(row: Row) -> bool:
    """Return whether the deviance hardly rises over the whole range of a parameter."""
    return (row["rise"] or 0) < 1 and "closed" not in (row["end_low"], row["end_high"])


def _choose_colour(row: Row) -> str:
    """Return the colour of the verdict: that of a warning where the interval is open or none is printed."""
    if _describe_state(row) == NO_INTERVAL:
        return WARNING_COLOUR
    return INK if _is_of_draws(row) or row["end_low"] == row["end_high"] == "closed" else WARNING_COLOUR


def choose_log_ticks(low: float, high: float) -> list[float]:
    """Return two to four round ticks of a logarithmic axis: powers of ten if there are enough of them."""
    if high < 5 * low:
        places = MaxNLocator(3, steps=[1, 2, 5, 10]).tick_values(low, high)
        inner = [float(place) for place in places if low <= place <= high]
        return inner[:: 2 if len(inner) > 3 else 1]  # their numbers are long
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    for steps in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0)):
        ticks = [step * 10.0**power for power in powers for step in steps]
        ticks = [tick for tick in ticks if low <= tick <= high]
        if len(ticks) >= 2:
            break
    return ticks[:: math.ceil(len(ticks) / MAX_TICKS)]


def _draw_legend(figure: Figure, last: Axes, threshold: float) -> None:
    """Name the curves above the panels, and the threshold beside the last panel of the first row."""
    figure.suptitle(" ")  # keeps the line free
    for x, words, colour in (
        (0.01, "profile", PROFILE_COLOUR),
        (0.01 + 0.55 / figure.get_figwidth(), "information at the optimum", PARABOLA_COLOUR),
    ):
        figure.text(x, 0.985, words, va="top", color=colour)
    across = last.get_yaxis_transform()
    last.text(1.02, threshold, "95 %", transform=across, va="center", color=GREY)


def _format_tick(value: float) -> str:
    return typeset(format_number(value))
