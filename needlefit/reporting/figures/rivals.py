"""Mean in-plane error of the model and of everything it has to beat, per held-out group."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import WIDTH, label_origin, light_grid, plot
from needlefit.reporting.names import (
    INK,
    METHOD_COLOURS,
    PAPER,
    layers_name,
    medium_name,
    method_name,
    study_name,
)
from needlefit.reporting.tables import Row, records, validation_table
from needlefit.validation.results import METHODS, Results

_MARKERS = dict(zip(METHODS, ("o", "o", "s", "s", "v", "^", "D"), strict=True))


def rivals(results: Sequence[Results], path: Path) -> Path:
    """Draw one line per held-out group with a mark per method: the further left, the smaller the error."""
    twin = next((one for one in results if one.origin == "synthetic"), None)
    names = {method: method_name(method, twin or results[0]) for method in METHODS}
    return plot(path, _marks(results), lambda marks: _paint(marks, names, synthetic=twin is not None))


def _marks(results: Sequence[Results]) -> pd.DataFrame:
    """Return one row per mark: of every group the rivals, the paper and the noise floor."""
    rows = [
        {
            "group": f"{study_name(row['study'])}: {medium_name(row['validate_medium'])}, "
            f"{layers_name(row['validate_layers'])}",
            "method": method,
            "ipe_mean_mm": row[key],
            "origin": row["origin"],
        }
        for row in records(validation_table(*results))
        for method, key in _CELLS.items()
        if row[key] is not None
    ]
    return pd.DataFrame(rows, columns=["group", "method", "ipe_mean_mm", "origin"])


_CELLS = {
    **{method: "ipe_mean_mm" if method == "fitted" else f"{method}_ipe_mean_mm" for method in METHODS},
    "paper": "paper_ipe_mean_mm",
    "noise floor": "floor_ipe_mean_mm",
}


def _paint(marks: pd.DataFrame, names: dict[str, str], synthetic: bool) -> Figure:
    groups = list(dict.fromkeys(marks["group"]))
    figure = Figure(figsize=(WIDTH, 1.2 + 0.42 * len(groups)))
    axes = figure.add_subplot()
    present = [method for method in METHODS if (marks["method"] == method).any()]
    for y in range(len(groups)):
        axes.axhline(y + 0.5, color=INK, lw=0.3, alpha=0.25)
    for row in records(marks):
        _mark(axes, row, groups.index(row["group"]), present)
    _dress(axes, groups)
    for method in present:
        axes.plot([], [], _MARKERS[method], ms=4.5, color=METHOD_COLOURS[method], label=names[method])
    if (marks["method"] == "paper").any():
        axes.plot([], [], "D", ms=4, mfc="white", mec=PAPER, mew=1.0, label="paper, on its own needles")
    axes.plot([], [], color=INK, lw=0.9, ls=(0, (2, 1.5)), label="noise floor")
    figure.legend(loc="outside upper left", ncols=2, handletextpad=0.2, columnspacing=1.2)
    label_origin(figure, synthetic)
    return figure


def _mark(axes: Axes, row: Row, y: int, present: list[str]) -> None:
    """Draw one mark in the line of its group: the rivals one under the other, paper and floor over all."""
    method, error = row["method"], row["ipe_mean_mm"]
    if method == "noise floor":
        axes.vlines(error, y - 0.4, y + 0.4, color=INK, lw=0.9, ls=(0, (2, 1.5)), zorder=3)
    elif method == "paper":
        axes.plot(error, y, "D", ms=4, mfc="white", mec=PAPER, mew=1.0, zorder=5)
    else:
        level = y + 0.6 * (present.index(method) - (len(present) - 1) / 2) / max(len(present) - 1, 1)
        size, colour = 5.5 if method == "fitted" else 4, METHOD_COLOURS[method]
        axes.plot(error, level, _MARKERS[method], ms=size, mfc=colour, mec="white", mew=0.4, zorder=4)


def _dress(axes: Axes, groups: list[str]) -> None:
    axes.set_xscale("log")
    axes.set_yticks(range(len(groups)), groups)
    axes.set_ylim(len(groups) - 0.5, -0.5)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    low, high = axes.get_xlim()
    ticks = [t for t in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20) if low <= t <= high]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("mean in-plane error, mean over insertions (mm, logarithmic)")
    light_grid(axes, "x")
