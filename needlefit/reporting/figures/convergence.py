"""Errors of manufactured solutions under refinement, log over log."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from needlefit.reporting.figures.style import WIDTH, plot
from needlefit.reporting.names import GREY, INK

_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", INK)  # Okabe and Ito
_MARKS = "osD^vPX"
_PANELS = (("deflection", 4, "error of the deflection (mm)"), ("slope", 3, "error of the slope"))


def convergence(errors: pd.DataFrame, path: Path) -> Path:
    """Draw the largest error of deflection and slope over the mesh size, a line per case.

    `errors` has a row per `case`, `norm` and mesh size `h_mm`, with the `error` and the `order` observed.
    """
    return plot(path, errors, _paint)


def _paint(errors: pd.DataFrame) -> Figure:
    figure = Figure(figsize=(WIDTH, 1.9))
    panels = figure.subplots(1, 3, width_ratios=(1, 1, 0.9))
    for axes, (norm, order, words) in zip(panels[:2], _PANELS, strict=True):
        _draw_panel(axes, errors, norm, order)
        axes.set_title(words, loc="left")
        axes.set_xlabel("element size h (mm)")
    handles, labels = panels[0].get_legend_handles_labels()
    panels[2].axis("off")
    panels[2].legend(handles, labels, loc="center left", fontsize=6, handlelength=1.6, labelspacing=0.7)
    return figure


def _draw_panel(axes: Axes, errors: pd.DataFrame, norm: str, order: int) -> None:
    curves = errors[errors["norm"] == norm]
    sizes = curves["h_mm"].drop_duplicates().to_numpy(dtype=np.float64)
    for i, (case, curve) in enumerate(curves.groupby("case", sort=False)):
        style = {
            "color": _COLOURS[i % 7],
            "marker": _MARKS[i % 7],
            "ms": 3.2,
            "mfc": "none",
            "lw": 0.8,
            "mew": 0.7,
        }
        axes.loglog(curve["h_mm"], curve["error"], label=_short(str(case)), **style)
    nodes = errors[errors["norm"] == f"{norm} at the nodes"]
    at_nodes = nodes.groupby("h_mm", sort=False)["error"].max().to_numpy(dtype=np.float64)
    axes.loglog(sizes, at_nodes, ".-", color=GREY, ms=3, lw=0.8, label="at the nodes, all")
    finest = float(curves.loc[curves["h_mm"] == sizes[-1], "error"].max())
    for error, slope in ((2.2 * finest, order), (at_nodes[-1] / 2.2, 4)):
        line = error * (sizes / sizes[-1]) ** slope
        axes.loglog(sizes, line, color=INK, lw=0.6, ls=(0, (4, 3)), zorder=1)
        axes.annotate(
            f"order {slope}", (sizes[1], line[1]), xytext=(0, 7 if error > finest else -9), color=INK,
            textcoords="offset points", ha="center", fontsize=6.5,
        )  # fmt: skip
    axes.set_xticks(sizes, [f"{size:g}" for size in sizes])
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_tick_params(which="minor", size=0)
    axes.margins(x=0.12)


def _short(case: str) -> str:
    return case.replace(", ", ",\n", 1)
