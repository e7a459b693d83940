"""Errors in sample and of what was left out, fit by fit."""

from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import WIDTH, is_synthetic, label_origin, light_grid, plot
from needlefit.reporting.names import GREY, INK, METHOD_COLOURS, medium_name
from needlefit.reporting.tables import Row, records
from needlefit.validation.analyses.runner import AnalysisResult


def draw_left_out(answer: AnalysisResult, path: Path) -> Path:
    """Draw mean IPE and TE in sample and left out, with the noise floor and a constant curvature."""
    return plot(path, answer.frames["summary"].assign(origin=answer.origin), _paint)


def _paint(frame: pd.DataFrame) -> Figure:
    rows = [row for row in records(frame) if not row["note"]]
    figure = Figure(figsize=(WIDTH, 1.0 + 0.36 * len(rows)))
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, metric, words in ((left, "ipe_mean", "mean in-plane error"), (right, "te", "tip error")):
        for y, row in enumerate(rows):
            _pair(axes, y, row, metric, direct=y == 0)
        axes.set_xlabel(f"{words}, mean over insertions (mm)")
        axes.set_xlim(0, None)
        light_grid(axes, "x")
        axes.tick_params(axis="y", length=0)
    labels = [f"{medium_name(row['fit'])}, {row['left_out']}s ({row['groups']})" for row in rows]
    left.set_yticks(range(len(rows)), labels)
    left.set_ylim(len(rows) - 0.5, -1.1)
    label_origin(figure, is_synthetic(frame))
    return figure


def _pair(axes: Axes, y: int, row: Row, metric: str, direct: bool) -> None:
    """Draw one row: floor, in sample, left out, and the curve that knows no tissue."""
    floor, sample = row[f"floor_{metric}_mm"], row[f"in_sample_{metric}_mm"]
    held, curve = row[f"{metric}_mm"], row[f"curve_{metric}_mm"]
    axes.plot([sample, held], [y, y], color=METHOD_COLOURS["fitted"], lw=1.0, zorder=2)
    axes.plot(sample, y, "o", ms=5, mfc="white", mec=METHOD_COLOURS["fitted"], zorder=3)
    axes.plot(held, y, "o", ms=5, color=METHOD_COLOURS["fitted"], zorder=4)
    axes.plot(curve, y, "^", ms=4.5, color=METHOD_COLOURS["constant_curvature"], zorder=3)
    if floor is not None:
        axes.vlines(floor, y - 0.35, y + 0.35, color=INK, lw=0.9, ls=(0, (2, 1.5)))
    if direct:
        _label(axes, y, row, metric)


def _label(axes: Axes, y: int, row: Row, metric: str) -> None:
    """Name the marks of the first row, the middle ones above it, the outer ones higher still."""
    blue = METHOD_COLOURS["fitted"]
    marks = [("in sample", row[f"in_sample_{metric}_mm"], 7, "right", blue)]
    marks += [("left out", row[f"{metric}_mm"], 7, "left", blue)]
    marks += [("constant curvature", row[f"curve_{metric}_mm"], 15, "center", GREY)]
    if row[f"floor_{metric}_mm"] is not None:
        marks += [("floor", row[f"floor_{metric}_mm"], 15, "center", INK)]
    for words, x, above, side, colour in marks:
        style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 6.5, "ha": side, "color": colour}
        axes.annotate(words, (x, y), xytext=(0, above), **style)
