"""A compression test: the curves with their fit and what it leaves, and what they say of alpha."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.mechanics.compression import StressMeasure
from needlefit.reporting.figures.style import WIDTH, light_grid, plot
from needlefit.reporting.material_tables import PRIOR
from needlefit.reporting.names import GREY, INK

_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")  # Okabe and Ito
_NAMED = 8
"""More specimens than these are not named one by one."""

_FLOOR, _BAR = -8.0, 0.3
"""Log likelihood at which the profiles are cut off; height of a bar below."""

_DOTS = 60
"""Measured points of a specimen that are drawn, about."""


def draw_curves(measure: StressMeasure, curves: pd.DataFrame, path: Path) -> Path:
    """Draw measured and fitted stress over stretch, and below what the fit leaves."""
    return plot(path, curves, lambda frame: _paint_curves(measure, frame))


def draw_profiles(profiles: pd.DataFrame, path: Path) -> Path:
    """Draw the profile log likelihoods of alpha, their 95 % regions, and the prior that follows."""
    return plot(path, profiles, _paint_profiles)


def _paint_curves(measure: StressMeasure, curves: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(0.6 * WIDTH, 3.3))
    upper, lower = figure.subplots(2, 1, height_ratios=(2.2, 1), sharex=True)
    for colour, (name, rows) in _coloured(curves):
        dots = rows.iloc[:: max(1, len(rows) // _DOTS)]
        style = {"ms": 2.4, "mfc": "none", "mew": 0.6}
        upper.plot(dots["stretch"], -dots["measured_pa"] / 1e3, "o", color=colour, **style)
        line = rows.sort_values("stretch")
        upper.plot(line["stretch"], -line["fitted_pa"] / 1e3, color=colour, lw=1.1, label=name)
        lower.plot(rows["stretch"], rows["residual_pa"] / 1e3, color=colour, lw=0.8)
    upper.invert_xaxis()
    upper.set_ylabel(f"{measure} stress (kPa),\npositive in compression")
    lower.axhline(0.0, color=INK, lw=0.5)
    lower.set_ylabel("fitted minus\nmeasured (kPa)")
    lower.set_xlabel("stretch")
    for axes in (upper, lower):
        light_grid(axes, "y")
    if 1 < curves["specimen"].nunique() <= _NAMED:
        upper.legend(loc="upper left", fontsize=6.5, handlelength=1.2, labelspacing=0.3)
    return figure


def _paint_profiles(profiles: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(0.6 * WIDTH, 3.0))
    axes = figure.add_subplot()
    specimens = profiles[profiles["specimen"] != PRIOR]
    for n, (colour, (name, rows)) in enumerate(_coloured(specimens)):
        shown = rows["log_likelihood"].where(rows["log_likelihood"] >= _FLOOR)
        axes.plot(rows["alpha"], shown, color=colour, lw=1.1, label=name)
        bar = rows["alpha"].where(rows["in_95_region"].astype(bool))
        level = np.full(len(rows), _FLOOR - _BAR * (n + 0.5))
        axes.plot(bar, level, color=colour, lw=2, solid_capstyle="butt")
    _dress_profiles(axes, profiles, specimens)
    return figure


def _dress_profiles(axes: Axes, profiles: pd.DataFrame, specimens: pd.DataFrame) -> None:
    count = specimens["specimen"].nunique()
    axes.set_title("profile log likelihood of α; bars: 95 % region", loc="left")
    axes.set_ylim(_FLOOR - _BAR * (count + 0.5), 0.6)
    prior = profiles.loc[profiles["specimen"] == PRIOR, "alpha"]
    ends = [*specimens.loc[specimens["in_95_region"].astype(bool), "alpha"], *prior]
    margin = 0.5 * (max(ends) - min(ends)) + 0.1
    axes.set_xlim(min(ends) - margin, max(ends) + margin)
    axes.set_xlabel("α")
    if len(prior):
        axes.axvspan(prior.min(), prior.max(), color=GREY, alpha=0.2, lw=0, label="prior, ± one sd")
    if len(prior) or 1 < count <= _NAMED:
        axes.legend(loc="upper right", fontsize=6.5, handlelength=1.2, labelspacing=0.3)
    light_grid(axes, "y")


def _coloured(rows: pd.DataFrame) -> Iterator[tuple[str, tuple[str, pd.DataFrame]]]:
    """Yield a colour, and the name and rows of each specimen."""
    for n, (name, group) in enumerate(rows.groupby("specimen", sort=False)):
        yield _COLOURS[n % len(_COLOURS)], (str(name), group)
