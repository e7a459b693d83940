"""How far simulated shapes lie from measured ones, along each insertion: what overlays are too small for."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from needlefit.reporting.figures.style import WIDTH, is_synthetic, label_origin, light_grid, plot
from needlefit.reporting.names import INK, RIVAL_COLOURS, rival_name
from needlefit.validation.results import Results

_SHOWN = ("constant_curvature", "linear_curvature", "hand_tuned", "fitted")
_KEYS = ["fold", "insertion"]


def residuals(results: Results, path: Path, role: str = "validate") -> Path:
    """Draw, per insertion of a role, simulated minus measured normal to the measured shape, mm.

    The straight line is left out: its residuals would hide all others.
    """
    names = {rival: rival_name(rival, results) for rival in _SHOWN}
    return plot(path, _off(results, role), lambda off: _paint(off, names))


def _off(results: Results, role: str) -> pd.DataFrame:
    """Return how far each curve lies off each measured needle, point by point, mm."""
    where = "role == @role and boundaries == 'measured' and rival in @_SHOWN"
    shapes = results.shapes.query(where, local_dict={"role": role, "_SHOWN": _SHOWN})
    about = [*_KEYS, "rival", "j", "measured_x_mm"]
    parts = [
        shape[about].assign(off_normal_mm=off_normal(shape))
        for _, shape in shapes.sort_values("j", kind="stable").groupby([*_KEYS, "rival"], sort=False)
    ]
    return pd.concat(parts, ignore_index=True).assign(origin=results.origin)


def off_normal(shape: pd.DataFrame) -> NDArray[np.float64]:
    """Return by how much a simulated shape lies to the left of the measured one, point by point (K,), mm.

    Parameters
    ----------
    shape : DataFrame
        `measured_x_mm`, `measured_y_mm`, `simulated_x_mm` and `simulated_y_mm` in the order of the points.
    """
    measured = shape[["measured_x_mm", "measured_y_mm"]].to_numpy(dtype=np.float64)
    simulated = shape[["simulated_x_mm", "simulated_y_mm"]].to_numpy(dtype=np.float64)
    tangent = np.gradient(measured, axis=0)  # (K, 2)
    tangent /= np.hypot(*tangent.T)[:, None]
    off = simulated - measured
    across: NDArray[np.float64] = tangent[:, 0] * off[:, 1] - tangent[:, 1] * off[:, 0]
    return across


def _paint(off: pd.DataFrame, names: Mapping[str, str]) -> Figure:
    panels = dict(list(off.groupby(_KEYS, sort=False)))
    columns = min(3, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(WIDTH * max(columns, 2) / 3, 1.15 * rows + 0.75))
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, ((_, insertion), group) in zip(grid.flat, panels.items(), strict=False):
        _panel(axes, group)
        axes.set_title(str(insertion), loc="left", pad=3)
    spare = list(grid.flat)[len(panels) :]
    for i, axes in enumerate(reversed(spare), start=1):
        axes.set_visible(False)
        if rows > 1:
            grid[-2, -i].tick_params(labelbottom=True)
    figure.supxlabel("measured x (mm)", fontsize=7.5)
    figure.supylabel("simulated minus measured,\nnormal to the shape (mm)", fontsize=7.5)
    _explain(figure, {rival: name for rival, name in names.items() if (off["rival"] == rival).any()})
    label_origin(figure, is_synthetic(off))
    return figure


def _panel(axes: Axes, group: pd.DataFrame) -> None:
    axes.axhline(0.0, color=INK, lw=0.5)
    for rival in _SHOWN:
        shape = group[group["rival"] == rival]
        if len(shape):
            width = 1.4 if rival == "fitted" else 0.8
            axes.plot(shape["measured_x_mm"], shape["off_normal_mm"], color=RIVAL_COLOURS[rival], lw=width)
    light_grid(axes, "y")


def _explain(figure: Figure, names: Mapping[str, str]) -> None:
    handles = [
        Line2D([], [], color=RIVAL_COLOURS[rival], lw=1.3, label=names[rival])
        for rival in reversed(_SHOWN)
        if rival in names
    ]
    figure.legend(handles=handles, loc="outside upper left", ncols=4, handlelength=1.3)
