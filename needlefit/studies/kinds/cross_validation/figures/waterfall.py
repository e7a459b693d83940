"""Figure of a multi-start search: objective and parameters at the end of each start."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.figures.style import COLUMN_WIDTH_IN, choose_width, draw_grid, plot
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS, method_colour, method_name
from needlefit.reporting.number_format import format_bare_symbol, format_quantity
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.kinds.cross_validation.facts import describe_counts
from needlefit.studies.run import Run


def draw_waterfall(results: Run, path: Path) -> Path:
    """Draw the objective of all starts above the best one, and the final value of each parameter within its
    bounds.

    The data do not determine a parameter whose dots within tolerance of the best objective spread along its
    axis.
    """
    return plot(path, tabulate_starts(results), _paint)


def tabulate_starts(results: Run) -> pd.DataFrame:
    """Return one row per start and free parameter: rank, objective minus best, and final value.

    Ranks are within a search, best first; starts without a result have none. Only of the fit itself are the
    parameters' ends drawn, so those of other searches are left out.
    """
    keys = ["fold", "fit", "start", "excess", "within_tolerance", "objective"]
    starts = results.frames["starts"].astype({"excess": float, "objective": float})
    starts["rank"] = (
        starts["excess"]
        .where(np.isfinite(starts["excess"]))
        .groupby([starts["fold"], starts["fit"]], sort=False)
        .rank(method="first")
    )
    rows = []
    for start in to_records(starts):
        row = {key: start[key] for key in (*keys[:3], "rank", *keys[3:5])}
        row["failed"] = start["objective"] is None
        free = _free_rows(results) if start["fit"] == "fitted" else []
        rows += [row | _end_values(start, one) for one in free] or [row]
    columns = ["fold", "fit", "start", "rank", "excess", "within_tolerance", "failed", *_END_COLUMNS]
    return pd.DataFrame(rows, columns=columns).assign(origin=results.origin)


_END_COLUMNS = ("parameter", "value", "bound_low", "bound_high", "between_bounds")


def _end_values(start: Row, free: Row) -> Row:
    values = (start[free["parameter"]], free["bound_low"], free["bound_high"])
    share = None if values[0] is None else _fraction_of_bounds(free["parameter"], *values)
    return dict(zip(_END_COLUMNS, (free["parameter"], *values, share), strict=True))


def _paint(marks: pd.DataFrame) -> Figure:
    parameters = list(dict.fromkeys(marks["parameter"].dropna()))
    width, height = choose_width(), max(1.8, 0.7 + 0.24 * len(parameters))
    if width > COLUMN_WIDTH_IN:
        figure = Figure(figsize=(width, height))
        left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
    else:
        figure = Figure(figsize=(width, 2 * height))
        left, right = figure.subplots(2, 1)
    _paint_ranked(left, marks.drop_duplicates(["fold", "fit", "start"]))
    _paint_ends(right, marks, parameters)
    return figure


MIN_SHOWN_EXCESS = 1e-3
"""Tolerances: starts nearer to the best one are drawn here, for the axis is logarithmic."""


def _paint_ranked(axes: Axes, starts: pd.DataFrame) -> None:
    """Draw the excess of each search's starts, best first; failed starts stand nowhere but in the count."""
    for (fit, _), group in starts.groupby(["fit", "fold"], sort=False):
        ranked = group[group["rank"].notna()].sort_values("rank")
        shown = ranked["excess"].clip(lower=MIN_SHOWN_EXCESS)
        axes.plot(ranked["rank"], shown, "o-", color=method_colour(str(fit)), ms=3, lw=0.8)
    failed = int(starts["failed"].sum())
    fits = list(dict.fromkeys(starts["fit"]))
    each = ", a line per fold" if starts["fold"].nunique() > 1 else ""
    handles = [
        Line2D([], [], color=method_colour(f), marker="o", ms=3, lw=0.8, label=method_name(f) + each)
        for f in fits
    ]
    axes.legend(handles=handles, loc="best", handlelength=1.5)
    axes.set_title(describe_counts(starts) + (f",\n{failed} without a result" if failed else ""), loc="left")
    axes.set_xlabel("start, sorted")
    axes.axhline(1, color=GREY, lw=0.6, ls=(0, (2, 1.5)))
    axes.set_ylabel("objective − best (tolerances)")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(bottom=0.5 * MIN_SHOWN_EXCESS)
    draw_grid(axes, "y")


_OUTSIDE_TOLERANCE_STYLE: dict[str, Any] = {"ms": 3.4, "mfc": "none", "mec": GREY, "mew": 0.6}
_WITHIN_TOLERANCE_STYLE: dict[str, Any] = {
    "ms": 4,
    "mfc": METHOD_COLOURS["fitted"],
    "mec": "white",
    "mew": 0.4,
}


def _paint_ends(axes: Axes, marks: pd.DataFrame, parameters: list[str]) -> None:
    """Draw the end of every start of the fit within the bounds: full colour within tolerance of the best."""
    for y, name in enumerate(parameters):
        here = marks[(marks["parameter"] == name) & ~marks["failed"].astype(bool)]
        near = here["within_tolerance"].to_numpy(dtype=np.bool_)
        axes.hlines(y, 0, 1, color=GREY, lw=0.5, alpha=0.6)
        for some, look in ((~near, _OUTSIDE_TOLERANCE_STYLE), (near, _WITHIN_TOLERANCE_STYLE)):
            at = here.loc[some, "between_bounds"]
            axes.plot(at, np.full(len(at), y), "o", **look)
        bounds = marks[marks["parameter"] == name].iloc[0]
        for x, side, bound in ((0, "left", "bound_low"), (1, "right", "bound_high")):
            summary = format_quantity(name, float(bounds[bound]))
            axes.text(x, y - 0.17, summary, ha=side, va="bottom", color=GREY)
    axes.set_yticks(range(len(parameters)), [format_bare_symbol(name) for name in parameters])
    axes.set_ylim(len(parameters) - 0.45, -0.65)
    axes.set_xlim(-0.03, 1.03)
    axes.set_xticks([])
    axes.tick_params(axis="y", length=0)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    axes.set_title("final value between the bounds", loc="left", color=INK)
    axes.set_xlabel("filled: within tolerance of the best objective", color=METHOD_COLOURS["fitted"])


def _fraction_of_bounds(parameter: str, value: float, low: float, high: float) -> float:
    """Return where a value lies between the bounds, 0 to 1; moduli and lengths in logarithms."""
    if is_logarithmic(parameter):
        value, low, high = math.log(value), math.log(low), math.log(high)
    return (value - low) / (high - low)


def _free_rows(results: Run) -> list[Row]:
    rows = [
        r
        for r in to_records(results.frames["parameters"])
        if r["method"] == "fitted" and r["status"] == "free"
    ]
    first = {row["parameter"]: row for row in reversed(rows)}
    return [first[name] for name in dict.fromkeys(row["parameter"] for row in rows)]
