"""Figures of studies on many synthetic datasets: pattern, comparisons of methods, and every cell of the
tables.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.metrics import list_metrics
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, plot
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS, PAPER_COLOUR, medium_name, method_name
from needlefit.reporting.table_files import Row, to_records
from needlefit.studies import paper
from needlefit.studies.kinds.seeds.one_twin import TRUTH
from needlefit.studies.run import Run
from needlefit.studies.score import list_methods

_LINEAR_RANGE_MM = 0.1
"""The scale of the comparisons is linear up to this, mm."""

_TABLE_LABELS = {
    "validation": "held out",
    "tuning_by_layers": "tuned, by layers",
    "tuning_by_media": "tuned, by media",
}


def draw_pattern(result: Run, path: Path) -> Path:
    """Draw the mean IPE of every study on every dataset, with the threshold and the paper's value."""
    return plot(path, _tabulate_pattern(result), _paint_pattern)


def draw_comparisons(result: Run, path: Path) -> Path:
    """Draw the differences between the fit's errors and each method's, one panel per method."""
    return plot(path, result.frames["comparisons"].assign(origin=result.origin), _paint_comparisons)


def draw_cells(result: Run, path: Path) -> Path:
    """Draw median and range of every cell, one panel per metric."""
    return plot(path, result.frames["cells"].assign(origin=result.origin), _paint_cells)


def _tabulate_pattern(result: Run) -> pd.DataFrame:
    """Return mean IPE of every study: on each twin, their median, and of the paper's groups."""
    every = result.frames["pattern"]
    twins = every[["study", "seed", "ipe_mean_mm", "limit_mm", "generalises_in_paper"]]
    about = twins.groupby("study", sort=False).agg(
        {"ipe_mean_mm": "median", "limit_mm": "first", "generalises_in_paper": "all"}
    )
    medians = about.reset_index().assign(mark="median")
    printed = [
        {"mark": "paper", "study": n, "ipe_mean_mm": ipe} for n in about.index for ipe in _published_errors(n)
    ]
    parts = [twins.assign(mark="twin"), medians, pd.DataFrame(printed)]
    columns = ["mark", *twins.columns]
    known = [part.reindex(columns=columns).astype({"seed": "Int64"}) for part in parts if len(part)]
    return pd.concat(known, ignore_index=True).assign(origin=result.origin)


def _published_errors(study: str) -> list[float]:
    """Return the paper's mean IPE of the groups that a study holds out."""
    table = paper.read_published_table("validation")
    own = table[table["study"].astype(str) == study.removeprefix("study")]
    return [float(value) for value in own["ipe_mean_mm"]]


def _paint_pattern(frame: pd.DataFrame) -> Figure:
    names = list(dict.fromkeys(frame["study"]))
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.8 + 0.36 * len(names)))
    axes = figure.add_subplot()
    for y, name in enumerate(names):
        _paint_study(axes, y, frame[frame["study"] == name])
    limit = frame["limit_mm"].iloc[0]
    axes.axvline(limit, color=INK, lw=0.8, ls=(0, (3, 2)))
    axes.text(limit, -0.62, " does not generalise", fontsize=6.5, ha="left", color=INK)
    axes.text(limit, -0.62, "generalises ", fontsize=6.5, ha="right", color=INK)
    _name_rows(axes, [medium_name(name).capitalize() for name in names])
    axes.set_xlabel("mean in-plane error of what is held out (mm)")
    axes.set_xlim(0, None)
    draw_grid(axes, "x")
    return figure


def _paint_study(axes: Axes, y: int, rows: pd.DataFrame) -> None:
    """Draw one study: twins, their median, and what the paper prints."""
    twins, median, printed = (rows[rows["mark"] == part] for part in ("twin", "median", "paper"))
    colour = METHOD_COLOURS["fitted"] if twins["generalises_in_paper"].all() else PAPER_COLOUR
    level = y + 0.18 * np.linspace(-1, 1, len(twins))
    axes.plot(twins["ipe_mean_mm"], level, "o", ms=3, color=colour, alpha=0.6, mew=0)
    axes.vlines(median["ipe_mean_mm"], y - 0.32, y + 0.32, color=colour, lw=1.6)
    axes.plot(printed["ipe_mean_mm"], [y] * len(printed), "D", ms=4, mfc="white", mec=INK, mew=0.8, zorder=5)


def _paint_comparisons(frame: pd.DataFrame) -> Figure:
    methods = [name for name in (*list_methods(), TRUTH) if name in set(frame["method"])]
    groups = list(dict.fromkeys(zip(frame["study"], frame["medium"], frame["layers"], strict=True)))
    figure = Figure(figsize=(TEXT_WIDTH_IN, 1.0 + 2 * 0.2 * len(groups) + 0.6))
    panels = figure.subplots(2, -(-len(methods) // 2), sharex=True, sharey=True).ravel()
    for axes, method in zip(panels, methods, strict=False):
        for row in to_records(frame[frame["method"] == method]):
            y = groups.index((row["study"], row["medium"], row["layers"]))
            _paint_comparison(axes, y, row)
        axes.axvline(0, color=INK, lw=0.6)
        axes.set_xscale("symlog", linthresh=_LINEAR_RANGE_MM, linscale=0.6)
        axes.set_xticks([-10, -1, -0.1, 0, 0.1, 1], ["−10", "−1", "−0.1", "0", "0.1", "1"])
        axes.set_title(f"against {method_name(method)}", loc="left", fontsize=6.5)
        draw_grid(axes, "x")
    _name_rows(panels[0], [_name_group(group) for group in groups])
    for axes in panels[len(methods) :]:
        axes.set_visible(False)
    _draw_legend(figure, panels[0])
    figure.supxlabel("error of the fit less that of the method (mm)", fontsize=7.5)
    return figure


def _paint_comparison(axes: Axes, y: int, row: Row) -> None:
    """Draw one difference: mean IPE filled, above; TE hollow, below."""
    mean = row["metric"] == "ipe_mean_mm"
    level = y + (-0.17 if mean else 0.17)
    colour = {"wins": METHOD_COLOURS["fitted"], "loses": PAPER_COLOUR, "open": GREY}[row["verdict"]]
    axes.hlines(level, row["low"], row["high"], color=colour, lw=1.0)
    axes.plot(row["difference"], level, "o", ms=3.2, mec=colour, mfc=colour if mean else "white", mew=0.8)


def _draw_legend(figure: Figure, axes: Axes) -> None:
    """Say above the panels what marks and colours are."""
    mark: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.6, "mec": INK, "mew": 0.8}
    axes.plot([], [], mfc=INK, label="mean IPE", **mark)
    axes.plot([], [], mfc="white", label="TE", **mark)
    colours = {"the fit wins": METHOD_COLOURS["fitted"], "it loses": PAPER_COLOUR, "open": GREY}
    for words, colour in colours.items():
        axes.plot([], [], color=colour, lw=1.6, label=words)
    figure.legend(loc="outside upper left", ncols=5, handletextpad=0.4, columnspacing=1.4)


def _paint_cells(frame: pd.DataFrame) -> Figure:
    keys = ["grouping", "study", "medium", "layers"]
    groups = list(frame[keys].drop_duplicates().itertuples(index=False, name=None))
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.8 + 0.22 * len(groups)))
    metrics = list_metrics()
    panels = figure.subplots(1, len(metrics), sharey=True)
    for axes, metric in zip(panels, metrics, strict=True):
        for row in to_records(frame[frame["metric"] == metric.name]):
            _paint_cell(axes, groups.index(tuple(row[key] for key in keys)), row)
        if metric.unit == "%":
            axes.set_xscale("log")
        else:
            axes.set_xlim(0, None)
        axes.set_xlabel(f"{metric.label} ({metric.unit})")
        draw_grid(axes, "x")
        for y in _find_changes([group[0] for group in groups]):
            axes.axhline(y - 0.5, color=INK, lw=0.4)
    _name_rows(panels[0], [_name_cell(group) for group in groups])
    return figure


def _paint_cell(axes: Axes, y: int, row: Row) -> None:
    colour = METHOD_COLOURS["fitted"]
    axes.hlines(y, row["q05"], row["q95"], color=colour, lw=1.4)
    axes.plot(row["q50"], y, "o", ms=3.2, color=colour)
    if row["paper"] is not None:
        axes.plot(row["paper"], y, "D", ms=3.2, mfc="white", mec=PAPER_COLOUR, mew=0.9, zorder=5)
    if row["floor"] is not None:
        axes.vlines(row["floor"], y - 0.35, y + 0.35, color=INK, lw=0.8, ls=(0, (2, 1.5)))


def _find_changes(tables: Sequence[str]) -> list[int]:
    return [i for i in range(1, len(tables)) if tables[i] != tables[i - 1]]


def _name_cell(group: tuple[Any, ...]) -> str:
    table, study, medium, layers = group
    if table != "validation":
        return f"{_TABLE_LABELS[table]}: {medium_name(medium)}" + (f", {layers}" if layers else "")
    return _name_group((study, medium, layers))


def _name_group(group: tuple[Any, ...]) -> str:
    study, medium, layers = group
    return f"{medium_name(study)}: {medium_name(medium)}, {layers}"


def _name_rows(axes: Axes, names: list[str]) -> None:
    """Name the rows from the top downwards."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.75)
    axes.tick_params(axis="y", length=0)
