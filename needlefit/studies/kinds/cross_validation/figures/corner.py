"""Figure of posterior draws: every parameter, every pair of parameters, and the ridge."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator, NullLocator

from needlefit.arrays import Floats
from needlefit.inference.parameters import is_logarithmic
from needlefit.reporting.figures.profiles import choose_log_ticks
from needlefit.reporting.figures.style import COLUMN_WIDTH_IN, TEXT_WIDTH_IN, choose_width, plot
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS, method_name
from needlefit.reporting.number_format import (
    choose_printed_unit,
    format_plain,
)
from needlefit.studies.kinds.cross_validation.posterior import (
    find_ridge_ends,
    list_free_parameters,
    to_log_coordinates,
)
from needlefit.studies.run import Run

_MARGIN_FRACTION = 0.12  # of the range of what is shown, left free at each side
_MAX_PANEL_IN = 0.64  # inches at most
_MAX_TICK_LETTERS = 2  # signs of a number of which more than two stand along a panel
_MIN_PANEL_IN = 0.8  # inches, of panels whose numbers stand side by side
_MAX_COLUMN_PARAMETERS = 3
_DRAW_COLOUR, _RIDGE_COLOUR = METHOD_COLOURS["fitted"], "#D55E00"
_MARKS = {"fitted": ("D", 4.2, INK), "hand_tuned": ("s", 4.0, METHOD_COLOURS["hand_tuned"])}


def draw_corner(results: Run, path: Path) -> Path:
    """Draw the draws of the first fold with the fit, the paper's parameters, the bounds and the ridge."""
    names = {"fitted": "the fit", "hand_tuned": method_name("hand_tuned", results.origin)}
    return plot(path, tabulate_marks(results), lambda frame: _paint(frame, names))


def tabulate_marks(results: Run) -> pd.DataFrame:
    """Return what is drawn, Pa and mm: one row per draw, fit, paper's set, bound and end of the ridge."""
    fold = results.frames["draws"]["fold"].iloc[0]
    names = list_free_parameters(results)
    draws = results.frames["draws"].loc[results.frames["draws"]["fold"] == fold, names].assign(mark="draw")
    known = results.frames["parameters"][results.frames["parameters"]["fold"] == fold]
    values = known.pivot_table(index="method", columns="parameter", values="value", sort=False)
    sets = [method for method in _MARKS if method in values.index]
    bounds = known[known["method"] == "fitted"].set_index("parameter")[["bound_low", "bound_high"]].T
    marks = [
        values.loc[sets].reindex(columns=names).assign(mark=sets),
        bounds.reindex(columns=names).assign(mark=["lower bound", "upper bound"]),
        pd.DataFrame(find_ridge_ends(draws[names])).assign(mark="ridge"),
    ]
    frame = pd.concat([draws, *(part for part in marks if len(part))], ignore_index=True)
    drawn: pd.DataFrame = frame[["mark", *names]]
    return drawn.assign(origin=results.origin)


def _paint(frame: pd.DataFrame, summary: dict[str, str]) -> Figure:
    names = [str(name) for name in frame.columns if name not in ("mark", "origin")]
    count = len(names)
    width = choose_width(COLUMN_WIDTH_IN if count <= _MAX_COLUMN_PARAMETERS else TEXT_WIDTH_IN)
    height = min(max(_MAX_PANEL_IN * count, 2.2) + 0.4, 1.1 * width)
    figure = Figure(figsize=(width, height))
    grid = figure.add_gridspec(count, count)
    marginals: list[Axes] = []
    for row, below in enumerate(names):
        for column, left in enumerate(names[: row + 1]):
            if column == row:
                axes = figure.add_subplot(grid[row, column])
                marginals.append(axes)
                _paint_marginal(axes, frame, left)
            else:
                axes = figure.add_subplot(grid[row, column], sharex=marginals[column])
                _paint_pair(axes, frame, left, below)
            _format_axes(axes, (left, below), frame, outer=(row == count - 1, column == 0 and row > 0))
            if width / count < _MIN_PANEL_IN:
                _make_narrow(axes)
    _draw_legend(figure, frame, summary)
    return figure


def _make_narrow(axes: Axes) -> None:
    """Turn the numbers, and break the names, of a panel that is too narrow for them."""
    axes.tick_params(axis="x", labelrotation=90)
    axes.set_xlabel(axes.get_xlabel().replace(" ", "\n", 1))
    axes.set_ylabel(axes.get_ylabel().replace(" ", "\n", 1))
    axes.set_title("", loc="left")


def _paint_marginal(axes: Axes, frame: pd.DataFrame, name: str) -> None:
    """Draw how the draws of one parameter fall, beside the flat prior between its bounds."""
    _set_scale(axes, name, "x")
    values = _select_mark(frame, "draw")[[name]]
    at = to_log_coordinates(values)[:, 0]
    heights, edges = np.histogram(at, bins=min(24, max(8, len(at) // 16)), density=True)
    back = np.exp(edges) if is_logarithmic(name) else edges
    axes.stairs(heights, back, fill=True, color=_DRAW_COLOUR, alpha=0.35, lw=0)
    bounds = to_log_coordinates(frame[frame["mark"].str.endswith("bound")][[name]])[:, 0]
    # A parameter without bounds has no flat prior to draw.
    if np.isfinite(bounds).all():
        axes.axhline(1 / float(np.ptp(bounds)), color=GREY, lw=0.8, ls=(0, (1, 1.5)))
    for mark, (_, _, colour) in _MARKS.items():
        for value in _select_mark(frame, mark)[name]:
            axes.axvline(value, color=colour, lw=0.9)
    axes.set_ylim(bottom=0)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)


def _paint_pair(axes: Axes, frame: pd.DataFrame, left: str, below: str) -> None:
    _set_scale(axes, left, "x")
    _set_scale(axes, below, "y")
    draws, ridge = _select_mark(frame, "draw"), _select_mark(frame, "ridge")
    _paint_dots(axes, draws[left].to_numpy(dtype=np.float64), draws[below].to_numpy(dtype=np.float64))
    axes.plot(ridge[left], ridge[below], color=_RIDGE_COLOUR, lw=1.2, ls=(0, (4, 1.5)), zorder=3)
    for mark, (marker, size, colour) in _MARKS.items():
        some = _select_mark(frame, mark)
        axes.plot(some[left], some[below], marker, ms=size, mfc=colour, mec="white", mew=0.5, zorder=4)
    for bound in ("lower bound", "upper bound"):
        for value in _select_mark(frame, bound)[left]:
            axes.axvline(value, color=GREY, lw=0.8, ls=(0, (1, 1.5)))
        for value in _select_mark(frame, bound)[below]:
            axes.axhline(value, color=GREY, lw=0.8, ls=(0, (1, 1.5)))


def _paint_dots(axes: Axes, x: Floats, y: Floats) -> None:
    """Draw dots as one path of lines without length and with round ends: a tenth of the bytes of marks."""
    twice = (np.repeat(one, 3) for one in (x, y))
    across, up = (np.where(np.arange(len(one)) % 3 == 2, np.nan, one) for one in twice)
    (line,) = axes.plot(across, up, color=_DRAW_COLOUR, alpha=0.45, lw=1.7, solid_capstyle="round")
    line.get_path().should_simplify = False  # or what has no length would be left out


def _select_mark(frame: pd.DataFrame, mark: str) -> pd.DataFrame:
    return frame[frame["mark"] == mark]


def _set_scale(axes: Axes, name: str, axis: str) -> None:
    if is_logarithmic(name):
        axes.set(**{f"{axis}scale": "log"})


def _find_limits(frame: pd.DataFrame, name: str) -> tuple[float, float]:
    """Return the range of draws, fit and the paper's set, with room; bounds may lie outside."""
    seen = frame[frame["mark"].isin(["draw", *_MARKS])][[name]].dropna()
    at = to_log_coordinates(seen)[:, 0]
    room = _MARGIN_FRACTION * max(float(np.ptp(at)), 1e-3)
    ends = float(at.min()) - room, float(at.max()) + room
    return (float(np.exp(ends[0])), float(np.exp(ends[1]))) if is_logarithmic(name) else ends


def _format_axes(axes: Axes, names: tuple[str, str], frame: pd.DataFrame, outer: tuple[bool, bool]) -> None:
    """Give axes limits, round places, and names where they are the last of their column or row."""
    alone = names[0] == names[1]
    for axis, name, last in zip((axes.xaxis, axes.yaxis), names, outer, strict=True):
        if axis is axes.yaxis and alone:
            continue
        low, high = _find_limits(frame, name)
        (axes.set_xlim if axis is axes.xaxis else axes.set_ylim)(low, high)
        if is_logarithmic(name):
            axis.set_minor_locator(NullLocator())
            ticks = choose_log_ticks(low, high)
            unit = choose_printed_unit(name, [low])[1]
            if any(len(format_plain(tick / unit)) > _MAX_TICK_LETTERS for tick in ticks):
                ticks = [ticks[0], ticks[-1]]
            axis.set_ticks(ticks, [format_plain(tick / unit) for tick in ticks])
        else:
            axis.set_major_locator(MaxNLocator(3))
        axis.set_tick_params(labelbottom=last, labelleft=last)
        if last:
            axis.set_label_text(choose_printed_unit(name, [low])[0])
    if alone:
        axes.set_title(
            choose_printed_unit(names[0], [_find_limits(frame, names[0])[0]])[0], loc="left", pad=2
        )


def _draw_legend(figure: Figure, frame: pd.DataFrame, summary: dict[str, str]) -> None:
    handles = [Line2D([], [], marker="o", ms=3, mew=0, lw=0, color=_DRAW_COLOUR, alpha=0.6, label="draws")]
    for mark, (marker, size, colour) in _MARKS.items():
        if len(_select_mark(frame, mark)):
            handles.append(
                Line2D([], [], marker=marker, ms=size, mfc=colour, mec="white", lw=0, label=summary[mark])
            )
    if len(_select_mark(frame, "ridge")):
        handles.append(Line2D([], [], color=_RIDGE_COLOUR, lw=1.2, ls=(0, (4, 1.5)), label="ridge"))
    handles.append(Line2D([], [], color=GREY, lw=0.8, ls=(0, (1, 1.5)), label="bounds, flat prior"))
    if figure.get_figwidth() > COLUMN_WIDTH_IN:
        figure.legend(handles=handles, loc="upper right", handlelength=1.5, bbox_to_anchor=(1, 0.97))
    else:
        figure.legend(handles=handles, loc="outside upper left", handlelength=1.5)
