"""Errors of every held-out group as boxes: in-plane errors of all points, and tip errors."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from needlefit.reporting.figures.style import WIDTH, draw, label_origin, light_grid
from needlefit.reporting.names import INK, PAPER, layers_name, medium_name
from needlefit.reporting.tables import Row, records, validation_table
from needlefit.validation.results import Results
from needlefit.validation.summary import points

_IPE, _TE = "#0072B2", "#009E73"
_LEAST = 5  # fewer tip errors than this are shown as points only: a box of them would be an invention


@dataclass(frozen=True)
class _Group:
    label: str
    ipe: NDArray[np.float64]
    te: NDArray[np.float64]
    row: Row


def boxplot(results: Sequence[Results], path: Path) -> Path:
    """Draw, per held-out group, the in-plane errors of all points and the tip errors (boxes: quartiles).

    Whiskers span the 5th to the 95th percentile, dots are tips of single insertions. Diamonds are
    means over insertions, ours filled and the paper's open; dashes are the noise floor's.
    """
    groups = [group for one in results for group in _groups(one)]
    return draw(path, lambda: _paint(groups, any(one.origin == "synthetic" for one in results)))


def _groups(results: Results) -> list[_Group]:
    where = "role == 'validate' and rival == 'fitted' and boundaries == 'measured'"
    cloud, errors = points(results).query(where), results.errors.query(where)
    made = []
    for row in records(validation_table(results)):
        medium, layers = row["validate_medium"], row["validate_layers"]
        ipe, te = (
            frame[(frame["medium"] == medium) & (frame["layers"] == layers)][column].to_numpy(np.float64)
            for frame, column in ((cloud, "ipe_mm"), (errors, "te_mm"))
        )
        study = f"study {row['study']}" if isinstance(row["study"], int) else str(row["study"])
        label = f"{study}\n{medium_name(medium)}\n{layers_name(layers)}\nn = {row['insertions']}"
        made.append(_Group(label, ipe[np.isfinite(ipe)], te[np.isfinite(te)], row))
    return made


def _paint(groups: list[_Group], synthetic: bool) -> Figure:
    figure = Figure(figsize=(max(5.6, min(WIDTH, 1.6 + 0.95 * len(groups))), 3.0))
    axes = figure.add_subplot()
    for x, group in enumerate(groups):
        _box(axes, x - 0.19, group.ipe, _IPE)
        if len(group.te) >= _LEAST:
            _box(axes, x + 0.19, group.te, _TE)
        spread = np.linspace(-0.07, 0.07, len(group.te)) if len(group.te) > 1 else np.zeros(len(group.te))
        axes.plot(x + 0.19 + spread, group.te, "o", ms=2.6, mfc=_TE, mec="white", mew=0.3, zorder=4)
        for shift, metric, colour in ((-0.19, "ipe_mean_mm", _IPE), (0.19, "te_mm", _TE)):
            _mark(axes, x + shift, (group.row, metric), colour)
    axes.set_xticks(range(len(groups)), [group.label for group in groups], linespacing=1.25)
    axes.tick_params(axis="x", length=0, pad=5)
    margin = 0.55 + 0.4 * max(0, 3 - len(groups))  # one or two groups do not fill the whole width
    axes.set_xlim(-margin, len(groups) - 1 + margin)
    axes.set_ylim(bottom=0)
    axes.set_ylabel("error (mm)")
    light_grid(axes, "y")
    _explain(figure, any(group.row["paper_te_mm"] is not None for group in groups))
    label_origin(figure, synthetic)
    return figure


def _box(axes: Axes, x: float, values: NDArray[np.float64], colour: str) -> None:
    line: dict[str, Any] = {"color": colour, "linewidth": 0.8}
    axes.boxplot(
        [values],
        positions=[x],
        widths=0.3,
        whis=(5, 95),
        showfliers=False,
        patch_artist=True,
        boxprops={"facecolor": colour, "alpha": 0.28, "linewidth": 0},
        medianprops={"color": colour, "linewidth": 1.6},
        whiskerprops=line,
        capprops={"linewidth": 0},
        manage_ticks=False,
    )


def _mark(axes: Axes, x: float, cell: tuple[Row, str], colour: str) -> None:
    """Mark our mean over insertions, the noise floor's and the paper's."""
    row, metric = cell
    ours, floor, printed = (row[f"{whose}{metric}"] for whose in ("", "floor_", "paper_"))
    if ours is not None:
        axes.plot(x, ours, "D", ms=3.2, mfc=colour, mec="white", mew=0.5, zorder=5)
    if floor is not None:
        axes.hlines(floor, x - 0.17, x + 0.17, color=INK, linewidth=0.8, linestyle=(0, (2, 1.5)), zorder=5)
    if printed is not None:
        axes.plot(x, printed, "D", ms=3.6, mfc="white", mec=PAPER, mew=1.0, zorder=6)


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
