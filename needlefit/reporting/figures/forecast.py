"""A predicted needle with its bands."""

from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import WIDTH, is_synthetic, label_origin, plot, snug, stretch
from needlefit.reporting.names import GREY, INK, METHOD_COLOURS

_BESIDE = 0.2  # share of the bands' height left free above and below
_TALL = 2.6  # inches


def draw_forecast(table: pd.DataFrame, title: str, depth: float, path: Path) -> None:
    """Draw median, 50 and 95 % bands of the needle, and the 95 % band of its measurement, mm."""
    plot(path, table, lambda frame: _paint(frame, title, depth))


def _paint(table: pd.DataFrame, title: str, depth: float) -> Figure:
    x, colour = table["x_mm"], METHOD_COLOURS["fitted"]
    low, high = table["measured_95_low_mm"].min(), table["measured_95_high_mm"].max()
    room = _BESIDE * (high - low) + 0.05
    figure = Figure(figsize=(WIDTH, _TALL))
    axes = figure.add_subplot()
    factor = stretch(1.1 * depth, high - low + 2 * room)
    axes.set_aspect(factor)
    axes.set(xlim=(-0.02 * depth, 1.12 * depth), ylim=(low - room, high + room))
    axes.axhline(0.0, color=GREY, lw=0.5, ls=(0, (4, 3)))
    for name in ("measured_95_low_mm", "measured_95_high_mm"):
        axes.plot(x, table[name], color=INK, lw=0.6, ls=(0, (1, 1.5)))
    for level, alpha in ((95, 0.2), (50, 0.35)):
        ends = table[f"needle_{level}_low_mm"], table[f"needle_{level}_high_mm"]
        axes.fill_between(x, *ends, color=colour, alpha=alpha, lw=0)
    axes.plot(x, table["needle_median_mm"], color=colour, lw=1.4)
    last = table.iloc[-1]
    for name, said, ink in (
        ("measured_95_high_mm", "95 % of measurements", INK),
        ("needle_median_mm", f"tip {last['needle_median_mm']:+z.2f} mm", colour),
    ):
        axes.annotate(
            said.replace("-", "−"), (last["x_mm"], last[name]), xytext=(4, 0), textcoords="offset points",
            va="center", color=ink, fontsize=6.5,
        )  # fmt: skip
    axes.set_title(f"{title}: median, 50 and 95 % of needles", loc="left")
    axes.set_xlabel("x along the entry (mm)")
    axes.set_ylabel("y (mm)" + ("" if factor == 1 else f",\ndrawn {factor}× as large as x"))
    label_origin(figure, is_synthetic(table))
    snug(figure)
    return figure
