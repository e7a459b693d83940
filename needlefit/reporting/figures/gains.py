"""What one more insertion is expected to tell, against its depth: a line for each way in."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.labels import apart
from needlefit.reporting.figures.style import WIDTH, is_synthetic, label_origin, light_grid, plot
from needlefit.reporting.names import GREY, INK, way_in_name
from needlefit.validation.analyses.runner import AnalysisResult

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
BEYOND = 1.62
"""The width of a panel by its greatest depth: names stand beyond."""


def draw_gains(answer: AnalysisResult, path: Path) -> Path:
    """Draw gain and remaining deviation of the first tip asked for."""
    return plot(path, answer.frames["gains"].assign(origin=answer.origin), _paint)


def _paint(told: pd.DataFrame) -> Figure:
    tip = told["tip"].dropna().unique()
    figure = Figure(figsize=(WIDTH, 2.9))
    panels = figure.subplots(1, 1 + len(tip), squeeze=False)[0]
    _lines(panels[0], told, "nats")
    panels[0].set_title("Expected gain about all parameters (nats)", loc="left")
    if len(tip):
        now = float(told["sd_now_mm"].iloc[0])
        panels[1].axhline(now, xmax=1 / BEYOND, color=INK, lw=0.7, ls=(0, (4, 3)))
        panels[1].text(0.5, now, "now", fontsize=6.5, color=INK, va="bottom")
        _lines(panels[1], told, "sd_after_mm")
        panels[1].set_title(f"Expected sd of the {tip[0]} (mm)", loc="left")
    for axes in panels:
        axes.set_xlabel("depth (mm)", x=0.5 / BEYOND)
        light_grid(axes, "y")
    label_origin(figure, is_synthetic(told))
    return figure


def _lines(axes: Axes, told: pd.DataFrame, column: str) -> None:
    """Draw one column against depth, each line named at its end."""
    ends: list[tuple[float, float, str, str]] = []
    candidates = told[told["role"] == "candidate"]
    for place, ((entry, angle), rows) in enumerate(candidates.groupby(["entry", "angle_deg"], sort=False)):
        colour = COLOURS[place % len(COLOURS)]
        known = rows[rows[column].notna()]
        if known.empty:
            continue
        x, y = (known[name].to_numpy(dtype=np.float64) for name in ("depth_mm", column))
        if column == "nats":
            spread = known["nats_se"].to_numpy(dtype=np.float64)
            axes.fill_between(x, y - spread, y + spread, color=colour, alpha=0.15, lw=0)
        axes.plot(x, y, color=colour, lw=1.2, marker="o", ms=2.2)
        ends.append((float(y[-1]), float(x[-1]), way_in_name(str(entry), float(str(angle))), colour))
    again = told[(told["role"] == "repeat") & told[column].notna()]
    for x, y in zip(again["depth_mm"], again[column], strict=True):
        axes.plot(x, y, "D", ms=4.5, color=INK, mfc="white", zorder=4)
        ends.append((float(y), float(x), "once more", INK))
    _name_ends(axes, sorted(ends), float(told["depth_mm"].max()))


def _name_ends(axes: Axes, ends: list[tuple[float, float, str, str]], deepest: float) -> None:
    """Write names beyond the lines, in the order of their ends, with a hair to each."""
    bottom, top = 0.0, 1.05 * max(axes.get_ylim()[1], 1e-9)
    gap = 0.062 * (top - bottom)
    at = apart([y for y, *_ in ends], gap * np.arange(len(ends), dtype=np.float64))
    at = at - max(0.0, float(at[-1]) - (top - 0.4 * gap))
    for (y, x, name, colour), place in zip(ends, at.tolist(), strict=True):
        axes.plot([x, 1.06 * deepest], [y, place], color=GREY, lw=0.4, alpha=0.7, zorder=1)
        axes.text(1.08 * deepest, place, name, va="center", color=colour, fontsize=6.5)
    axes.set(xlim=(0, BEYOND * deepest), ylim=(bottom, top))
    axes.set_xticks([tick for tick in axes.get_xticks() if tick <= deepest])
