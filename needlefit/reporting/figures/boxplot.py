"""Errors of every held-out group as boxes: in-plane errors of all points, and tip errors."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from needlefit.reporting.figures.style import WIDTH, is_synthetic, label_origin, light_grid, plot
from needlefit.reporting.names import INK, PAPER, layers_name, medium_name, study_name
from needlefit.reporting.tables import Row, records, validation_table
from needlefit.validation.results import Results
from needlefit.validation.summary import tabulate_points

_IPE, _TE = "#0072B2", "#009E73"
_LEAST = 5  # fewer tip errors than this are shown as points only: a box of them would be an invention


_QUARTILES = {"5 %": 5, "25 %": 25, "median": 50, "75 %": 75, "95 %": 95}
_COLUMNS = ("group", "error", "shown", "insertion", "value_mm", "origin")


def boxplot(results: Sequence[Results], path: Path) -> Path:
    """Draw, per held-out group, the in-plane errors of all points and the tip errors (boxes: quartiles).

    Whiskers span the 5th to the 95th percentile, dots are tips of single insertions. Diamonds are
    means over insertions, ours filled and the paper's open; dashes are the noise floor's.
    """
    return plot(path, _marks(results), _paint)


def _marks(results: Sequence[Results]) -> pd.DataFrame:
    """Return one row per mark: what ends, halves and quarters a box, tips, means, floor and paper."""
    return pd.DataFrame([row for one in results for row in _rows(one)], columns=_COLUMNS)


def _rows(results: Results) -> Iterator[Row]:
    where = "role == 'validate' and method == 'fitted' and boundaries == 'measured'"
    cloud, errors = tabulate_points(results).query(where), results.errors.query(where)
    for row in records(validation_table(results)):
        medium, layers = row["validate_medium"], row["validate_layers"]
        label = f"{study_name(row['study'])}, {medium_name(medium)}, {layers_name(layers)}"
        about = {"group": f"{label}, n = {row['insertions']}", "origin": results.origin}
        ipe, te = (
            frame[(frame["medium"] == medium) & (frame["layers"] == layers) & np.isfinite(frame[column])]
            for frame, column in ((cloud, "ipe_mm"), (errors, "te_mm"))
        )
        yield from ({**about, "error": "IPE", **mark} for mark in _box_of(ipe["ipe_mm"]))
        if len(te) >= _LEAST:
            yield from ({**about, "error": "TE", **mark} for mark in _box_of(te["te_mm"]))
        for tip in records(te[["insertion", "te_mm"]]):
            yield {
                **about,
                "error": "TE",
                "shown": "tip",
                "insertion": tip["insertion"],
                "value_mm": tip["te_mm"],
            }
        for error, metric in (("IPE", "ipe_mean_mm"), ("TE", "te_mm")):
            for shown, prefix in (("mean", ""), ("noise floor", "floor_"), ("paper", "paper_")):
                if row[f"{prefix}{metric}"] is not None:
                    yield {**about, "error": error, "shown": shown, "value_mm": row[f"{prefix}{metric}"]}


def _box_of(values: pd.Series) -> list[Row]:
    if not len(values):
        return []
    ends = np.percentile(values.to_numpy(dtype=np.float64), list(_QUARTILES.values()))
    return [{"shown": shown, "value_mm": float(end)} for shown, end in zip(_QUARTILES, ends, strict=True)]


def _paint(marks: pd.DataFrame) -> Figure:
    groups = list(dict.fromkeys(marks["group"]))
    figure = Figure(figsize=(max(5.6, min(WIDTH, 1.6 + 0.95 * len(groups))), 3.0))
    axes = figure.add_subplot()
    for x, group in enumerate(groups):
        for error, shift, colour in (("IPE", -0.19, _IPE), ("TE", 0.19, _TE)):
            here = marks[(marks["group"] == group) & (marks["error"] == error)]
            _draw_error(axes, x + shift, here, colour)
    labels = [group.replace(", ", "\n") for group in groups]
    axes.set_xticks(range(len(groups)), labels, linespacing=1.25)
    axes.tick_params(axis="x", length=0, pad=5)
    margin = 0.55 + 0.4 * max(0, 3 - len(groups))  # one or two groups do not fill the whole width
    axes.set_xlim(-margin, len(groups) - 1 + margin)
    axes.set_ylim(bottom=0)
    axes.set_ylabel("error (mm)")
    light_grid(axes, "y")
    _explain(figure, bool((marks["shown"] == "paper").any()))
    label_origin(figure, is_synthetic(marks))
    return figure


def _draw_error(axes: Axes, x: float, marks: pd.DataFrame, colour: str) -> None:
    """Draw the box of one error of one group, single tips, our mean, the noise floor's and the paper's."""
    at = {str(row["shown"]): row["value_mm"] for row in records(marks)}
    if all(end in at for end in _QUARTILES):
        _box(axes, x, [at[end] for end in _QUARTILES], colour)
    tips = marks.loc[marks["shown"] == "tip", "value_mm"]
    spread = np.linspace(-0.07, 0.07, len(tips)) if len(tips) > 1 else np.zeros(len(tips))
    axes.plot(x + spread, tips, "o", ms=2.6, mfc=colour, mec="white", mew=0.3, zorder=4)
    if "mean" in at:
        axes.plot(x, at["mean"], "D", ms=3.2, mfc=colour, mec="white", mew=0.5, zorder=5)
    if "noise floor" in at:
        axes.hlines(at["noise floor"], x - 0.17, x + 0.17, color=INK, lw=0.8, ls=(0, (2, 1.5)), zorder=5)
    if "paper" in at:
        axes.plot(x, at["paper"], "D", ms=3.6, mfc="white", mec=PAPER, mew=1.0, zorder=6)


def _box(axes: Axes, x: float, ends: list[float], colour: str) -> None:
    line: dict[str, Any] = {"color": colour, "linewidth": 0.8}
    box = dict(zip(("whislo", "q1", "med", "q3", "whishi"), ends, strict=True))
    axes.bxp(
        [box],
        positions=[x],
        widths=0.3,
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": colour, "alpha": 0.28, "linewidth": 0},
        medianprops={"color": colour, "linewidth": 1.6},
        whiskerprops=line,
        capprops={"linewidth": 0},
        manage_ticks=False,
    )


def _explain(figure: Figure, printed: bool) -> None:
    handles = [
        Line2D([], [], color=_IPE, alpha=0.5, lw=5, label="in-plane error, all points"),
        Line2D([], [], color=_TE, alpha=0.5, lw=5, label="tip error"),
        Line2D([], [], color=_IPE, marker="D", mec="white", ms=4, lw=0, label="our mean"),
        Line2D([], [], color=PAPER, marker="D", mfc="white", ms=3.6, lw=0, label="paper's mean"),
        Line2D([], [], color=INK, lw=0.8, ls=(0, (2, 1.5)), label="noise floor"),
    ]
    handles = handles if printed else [*handles[:3], handles[4]]
    columns = 5 if figure.get_figwidth() > 6 else 3
    figure.legend(
        handles=handles, loc="outside upper left", ncols=columns, handlelength=1.3, columnspacing=1.4
    )
