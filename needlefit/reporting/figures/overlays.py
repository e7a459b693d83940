"""Measured and simulated needles of every held-out insertion, one over the other, x and y to one scale."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from needlefit.reporting.figures.insertions import (
    DOT,
    HEIGHTS,
    ROOMY,
    Insertion,
    curves,
    explain,
    paint_bands,
    panels,
)
from needlefit.reporting.figures.style import WIDTH, is_synthetic, label_origin, plot, snug
from needlefit.reporting.names import METHOD_COLOURS, method_name
from needlefit.reporting.numbers import fixed
from needlefit.reporting.tables import records
from needlefit.validation.results import Results

_SHOWN = ("hand_tuned", "fitted")
_EVERY = 5  # of the points compared, one in so many is drawn as a dot, or half of these
_FLAT = 0.14  # height of a panel over its width, at least: a needle that hardly bends has room about it
_AROUND = 0.36  # inches of each row beside its panel


def overlays(results: Results, path: Path, role: str = "validate") -> Path:
    """Draw each insertion of a role: the measured needle as dots, the model's prediction as a line.

    Where it was held out, bands say where 50 and 95 % of its measurements were foretold to lie. All panels
    have the same axes in mm, x and y to the same scale, y positive toward the bevel. What this hides,
    `residuals` shows.
    """
    titles = _titles(results, role)
    every = _EVERY if len(titles) <= ROOMY else 2 * _EVERY
    names = {method: method_name(method, results) for method in reversed(_SHOWN)}
    drawn = curves(results, role, _SHOWN, every)
    return plot(path, drawn, lambda points: _paint(points, titles, names))


def _titles(results: Results, role: str) -> dict[Insertion, str]:
    """Return by fold and insertion what stands above its panel: its errors."""
    scored = results.errors.query("role == @role and boundaries == 'measured' and method == 'fitted'")
    said = {}
    for row in records(scored):
        digits = 3 if row["comparison"] == "aligned" else 2
        errors = f"IPE {fixed(row['ipe_mean_mm'], digits)}, TE {fixed(row['te_mm'], digits)} mm"
        said[row["fold"], row["insertion"]] = errors if row["converged"] else "did not converge"
    return said


def _paint(points: pd.DataFrame, titles: dict[Insertion, str], names: dict[str, str]) -> Figure:
    x, y = _span(points[["x_mm"]]), _span(points[HEIGHTS])
    wide = x[1] - x[0]
    room = max(0.0, _FLAT * wide - (y[1] - y[0])) / 2
    y = (y[0] - room, y[1] + room)
    columns = 2 if len(titles) <= ROOMY else 3
    rows = math.ceil(len(titles) / columns)
    high = (WIDTH - 0.4) / columns * 0.92 * (y[1] - y[0]) / wide
    figure = Figure(figsize=(WIDTH, rows * (high + _AROUND) + 0.8))
    for axes, which, mine in panels(figure, points, columns, titles):
        _panel(axes, mine)
        axes.set_title(titles[which], loc="right", pad=3, fontsize=6.5, color=METHOD_COLOURS["fitted"])
        axes.set(xlim=x, ylim=y, aspect="equal")
        axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    figure.supxlabel("depth x (mm)", fontsize=7.5)
    figure.supylabel("toward the bevel y (mm)", fontsize=7.5)
    explain(figure, set(points["curve"]), names)
    label_origin(figure, is_synthetic(points))
    snug(figure)
    return figure


def _panel(axes: Axes, points: pd.DataFrame) -> None:
    paint_bands(axes, points)
    for method in _SHOWN:
        curve, ours = points[points["curve"] == method], method == "fitted"
        colour = METHOD_COLOURS[method]
        axes.plot(curve["x_mm"], curve["y_mm"], color=colour, lw=1.0 if ours else 0.8, zorder=2.0 + ours)
    dots = points[points["curve"] == "measured"]
    axes.plot(dots["x_mm"], dots["y_mm"], "o", zorder=4, **{**DOT, "ms": 2.2, "mew": 0.3})


def _span(values: pd.DataFrame) -> tuple[float, float]:
    """Return the range of all values, and some room."""
    low, high = (float(f(values.to_numpy(dtype=np.float64))) for f in (np.nanmin, np.nanmax))
    margin = 0.06 * max(high - low, 0.2)
    return low - margin, high + margin
