"""The forms of figures: each is a function of a tidy frame, whatever kind of study it comes from."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.figures import Look, Panel
from needlefit.reporting.figures.style import (
    TEXT_WIDTH_IN,
    choose_width,
    count_legend_columns,
    draw_grid,
)
from needlefit.reporting.labels import GREY, INK, SERIES_COLOURS, SYNTHETIC_COLOUR, medium_name, method_colour
from needlefit.reporting.number_format import choose_printed_unit
from needlefit.reporting.table_files import Row, to_records

MAX_NAMED_SERIES = 8  # more series than these are not named one by one


def choose_looks(frame: pd.DataFrame, by: str, looks: Mapping[str, Look] | None = None) -> dict[str, Look]:
    """Return the look of each series, in the order of the frame; those without one get a colour each."""
    names = [str(name) for name in dict.fromkeys(frame[by])]
    if looks is not None:
        return {name: looks[name] for name in looks if name in names}
    colours = (SERIES_COLOURS[n % len(SERIES_COLOURS)] for n in range(len(names)))
    return {name: Look(name, colour) for name, colour in zip(names, colours, strict=True)}


def curves(
    frame: pd.DataFrame,
    x: str,
    by: str,
    panels: Sequence[Panel],
    x_label: str = "",
    looks: Mapping[str, Look] | None = None,
    size: tuple[float, float] | None = None,
) -> Figure:
    """Draw columns over the column `x`, a series for each value of `by`."""
    chosen = choose_looks(frame, by, looks)
    figure = Figure(figsize=size or (0.6 * TEXT_WIDTH_IN, 3.3))
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)
    for axes, panel in zip(grid.flat, panels, strict=True):
        for name, look in chosen.items():
            _draw_curve(axes, frame[frame[by].astype(str) == name].sort_values(x), x, panel, look)
        axes.set_ylabel(panel.label)
        draw_grid(axes, "y")
        if panel.zero:
            axes.axhline(0.0, color=INK, lw=0.5)
    grid[-1, 0].set_xlabel(x_label or x)
    if 1 < len(chosen) <= MAX_NAMED_SERIES:
        add_legend(figure, chosen.values(), width=1.3)
    return figure


def _draw_curve(axes: Axes, rows: pd.DataFrame, x: str, panel: Panel, look: Look) -> None:
    if panel.low:
        low, high = (rows[end].astype(float) for end in (panel.low, panel.high))
        axes.fill_between(rows[x], low, high, color=lighten(look.colour, look.white), lw=0, zorder=1)
    if panel.line:
        axes.plot(rows[x], rows[panel.line], lw=look.width, ls=look.dashes, zorder=3, color=look.colour)


def set_plain_log_scale(axis: Axis) -> None:
    """Make an axis logarithmic, with plain numbers at as many places as a decade needs to be read."""
    axes = axis.axes
    end = "x" if axis is axes.xaxis else "y"
    getattr(axes, f"set_{end}scale")("log")
    low, high = getattr(axes, f"get_{end}lim")()
    steps = (1,) if high > 200 * low else (1, 2, 5) if high > 20 * low else (1, 2, 3, 5, 7)
    ticks = [t for power in range(-6, 6) for t in (k * 10.0**power for k in steps) if low <= t <= high]
    axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_ticks([], minor=True)


def lighten(colour: str, share: float) -> tuple[float, float, float]:
    """Return a colour with this share of white: opaque, so that it is the same over every background."""
    red, green, blue = (share + (1 - share) * part for part in to_rgb(colour))
    return red, green, blue


_LEGEND_LINE_IN = 0.17


def add_legend(figure: Figure, looks: Iterable[Look], width: float = 0.0) -> int:
    """Draw a legend above all panels; return its columns. `width` is that of the lines, 0 of marks alone."""
    handles = [
        Line2D(
            [], [], color=one.colour, lw=one.width if width else 0, ls=one.dashes, marker=one.marker,
            ms=one.size, mfc=one.colour if one.filled else "white", label=one.label, solid_capstyle="butt",
        )
        for one in looks
    ]  # fmt: skip
    columns = count_legend_columns(figure, [one.label for one in looks], min(len(handles), 5))
    spacing: dict[str, Any] = {"handlelength": width or 0.8, "handletextpad": 0.4, "columnspacing": 1.3}
    figure.legend(handles=handles, loc="outside upper left", ncols=columns, **spacing)
    return columns


def dots_with_intervals(
    frame: pd.DataFrame,
    rows: Sequence[str],  # columns that make a row; a rule stands where the first of several changes
    value: str,  # the column that is drawn
    by: str,  # the column that says in which look
    looks: Mapping[str, Look] | None = None,  # by value of `by`, in the order of the legend
    name_row: Callable[[tuple[Any, ...]], str] = lambda row: ", ".join(map(str, row)),
    intervals: Sequence[tuple[str, str]] = (),  # columns (low, high), the wide interval first
    panel: str = "",  # a column; empty: one panel
    panels: Mapping[Any, str] | None = None,  # value of `panel` -> title
    x_label: str = "",
    # "linear", "from 0" or "log"; or a mapping of these, by value of `panel`, with axes of their own
    scale: str | Mapping[Any, str] = "linear",
    row_height: float = 0.22,  # inches
) -> Figure:
    """Draw values with their intervals in rows, a panel for each value of the column `panel`."""
    chosen = choose_looks(frame, by, looks)
    order = list(frame[list(rows)].drop_duplicates().itertuples(index=False, name=None))
    titles = panels or ({name: str(name) for name in dict.fromkeys(frame[panel])} if panel else {"": ""})
    figure = Figure(figsize=(choose_width(), 0.9 + row_height * len(order)))
    own_axes = isinstance(scale, Mapping)
    grid = figure.subplots(1, len(titles), sharex=not own_axes, sharey=True, squeeze=False)[0]
    for axes, (which, title) in zip(grid, titles.items(), strict=True):
        for row in to_records(frame[frame[panel] == which] if panel else frame):
            look = chosen.get(str(row[by]))
            if look is not None and row[value] is not None:
                place = order.index(tuple(row[name] for name in rows)) + look.shift
                _draw_dot(axes, row, place, value, intervals, look)
        axes.set_title(title, loc="left", fontsize=7)
        _format_rows(axes, order, scale[which] if isinstance(scale, Mapping) else scale)
    grid[0].set_yticks(range(len(order)), [name_row(row) for row in order])
    grid[0].set_ylim(len(order) - 0.4, -0.6)
    if len(chosen) > 1:
        columns = add_legend(figure, chosen.values())
        lines = math.ceil(len(chosen) / columns)
        figure.set_figheight(figure.get_figheight() + _LEGEND_LINE_IN * (lines - 1))
    figure.supxlabel(x_label, fontsize=7.5)
    return figure


def _draw_dot(
    axes: Axes, row: Row, y: float, value: str, intervals: Sequence[tuple[str, str]], look: Look
) -> None:
    for width, (low, high) in zip((0.9, 2.4), intervals, strict=False):
        if row[low] is not None and row[high] is not None:
            axes.hlines(y, row[low], row[high], color=look.colour, lw=width)
    if look.marker == "|":
        axes.vlines(row[value], y - 0.35, y + 0.35, color=look.colour, lw=look.width, ls=look.dashes)
        return
    face = look.colour if look.filled else "white"
    axes.plot(row[value], y, look.marker, ms=look.size, mfc=face, mec=look.colour, mew=0.8, zorder=4)


def _format_rows(axes: Axes, order: Sequence[tuple[Any, ...]], scale: str) -> None:
    if scale == "log":
        set_plain_log_scale(axes.xaxis)
    elif scale == "from 0":
        axes.set_xlim(0, None)
    for y in (k for k in range(1, len(order)) if len(order[0]) > 1 and order[k][0] != order[k - 1][0]):
        axes.axhline(y - 0.5, color=INK, lw=0.3, alpha=0.4)
    axes.tick_params(axis="y", length=0)
    draw_grid(axes, "x")


def steps_in_bands(frame: pd.DataFrame, x_label: str, y_label: str, across: int = 4) -> Figure:
    """Draw a step line about 0 on a band, a panel for each `panel` (its title).

    `frame` has the columns `x` (0 to 1), `low`, `high`, `y`, `inside` (of the band), and `passes`: the title
    of a panel that does not pass is coloured.
    """
    panels = list(frame.groupby("panel", sort=False))
    down = -(-len(panels) // across)
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.35 + 1.45 * down))
    drawn = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
    for n, axes in enumerate(drawn.flat):
        if n >= len(panels):
            axes.set_axis_off()
            continue
        title, rows = panels[n]
        axes.fill_between(rows["x"], rows["low"], rows["high"], color=GREY, alpha=0.22, lw=0)
        axes.axhline(0, color=GREY, lw=0.5)
        axes.step(rows["x"], rows["y"], where="post", color=SERIES_COLOURS[0], lw=1.0)
        outside = rows[~rows["inside"]]
        axes.plot(outside["x"], outside["y"], ".", color=SYNTHETIC_COLOUR, ms=2.5)
        axes.set_title(title, loc="left", color=INK if rows["passes"].all() else SYNTHETIC_COLOUR)
        axes.set_xlim(0, 1)
        axes.set_xticks([0, 0.5, 1], ["0", "½", "1"])
        if n + across >= len(panels):
            axes.set_xlabel(x_label)
            axes.tick_params(labelbottom=True)
        if n % across == 0:
            axes.set_ylabel(y_label)
    return figure


def tracks(readings: pd.DataFrame) -> Figure:
    """Draw every predicted run of tip tracks, a row of panels for each medium: the tip, below it the guide.

    `readings` has the columns of the frame `readings` of such a study.
    """
    media = {name: list(dict.fromkeys(some["run"])) for name, some in readings.groupby("medium", sort=False)}
    down, across = max(1, len(media)), max(map(len, media.values()), default=1)
    figure = Figure(figsize=(TEXT_WIDTH_IN, 1.75 * down))
    grid = figure.add_gridspec(2 * down, across, height_ratios=[3, 1] * down)
    for n, (medium, names) in enumerate(media.items()):
        group = readings[readings["medium"] == medium]
        values = np.concatenate([group["measured_mm"], group["median_mm"].dropna()])
        room = 0.25 * (values.max() - values.min())  # bands may leave it
        for k, name in enumerate(names):
            tip = figure.add_subplot(grid[2 * n, k])
            guide = figure.add_subplot(grid[2 * n + 1, k], sharex=tip)
            run = group[group["run"] == name]
            _draw_readings(tip, run)
            known = run[run["method"] == run["method"].iloc[0]]
            guide.step(known["depth_mm"], known["guide_mm"], where="pre", color=GREY, lw=0.9)
            tip.set_ylim(values.min() - room, values.max() + room)
            guide.set_ylim(group["guide_mm"].min() - 1, group["guide_mm"].max() + 1)
            short = str(name).removeprefix(str(medium)).strip("_-. ") or str(name)
            tip.set_title(short.replace("_", " "), loc="left", fontsize=6)
            tip.tick_params(labelbottom=False, labelleft=k == 0)
            guide.tick_params(labelbottom=n == down - 1, labelleft=k == 0)
            draw_grid(tip, "y")
            if k == 0:
                tip.set_ylabel(f"{medium_name(str(medium))}\ntip (mm)")
                guide.set_ylabel("guide\n(mm)")
            if n == down - 1:
                guide.set_xlabel("depth (mm)")
    return figure


def _draw_readings(axes: Axes, run: pd.DataFrame) -> None:
    for method, some in run[run["scored"]].groupby("method", sort=False):
        colour, fitted = method_colour(str(method)), method == "fitted"
        for level, share in ((95, 0.84), (50, 0.68)) if fitted else ():
            ends = some[f"low_{level}_mm"], some[f"high_{level}_mm"]
            axes.fill_between(some["depth_mm"], *ends, color=lighten(colour, share), lw=0)
        axes.plot(some["depth_mm"], some["median_mm"], color=colour, lw=1.2 if fitted else 0.9)
    measured = run[run["method"] == run["method"].iloc[0]]
    for scored, face in ((True, INK), (False, "none")):
        some = measured[measured["scored"] == scored]
        axes.plot(some["depth_mm"], some["measured_mm"], "o", ms=2, mfc=face, mec=INK, mew=0.5)


def histograms(bins: pd.DataFrame, counts: str) -> Figure:
    """Draw histograms of the column `counts` by `parameter`; `low` and `high` are edges in units of files."""
    groups = list(bins.groupby("parameter", sort=False))
    figure = Figure(figsize=(TEXT_WIDTH_IN, 1.9), layout="constrained")
    panels = figure.subplots(1, len(groups), sharey=True, squeeze=False)[0]
    for axes, (name, rows) in zip(panels, groups, strict=True):
        label, unit = choose_printed_unit(str(name), rows["high"])
        edges = np.append(rows["low"], rows["high"].iloc[-1]) / unit
        axes.stairs(rows[counts], edges, fill=True, color=SERIES_COLOURS[0])
        if is_logarithmic(str(name)) and edges[-1] > 10 * edges[0]:
            axes.set_xscale("log")
        axes.set_xlabel(label)
        draw_grid(axes, "y")
    figure.axes[0].set_ylabel(counts)
    return figure
