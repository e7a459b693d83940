"""How far measured needles and other curves lie off the fitted one: what needles drawn to scale hide."""

import math
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from needlefit.reporting.figures.insertions import (
    DASHED,
    DOT,
    HEIGHTS,
    KEYS,
    curves,
    explain,
    paint_bands,
    panels,
)
from needlefit.reporting.figures.style import WIDTH, is_synthetic, label_origin, light_grid, plot
from needlefit.reporting.names import METHOD_COLOURS, method_name
from needlefit.validation.results import Results

Floats = NDArray[np.float64]

_RIVALS = ("hand_tuned", "linear_curvature", "constant_curvature")
_EVERY = 2  # of the points compared, one in so many is drawn


def residuals(results: Results, path: Path, role: str = "validate") -> Path:
    """Draw, per insertion of a role, deflections less that of the fitted needle at the same x, mm.

    Measured points as dots, rivals as lines, and the bands of what was foretold. The straight line is left
    out: it would hide all others.
    """
    names = {method: method_name(method, results) for method in ("fitted", *_RIVALS)}
    off = about_fit(curves(results, role, ("fitted", *_RIVALS), _EVERY))
    return plot(path, off, lambda points: _paint(points, names))


def about_fit(points: pd.DataFrame) -> pd.DataFrame:
    """Return all curves but the fit, their heights less the fit's at the same x."""
    parts = []
    for _, mine in points.groupby(KEYS, sort=False):
        fit = mine[mine["curve"] == "fitted"].dropna(subset="y_mm")
        others = mine[mine["curve"] != "fitted"]
        if len(fit) > 1:
            height = _height(fit["x_mm"].to_numpy(), fit["y_mm"].to_numpy(), others["x_mm"].to_numpy())
            parts.append(others.assign(**{name: others[name] - height for name in HEIGHTS}))
    return pd.concat(parts, ignore_index=True) if parts else points.head(0)


def _height(x: Floats, y: Floats, at: Floats) -> Floats:
    """Return a needle's height at `at` (K,), straight on beyond its ends."""
    found: Floats = np.interp(at, x, y)
    for end, beside, beyond in ((0, 1, at < x[0]), (-1, -2, at > x[-1])):
        slope = (y[end] - y[beside]) / (x[end] - x[beside])
        found = np.where(beyond, y[end] + slope * (at - x[end]), found)
    return found


def _paint(points: pd.DataFrame, names: dict[str, str]) -> Figure:
    wanted = list(points[KEYS].drop_duplicates().itertuples(index=False, name=None))
    columns = min(3, max(len(wanted), 2))
    figure = Figure(figsize=(WIDTH, 1.15 * math.ceil(len(wanted) / columns) + 0.95))
    for axes, _, mine in panels(figure, points, columns, wanted):
        _panel(axes, mine)
    axes.set_ylim(_limits(points))
    figure.supxlabel("depth x (mm)", fontsize=7.5)
    figure.supylabel("toward the bevel,\nless the fitted needle (mm)", fontsize=7.5)
    explain(figure, {"fitted", *points["curve"]}, names)
    label_origin(figure, is_synthetic(points))
    return figure


def _panel(axes: Axes, points: pd.DataFrame) -> None:
    paint_bands(axes, points)
    axes.axhline(0.0, color=METHOD_COLOURS["fitted"], lw=1.0)
    for method in _RIVALS:
        curve = points[points["curve"] == method]
        line = {"color": METHOD_COLOURS[method], "lw": 0.8, "ls": DASHED.get(method, "-")}
        axes.plot(curve["x_mm"], curve["y_mm"], **line)
    dots = points[points["curve"] == "measured"]
    axes.plot(dots["x_mm"], dots["y_mm"], "o", zorder=4, **{**DOT, "ms": 1.8, "mew": 0})
    light_grid(axes, "y")


def _limits(points: pd.DataFrame) -> tuple[float, float]:
    """Return what holds all measured points and bands, and of rivals what lies not much farther."""
    near = points[~points["curve"].isin(_RIVALS)]
    every, own = (frame[HEIGHTS].to_numpy(dtype=np.float64) for frame in (points, near))
    low, high = float(np.nanmin(own)), float(np.nanmax(own))
    far, room = 0.5 * (high - low), 0.06 * (high - low)
    return max(low - far, float(np.nanmin(every))) - room, min(high + far, float(np.nanmax(every))) + room
