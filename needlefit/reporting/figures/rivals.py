"""Mean in-plane error of the model and of everything it has to beat, per held-out group."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import WIDTH, label_origin, light_grid, plot
from needlefit.reporting.names import (
    INK,
    PAPER,
    RIVAL_COLOURS,
    layers_name,
    medium_name,
    rival_name,
    study_name,
)
from needlefit.reporting.tables import Row, records, validation_table
from needlefit.validation.results import RIVALS, Results

_MARKERS = dict(zip(RIVALS, ("o", "o", "s", "s", "v", "^", "D"), strict=True))


def rivals(results: Sequence[Results], path: Path) -> Path:
    """Draw one line per held-out group with a mark per rival: the further left, the smaller the error."""
    twin = next((one for one in results if one.origin == "synthetic"), None)
    names = {rival: rival_name(rival, twin or results[0]) for rival in RIVALS}
    return plot(path, _marks(results), lambda marks: _paint(marks, names, synthetic=twin is not None))


def _marks(results: Sequence[Results]) -> pd.DataFrame:
    """Return one row per mark: of every group the rivals, the paper and the noise floor."""
    rows = [
        {
            "group": f"{study_name(row['study'])}: {medium_name(row['validate_medium'])}, "
            f"{layers_name(row['validate_layers'])}",
            "rival": rival,
            "ipe_mean_mm": row[key],
            "origin": row["origin"],
        }
        for row in records(validation_table(*results))
        for rival, key in _CELLS.items()
        if row[key] is not None
    ]
    return pd.DataFrame(rows, columns=["group", "rival", "ipe_mean_mm", "origin"])


_CELLS = {
    **{rival: "ipe_mean_mm" if rival == "fitted" else f"{rival}_ipe_mean_mm" for rival in RIVALS},
    "paper": "paper_ipe_mean_mm",
    "noise floor": "floor_ipe_mean_mm",
}


def _paint(marks: pd.DataFrame, names: dict[str, str], synthetic: bool) -> Figure:
    groups = list(dict.fromkeys(marks["group"]))
    figure = Figure(figsize=(WIDTH, 1.2 + 0.42 * len(groups)))
    axes = figure.add_subplot()
    present = [rival for rival in RIVALS if (marks["rival"] == rival).any()]
    for y in range(len(groups)):
        axes.axhline(y + 0.5, color=INK, lw=0.3, alpha=0.25)
    for row in records(marks):
        _mark(axes, row, groups.index(row["group"]), present)
    _dress(axes, groups)
    for rival in present:
        axes.plot([], [], _MARKERS[rival], ms=4.5, color=RIVAL_COLOURS[rival], label=names[rival])
    if (marks["rival"] == "paper").any():
        axes.plot([], [], "D", ms=4, mfc="white", mec=PAPER, mew=1.0, label="paper, on its own needles")
    axes.plot([], [], color=INK, lw=0.9, ls=(0, (2, 1.5)), label="noise floor")
    figure.legend(loc="outside upper left", ncols=2, handletextpad=0.2, columnspacing=1.2)
    label_origin(figure, synthetic)
    return figure


def _mark(axes: Axes, row: Row, y: int, present: list[str]) -> None:
    """Draw one mark in the line of its group: the rivals one under the other, paper and floor over all."""
    rival, error = row["rival"], row["ipe_mean_mm"]
    if rival == "noise floor":
        axes.vlines(error, y - 0.4, y + 0.4, color=INK, lw=0.9, ls=(0, (2, 1.5)), zorder=3)
    elif rival == "paper":
        axes.plot(error, y, "D", ms=4, mfc="white", mec=PAPER, mew=1.0, zorder=5)
    else:
        level = y + 0.6 * (present.index(rival) - (len(present) - 1) / 2) / max(len(present) - 1, 1)
        size, colour = 5.5 if rival == "fitted" else 4, RIVAL_COLOURS[rival]
        axes.plot(error, level, _MARKERS[rival], ms=size, mfc=colour, mec="white", mew=0.4, zorder=4)


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
