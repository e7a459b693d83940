"""Measured and simulated needles of every held-out insertion, one over the other."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from needlefit.reporting.figures.style import WIDTH, is_synthetic, label_origin, plot
from needlefit.reporting.names import INK, RIVAL_COLOURS, rival_name
from needlefit.reporting.numbers import fixed
from needlefit.reporting.tables import records
from needlefit.validation.results import Results
from needlefit.validation.summary import bevel_sides

_STRETCHES = (1, 2, 5, 10, 20, 50, 100)
_SHOWN = ("hand_tuned", "fitted")
_EVERY = 5  # of the points compared, one in so many is drawn as a dot, or half of these
_ROOMY = 24  # insertions at most that stand three in a row, with all dots
_LEVELS = {95: 0.16, 50: 0.28}  # opacity of each band; the narrow one lies on the wide one
_KEYS = ["fold", "insertion"]
_HEIGHTS = ["y_mm", "low_mm", "high_mm"]
_POINT = [*_KEYS, "curve", "x_mm", *_HEIGHTS]
_BLUE = RIVAL_COLOURS["fitted"]
_DOT: dict[str, Any] = {"mfc": INK, "mec": "white", "mew": 0.4, "ms": 2.7}  # seen above a line that fits


def overlays(results: Results, path: Path, role: str = "validate") -> Path:
    """Draw each insertion of a role: the measured needle as dots, the model's prediction as a line.

    Where it was held out, bands say where 50 and 95 % of its measurements were foretold to lie. All panels
    have the same axes in mm, y positive toward the bevel and stretched by the factor that its label states.
    """
    titles = _titles(results, role)
    name = rival_name("hand_tuned", results)
    return plot(path, _curves(results, role), lambda curves: _paint(curves, titles, name))


def stretch(width: float, height: float) -> int:
    """Return the largest of 1, 2, 5, ... that keeps a drawing of `width` by `height` mm wider than high."""
    fitting = [factor for factor in _STRETCHES if factor * height <= 0.62 * width]
    return fitting[-1] if fitting else 1


def _curves(results: Results, role: str) -> pd.DataFrame:
    """Return one row per drawn point, y toward the bevel; `low_mm`, `high_mm` are the ends of a band."""
    where = "role == @role and boundaries == 'measured' and rival in @_SHOWN"
    shapes = results.shapes.query(where, local_dict={"role": role, "_SHOWN": _SHOWN})
    shapes = shapes.sort_values([*_KEYS, "rival", "j"])
    simulated = shapes.set_axis([c.replace("simulated_", "") for c in shapes.columns], axis=1)
    dots = shapes.drop_duplicates([*_KEYS, "j"])
    every = _EVERY if shapes["insertion"].nunique() <= _ROOMY else 2 * _EVERY
    dots = dots[dots["j"] % every == 0].set_axis([c.replace("measured_", "") for c in shapes.columns], axis=1)
    parts = [simulated.assign(curve=simulated["rival"]), dots.assign(curve="measured")]
    for level in _LEVELS if role == "validate" else ():
        ends = {f"low_{level}_mm": "low_mm", f"high_{level}_mm": "high_mm"}
        parts.append(results.bands.rename(columns=ends).assign(curve=f"{level} %"))
    curves = pd.concat([part.reindex(columns=_POINT) for part in parts if len(part)], ignore_index=True)
    sides = curves["insertion"].map(bevel_sides(results))
    curves[_HEIGHTS] = curves[_HEIGHTS].mul(sides, axis=0)
    return curves.assign(origin=results.origin)


def _titles(results: Results, role: str) -> dict[tuple[str, str], str]:
    """Return by fold and insertion what stands above its panel: its errors."""
    scored = results.errors.query("role == @role and boundaries == 'measured' and rival == 'fitted'")
    said = {}
    for row in records(scored):
        digits = 3 if row["comparison"] == "aligned" else 2
        errors = f"IPE {fixed(row['ipe_mean_mm'], digits)}, TE {fixed(row['te_mm'], digits)} mm"
        said[row["fold"], row["insertion"]] = errors if row["converged"] else "did not converge"
    return said


def _paint(curves: pd.DataFrame, titles: dict[tuple[str, str], str], hand_tuned: str) -> Figure:
    x, y = _span(curves[["x_mm"]]), _span(curves[_HEIGHTS])
    factor = stretch(x[1] - x[0], y[1] - y[0])
    columns = min(3 if len(titles) <= _ROOMY else 4, len(titles))
    rows = math.ceil(len(titles) / columns)
    panel = WIDTH / max(columns, 3)
    height = panel * 0.86 * factor * (y[1] - y[0]) / (x[1] - x[0]) + 0.32
    figure = Figure(figsize=(max(columns, 2) * panel, rows * height + 0.75))
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, ((fold, insertion), said) in zip(grid.flat, titles.items(), strict=False):
        _panel(axes, curves[(curves["fold"] == fold) & (curves["insertion"] == insertion)])
        axes.set_title(insertion, loc="left", pad=3)
        axes.set_title(said, loc="right", pad=3, fontsize=6.5, color=RIVAL_COLOURS["fitted"])
        axes.set(xlim=x, ylim=y)
        axes.set_aspect(factor)
    _hide(list(grid.flat)[len(titles) :], grid)
    figure.supxlabel("depth x (mm)", fontsize=7.5)
    drawn = "" if factor == 1 else f",\ndrawn {factor}× as large as x"
    figure.supylabel(f"toward the bevel y (mm){drawn}", fontsize=7.5)
    _explain(figure, set(curves["curve"]), hand_tuned)
    label_origin(figure, is_synthetic(curves))
    return figure


def _panel(axes: Axes, curves: pd.DataFrame) -> None:
    for level, alpha in _LEVELS.items():
        band = curves[curves["curve"] == f"{level} %"]
        axes.fill_between(band["x_mm"], band["low_mm"], band["high_mm"], color=_BLUE, alpha=alpha, lw=0)
    for rival in _SHOWN:
        curve, width = curves[curves["curve"] == rival], 1.1 if rival == "fitted" else 0.9
        axes.plot(
            curve["x_mm"],
            curve["y_mm"],
            color=RIVAL_COLOURS[rival],
            lw=width,
            zorder=2.0 + (rival == "fitted"),
        )
    dots = curves[curves["curve"] == "measured"]
    axes.plot(dots["x_mm"], dots["y_mm"], "o", zorder=4, **_DOT)


def _span(values: pd.DataFrame) -> tuple[float, float]:
    """Return the range of all values, and some room."""
    low, high = (float(f(values.to_numpy(dtype=np.float64))) for f in (np.nanmin, np.nanmax))
    margin = 0.06 * max(high - low, 0.2)
    return low - margin, high + margin


def _hide(spare: list[Axes], grid: NDArray[np.object_]) -> None:
    """Take empty panels away; the panels above them get the x labels back."""
    for i, axes in enumerate(reversed(spare), start=1):
        axes.set_visible(False)
        if len(grid) > 1:
            grid[-2, -i].tick_params(labelbottom=True)


def _explain(figure: Figure, present: set[str], hand_tuned: str) -> None:
    handles: list[Artist] = [
        Line2D([], [], color=INK, marker="o", ms=2.7, lw=0, label="measured"),
        Line2D([], [], color=_BLUE, lw=1.1, label="needlefit, fitted"),
    ]
    if "hand_tuned" in present:
        handles.append(Line2D([], [], color=RIVAL_COLOURS["hand_tuned"], lw=1.1, label=hand_tuned))
    if "95 %" in present:
        handles += [
            Patch(color=_BLUE, alpha=a, lw=0, label=f"{n} % foretold") for n, a in ((50, 0.4), (95, 0.16))
        ]
    figure.legend(handles=handles, loc="outside upper left", ncols=3, handlelength=1.3)
