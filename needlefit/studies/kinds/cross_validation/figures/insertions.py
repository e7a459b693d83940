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

from needlefit.arrays import Floats
from needlefit.inference.baselines import list_baselines
from needlefit.reporting.figures.style import (
    COLUMN_WIDTH_IN,
    choose_vertical_scale,
    choose_width,
    count_legend_columns,
    describe_scale,
    draw_grid,
    fit_height,
    plot,
)
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS, PAPER_COLOUR, method_colour, method_name
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table_files import to_records
from needlefit.studies.run import Run
from needlefit.studies.summary import find_bevel_sides

InsertionKey = tuple[str, str]
"""Fold and insertion."""

INSERTION_KEYS = ["fold", "insertion"]
HEIGHT_COLUMNS = ["y_mm", "low_mm", "high_mm"]
DOT_STYLE: dict[str, Any] = {"mfc": INK, "mec": "white", "mew": 0.4, "ms": 2.7}  # seen above a line that fits
MAX_LARGE_PANELS = 24
"""Insertions at most whose panels are large."""


_BAND_OPACITIES = {95: 0.2, 50: 0.3}  # opacity of each band; the narrow one lies on the wide one
_POINT_COLUMNS = [*INSERTION_KEYS, "curve", "x_mm", *HEIGHT_COLUMNS]
_BAND_COLOUR = METHOD_COLOURS["fitted"]


def choose_dashes(method: str) -> Any:  # noqa: ANN401
    """Return a method's line style: every other baseline is dashed, so that both of two equal lines show."""
    names = [baseline.name for baseline in list_baselines()]
    return (0, (4, 2)) if method in names and names.index(method) % 2 else "-"


def list_residual_methods() -> tuple[str, ...]:
    """Return the methods drawn less the fit; a straight line, without coefficients, would hide all others."""
    return ("hand_tuned", *(one.name for one in reversed(list_baselines()) if one.scales or one.fit))


def collect_curves(results: Run, role: str, shown: Iterable[str], every: int = 1) -> pd.DataFrame:
    """Return one row per drawn point of a role's insertions; y is toward the bevel, mm.

    `curve` is a method of `shown`, "measured" (of the points, one in `every`), or the level of a band, which
    held-out insertions have: `low_mm`, `high_mm` are its ends.
    """
    where = "role == @role and boundaries == 'measured' and method in @shown"
    shapes = results.frames["shapes"].query(where, local_dict={"role": role, "shown": list(shown)})
    shapes = shapes.sort_values([*INSERTION_KEYS, "method", "j"])
    simulated = shapes.set_axis([c.replace("simulated_", "") for c in shapes.columns], axis=1)
    dots = shapes.drop_duplicates([*INSERTION_KEYS, "j"])
    bands = _align_bands(results.frames["bands"], dots)
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
            look = {"color": method_colour(method), "lw": 1.1, "ls": choose_dashes(method)}
            handles.append(Line2D([], [], **look, label=name))
    if "95 %" in present:
        handles += [
            Patch(color=_BAND_COLOUR, alpha=a, lw=0, label=f"{n} % predictive band")
            for n, a in ((50, 0.44), (95, 0.2))
        ]
    names = [str(handle.get_label()) for handle in handles]
    columns = count_legend_columns(figure, names, 5 if len(handles) <= 5 else 3)
    figure.legend(
        handles=handles, loc="outside upper left", ncols=columns, handlelength=1.3, columnspacing=1.2
    )


_OVERLAY_METHODS = ("hand_tuned", "fitted")
_CURVES = ("measured", *_OVERLAY_METHODS)  # they fill the panels; wide bands leave them
_OVERLAY_POINT_STEP = 5  # of the points compared, one in so many is drawn as a dot, or half of these
_ROW_MARGIN_IN = 0.32  # inches of each row beside its panel


def draw_overlays(results: Run, path: Path, role: str = "validate") -> Path:
    """Draw each insertion of a role: the measured needle as dots, the model's prediction as a line.

    Where it was held out, bands say where 50 and 95 % of its measurements were predicted to lie. All panels
    have the same axes in mm; deflections are exaggerated by the factor that stands at the axis.
    """
    titles = _panel_titles(results, role)
    every = _OVERLAY_POINT_STEP if len(titles) <= MAX_LARGE_PANELS else 2 * _OVERLAY_POINT_STEP
    names = {method: method_name(method) for method in reversed(_OVERLAY_METHODS)}
    drawn = collect_curves(results, role, _OVERLAY_METHODS, every)
    return plot(path, drawn, lambda points: _paint_overlays(points, titles, names))


def _panel_titles(results: Run, role: str) -> dict[InsertionKey, str]:
    """Return by fold and insertion what stands above its panel: its tip error."""
    errors_frame = results.frames["errors"]
    scored = errors_frame.query("role == @role and boundaries == 'measured' and method == 'fitted'")
    summary = {}
    for row in to_records(scored):
        digits = 3 if row["comparison"] == "aligned" else 2
        error = f"{format_mm(row['te_mm'], digits)} mm"
        summary[row["fold"], row["insertion"]] = error if row["converged"] else "did not converge"
    return summary


def _paint_overlays(points: pd.DataFrame, titles: dict[InsertionKey, str], names: dict[str, str]) -> Figure:
    width = choose_width()
    columns = _count_columns(len(titles), width)
    x, y = _find_range(points[["x_mm"]]), _find_limits(points, points["curve"].isin(_CURVES))
    factor = choose_vertical_scale(x[1] - x[0], y[1] - y[0])
    wide = (width - 0.4) / columns - 0.12
    high = min(factor * (y[1] - y[0]) / (x[1] - x[0]), 1.0) * wide
    rows = math.ceil(len(titles) / columns)
    figure = Figure(figsize=(width, rows * (high + _ROW_MARGIN_IN) + 0.75))
    for axes, which, mine in iterate_panels(figure, points, columns, titles):
        _paint_overlay_panel(axes, mine)
        axes.set_title(titles[which], loc="right", pad=3, color=METHOD_COLOURS["fitted"])
        axes.set(xlim=x, ylim=y, aspect=factor)
        axes.yaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
    return _finish(figure, points, names, factor)


def _finish(figure: Figure, points: pd.DataFrame, names: dict[str, str], factor: int) -> Figure:
    """Return the figure with what all of its panels share: axis labels, legend, height."""
    figure.supxlabel("depth (mm)")
    figure.supylabel(f"deflection toward\nthe bevel (mm),\n{describe_scale(factor)}")
    draw_legend(figure, set(points["curve"]), names)
    fit_height(figure)
    return figure


def _count_columns(panels: int, width: float) -> int:
    most = 2 if width <= COLUMN_WIDTH_IN else 4
    return min(panels, most)


def _paint_overlay_panel(axes: Axes, points: pd.DataFrame) -> None:
    paint_bands(axes, points)
    for method in _OVERLAY_METHODS:
        curve, ours = points[points["curve"] == method], method == "fitted"
        colour = method_colour(method)
        axes.plot(curve["x_mm"], curve["y_mm"], color=colour, lw=1.1 if ours else 0.8, zorder=2.0 + ours)
    dots = points[points["curve"] == "measured"]
    axes.plot(dots["x_mm"], dots["y_mm"], "o", zorder=4, **{**DOT_STYLE, "ms": 2.2, "mew": 0.3})


_SHAFT_SHARE = 0.16  # of the depth, drawn before the entry


def draw_schematic(results: Run, path: Path, role: str = "validate") -> Path:
    """Draw the insertions with the smallest and the largest tip error: tissue, needle, measurement, band."""
    titles = _panel_titles(results, role)
    chosen = find_extremes(results, role)
    points = collect_curves(results, role, ("fitted",), _OVERLAY_POINT_STEP)
    here = pd.MultiIndex.from_frame(points[INSERTION_KEYS]).isin(list(chosen.values()))
    names = {"fitted": method_name("fitted")}
    heads = {which: f"{word}: TE {titles[which]}" for word, which in chosen.items()}
    shown = pd.concat([points[here], _list_layers(results, chosen.values())], ignore_index=True)
    return plot(path, shown, lambda drawn: _paint_schematic(drawn, heads, names))


def _list_layers(results: Run, chosen: Iterable[InsertionKey]) -> pd.DataFrame:
    """Return a row for each layer of some insertions: `curve` is its name, `x_mm` where it begins."""
    stored = results.run.get("layers", {})
    rows = [
        {"fold": fold, "insertion": insertion, "curve": f"{_LAYER} {layer:.0f}", "x_mm": float(begin)}
        for fold, insertion in chosen
        for layer, begin in stored.get(insertion, [(1, 0.0)])
    ]
    return pd.DataFrame(rows).assign(origin=results.origin)


def find_extremes(results: Run, role: str) -> dict[str, InsertionKey]:
    """Return the insertions with the smallest and the largest tip error; one alone is "only"."""
    keys = _rank_by_tip_error(results, role)
    return {"Only insertion": keys[0]} if len(keys) == 1 else {"Best": keys[0], "Worst": keys[-1]}


def _rank_by_tip_error(results: Run, role: str) -> list[InsertionKey]:
    """Return the insertions of a role by the tip error of the fit, smallest first."""
    rows = results.frames["errors"].query(
        "role == @role and boundaries == 'measured' and method == 'fitted' and converged"
    )
    rows = rows.sort_values("te_mm", kind="stable")
    return list(rows[INSERTION_KEYS].itertuples(index=False, name=None))


def _paint_schematic(points: pd.DataFrame, heads: dict[InsertionKey, str], names: dict[str, str]) -> Figure:
    x, y = _find_range(points[["x_mm"]]), _find_range(points[HEIGHT_COLUMNS])
    left = x[0] - _SHAFT_SHARE * (x[1] - x[0])
    factor = choose_vertical_scale(x[1] - left, y[1] - y[0])
    width = choose_width()
    columns = 1 if width <= COLUMN_WIDTH_IN else 2
    wide = (width - 0.5) / columns
    high = min(factor * (y[1] - y[0]) / (x[1] - left), 1.0) * wide
    figure = Figure(figsize=(width, math.ceil(len(heads) / columns) * (high + _ROW_MARGIN_IN) + 0.65))
    for axes, which, mine in iterate_panels(figure, points, columns, heads):
        _paint_layers(axes, mine, x[1], y[1])
        _paint_overlay_panel(axes, mine)
        _paint_shaft_and_tips(axes, mine, left)
        axes.set_title(heads[which], loc="right", pad=3, color=METHOD_COLOURS["fitted"])
        axes.set(xlim=(left, x[1]), ylim=y, aspect=factor)
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    return _finish(figure, points, names, factor)


_LAYER = "layer"
_LAYER_COLOURS = ("#f3ecdd", "#e9e0ca")


def _paint_layers(axes: Axes, points: pd.DataFrame, end: float, top: float) -> None:
    """Shade the layers up to the depth `end`, and write the number of each where it begins."""
    layers = points[points["curve"].str.startswith(_LAYER)]
    ends = [*layers["x_mm"].iloc[1:], end]
    for name, begin, stop in zip(layers["curve"], layers["x_mm"], ends, strict=True):
        shade = _LAYER_COLOURS[(int(name.removeprefix(_LAYER)) - 1) % 2]
        axes.axvspan(begin, stop, color=shade, lw=0, zorder=0)
        axes.axvline(begin, color=GREY, lw=0.8 if begin == 0 else 0.4, zorder=0.5)
        axes.text(begin + 0.4, top, name.removeprefix(_LAYER).strip(), color=GREY, va="top")


def _paint_shaft_and_tips(axes: Axes, points: pd.DataFrame, left: float) -> None:
    """Draw the needle before the entry, and the tip error as the gap between both tips."""
    ends = {name: points[points["curve"] == name].dropna(subset="y_mm") for name in ("fitted", "measured")}
    if any(part.empty for part in ends.values()):
        return
    start = ends["fitted"].iloc[0]
    axes.plot([left, start["x_mm"]], [start["y_mm"]] * 2, color=METHOD_COLOURS["fitted"], lw=2.6, zorder=2)
    tips = [part.sort_values("x_mm").iloc[-1] for part in ends.values()]
    across, up = ([float(tip[name]) for tip in tips] for name in ("x_mm", "y_mm"))
    axes.plot(across, up, color=PAPER_COLOUR, lw=1.2, zorder=5)


def _find_range(values: pd.DataFrame) -> tuple[float, float]:
    """Return the range of all values, and some room."""
    low, high = (float(f(values.to_numpy(dtype=np.float64))) for f in (np.nanmin, np.nanmax))
    margin = 0.06 * max(high - low, 0.2)
    return low - margin, high + margin


_LEGEND_LINE_IN = 0.16
_RESIDUAL_POINT_STEP = 2  # of the points compared, one in so many is drawn


def draw_residuals(results: Run, path: Path, role: str = "validate") -> Path:
    """Draw deflections minus that of the fitted needle at the same x, mm, of the insertions with the
    smallest, the median and the largest tip error.

    Measured points as dots, baselines as lines, and the bands of what was predicted. The straight line is
    left out: it would hide all others.
    """
    methods = ("fitted", *list_residual_methods())
    names = {method: method_name(method) for method in methods}
    points = collect_curves(results, role, methods, _RESIDUAL_POINT_STEP)
    ranked = _rank_by_tip_error(results, role)
    chosen = list(dict.fromkeys([ranked[0], ranked[len(ranked) // 2], ranked[-1]]))
    here = pd.MultiIndex.from_frame(points[INSERTION_KEYS]).isin(chosen)
    return plot(path, subtract_fit(points[here]), lambda drawn: _paint_residuals(drawn, names, chosen))


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


def _paint_residuals(points: pd.DataFrame, names: dict[str, str], wanted: list[InsertionKey]) -> Figure:
    width = choose_width()
    columns = 1 if width <= COLUMN_WIDTH_IN else 3
    legend = _LEGEND_LINE_IN * math.ceil((len(names) + 3) / columns)
    figure = Figure(figsize=(width, 1.35 * math.ceil(len(wanted) / columns) + 0.35 + legend))
    for number, (axes, _, mine) in enumerate(iterate_panels(figure, points, columns, wanted)):
        _paint_residual_panel(axes, mine)
        if number % columns == 0:
            axes.set_ylabel("deflection\nminus fit (mm)")
    axes.set_ylim(_find_limits(points, ~points["curve"].isin([*list_residual_methods(), "95 %"])))
    figure.supxlabel("depth (mm)")
    draw_legend(figure, {"fitted", *points["curve"]}, names)
    return figure


def _paint_residual_panel(axes: Axes, points: pd.DataFrame) -> None:
    paint_bands(axes, points)
    axes.axhline(0.0, color=METHOD_COLOURS["fitted"], lw=1.0)
    for method in list_residual_methods():
        curve = points[points["curve"] == method]
        line = {"color": method_colour(method), "lw": 0.8, "ls": choose_dashes(method)}
        axes.plot(curve["x_mm"], curve["y_mm"], **line)
    dots = points[points["curve"] == "measured"]
    axes.plot(dots["x_mm"], dots["y_mm"], "o", zorder=4, **{**DOT_STYLE, "ms": 1.8, "mew": 0})
    draw_grid(axes, "y")


def _find_limits(points: pd.DataFrame, near: "pd.Series[bool]") -> tuple[float, float]:
    """Return a range of heights: of the points marked as near, and of the others what is not much farther."""
    every, own = (frame[HEIGHT_COLUMNS].to_numpy(dtype=np.float64) for frame in (points, points[near]))
    low, high = float(np.nanmin(own)), float(np.nanmax(own))
    far, room = 0.5 * (high - low), 0.06 * max(high - low, 0.2)
    return max(low - far, float(np.nanmin(every))) - room, min(high + far, float(np.nanmax(every))) + room
