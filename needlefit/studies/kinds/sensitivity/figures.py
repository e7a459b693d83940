"""Figure of how much held-out errors change with each modelling decision: one row per variation, one dot per
study.
"""

from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.metrics import headline_metrics
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, plot
from needlefit.reporting.labels import INK, medium_name
from needlefit.reporting.table_files import to_records
from needlefit.studies.kinds.sensitivity.run import BASE_VARIATION
from needlefit.studies.run import Run

_STUDY_COLOURS = ("#0072B2", "#009E73", "#D55E00", "#CC79A7", "#E69F00")
_MAX_CHANGE_FLOORS = 20.0
"""Noise floors up to which the scale goes."""

_TUNED_NAMES = {"again": "tuned again", "kept": "kept"}


def draw_studies(result: Run, path: Path) -> Path:
    """Draw the change of every study's mean IPE and TE, in units of the noise floor."""
    return plot(path, result.frames["studies"].assign(origin=result.origin), _paint)


def _paint(every: pd.DataFrame) -> Figure:
    frame = every[every["aspect"] != BASE_VARIATION]
    rows = list(frame[["aspect", "variation"]].drop_duplicates().itertuples(index=False, name=None))
    studies = list(dict.fromkeys(frame["study"]))
    figure = Figure(figsize=(TEXT_WIDTH_IN, 1.1 + 0.23 * len(rows)))
    shown = [(tuned, metric) for tuned in _TUNED_NAMES for metric in headline_metrics()]
    panels = figure.subplots(1, len(shown), sharex=True, sharey=True)
    for axes, (tuned, metric) in zip(panels, shown, strict=True):
        for row in to_records(frame[(frame["tuned"] == tuned) & (frame["metric"] == metric.name)]):
            change = row["change_in_floors"]
            y, place = rows.index((row["aspect"], row["variation"])), studies.index(row["study"])
            level = y + 0.7 * ((place + 0.5) / len(studies) - 0.5)
            colour = _STUDY_COLOURS[place % len(_STUDY_COLOURS)]
            ring = {"mec": INK, "mew": 1.0} if row["conclusion_changes"] else {"mew": 0.0}
            axes.plot(change, level, "o", ms=3.4, color=colour, **ring, zorder=3)
        axes.set_title(f"{metric.label}, {_TUNED_NAMES[tuned]}", loc="left", fontsize=7)
        _format_axes(axes, rows)
    panels[0].set_yticks(range(len(rows)), [f"{aspect}: {name}" for aspect, name in rows])
    panels[0].set_ylim(len(rows) - 0.4, -0.6)
    for place, study in enumerate(studies):
        colour = _STUDY_COLOURS[place % len(_STUDY_COLOURS)]
        panels[0].plot([], [], "o", ms=3.4, mew=0, color=colour, label=medium_name(study))
    figure.legend(loc="outside upper left", ncols=len(studies), handletextpad=0.1, columnspacing=1.2)
    figure.supxlabel("change of the held-out error (noise floors)", fontsize=7.5)
    return figure


def _format_axes(axes: Axes, rows: list[tuple[str, str]]) -> None:
    """Draw scale and rules: between kinds of variations, and where nothing changes."""
    axes.axvline(0, color=INK, lw=0.6)
    axes.set_xscale("symlog", linthresh=1.0, linscale=1.0)
    axes.set_xticks([-10, -1, 0, 1, 10], ["−10", "−1", "0", "1", "10"])
    axes.set_xlim(-_MAX_CHANGE_FLOORS, _MAX_CHANGE_FLOORS)
    axes.minorticks_off()
    for y in [i for i in range(1, len(rows)) if rows[i][0] != rows[i - 1][0]]:
        axes.axhline(y - 0.5, color=INK, lw=0.3, alpha=0.4)
    axes.tick_params(axis="y", length=0)
    draw_grid(axes, "x")
