"""Figures with one panel per insertion: overlaid curves, and residuals from the fitted needle."""

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from needlefit.reporting.figures.style import (
    TEXT_WIDTH_IN,
    draw_grid,
    fit_height,
    is_synthetic,
    label_origin,
    plot,
)
from needlefit.reporting.labels import INK, METHOD_COLOURS, method_name
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.tables import to_records
from needlefit.validation.results import Results
from needlefit.validation.summary import find_bevel_sides

InsertionKey = tuple[str, str]
"""Fold and insertion."""

INSERTION_KEYS = ["fold", "insertion"]
HEIGHT_COLUMNS = ["y_mm", "low_mm", "high_mm"]
DOT_STYLE: dict[str, Any] = {"mfc": INK, "mec": "white", "mew": 0.4, "ms": 2.7}  # seen above a line that fits
MAX_LARGE_PANELS = 24
"""Insertions at most whose panels are large."""

DASH_PATTERNS: Mapping[str, Any] = {
    "constant_curvature": (0, (4, 2))
}  # where two lines are one, both are seen

_BAND_OPACITIES = {95: 0.16, 50: 0.28}  # opacity of each band; the narrow one lies on the wide one
_POINT_COLUMNS = [*INSERTION_KEYS, "curve", "x_mm", *HEIGHT_COLUMNS]
_BAND_COLOUR = METHOD_COLOURS["fitted"]


def collect_curves(results: Results, role: str, shown: Iterable[str], every: int = 1) -> pd.DataFrame:
    """Return one row per drawn point of a role's insertions; y is toward the bevel, mm.

    `curve` is a method of `shown`, "measured" (of the points, one in `every`), or the level of a band, which
    held-out insertions have: `low_mm`, `high_mm` are its ends.
    """
    where = "role == @role and boundaries == 'measured' and method in @shown"
    shapes = results.shapes.query(where, local_dict={"role": role, "shown": list(shown)})
    shapes = shapes.sort_values([*INSERTION_KEYS, "method", "j"])
    simulated = shapes.set_axis([c.replace("simulated_", "") for c in shapes.columns], axis=1)
    dots = shapes.drop_duplicates([*INSERTION_KEYS, "j"])
    bands = _align_bands(results.bands, dots)
    dots = dots[dots["j"] % every == 0].set_axis([c.replace("measured_", "") for c in shapes.columns], axis=1)
    parts = [simulated.assign(curve=simulated["method"]), dots.assign(curve="measured")]
    for level in _BAND_OPACITIES if role == "validate" else ():
        ends = {f"low_{level}_mm": "low_mm", f"high_{level}_mm": "high_mm"}
        parts.append(bands.rename(columns=ends).assign(curve=f"{level} %"))
    found = pd.concat(
        [part.reindex(columns=_POINT_COLUMNS) for part in parts if len(part)], ignore_index=True
    )
    sides = found["insertion"].map(find_bevel_sides(results))
    found[HEIGHT_COLUMNS] = found[HEIGHT_COLUMNS].mul(sides, axis=0)
    return found.assign(origin=results.origin)


def _align_bands(bands: pd.DataFrame, shapes: pd.DataFrame) -> pd.DataFrame:
    """Return bands as they lie about the measured needle that is drawn.

    Where only the shape is known, scores turn it into a frame of their own: a band stays where it is beside
    the needle it was predicted for.
    """
    parts = []
    ends = [name for name in bands.columns if name.startswith(("low_", "high_"))]
    for key, band in bands.groupby(INSERTION_KEYS, sort=False):
        needle = shapes[(shapes["fold"] == key[0]) & (shapes["insertion"] == key[1])]
        if len(needle):
            height = np.interp(band["x_mm"], needle["measured_x_mm"], needle["measured_y_mm"])
            parts.append(band.assign(**{name: band[name] - band["measured_mm"] + height for name in ends}))
    return pd.concat(parts) if parts else bands


def iterate_panels(
    figure: Figure, points: pd.DataFrame, columns: int, names: Iterable[InsertionKey]
) -> Iterator[tuple[Axes, InsertionKey, pd.DataFrame]]:
    """Yield each insertion's panel, name and points; all panels have the same axes."""
    wanted = list(names)
    rows = math.ceil(len(wanted) / columns)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for i, spare in enumerate(reversed(list(grid.flat)[len(wanted) :]), start=1):
        spare.set_visible(False)
        if rows > 1:
            grid[-2, -i].tick_params(labelbottom=True)  # the panel above has the lowest x axis of its column
    for axes, (fold, insertion) in zip(grid.flat, wanted, strict=False):
        axes.set_title(insertion, loc="left", pad=3)
        mine = points[(points["fold"] == fold) & (points["insertion"] == insertion)]
        yield axes, (fold, insertion), mine


def paint_bands(axes: Axes, points: pd.DataFrame) -> None:
    """Shade the predicted bands of the measurements."""
    for level, alpha in _BAND_OPACITIES.items():
        band = points[points["curve"] == f"{level} %"]
        axes.fill_between(
            band["x_mm"], band["low_mm"], band["high_mm"], color=_BAND_COLOUR, alpha=alpha, lw=0
        )


def draw_legend(figure: Figure, present: set[str], method_names: Mapping[str, str]) -> None:
    """Draw the legend above all panels; `method_names` are the printed names of the curves."""
    handles: list[Artist] = [Line2D([], [], color=INK, marker="o", ms=2.7, lw=0, label="measured")]
    for method, name in method_names.items():
        if method in present:
            look = {"color": METHOD_COLOURS[method], "lw": 1.1, "ls": DASH_PATTERNS.get(method, "-")}
            handles.append(Line2D([], [], **look, label=name))
    if "95 %" in present:
        handles += [
            Patch(color=_BAND_COLOUR, alpha=a, lw=0, label=f"{n} % predicted")
            for n, a in ((50, 0.4), (95, 0.16))
        ]
    columns = 3 if len(handles) <= 5 else 2  # what the data are stands at the right
    figure.legend(handles=handles, loc="outside upper left", ncols=columns, handlelength=1.3)


_OVERLAY_METHODS = ("hand_tuned", "fitted")
_OVERLAY_POINT_STEP = 5  # of the points compared, one in so many is drawn as a dot, or half of these
_MIN_PANEL_RATIO = (
    0.14  # height of a panel over its width, at least: a needle that hardly bends has room about it
)
_ROW_MARGIN_IN = 0.36  # inches of each row beside its panel


def draw_overlays(results: Results, path: Path, role: str = "validate") -> Path:
    """Draw each insertion of a role: the measured needle as dots, the model's prediction as a line.

    Where it was held out, bands say where 50 and 95 % of its measurements were predicted to lie. All panels
    have the same axes in mm, x and y to the same scale, y positive toward the bevel. What this hides,
    `residuals` shows.
    """
    titles = _panel_titles(results, role)
    every = _OVERLAY_POINT_STEP if len(titles) <= MAX_LARGE_PANELS else 2 * _OVERLAY_POINT_STEP
    names = {method: method_name(method, results) for method in reversed(_OVERLAY_METHODS)}
    drawn = collect_curves(results, role, _OVERLAY_METHODS, every)
    return plot(path, drawn, lambda points: _paint_overlays(points, titles, names))


def _panel_titles(results: Results, role: str) -> dict[InsertionKey, str]:
    """Return by fold and insertion what stands above its panel: its errors."""
    scored = results.errors.query("role == @role and boundaries == 'measured' and method == 'fitted'")
    summary = {}
    for row in to_records(scored):
        digits = 3 if row["comparison"] == "aligned" else 2
        errors = f"IPE {format_mm(row['ipe_mean_mm'], digits)}, TE {format_mm(row['te_mm'], digits)} mm"
        summary[row["fold"], row["insertion"]] = errors if row["converged"] else "did not converge"
    return summary


def _paint_overlays(points: pd.DataFrame, titles: dict[InsertionKey, str], names: dict[str, str]) -> Figure:
    x, y = _find_range(points[["x_mm"]]), _find_range(points[HEIGHT_COLUMNS])
    wide = x[1] - x[0]
    room = max(0.0, _MIN_PANEL_RATIO * wide - (y[1] - y[0])) / 2
    y = (y[0] - room, y[1] + room)
    columns = 2 if len(titles) <= MAX_LARGE_PANELS else 3
    rows = math.ceil(len(titles) / columns)
    high = (TEXT_WIDTH_IN - 0.4) / columns * 0.92 * (y[1] - y[0]) / wide
    figure = Figure(figsize=(TEXT_WIDTH_IN, rows * (high + _ROW_MARGIN_IN) + 0.8))
    for axes, which, mine in iterate_panels(figure, points, columns, titles):
        _paint_overlay_panel(axes, mine)
        axes.set_title(titles[which], loc="right", pad=3, fontsize=6.5, color=METHOD_COLOURS["fitted"])
        axes.set(xlim=x, ylim=y, aspect="equal")
        axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    figure.supxlabel("depth x (mm)", fontsize=7.5)
    figure.supylabel("toward the bevel y (mm)", fontsize=7.5)
    draw_legend(figure, set(points["curve"]), names)
    label_origin(figure, is_synthetic(points))
    fit_height(figure)
    return figure


def _paint_overlay_panel(axes: Axes, points: pd.DataFrame) -> None:
    paint_bands(axes, points)
    for method in _OVERLAY_METHODS:
        curve, ours = points[points["curve"] == method], method == "fitted"
        colour = METHOD_COLOURS[method]
        axes.plot(curve["x_mm"], curve["y_mm"], color=colour, lw=1.0 if ours else 0.8, zorder=2.0 + ours)
    dots = points[points["curve"] == "measured"]
    axes.plot(dots["x_mm"], dots["y_mm"], "o", zorder=4, **{**DOT_STYLE, "ms": 2.2, "mew": 0.3})


def _find_range(values: pd.DataFrame) -> tuple[float, float]:
    """Return the range of all values, and some room."""
    low, high = (float(f(values.to_numpy(dtype=np.float64))) for f in (np.nanmin, np.nanmax))
    margin = 0.06 * max(high - low, 0.2)
    return low - margin, high + margin


Floats = NDArray[np.float64]

_RESIDUAL_METHODS = ("hand_tuned", "linear_curvature", "constant_curvature")
_RESIDUAL_POINT_STEP = 2  # of the points compared, one in so many is drawn


def draw_residuals(results: Results, path: Path, role: str = "validate") -> Path:
    """Draw, per insertion of a role, deflections minus that of the fitted needle at the same x, mm.

    Measured points as dots, baselines as lines, and the bands of what was predicted. The straight line is
    left out: it would hide all others.
    """
    names = {method: method_name(method, results) for method in ("fitted", *_RESIDUAL_METHODS)}
    off = subtract_fit(collect_curves(results, role, ("fitted", *_RESIDUAL_METHODS), _RESIDUAL_POINT_STEP))
    return plot(path, off, lambda points: _paint_residuals(points, names))


def subtract_fit(points: pd.DataFrame) -> pd.DataFrame:
    """Return all curves except the fit, minus the fit's deflection at the same x."""
    parts = []
    for _, mine in points.groupby(INSERTION_KEYS, sort=False):
        fit = mine[mine["curve"] == "fitted"].dropna(subset="y_mm")
        others = mine[mine["curve"] != "fitted"]
        if len(fit) > 1:
            height = _extrapolate_height(
                fit["x_mm"].to_numpy(), fit["y_mm"].to_numpy(), others["x_mm"].to_numpy()
            )
            parts.append(others.assign(**{name: others[name] - height for name in HEIGHT_COLUMNS}))
    return pd.concat(parts, ignore_index=True) if parts else points.head(0)


def _extrapolate_height(x: Floats, y: Floats, at: Floats) -> Floats:
    """Return a needle's height at `at` (K,), straight on beyond its ends."""
    found: Floats = np.interp(at, x, y)
    for end, neighbour, outside in ((0, 1, at < x[0]), (-1, -2, at > x[-1])):
        slope = (y[end] - y[neighbour]) / (x[end] - x[neighbour])
        found = np.where(outside, y[end] + slope * (at - x[end]), found)
    return found


def _paint_residuals(points: pd.DataFrame, names: dict[str, str]) -> Figure:
    wanted = list(points[INSERTION_KEYS].drop_duplicates().itertuples(index=False, name=None))
    columns = min(3, max(len(wanted), 2))
    figure = Figure(figsize=(TEXT_WIDTH_IN, 1.15 * math.ceil(len(wanted) / columns) + 0.95))
    for axes, _, mine in iterate_panels(figure, points, columns, wanted):
        _paint_residual_panel(axes, mine)
    axes.set_ylim(_find_limits(points))
    figure.supxlabel("depth x (mm)", fontsize=7.5)
    figure.supylabel("toward the bevel,\nless the fitted needle (mm)", fontsize=7.5)
    draw_legend(figure, {"fitted", *points["curve"]}, names)
    label_origin(figure, is_synthetic(points))
    return figure


def _paint_residual_panel(axes: Axes, points: pd.DataFrame) -> None:
    paint_bands(axes, points)
    axes.axhline(0.0, color=METHOD_COLOURS["fitted"], lw=1.0)
    for method in _RESIDUAL_METHODS:
        curve = points[points["curve"] == method]
        line = {"color": METHOD_COLOURS[method], "lw": 0.8, "ls": DASH_PATTERNS.get(method, "-")}
        axes.plot(curve["x_mm"], curve["y_mm"], **line)
    dots = points[points["curve"] == "measured"]
    axes.plot(dots["x_mm"], dots["y_mm"], "o", zorder=4, **{**DOT_STYLE, "ms": 1.8, "mew": 0})
    draw_grid(axes, "y")


def _find_limits(points: pd.DataFrame) -> tuple[float, float]:
    """Return what holds all measured points and bands, and of baselines what lies not much farther."""
    near = points[~points["curve"].isin(_RESIDUAL_METHODS)]
    every, own = (frame[HEIGHT_COLUMNS].to_numpy(dtype=np.float64) for frame in (points, near))
    low, high = float(np.nanmin(own)), float(np.nanmax(own))
    far, room = 0.5 * (high - low), 0.06 * (high - low)
    return max(low - far, float(np.nanmin(every))) - room, min(high + far, float(np.nanmax(every))) + room
