"""Differences of log predictive density between candidates, group by group."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import WIDTH, draw, label_origin, light_grid
from needlefit.reporting.names import CANDIDATE_NAMES, GREY, INK, RIVAL_COLOURS
from needlefit.reporting.tables import Row, records
from needlefit.validation.inquiries.answer import Answer

_VERDICT_COLOURS = {
    "ahead": RIVAL_COLOURS["constant_curvature"],
    "behind": RIVAL_COLOURS["hand_tuned"],
    "tie": GREY,
}


def draw_candidates(answer: Answer, path: Path) -> Path:
    """Draw one row for each candidate but the reference."""
    return draw(path, lambda: _paint(answer))


def _paint(answer: Answer) -> Figure:
    rows = [row for row in records(answer.frames["against"]) if row["verdict"] != "reference"]
    each = answer.frames["differences"].groupby(["candidate", "group"], sort=False)["difference"].sum()
    figure = Figure(figsize=(WIDTH, 0.9 + 0.36 * len(rows)))
    axes = figure.add_subplot()
    axes.axvline(0, color=INK, lw=0.8)
    for y, row in enumerate(rows):
        _row(axes, y, row, np.sort(each[row["candidate"]].to_numpy(dtype=np.float64)))
    axes.set_xscale("symlog", linthresh=1.0)
    axes.set_xlabel("log predictive density less the reference’s, a group of repeats (symmetric logarithm)")
    axes.set_yticks(range(len(rows)), [CANDIDATE_NAMES[row["candidate"]] for row in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    light_grid(axes, "x")
    label_origin(figure, answer.synthetic)
    return figure


def _row(axes: Axes, y: int, row: Row, each: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> None:
    """Draw groups, and their mean with two standard errors."""
    colour = _VERDICT_COLOURS[row["verdict"]]
    axes.plot(each, np.full(len(each), y + 0.18), "o", ms=2.5, color=GREY, alpha=0.7, mec="none")
    mean, error = row["difference"] / row["groups"], (row["difference_se"] or 0.0) / row["groups"]
    axes.plot([mean - 2 * error, mean + 2 * error], [y, y], color=colour, lw=1.6)
    axes.plot(mean, y, "D", ms=5, color=colour, mec="white", mew=0.5, zorder=4)
    axes.annotate(
        row["verdict"], (1.0, y), xycoords=("axes fraction", "data"), xytext=(-2, 0),
        textcoords="offset points", ha="right", va="center", color=colour,
    )  # fmt: skip
