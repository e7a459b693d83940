"""Report of a simulation-based calibration."""

import math
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, plot
from needlefit.reporting.labels import GREY, INK, SYNTHETIC_COLOUR
from needlefit.reporting.table_files import to_records
from needlefit.studies.csv_tables import ANY_COLUMNS
from needlefit.studies.kinds.calibration.run import NESTED_FRAMES
from needlefit.studies.kinds.calibration.summary import (
    describe_figure,
    headline_calibration,
    is_of_synthetic_truths,
    judge_calibration,
    lay_out_calibration,
    name_quantity,
    scope_note,
    summarize_calibration,
)
from needlefit.studies.rank_statistics import RANK_DRAWS
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.run_differences import Difference, TableComparison

ECDF_COLOUR = "#0072B2"
MAX_PANEL_COLUMNS = 4


def draw_ranks(found: Run, path: Path) -> Path:
    """Draw, for each quantity, the ECDF of the ranks minus that of uniform ranks, on the band expected by
    chance.

    A curve that is first above and then below: posteriors too narrow; the other way round: too wide.
    """
    curves = found.frames["ranks"].assign(origin=found.origin)
    label = "PIT of the truth" if is_of_synthetic_truths(found.run) else "rank of the truth"
    return plot(path, curves, partial(_paint_ranks, label=label))


def _paint_ranks(curves: pd.DataFrame, label: str) -> Figure:
    groups = list(curves.groupby("quantity", sort=False))
    down = math.ceil(len(groups) / MAX_PANEL_COLUMNS)
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.35 + 1.45 * down))
    panels = figure.subplots(down, MAX_PANEL_COLUMNS, sharex=True, sharey=True, squeeze=False)
    for axes, (name, rows) in zip(panels.flat, groups, strict=False):
        _paint_rank_panel(axes, rows)
        colour = INK if rows["calibrated"].all() else SYNTHETIC_COLOUR
        axes.set_title(name_quantity(str(name)), loc="left", color=colour)
    for axes in panels.flat[len(groups) :]:
        axes.set_axis_off()
    for axes in panels[:, 0]:
        axes.set_ylabel("ECDF − uniform")
    for n, axes in enumerate(panels.flat):
        if n < len(groups) <= n + MAX_PANEL_COLUMNS:
            axes.set_xlabel(label)
            axes.tick_params(labelbottom=True)
    return figure


def _paint_rank_panel(axes: Axes, rows: pd.DataFrame) -> None:
    place = rows["rank"].to_numpy(dtype=np.float64) / (RANK_DRAWS + 1)
    count = rows["expected"].to_numpy(dtype=np.float64)[-1] / place[-1]
    low, high, below = (
        rows[name].to_numpy(dtype=np.float64) / count - place for name in ("count_low", "count_high", "below")
    )
    axes.fill_between(place, low, high, color=GREY, alpha=0.22, lw=0)
    axes.axhline(0, color=GREY, lw=0.5)
    axes.step(place, below, where="post", color=ECDF_COLOUR, lw=1.0)
    outside = ~rows["passes"].to_numpy(dtype=np.bool_)
    axes.plot(place[outside], below[outside], ".", color=SYNTHETIC_COLOUR, ms=2.5)
    axes.set_xlim(0, 1)
    axes.set_xticks([0, 0.5, 1], ["0", "½", "1"])


def calibration_to_json(found: Run) -> dict[str, Any]:
    """Return the calibration as JSON values, without the warnings."""
    outcome = {key: found.run[key] for key in _OUTCOME_KEYS}
    return {
        **{"name": found.run["name"], "origin": found.origin, "dataset": found.dataset_title, **outcome},
        **({"not_predicted": found.run["not_predicted"]} if is_of_synthetic_truths(found.run) else {}),
        "sentences": summarize_calibration(found),
        **{name: to_records(found.frames[name]) for name in ("coverage", *_list_nested(found))},
    }


def _list_nested(found: Run) -> list[str]:
    return [name for name in NESTED_FRAMES if name in found.frames]


_OUTCOME_KEYS = ("control", "passes", "not_calibrated", "draw_source", "untrusted", "redrawn", "interrupted")


def _draw_figures(found: Run, folder: Path) -> dict[str, Path]:
    return {"ranks": draw_ranks(found, folder / "ranks.pdf")}


def _compose_sections(found: Run, figures: FigurePaths) -> list[Block]:
    return [
        document.table(lay_out_calibration(found)),
        document.figure(figures["ranks"], describe_figure(found)),
        document.text(scope_note(found)),
    ]


def _compare_coverages(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield counts of a calibration that changed; it matters where one is now within chance, or out of it."""
    both = before.merge(after, validate="1:1", on=["quantity", "level"], suffixes=("_a", "_b"), sort=False)
    for _, row in both.iterrows():
        counts = int(row["covered_a"]), int(row["covered_b"])
        matters = bool(row["passes_a"]) != bool(row["passes_b"])
        if counts[0] != counts[1] or matters:
            where = f"{row['quantity']}, {100 * row['level']:.0f} % interval"
            why = "the verdict changed" if matters else "both as chance allows, or both not"
            yield Difference("state", where, *counts, matters, why)


REPORT = StudyReport(
    summarize_calibration,
    lambda found: [lay_out_calibration(found)],
    _draw_figures,
    _compose_sections,
    to_json=calibration_to_json,
    judge=judge_calibration,
    headline=headline_calibration,
    comparisons={"coverage": TableComparison(ANY_COLUMNS, _compare_coverages)},
)
