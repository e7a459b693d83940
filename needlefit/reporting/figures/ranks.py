"""Where truths stand among draws of their posteriors, beside where chance would have them."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.calibration_said import quantity
from needlefit.reporting.figures.style import WIDTH, is_synthetic, label_origin, plot
from needlefit.reporting.names import GREY, INK, SYNTHETIC
from needlefit.validation.calibration.rank_statistics import RANK_DRAWS
from needlefit.validation.calibration.run import Calibration

BLUE = "#0072B2"
ACROSS = 4


def draw_ranks(found: Calibration, path: Path) -> Path:
    """Draw, for each quantity, the ECDF of the ranks less that of uniform ones, on the band of chance.

    A curve that is first above and then below: posteriors too narrow; the other way round: too wide.
    """
    curves = _curves(found).assign(origin=found.origin)
    return plot(path, curves, lambda frame: _paint(frame, found.failing))


def _curves(found: Calibration) -> pd.DataFrame:
    """Return the ECDFs with what is drawn of them: the part of ranks below a place, less the place's own."""
    place, count = found.ecdfs["rank"] / (RANK_DRAWS + 1), len(found.replicates)
    parts = {
        f"{name}_less_uniform": found.ecdfs[name] / count - place
        for name in ("below", "count_low", "count_high")
    }
    return found.ecdfs.assign(uniform=place, **parts)


def _paint(curves: pd.DataFrame, failing: Sequence[str]) -> Figure:
    groups = list(curves.groupby("quantity", sort=False))
    down = math.ceil(len(groups) / ACROSS)
    figure = Figure(figsize=(WIDTH, 0.35 + 1.45 * down))
    panels = figure.subplots(down, ACROSS, sharex=True, sharey=True, squeeze=False)
    for axes, (name, rows) in zip(panels.flat, groups, strict=False):
        _panel(axes, rows)
        failed = str(name) in failing
        axes.set_title(quantity(str(name)), loc="left", color=SYNTHETIC if failed else INK)
    for axes in panels.flat[len(groups) :]:
        axes.set_axis_off()
    for axes in panels[:, 0]:
        axes.set_ylabel("ECDF − uniform")
    for n, axes in enumerate(panels.flat):
        if n < len(groups) <= n + ACROSS:
            axes.set_xlabel("rank of the truth")
            axes.tick_params(labelbottom=True)
    label_origin(figure, is_synthetic(curves))
    return figure


def _panel(axes: Axes, rows: pd.DataFrame) -> None:
    place, low, high, below = (
        rows[name].to_numpy(dtype=np.float64)
        for name in ("uniform", "least_less_uniform", "most_less_uniform", "below_less_uniform")
    )
    axes.fill_between(place, low, high, color=GREY, alpha=0.22, lw=0)
    axes.axhline(0, color=GREY, lw=0.5)
    axes.step(place, below, where="post", color=BLUE, lw=1.0)
    outside = ~rows["passes"].to_numpy(dtype=np.bool_)
    axes.plot(place[outside], below[outside], ".", color=SYNTHETIC, ms=2.5)
    axes.set_xlim(0, 1)
    axes.set_xticks([0, 0.5, 1], ["0", "½", "1"])
