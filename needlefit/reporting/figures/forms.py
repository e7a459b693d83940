"""The forms of figures: each is a function of a tidy frame, whatever kind of study it comes from."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import scipy
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, NullLocator

from needlefit.inference.parameter_names import is_logarithmic
from needlefit.reporting.figures import (
    BAND_WHITE,
    HEIGHT_COLUMNS,
    PROFILE_KEYS,
    TIP_ERROR,
    VERDICT_COLUMNS,
    InsertionKey,
    Look,
    Panel,
)
from needlefit.reporting.figures.style import (
    COLUMN_WIDTH_IN,
    GAP_IN,
    LABEL_IN,
    LETTER_WIDTH_IN,
    TEXT_WIDTH_IN,
    TICKS_IN,
    TITLE_IN,
    add_legend,
    choose_vertical_scale,
    choose_width,
    describe_scale,
    draw_grid,
    set_margins,
)
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS, PAPER_COLOUR, SERIES_COLOURS, method_colour
from needlefit.reporting.number_format import choose_interval_unit, format_number, typeset, typeset_interval
from needlefit.reporting.table_files import Row, select_rows, to_records

MAX_NAMED_SERIES = 8  # largest number of series that a legend names


def choose_looks(frame: pd.DataFrame, by: str, looks: Mapping[str, Look] | None = None) -> dict[str, Look]:
    """Return the look of each series: of `looks` those that the frame has, without any a colour each."""
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
    x_label: str,
    looks: Mapping[str, Look] | None = None,
    size: tuple[float, float] = (0.6 * TEXT_WIDTH_IN, 3.3),
) -> Figure:
    """Draw columns over the column `x`, a series for each value of `by`; a line marks 0."""
    chosen, figure = choose_looks(frame, by, looks), Figure(figsize=size)
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)
    for axes, panel in zip(grid.flat, panels, strict=True):
        for name, look in chosen.items():
            rows = frame[frame[by].astype(str) == name].sort_values(x)
            low, high = (rows[end].astype(float) for end in (panel.low, panel.high))
            axes.fill_between(rows[x], low, high, color=lighten(look.colour, look.white), lw=0, zorder=1)
            axes.plot(rows[x], rows[panel.line], lw=look.width, zorder=3, color=look.colour)
        axes.set_ylabel(panel.label)
        draw_grid(axes)
        axes.axhline(0.0, color=INK, lw=0.5)
    grid[-1, 0].set_xlabel(x_label)
    above = GAP_IN
    if 1 < len(chosen) <= MAX_NAMED_SERIES:
        handles = [
            Line2D([], [], color=curve.colour, lw=curve.width, label=curve.label, solid_capstyle="butt")
            for curve in chosen.values()
        ]
        above = add_legend(figure, handles, 5)
    set_margins(figure, 0.58, above)
    return figure


def readings(frame: pd.DataFrame, x: str, x_label: str, y_label: str, height: float) -> Figure:
    """Draw numbers that were measured, over the column `x`, and their predictions with 95 % intervals.

    `frame` has the columns `panel`, by whose values panels are, each `height` inches high, `measured`,
    `predicted`, `low` and `high`; the last two are empty where nothing certified was predicted.
    """
    groups = list(frame.groupby("panel", sort=False))
    across = min(MAX_PANEL_COLUMNS, len(groups))
    down = math.ceil(len(groups) / across)
    figure = Figure(figsize=(TEXT_WIDTH_IN, height * down))
    panels = figure.subplots(down, across, sharex=True, sharey=True, squeeze=False)
    for axes in panels.flat[len(groups) :]:
        axes.set_axis_off()
    for axes, (title, rows) in zip(panels.flat, groups, strict=False):
        axes.vlines(rows[x], rows["low"], rows["high"], color=SERIES_COLOURS[0], alpha=0.4, lw=3)
        axes.plot(rows[x], rows["predicted"], "_", color=SERIES_COLOURS[0], ms=7)
        axes.plot(rows[x], rows["measured"], "o", color=INK, ms=2.5)
        axes.set_title(title, loc="left")
        axes.set_xlabel(x_label)
        draw_grid(axes)
    for axes in panels[:, 0]:
        axes.set_ylabel(y_label)
    return figure


def lighten(colour: str, share: float) -> tuple[float, float, float]:
    """Return a colour with this share of white: opaque, so that it is the same over every background."""
    red, green, blue = (share + (1 - share) * part for part in to_rgb(colour))
    return red, green, blue


_OURS = METHOD_COLOURS["fitted"]


def _line(label: str, **style: Any) -> Line2D:  # noqa: ANN401
    return Line2D([], [], label=label, **style)


# ---- insertions with bands

BANDS = {level: lighten(_OURS, white) for level, white in BAND_WHITE.items()}
"""Opaque colours, the narrow band on the wide one: the same over every layer."""


def insertions(
    points: pd.DataFrame,
    heads: Mapping[InsertionKey, str],  # what stands above the panel of each insertion
    names: Mapping[str, str],  # printed names of the methods, the foremost line first
    height: str = "deflection toward\nthe bevel (mm)",  # what `y_mm` is: z, of needles from above
) -> Figure:
    """Draw a panel for each insertion: the measured needle as dots, methods as lines, bands behind.

    All panels have the same axes in mm; heights are exaggerated by the factor that stands at the axis.
    `points` has a row per point: `fold`, `insertion`, `curve` (a method, "measured", or the level of a band),
    `x_mm`, `y_mm`, `low_mm`, `high_mm`.
    """
    width = choose_width()
    columns = min(len(heads), MAX_PANEL_COLUMNS if width > COLUMN_WIDTH_IN else MAX_PANEL_COLUMNS // 2)
    left, right = _find_range(points[["x_mm"]])
    y = _find_limits(points, points["curve"].isin(["measured", *names]))
    factor = choose_vertical_scale(right - left, y[1] - y[0])
    locator = MaxNLocator(3, steps=[1, 2, 5, 10])
    letters = max(len(f"{tick:.3g}") for tick in locator.tick_values(*y)[1:-1])
    beside = LABEL_IN * (height.count("\n") + 2) + LETTER_WIDTH_IN * letters + GAP_IN
    wide = (width - beside - columns * GAP_IN) / columns
    high, rows = min(factor * (y[1] - y[0]) / (right - left), 1.0) * wide, math.ceil(len(heads) / columns)
    down = TITLE_IN + GAP_IN + (TICKS_IN if len(heads) % columns and rows > 1 else 0.0)
    figure = Figure(figsize=(width, 1.0))
    for axes, which, mine in _iterate_panels(figure, points, columns, list(heads)):
        _draw_panel(axes, mine, list(names))
        axes.set_title(heads[which], loc="right", pad=3, color=_OURS)
        axes.set(xlim=(left, right), ylim=y, aspect=factor)
        axes.yaxis.set_major_locator(locator)
    above = TITLE_IN + _name_curves(figure, set(points["curve"]), names)
    below = TICKS_IN + LABEL_IN + 0.04
    figure.set_figheight(above + rows * high + (rows - 1) * down + below)
    set_margins(figure, beside, above, bottom=below, gaps=(GAP_IN, down))
    middle = (below + figure.get_figheight() - above) / 2
    figure.supxlabel("depth (mm)", x=0.5, y=0.0)
    figure.supylabel(
        f"{height},\n{describe_scale(factor)}", x=0.04 / width, y=middle / figure.get_figheight()
    )
    return figure


def _draw_panel(axes: Axes, points: pd.DataFrame, methods: Sequence[str]) -> None:
    """Draw one insertion: bands, the methods as lines, the first in front, and the measured points."""
    for order, (level, colour) in enumerate(BANDS.items()):
        band = select_rows(points, curve=level)
        axes.fill_between(
            band["x_mm"], band["low_mm"], band["high_mm"], color=colour, lw=0, zorder=1 + 0.1 * order
        )
    for order, method in enumerate(reversed(methods)):
        curve, first = select_rows(points, curve=method), method == methods[0]
        look: dict[str, Any] = {"color": method_colour(method), "lw": 1.1 if first else 0.8}
        axes.plot(curve["x_mm"], curve["y_mm"], zorder=2 + order, **look)
    dots = select_rows(points, curve="measured")
    axes.plot(dots["x_mm"], dots["y_mm"], "o", mfc=INK, mec="white", ms=2.2, mew=0.3, zorder=9)


def first_page(points: pd.DataFrame, heads: Mapping[InsertionKey, str], method: str) -> Figure:
    """Draw some insertions, each in a panel, and beside them the tip errors of all by method.

    `points` as of `insertions`; rows whose `curve` is `TIP_ERROR` have `name`, `method` and `te_mm`: of every
    insertion, the mean of the paper's, and the measurement noise, which is a grey bar.
    """
    tips = select_rows(points, curve=TIP_ERROR)
    width = choose_width()
    figure = Figure(figsize=(width, 2.0))
    grid = figure.subplots(1, len(heads) + 1, width_ratios=[*[1.0] * len(heads), 1.15])
    set_margins(figure, 0.52, TITLE_IN, gaps=(0.18, 0.0))
    curves = points[points["curve"] != TIP_ERROR]
    y = _find_limits(curves, curves["curve"].isin(["measured", method]))
    for axes, which in zip(grid, heads, strict=False):
        fold, insertion = which
        _draw_panel(axes, select_rows(curves, fold=fold, insertion=insertion), [method])
        axes.set_title(f"{insertion}: {heads[which]}", loc="left", pad=3)
        axes.set(xlim=_find_range(curves[["x_mm"]]), ylim=y, xlabel="depth (mm)")
        axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        axes.tick_params(labelleft=axes is grid[0])
    grid[0].set_ylabel("deflection (mm)")
    _draw_tip_errors(grid[-1], tips)
    return figure


def _draw_tip_errors(axes: Axes, tips: pd.DataFrame) -> None:
    """Draw a line of dots for each method, and the measurement noise as a bar from 0."""
    noise = select_rows(tips, method="noise")["te_mm"]
    if len(noise):
        axes.axvspan(0, float(noise.iloc[0]), color=lighten(GREY, 0.7), lw=0, zorder=0)
    shown = tips[tips["method"] != "noise"]
    names = list(dict.fromkeys(shown["name"]))
    for place, name in enumerate(names):
        some = select_rows(shown, name=name)
        of_paper = some["method"].iloc[0] == "paper"
        look: dict[str, Any] = {"marker": "D" if of_paper else "o", "ms": 3.2, "lw": 0}
        colour = PAPER_COLOUR if of_paper else method_colour(some["method"].iloc[0])
        look |= {"mfc": "white" if of_paper else colour, "mec": colour if of_paper else "white", "mew": 0.5}
        axes.plot(some["te_mm"], [place] * len(some), zorder=3, **look)
        axes.annotate(name, (0.02, place - 0.28), xycoords=("axes fraction", "data"), va="bottom", size=6.5)
    axes.set(ylim=(len(names) - 0.5, -0.75), xlabel="tip error (mm)", yticks=[])
    axes.set_xlim(left=0)


def _iterate_panels(
    figure: Figure, points: pd.DataFrame, columns: int, wanted: list[InsertionKey]
) -> Iterator[tuple[Axes, InsertionKey, pd.DataFrame]]:
    """Yield each insertion's panel, name and points; all panels have the same axes."""
    rows = math.ceil(len(wanted) / columns)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for i, spare in enumerate(reversed(list(grid.flat)[len(wanted) :]), start=1):
        spare.set_visible(False)
        if rows > 1:
            grid[-2, -i].tick_params(labelbottom=True)  # the panel above has the lowest x axis of its column
    for axes, (fold, insertion) in zip(grid.flat, wanted, strict=False):
        axes.set_title(insertion, loc="left", pad=3)
        yield axes, (fold, insertion), select_rows(points, fold=fold, insertion=insertion)


def _name_curves(figure: Figure, present: set[str], names: Mapping[str, str]) -> float:
    handles: list[Artist] = [_line("measured", color=INK, marker="o", ms=2.7, lw=0)]
    for method, name in names.items():
        if method in present:
            handles.append(_line(name, color=method_colour(method), lw=1.1))
    for level in reversed(BANDS):
        if level in present:
            handles.append(Patch(color=BANDS[level], lw=0, label=f"{level} predictive band, simultaneous"))
    return add_legend(figure, handles, 5 if len(handles) <= 5 else 3)


def _find_range(values: pd.DataFrame) -> tuple[float, float]:
    low, high = (float(f(values.to_numpy(dtype=np.float64))) for f in (np.nanmin, np.nanmax))
    margin = 0.06 * max(high - low, 0.2)
    return low - margin, high + margin


def _find_limits(points: pd.DataFrame, near: "pd.Series[bool]") -> tuple[float, float]:
    """Return a range of heights: of the points marked as near, and of the others what is not much farther."""
    whole, near_rows = (frame[HEIGHT_COLUMNS].to_numpy(dtype=np.float64) for frame in (points, points[near]))
    low, high = float(np.nanmin(near_rows)), float(np.nanmax(near_rows))
    far, room = 0.5 * (high - low), 0.06 * max(high - low, 0.2)
    return max(low - far, float(np.nanmin(whole))) - room, min(high + far, float(np.nanmax(whole))) + room


# ---- predictive check

PREDICTED_QUANTITIES = {"tip": ("tips", "#0072B2"), "shape": ("whole shapes", "#009E73")}
_BAND_COLOUR = lighten(GREY, 0.75)


def predictive_check(rows: pd.DataFrame) -> Figure:
    """Draw the ECDFs of PIT values, and the band of uniform ones."""
    figure = Figure(figsize=(choose_width(COLUMN_WIDTH_IN), 2.2))
    axes = figure.add_subplot()
    count, trials = int(rows["insertions"].iloc[0]), int(rows["replicates"].iloc[0])
    chance = select_rows(rows, mark="band")
    independent = f", {trials} independent" if len(chance) else " of one fit: no band"
    axes.set_title(f"{count} insertions" + ("" if trials == count else independent), loc="left")
    axes.plot([0, 1], [0, 1], color=GREY, lw=0.5)
    for quantity, (_, colour) in PREDICTED_QUANTITIES.items():
        steps = select_rows(rows, mark="ECDF", quantity=quantity)
        axes.step(steps["probability"], steps["share"], where="post", color=colour, lw=1.2)
    axes.set(xlim=(-0.02, 1.02), ylim=(-0.04, 1.04), xlabel="PIT", ylabel="empirical CDF")
    axes.set_xticks([0, 0.5, 1], ["0", "½", "1"])
    axes.set_yticks([0, 0.5, 1], ["0", "½", "1"])
    handles: list[Artist] = [_line(name, color=colour) for name, colour in PREDICTED_QUANTITIES.values()]
    if len(chance):
        low, high = (chance[side].astype(float) for side in ("low", "high"))
        axes.fill_between(chance["probability"], low, high, color=_BAND_COLOUR, lw=0, zorder=0)
        handles.append(Patch(color=_BAND_COLOUR, lw=0, label="95 % band, uniform"))
    set_margins(figure, 0.42, add_legend(figure, handles, 3) + TITLE_IN)
    return figure


# ---- profile likelihoods

# largest number of panels in a row, as a page is wide; a column of a paper has half as many
MAX_PANEL_COLUMNS = 4
MAX_TICKS = 4  # largest number of labelled ticks on a logarithmic axis of so narrow a panel
"""Greatest number of panels in a row, and of labelled ticks on a logarithmic axis."""

MAX_DEVIANCE = 6.5  # upper end of the panels' axis of deviance


def profiles(frame: pd.DataFrame) -> Figure:
    """Draw the deviance over each parameter, its 95 % interval, and the parabola of the Fisher information.

    `frame` has the computed points, between which the curve is the cubic of their slopes, and with each of
    them what is known of its parameter.
    """
    rows = to_records(frame.drop_duplicates(PROFILE_KEYS)[[*PROFILE_KEYS, *VERDICT_COLUMNS]])
    count, width = len(rows), choose_width()
    across = min(count, MAX_PANEL_COLUMNS) if width > COLUMN_WIDTH_IN else min(2, count)
    if across == MAX_PANEL_COLUMNS and -count % (across - 1) < -count % across:
        across -= 1  # the last row is then fuller
    down = math.ceil(count / across)
    words = 2 * TITLE_IN  # above each panel: the parameter, and its interval
    figure = Figure(figsize=(width, TITLE_IN + down * (0.7 + words + TICKS_IN)))
    panels = figure.subplots(down, across, squeeze=False, sharey=True)
    set_margins(figure, 0.42, TITLE_IN + words, 0.36, TICKS_IN, (2 * GAP_IN, words + TICKS_IN))
    for n, axes in enumerate(panels.flat):
        if n >= count:
            axes.axis("off")
            continue
        row = rows[n]
        points = select_rows(frame, fold=row["fold"], parameter=row["parameter"])
        label, unit = choose_interval_unit(row, row["low"], row["high"])
        if len(points) > 1:
            axes.set_title(label, loc="left", color=INK, pad=14)
            _draw_profile(axes, row, points, unit)
        else:  # nothing but the optimum could be computed
            axes.set_title(label, loc="left", color=INK)
        if n % across == 0:
            axes.set_ylabel("deviance")
    second = 0.01 + 0.55 / figure.get_figwidth()
    top = 1 - 0.04 / figure.get_figheight()
    figure.text(0.01, top, "profile", va="top", color=_OURS)
    figure.text(second, top, "information at the optimum", va="top", color=METHOD_COLOURS["hand_tuned"])
    last, threshold = panels[0, across - 1], float(frame["threshold"].iloc[0])
    last.text(1.02, threshold, "95 %", transform=last.get_yaxis_transform(), va="center", color=GREY)
    return figure


def _draw_profile(axes: Axes, row: Row, points: pd.DataFrame, unit: float) -> None:
    logarithmic = is_logarithmic(str(row["parameter"]))
    values = points["value"].to_numpy()
    logs = np.log(values) if logarithmic else values
    fine = np.linspace(logs[0], logs[-1], 400)
    places = np.exp(fine) if logarithmic else fine
    deviance, threshold = points["deviance"].to_numpy(dtype=np.float64), float(points["threshold"].iloc[0])
    curve = scipy.interpolate.CubicHermiteSpline(logs, deviance, points["slope"])(fine)
    # the interval of the tables; of a profile alone, what is within the threshold
    inside = curve <= threshold
    if _is_of_draws(row):
        inside = (places >= row["interval_low"]) & (places <= row["interval_high"])
    axes.fill_between(places, 0, MAX_DEVIANCE, where=list(inside), color=_OURS, alpha=0.1, lw=0)
    if (sd := row["fisher_sd"]) is not None:
        parabola = ((fine - logs[int(np.argmin(deviance))]) / sd) ** 2
        look: dict[str, Any] = {"color": METHOD_COLOURS["hand_tuned"], "lw": 0.9, "ls": (0, (4, 1.5))}
        axes.plot(places, parabola, zorder=2, **look)
    axes.plot(places, curve, color=_OURS, lw=1.3, zorder=3)
    axes.plot(values, deviance, "o", ms=2.6, color=_OURS, mew=0, zorder=4)
    axes.axhline(threshold, color=GREY, lw=0.6, ls=(0, (3, 2)))
    low, high = float(values[0]), float(values[-1])
    axes.set(xlim=(low, high), ylim=(0, MAX_DEVIANCE), xscale="log" if logarithmic else "linear")
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    if logarithmic:
        ticks = choose_log_ticks(low, high)
        axes.xaxis.set_minor_locator(NullLocator())
        axes.set_xticks(ticks, [typeset(format_number(tick / unit)) for tick in ticks])
    else:
        axes.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    words, is_known = _describe_state(row, unit)
    colour = INK if is_known else PAPER_COLOUR
    axes.text(0, 1.035, words, transform=axes.transAxes, va="bottom", color=colour)


def _describe_state(row: Row, unit: float) -> tuple[str, bool]:
    """Return the interval of a parameter, or why there is none; and whether it is closed and printed."""
    low, high = row["end_low"] == "closed", row["end_high"] == "closed"
    if _is_of_draws(row) or (low and high):
        return typeset_interval(row, unit), True
    if "lost" in (row["end_low"], row["end_high"]):
        return "could not be followed to its end", False
    if not low and not high:
        # flat: the deviance hardly rises over the whole range
        return f"{'flat' if (row['rise'] or 0) < 1 else 'open'}: not identifiable", False
    end = typeset(format_number((row["low"] if low else row["high"]) / unit))
    return f"{'above' if low else 'below'} {end}, open", False


def _is_of_draws(row: Row) -> bool:
    return row["draw_source"] not in (None, "", "profile")


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
