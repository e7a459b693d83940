"""What figures with one panel per insertion have in common: the curves of each, the panels, the legend."""

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from needlefit.reporting.names import INK, METHOD_COLOURS
from needlefit.validation.results import Results
from needlefit.validation.summary import find_bevel_sides

Insertion = tuple[str, str]
"""Fold and insertion."""

KEYS = ["fold", "insertion"]
HEIGHTS = ["y_mm", "low_mm", "high_mm"]
DOT: dict[str, Any] = {"mfc": INK, "mec": "white", "mew": 0.4, "ms": 2.7}  # seen above a line that fits
ROOMY = 24
"""Insertions at most whose panels are large."""

DASHED: Mapping[str, Any] = {"constant_curvature": (0, (4, 2))}  # where two lines are one, both are seen

_LEVELS = {95: 0.16, 50: 0.28}  # opacity of each band; the narrow one lies on the wide one
_POINT = [*KEYS, "curve", "x_mm", *HEIGHTS]
_BLUE = METHOD_COLOURS["fitted"]


def curves(results: Results, role: str, shown: Iterable[str], every: int = 1) -> pd.DataFrame:
    """Return one row per drawn point of a role's insertions, y toward the bevel, mm.

    `curve` is a method of `shown`, "measured" (of the points, one in `every`), or the level of a band, which
    held-out insertions have: `low_mm`, `high_mm` are its ends.
    """
    where = "role == @role and boundaries == 'measured' and method in @shown"
    shapes = results.shapes.query(where, local_dict={"role": role, "shown": list(shown)})
    shapes = shapes.sort_values([*KEYS, "method", "j"])
    simulated = shapes.set_axis([c.replace("simulated_", "") for c in shapes.columns], axis=1)
    dots = shapes.drop_duplicates([*KEYS, "j"])
    bands = _on_measured(results.bands, dots)
    dots = dots[dots["j"] % every == 0].set_axis([c.replace("measured_", "") for c in shapes.columns], axis=1)
    parts = [simulated.assign(curve=simulated["method"]), dots.assign(curve="measured")]
    for level in _LEVELS if role == "validate" else ():
        ends = {f"low_{level}_mm": "low_mm", f"high_{level}_mm": "high_mm"}
        parts.append(bands.rename(columns=ends).assign(curve=f"{level} %"))
    found = pd.concat([part.reindex(columns=_POINT) for part in parts if len(part)], ignore_index=True)
    sides = found["insertion"].map(find_bevel_sides(results))
    found[HEIGHTS] = found[HEIGHTS].mul(sides, axis=0)
    return found.assign(origin=results.origin)


def _on_measured(bands: pd.DataFrame, shapes: pd.DataFrame) -> pd.DataFrame:
    """Return bands as they lie about the measured needle that is drawn.

    Where only the shape is known, scores turn it into a frame of their own: a band stays where it is beside
    the needle it was foretold for.
    """
    parts = []
    ends = [name for name in bands.columns if name.startswith(("low_", "high_"))]
    for key, band in bands.groupby(KEYS, sort=False):
        needle = shapes[(shapes["fold"] == key[0]) & (shapes["insertion"] == key[1])]
        if len(needle):
            height = np.interp(band["x_mm"], needle["measured_x_mm"], needle["measured_y_mm"])
            parts.append(band.assign(**{name: band[name] - band["measured_mm"] + height for name in ends}))
    return pd.concat(parts) if parts else bands


def panels(
    figure: Figure, points: pd.DataFrame, columns: int, names: Iterable[Insertion]
) -> Iterator[tuple[Axes, Insertion, pd.DataFrame]]:
    """Yield a panel for each insertion, which it is, and its points; all panels have the same axes."""
    wanted = list(names)
    rows = math.ceil(len(wanted) / columns)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for i, spare in enumerate(reversed(list(grid.flat)[len(wanted) :]), start=1):
        spare.set_visible(False)
        if rows > 1:
            grid[-2, -i].tick_params(labelbottom=True)  # the panel above has the lowest x axis of its column
    for axes, (fold, insertion) in zip(grid.flat, wanted, strict=False):
        axes.set_title(insertion, loc="left", pad=3)
        mine = points[(points["fold"] == fold) & (points["insertion"] == insertion)]
        yield axes, (fold, insertion), mine


def paint_bands(axes: Axes, points: pd.DataFrame) -> None:
    """Shade where measurements were foretold to lie."""
    for level, alpha in _LEVELS.items():
        band = points[points["curve"] == f"{level} %"]
        axes.fill_between(band["x_mm"], band["low_mm"], band["high_mm"], color=_BLUE, alpha=alpha, lw=0)


def explain(figure: Figure, present: set[str], rivals: Mapping[str, str]) -> None:
    """Say above all panels what is what; `rivals` are names by which curves are called."""
    handles: list[Artist] = [Line2D([], [], color=INK, marker="o", ms=2.7, lw=0, label="measured")]
    for method, name in rivals.items():
        if method in present:
            look = {"color": METHOD_COLOURS[method], "lw": 1.1, "ls": DASHED.get(method, "-")}
            handles.append(Line2D([], [], **look, label=name))
    if "95 %" in present:
        handles += [
            Patch(color=_BLUE, alpha=a, lw=0, label=f"{n} % foretold") for n, a in ((50, 0.4), (95, 0.16))
        ]
    columns = 3 if len(handles) <= 5 else 2  # what the data are stands at the right
    figure.legend(handles=handles, loc="outside upper left", ncols=columns, handlelength=1.3)
