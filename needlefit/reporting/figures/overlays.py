"""Measured and simulated needles of every held-out insertion, one over the other."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from needlefit.reporting.figures.style import WIDTH, draw, label_origin
from needlefit.reporting.names import INK, RIVAL_COLOURS, rival_name
from needlefit.validation.results import Results

_STRETCHES = (1, 2, 5, 10, 20, 50, 100)
_SHOWN = ("hand_tuned", "fitted")
_DOT: dict[str, Any] = {"mfc": INK, "mec": "white", "mew": 0.4, "ms": 2.7}  # seen above a line that fits


def overlays(results: Results, path: Path, role: str = "validate") -> Path:
    """Draw each insertion of a role: the measured needle as dots, the model's prediction as a line.

    All panels have the same axes in mm, y positive toward the bevel and stretched by the factor that its
    label states.
    """
    return draw(path, lambda: _paint(results, role))


def stretch(width: float, height: float) -> int:
    """Return the largest of 1, 2, 5, ... that keeps a drawing of `width` by `height` mm wider than high."""
    fitting = [factor for factor in _STRETCHES if factor * height <= 0.62 * width]
    return fitting[-1] if fitting else 1


def _paint(results: Results, role: str) -> Figure:
    where = "role == @role and boundaries == 'measured' and rival in @_SHOWN"
    shapes = results.shapes.query(where, local_dict={"role": role, "_SHOWN": _SHOWN}).copy()
    scored = results.errors.query("role == @role and boundaries == 'measured' and rival == 'fitted'")
    _turn_to_bevel(shapes, scored)
    x, y = _limits(shapes)
    factor = stretch(x[1] - x[0], y[1] - y[0])
    columns = min(3 if len(scored) <= 24 else 4, len(scored))
    rows = math.ceil(len(scored) / columns)
    panel = WIDTH / max(columns, 3)
    height = panel * 0.86 * factor * (y[1] - y[0]) / (x[1] - x[0]) + 0.32
    size = (max(columns, 2) * panel, rows * height + 0.75)
    figure = Figure(figsize=size)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, (_, row) in zip(grid.flat, scored.iterrows(), strict=False):
        here = (shapes["fold"] == row["fold"]) & (shapes["insertion"] == row["insertion"])
        _panel(axes, shapes[here], row)
        axes.set(xlim=x, ylim=y)
        axes.set_aspect(factor)
    _hide(list(grid.flat)[len(scored) :], grid)
    figure.supxlabel("depth x (mm)", fontsize=7.5)
    drawn = "" if factor == 1 else f",\ndrawn {factor}× as large as x"
    figure.supylabel(f"toward the bevel y (mm){drawn}", fontsize=7.5)
    _explain(figure, results, set(shapes["rival"]))
    label_origin(figure, results.origin == "synthetic")
    return figure


def _panel(axes: Axes, shapes: pd.DataFrame, row: pd.Series) -> None:
    for rival in _SHOWN:
        curve = shapes[shapes["rival"] == rival]
        width = 1.1 if rival == "fitted" else 0.9
        axes.plot(
            curve["simulated_x_mm"],
            curve["simulated_y_mm"],
            color=RIVAL_COLOURS[rival],
            lw=width,
            zorder=3 if rival == "fitted" else 2,
        )
    measured = shapes[shapes["rival"] == shapes["rival"].iloc[0]] if len(shapes) else shapes
    dots = measured[measured["j"] % 5 == 0]
    axes.plot(dots["measured_x_mm"], dots["measured_y_mm"], "o", zorder=4, **_DOT)
    axes.set_title(f"{row['insertion']}", loc="left", pad=3)
    digits = 3 if row["comparison"] == "aligned" else 2
    errors = f"IPE {row['ipe_mean_mm']:.{digits}f}, TE {row['te_mm']:.{digits}f} mm"
    said = errors if row["converged"] else "did not converge"
    axes.set_title(said, loc="right", pad=3, fontsize=6.5, color=RIVAL_COLOURS["fitted"])


def _turn_to_bevel(shapes: pd.DataFrame, scored: pd.DataFrame) -> None:
    """Mirror the needles whose bevel faces the other way; deflections are positive toward it already."""
    for _, row in scored.iterrows():
        here = (shapes["fold"] == row["fold"]) & (shapes["insertion"] == row["insertion"])
        measured = shapes.loc[here, ["j", "measured_y_mm"]].sort_values("j")["measured_y_mm"]
        if len(measured) and (measured.iloc[-1] - measured.iloc[0]) * row["deflection_mm"] < 0:
            shapes.loc[here, ["measured_y_mm", "simulated_y_mm"]] *= -1


def _limits(shapes: pd.DataFrame) -> tuple[tuple[float, float], tuple[float, float]]:
    def span(axis: str) -> tuple[float, float]:
        values = shapes[[f"measured_{axis}_mm", f"simulated_{axis}_mm"]].to_numpy(dtype=np.float64)
        low, high = (float(f(values)) for f in (np.nanmin, np.nanmax))
        margin = 0.06 * max(high - low, 0.2)
        return low - margin, high + margin

    return span("x"), span("y")


def _hide(spare: list[Axes], grid: NDArray[np.object_]) -> None:
    """Take empty panels away; the panels above them get the x labels back."""
    for i, axes in enumerate(reversed(spare), start=1):
        axes.set_visible(False)
        if len(grid) > 1:
            grid[-2, -i].tick_params(labelbottom=True)


def _explain(figure: Figure, results: Results, present: set[str]) -> None:
    said = [("measured", INK, "o"), ("needlefit, fitted", RIVAL_COLOURS["fitted"], "")]
    if "hand_tuned" in present:
        said.append((rival_name("hand_tuned", results), RIVAL_COLOURS["hand_tuned"], ""))
    handles = [
        Line2D([], [], color=colour, marker=marker, ms=2.7, lw=0 if marker else 1.1, label=label)
        for label, colour, marker in said
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=3, handlelength=1.3)
