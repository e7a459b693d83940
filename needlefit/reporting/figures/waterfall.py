"""Where the starts of a search ended: how good, and how far apart."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from needlefit.reporting.figures.style import WIDTH, draw, label_origin, light_grid
from needlefit.reporting.names import GREY, INK, RIVAL_COLOURS, RIVAL_NAMES
from needlefit.reporting.numbers import number, symbol, typeset
from needlefit.reporting.tables import Row, records
from needlefit.validation.results import Results


def waterfall(results: Results, path: Path) -> Path:
    """Draw how far all starts ended above the best, and where in its bounds each left each parameter.

    A parameter whose dots spread along its axis although their ends are practically the best one is not
    determined by the data.
    """
    return draw(path, lambda: _paint(results))


def _paint(results: Results) -> Figure:
    free = _free(results)
    figure = Figure(figsize=(WIDTH, max(2.2, 0.9 + 0.26 * len(free))))
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.25))
    _ranked(left, results.starts)
    _ended(right, results.starts, free)
    label_origin(figure, results.origin == "synthetic")
    return figure


def _ranked(axes: Axes, starts: pd.DataFrame) -> None:
    """Draw the excess of each search's starts, best first; failed starts stand nowhere but in the count."""
    for (fit, _), group in starts.groupby(["fit", "fold"], sort=False):
        values = np.sort(group["excess"].to_numpy(dtype=np.float64))
        values = values[np.isfinite(values)]
        axes.plot(np.arange(1, len(values) + 1), values, "o-", color=RIVAL_COLOURS[str(fit)], ms=3, lw=0.8)
    failed = int((~np.isfinite(starts["objective"].astype(float))).sum())
    fits = list(dict.fromkeys(starts["fit"]))
    each = ", a line per fold" if starts["fold"].nunique() > 1 else ""
    handles = [
        Line2D([], [], color=RIVAL_COLOURS[f], marker="o", ms=3, lw=0.8, label=RIVAL_NAMES[f] + each)
        for f in fits
    ]
    axes.legend(handles=handles, loc="best", handlelength=1.5)
    axes.set_title(f"{counted(starts)}, {failed} without a result", loc="left")
    axes.set_xlabel("start, best first")
    axes.axhline(1, color=GREY, lw=0.6, ls=(0, (2, 1.5)))
    axes.set_ylabel("above the best, in what counts as equal")
    axes.set_yscale("symlog", linthresh=1)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.set_ylim(bottom=0)
    light_grid(axes, "y")


def counted(starts: pd.DataFrame) -> str:
    """Return how many starts each search had, and how many searches there were."""
    sizes = starts.groupby(["fit", "fold"], sort=False).size()
    each = f"{sizes.min()}" if sizes.min() == sizes.max() else f"{sizes.min()} to {sizes.max()}"
    fits, folds = starts["fit"].nunique(), starts["fold"].nunique()
    where = [f"{folds} folds"] if folds > 1 else []
    where += [f"{fits} searches"] if fits > 1 else []
    return f"{each} starts" + (f" in each of {' × '.join(where)}" if where else "")


def _ended(axes: Axes, starts: pd.DataFrame, free: list[Row]) -> None:
    """Draw the end of every start of the fit within the bounds: full colour where practically the best."""
    fitted = starts[(starts["fit"] == "fitted") & np.isfinite(starts["objective"].astype(float))]
    near = fitted["as_good"].to_numpy(dtype=np.bool_)
    for y, row in enumerate(free):
        at = _share(fitted[row["parameter"]].to_numpy(dtype=np.float64), row)
        axes.hlines(y, 0, 1, color=GREY, lw=0.5, alpha=0.6)
        axes.plot(at[~near], np.full((~near).sum(), y), "o", ms=3.4, mfc="none", mec=GREY, mew=0.6)
        axes.plot(
            at[near], np.full(near.sum(), y), "o", ms=4, mfc=RIVAL_COLOURS["fitted"], mec="white", mew=0.4
        )
        for x, side in ((0, "left"), (1, "right")):
            bound = row["bound_low"] if x == 0 else row["bound_high"]
            axes.text(x, y - 0.17, typeset(number(bound)), ha=side, va="bottom", fontsize=5.5, color=GREY)
    names = [symbol(row["parameter"]) for row in free]
    axes.set_yticks(range(len(free)), names)
    axes.set_ylim(len(free) - 0.45, -0.65)
    axes.set_xlim(-0.03, 1.03)
    axes.set_xticks([])
    axes.tick_params(axis="y", length=0)
    for side in ("left", "bottom"):
        axes.spines[side].set_visible(False)
    axes.set_title("where they ended, between the bounds", loc="left", color=INK)
    axes.set_xlabel("filled: practically as good as the best", color=RIVAL_COLOURS["fitted"])


def _share(values: NDArray[np.float64], row: Row) -> NDArray[np.float64]:
    """Return where values lie between the bounds, 0 to 1; moduli and lengths in logarithms."""
    low, high = row["bound_low"], row["bound_high"]
    linear = row["parameter"].startswith("alpha")
    share: NDArray[np.float64] = (
        (values - low) / (high - low) if linear else np.log(values / low) / np.log(high / low)
    )
    return share


def _free(results: Results) -> list[Row]:
    rows = [r for r in records(results.parameters) if r["rival"] == "fitted" and r["status"] == "free"]
    first = {row["parameter"]: row for row in reversed(rows)}
    return [first[name] for name in dict.fromkeys(row["parameter"] for row in rows)]
