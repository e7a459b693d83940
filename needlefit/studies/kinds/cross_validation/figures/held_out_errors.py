"""Figures of errors on held-out groups: boxes of the fitted model, and mean errors of every method."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from needlefit.reporting.figures.style import (
    COLUMN_WIDTH_IN,
    TEXT_WIDTH_IN,
    choose_width,
    count_legend_columns,
    draw_grid,
    plot,
)
from needlefit.reporting.labels import (
    INK,
    PAPER_COLOUR,
    layers_name,
    medium_name,
    method_colour,
    method_marker,
    method_name,
    study_name,
)
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies.run import Run
from needlefit.studies.score import list_methods
from needlefit.studies.scored_groups import ScoredGroup, list_held_out_groups
from needlefit.studies.summary import tabulate_points

_IPE_COLOUR, _TE_COLOUR = "#0072B2", "#009E73"
_MIN_TIPS_OF_BOX = (
    5  # fewer tip errors than this are shown as points only: a box of them would be an invention
)


MAX_COLUMN_GROUPS = 3
"""Groups at most of a figure as wide as one column of a paper."""

_QUARTILES = {"5 %": 5, "25 %": 25, "median": 50, "75 %": 75, "95 %": 95}
_BOXPLOT_COLUMNS = ("group", "metric", "mark", "insertion", "value", "origin")


def draw_boxplot(results: Sequence[Run], path: Path) -> Path:
    """Draw the in-plane errors of all points and the tip errors of each held-out group (boxes: quartiles).

    Whiskers span the 5th to the 95th percentile, dots are tips of single insertions. Diamonds are
    means over insertions, ours filled and the paper's open; dashes are the noise floor's.
    """
    return plot(path, _tabulate_boxplot(results), _paint_boxplot)


def _tabulate_boxplot(results: Sequence[Run]) -> pd.DataFrame:
    """Return one row per mark: what ends, halves and quarters a box, tips, means, floor and paper."""
    return pd.DataFrame([row for one in results for row in _boxplot_rows(one)], columns=_BOXPLOT_COLUMNS)


def _boxplot_rows(results: Run) -> Iterator[Row]:
    where = "role == 'validate' and method == 'fitted' and boundaries == 'measured'"
    cloud, errors = tabulate_points(results).query(where), results.frames["errors"].query(where)
    for group in list_held_out_groups(results):
        row, medium, layers = group.head, group.head["medium"], group.head["layers"]
        label = f"{study_name(row['study'])}, {medium_name(medium)}, {layers_name(layers)}"
        group_values = {"group": f"{label}, n = {row['insertions']}", "origin": results.origin}
        ipe, te = (
            frame[(frame["medium"] == medium) & (frame["layers"] == layers) & np.isfinite(frame[column])]
            for frame, column in ((cloud, "ipe_mm"), (errors, "te_mm"))
        )
        yield from ({**group_values, "metric": "IPE", **mark} for mark in _box_rows(ipe["ipe_mm"]))
        if len(te) >= _MIN_TIPS_OF_BOX:
            yield from ({**group_values, "metric": "TE", **mark} for mark in _box_rows(te["te_mm"]))
        for tip in to_records(te[["insertion", "te_mm"]]):
            yield {
                **group_values,
                "metric": "TE",
                "mark": "tip",
                "insertion": tip["insertion"],
                "value": tip["te_mm"],
            }
        for error, metric in (("IPE", "ipe_mean_mm"), ("TE", "te_mm")):
            for mark, column in (("mean", "value"), ("noise floor", "floor"), ("paper", "paper")):
                if (value := group.get(metric, column)) is not None:
                    yield {**group_values, "metric": error, "mark": mark, "value": value}


def _box_rows(values: pd.Series) -> list[Row]:
    if not len(values):
        return []
    ends = np.percentile(values.to_numpy(dtype=np.float64), list(_QUARTILES.values()))
    return [{"mark": mark, "value": float(end)} for mark, end in zip(_QUARTILES, ends, strict=True)]


def _paint_boxplot(marks: pd.DataFrame) -> Figure:
    groups = list(dict.fromkeys(marks["group"]))
    wide = choose_width(TEXT_WIDTH_IN if len(groups) > MAX_COLUMN_GROUPS else COLUMN_WIDTH_IN)
    figure = Figure(figsize=(wide, 2.1))
    axes = figure.add_subplot()
    for x, group in enumerate(groups):
        for error, shift, colour in (("IPE", -0.19, _IPE_COLOUR), ("TE", 0.19, _TE_COLOUR)):
            here = marks[(marks["group"] == group) & (marks["metric"] == error)]
            _draw_error(axes, x + shift, here, colour)
    labels = [group.replace(", ", "\n") for group in groups]
    if len({group.partition(", ")[0] for group in groups}) == 1:  # the title names the study
        labels = [label.partition("\n")[2] for label in labels]
    axes.set_xticks(range(len(groups)), labels, linespacing=1.25)
    axes.tick_params(axis="x", length=0, pad=5)
    margin = 0.55 + 0.25 * max(0, 3 - len(groups))  # one or two groups do not fill the whole width
    axes.set_xlim(-margin, len(groups) - 1 + margin)
    axes.set_ylim(bottom=0)
    axes.set_ylabel("error (mm)")
    draw_grid(axes, "y")
    _draw_legend(figure, bool((marks["mark"] == "paper").any()))
    return figure


def _draw_error(axes: Axes, x: float, marks: pd.DataFrame, colour: str) -> None:
    """Draw the box of one error of one group, single tips, our mean, the noise floor's and the paper's."""
    at = {str(row["mark"]): row["value"] for row in to_records(marks)}
    if all(end in at for end in _QUARTILES):
        _draw_box(axes, x, [at[end] for end in _QUARTILES], colour)
    tips = marks.loc[marks["mark"] == "tip", "value"]
    spread = np.linspace(-0.07, 0.07, len(tips)) if len(tips) > 1 else np.zeros(len(tips))
    axes.plot(x + spread, tips, "o", ms=2.6, mfc=colour, mec="white", mew=0.3, zorder=4)
    if "mean" in at:
        axes.plot(x, at["mean"], "D", ms=3.2, mfc=colour, mec="white", mew=0.5, zorder=5)
    if "noise floor" in at:
        axes.hlines(at["noise floor"], x - 0.17, x + 0.17, color=INK, lw=0.8, ls=(0, (2, 1.5)), zorder=5)
    if "paper" in at:
        axes.plot(x, at["paper"], "D", ms=3.6, mfc="white", mec=PAPER_COLOUR, mew=1.0, zorder=6)


def _draw_box(axes: Axes, x: float, ends: list[float], colour: str) -> None:
    line: dict[str, Any] = {"color": colour, "linewidth": 0.8}
    box = dict(zip(("whislo", "q1", "med", "q3", "whishi"), ends, strict=True))
    axes.bxp(
        [box],
        positions=[x],
        widths=0.3,
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": colour, "alpha": 0.28, "linewidth": 0},
        medianprops={"color": colour, "linewidth": 1.6},
        whiskerprops=line,
        capprops={"linewidth": 0},
        manage_ticks=False,
    )


def _draw_legend(figure: Figure, printed: bool) -> None:
    handles = [
        Line2D([], [], color=_IPE_COLOUR, alpha=0.5, lw=5, label="in-plane error (IPE)"),
        Line2D([], [], color=_TE_COLOUR, alpha=0.5, lw=5, label="tip error (TE)"),
        Line2D([], [], color=_IPE_COLOUR, marker="D", mec="white", ms=4, lw=0, label="our mean"),
        Line2D([], [], color=PAPER_COLOUR, marker="D", mfc="white", ms=3.6, lw=0, label="paper's mean"),
        Line2D([], [], color=INK, lw=0.8, ls=(0, (2, 1.5)), label="noise floor"),
    ]
    handles = handles if printed else [*handles[:3], handles[4]]
    columns = 5 if figure.get_figwidth() > COLUMN_WIDTH_IN else 2
    figure.legend(
        handles=handles, loc="outside upper left", ncols=columns, handlelength=1.3, columnspacing=1.4
    )


def draw_baselines(results: Sequence[Run], path: Path) -> Path:
    """Draw one line per held-out group with a mark per method; smaller errors are further left."""
    names = {method: method_name(method) for method in list_methods()}
    return plot(
        path,
        _tabulate_baselines(results),
        lambda marks: _paint_baselines(marks, names),
    )


def _tabulate_baselines(results: Sequence[Run]) -> pd.DataFrame:
    """Return one row per mark: of every group the baselines, the paper and the noise floor."""
    rows = [
        {
            "group": f"{study_name(group.head['study'])}, {medium_name(group.head['medium'])}, "
            f"{layers_name(group.head['layers'])}",
            "method": method,
            "ipe_mean_mm": value,
            "origin": group.head["origin"],
        }
        for group in list_held_out_groups(*results)
        for method, value in _list_marks(group)
        if value is not None
    ]
    return pd.DataFrame(rows, columns=["group", "method", "ipe_mean_mm", "origin"])


def _list_marks(group: ScoredGroup) -> Iterator[tuple[str, float | None]]:
    """Yield the mean IPE of every method, of the paper and of the noise floor."""
    yield from ((method, group.get("ipe_mean_mm", method=method)) for method in list_methods())
    yield "paper", group.get("ipe_mean_mm", "paper")
    yield "noise floor", group.get("ipe_mean_mm", "floor")


def _paint_baselines(marks: pd.DataFrame, names: dict[str, str]) -> Figure:
    groups = list(dict.fromkeys(marks["group"]))
    wide = choose_width(TEXT_WIDTH_IN if len(groups) > MAX_COLUMN_GROUPS else COLUMN_WIDTH_IN)
    present = [method for method in list_methods() if (marks["method"] == method).any()]
    tall = 1.3 if wide > COLUMN_WIDTH_IN else 0.9 + 0.17 * (len(present) + 2)
    figure = Figure(figsize=(wide, tall + max(1.0, 0.42 * len(groups))))
    axes = figure.add_subplot()
    for y in range(len(groups)):
        axes.axhline(y + 0.5, color=INK, lw=0.3, alpha=0.25)
    for row in to_records(marks):
        _draw_mark(axes, row, groups.index(row["group"]), present)
    _format_axes(axes, groups)
    for method in present:
        axes.plot([], [], method_marker(method), ms=4.5, color=method_colour(method), label=names[method])
    if (marks["method"] == "paper").any():
        axes.plot([], [], "D", ms=4, mfc="white", mec=PAPER_COLOUR, mew=1.0, label="paper, own needles")
    axes.plot([], [], color=INK, lw=0.9, ls=(0, (2, 1.5)), label="noise floor")
    columns = count_legend_columns(figure, list(names.values()), 3)
    figure.legend(loc="outside upper left", ncols=columns, handletextpad=0.2, columnspacing=0.8)
    return figure


def _draw_mark(axes: Axes, row: Row, y: int, present: list[str]) -> None:
    """Draw one mark in the line of its group: the baselines one under the other, paper and floor over all."""
    method, error = row["method"], row["ipe_mean_mm"]
    if method == "noise floor":
        axes.vlines(error, y - 0.4, y + 0.4, color=INK, lw=0.9, ls=(0, (2, 1.5)), zorder=3)
    elif method == "paper":
        axes.plot(error, y, "D", ms=4, mfc="white", mec=PAPER_COLOUR, mew=1.0, zorder=5)
    else:
        level = y + 0.6 * (present.index(method) - (len(present) - 1) / 2) / max(len(present) - 1, 1)
        size, colour = 5.5 if method == "fitted" else 4, method_colour(method)
        axes.plot(error, level, method_marker(method), ms=size, mfc=colour, mec="white", mew=0.4, zorder=4)


def _format_axes(axes: Axes, groups: list[str]) -> None:
    axes.set_xscale("log")
    axes.set_yticks(range(len(groups)), [group.replace(", ", "\n") for group in groups])
    axes.set_ylim(len(groups) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    low, high = axes.get_xlim()
    ticks = [t for t in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20) if low <= t <= high]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("mean in-plane error (mm)")
    draw_grid(axes, "x")
