"""Figure of the predictive check: PIT values and coverage of intervals on held-out needles.

The level of a measurement is the probability that was predicted of less: of a tip less far toward the
bevel, of a shape nearer at its worst point. Where predictions are right, levels are uniform. A needle is one
trial, and repeats in one specimen are one where there are specimens enough (`group_independent`).
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from needlefit.arrays import Floats
from needlefit.datasets.select import group_independent
from needlefit.inference.proportions import estimate_proportion
from needlefit.reporting.figures.style import COLUMN_WIDTH_IN, TEXT_WIDTH_IN, choose_width, draw_grid, plot
from needlefit.reporting.labels import GREY, INK, study_name
from needlefit.reporting.table_files import Row
from needlefit.studies.rank_statistics import ecdf_band
from needlefit.studies.run import Run
from needlefit.studies.scored_groups import study_label
from needlefit.studies.summary import find_bevel_sides

BAND_POINTS = 100
"""Number of probabilities at which the band is computed, plus one."""

BAND_ERROR_PROBABILITY = 0.05
"""Probability that uniform PIT values leave the band somewhere."""

_QUANTITIES = {"tip": ("tips", "#0072B2"), "shape": ("whole shapes", "#009E73")}
_INTERVALS = (50, 95)
_ROW_HEIGHT_IN, _MANY_ROW_HEIGHT_IN = 1.5, 1.05  # inches a study, of one and of several
_COLUMNS = (
    "study",
    "mark",
    "quantity",
    "probability",
    "share",
    "low",
    "high",
    "insertions",
    "replicates",
    "origin",
)


def draw_predictive_check(results: Sequence[Run], path: Path) -> Path:
    """Draw, a row of panels per study, the ECDF of PIT values with its band, and coverage of intervals."""
    return plot(path, tabulate_predictive_check(results), _paint)


def tabulate_predictive_check(results: Sequence[Run]) -> pd.DataFrame:
    """Return what is drawn: steps of the ECDFs, their band, and shares with Wilson intervals."""
    rows = [row for one in results if len(one.frames["predictive"]) for row in _rows(one)]
    return pd.DataFrame(rows, columns=_COLUMNS)


def _rows(results: Run) -> Iterator[Row]:
    predictions = results.frames["predictive"]
    independent_groups = group_independent(list(predictions["insertion"]), list(predictions["specimen"]))
    trials = len(set(independent_groups))
    study_values: Row = {"study": study_name(study_label(results)), "origin": results.origin}
    study_values |= {"insertions": len(predictions), "replicates": trials}
    size = (
        pd.Series(independent_groups)
        .map(pd.Series(independent_groups).value_counts())
        .to_numpy(dtype=np.float64)
    )
    for quantity, pits in _orient_pits(results).items():
        order = np.argsort(pits, kind="stable")
        below = np.cumsum(1 / size[order]) / trials  # every group weighs the same
        for level, part in zip([0.0, *pits[order], 1.0], [0.0, *below, 1.0], strict=True):
            yield {
                **study_values,
                "mark": "ECDF",
                "quantity": quantity,
                "probability": float(level),
                "share": float(part),
            }
    count_low, count_high = ecdf_band(trials, BAND_POINTS, BAND_ERROR_PROBABILITY)
    for place, low, high in zip(range(1, BAND_POINTS), count_low / trials, count_high / trials, strict=True):
        yield {
            **study_values,
            "mark": "band",
            "probability": place / BAND_POINTS,
            "low": float(low),
            "high": float(high),
        }
    for quantity in _QUANTITIES:
        for level in _INTERVALS:
            found = estimate_proportion(
                [bool(covered) for covered in predictions[f"{quantity}_in_{level}"]], independent_groups
            )
            ends = {"share": found.hits / found.trials, "low": found.low, "high": found.high}
            yield {
                **study_values,
                "mark": "coverage",
                "quantity": quantity,
                "probability": level / 100,
                **ends,
            }


def _orient_pits(results: Run) -> dict[str, Floats]:
    """Return the levels of tips and shapes; those of tips are stored toward +y."""
    predictions = results.frames["predictive"]
    sides = predictions["insertion"].map(find_bevel_sides(results)).to_numpy(dtype=np.float64)
    tips, shapes = (
        predictions[f"{quantity}_pit"].to_numpy(dtype=np.float64) for quantity in ("tip", "shape")
    )
    # The PIT value of -y is 1 minus that of y: needles whose bevels face opposite sides become comparable.
    return {"tip": np.where(sides > 0, tips, 1 - tips), "shape": shapes}


def _paint(rows: pd.DataFrame) -> Figure:
    studies = list(rows.groupby("study", sort=False))
    width = choose_width(TEXT_WIDTH_IN if len(studies) > 1 else COLUMN_WIDTH_IN)
    head = 0.55 if width > COLUMN_WIDTH_IN else 0.75
    figure = Figure(
        figsize=(width, head + (_ROW_HEIGHT_IN if len(studies) == 1 else _MANY_ROW_HEIGHT_IN) * len(studies))
    )
    grid = figure.subplots(len(studies), 2, squeeze=False, sharex="col", width_ratios=(1.25, 1))
    for (left, right), (name, some) in zip(grid, studies, strict=True):
        count = f"{some['insertions'].iloc[0]} insertions"
        trials = some["replicates"].iloc[0]
        alone = "" if trials == some["insertions"].iloc[0] else f", {trials} independent"
        left.set_title(f"{name}: {count}{alone}" if len(studies) > 1 else f"{count}{alone}", loc="left")
        _paint_ecdfs(left, some)
        _paint_coverage(right, some)
        if len(studies) > 1:  # a low panel is shorter than the name in one line
            right.set_ylabel("empirical\ncoverage")
    grid[-1, 0].set_xlabel("PIT")
    grid[-1, 1].set_xlabel("interval")
    _draw_legend(figure)
    return figure


def _paint_ecdfs(axes: Axes, rows: pd.DataFrame) -> None:
    chance = rows[rows["mark"] == "band"]
    ends: Mapping[str, pd.Series] = {side: chance[side].astype(float) for side in ("low", "high")}
    axes.fill_between(chance["probability"], ends["low"], ends["high"], color=GREY, alpha=0.22, lw=0)
    axes.plot([0, 1], [0, 1], color=GREY, lw=0.5)
    for quantity, (_, colour) in _QUANTITIES.items():
        steps = rows[(rows["mark"] == "ECDF") & (rows["quantity"] == quantity)]
        axes.step(steps["probability"], steps["share"], where="post", color=colour, lw=1.2)
    axes.set(xlim=(-0.02, 1.02), ylim=(-0.04, 1.04), ylabel="empirical CDF")
    axes.set_xticks([0, 0.5, 1], ["0", "½", "1"])
    axes.set_yticks([0, 0.5, 1], ["0", "½", "1"])


def _paint_coverage(axes: Axes, rows: pd.DataFrame) -> None:
    """Draw what part of needles each interval held, with what so few of them leave open."""
    for at, level in enumerate(_INTERVALS):
        axes.plot([at - 0.32, at + 0.32], [level / 100] * 2, color=INK, lw=0.8, ls=(0, (2, 1.5)))
    for shift, (quantity, (_, colour)) in zip((-0.13, 0.13), _QUANTITIES.items(), strict=True):
        some = rows[(rows["mark"] == "coverage") & (rows["quantity"] == quantity)]
        for at, (_, row) in enumerate(some.iterrows()):
            axes.plot([at + shift] * 2, [row["low"], row["high"]], color=colour, lw=1.2)
            axes.plot(at + shift, row["share"], "o", ms=4, color=colour, mec="white", mew=0.5)
    axes.set_xticks(range(len(_INTERVALS)), [f"{level} %" for level in _INTERVALS])
    axes.tick_params(axis="x", length=0)
    axes.set(xlim=(-0.6, len(_INTERVALS) - 0.4), ylim=(-0.04, 1.04), ylabel="empirical coverage")
    axes.set_yticks([0, 0.5, 1], ["0", "½", "1"])
    draw_grid(axes, "y")


def _draw_legend(figure: Figure) -> None:
    handles: list[Artist] = [
        Line2D([], [], color=colour, lw=1.3, label=label) for label, colour in _QUANTITIES.values()
    ]
    handles.append(Patch(color=GREY, alpha=0.22, lw=0, label="95 % band, uniform"))
    handles.append(Line2D([], [], color=INK, lw=0.8, ls=(0, (2, 1.5)), label="nominal"))
    figure.legend(
        handles=handles,
        loc="outside upper left",
        ncols=4 if figure.get_figwidth() > COLUMN_WIDTH_IN else 2,
        handlelength=1.3,
    )
