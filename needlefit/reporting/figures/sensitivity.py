"""How much held-out errors change with what was decided: a row a variation, a study's number a change."""

from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting.figures.style import WIDTH, draw, label_origin, light_grid
from needlefit.reporting.names import GREY, INK, PAPER, RIVAL_COLOURS
from needlefit.reporting.tables import records
from needlefit.validation.inquiries.answer import Answer
from needlefit.validation.inquiries.sensitivity.verb import AS_DECIDED

_SMALL = 0.1
_PANELS = (
    ("again", "ipe_mean", "mean IPE, tuned again"),
    ("again", "te", "TE, tuned again"),
    ("kept", "ipe_mean", "mean IPE, kept"),
    ("kept", "te", "TE, kept"),
)


def draw_studies(answer: Answer, path: Path) -> Path:
    """Draw the change of every study's mean IPE and TE, in noise floors."""
    return draw(path, lambda: _paint(answer))


def _paint(answer: Answer) -> Figure:
    frame = answer.frames["studies"]
    frame = frame[frame["of"] != AS_DECIDED]
    rows = list(frame[["of", "variation"]].drop_duplicates().itertuples(index=False, name=None))
    figure = Figure(figsize=(WIDTH, 0.9 + 0.24 * len(rows)))
    panels = figure.subplots(1, len(_PANELS), sharey=True)
    for axes, (tuned, error, words) in zip(panels, _PANELS, strict=True):
        _panel(axes, frame[frame["tuned"] == tuned], rows, error)
        axes.set_title(words, loc="left", fontsize=7)
    names = [f"{of}: {name}" for of, name in rows]
    panels[0].set_yticks(range(len(rows)), names)
    panels[0].set_ylim(len(rows) - 0.5, -0.6)
    figure.supxlabel("change of the held-out error (noise floors)", fontsize=7.5)
    label_origin(figure, answer.synthetic)
    return figure


def _panel(axes: Axes, frame: pd.DataFrame, rows: list[tuple[str, str]], error: str) -> None:
    axes.axvspan(-_SMALL, _SMALL, color=GREY, alpha=0.15, lw=0)
    axes.axvline(0, color=INK, lw=0.6)
    for row in records(frame):
        y, change = rows.index((row["of"], row["variation"])), row[f"{error}_change_in_floors"]
        small = abs(change) < _SMALL
        colour = GREY if small else PAPER if row["conclusion_changes"] else RIVAL_COLOURS["fitted"]
        axes.text(
            change,
            y,
            row["study"].removeprefix("study"),
            color=colour,
            fontsize=6.5,
            ha="center",
            va="center",
        )
    largest = max(1.2, 1.3 * float(frame[f"{error}_change_in_floors"].abs().max()))
    axes.set_xscale("symlog", linthresh=1.0, linscale=1.0)
    axes.set_xlim(-largest, largest)
    ticks = [t for t in (-30, -10, -3, -1, 0, 1, 3, 10, 30) if abs(t) < largest]
    axes.set_xticks(ticks, [f"{t}".replace("-", "−") for t in ticks])
    axes.minorticks_off()
    for y in [i for i in range(1, len(rows)) if rows[i][0] != rows[i - 1][0]]:
        axes.axhline(y - 0.5, color=INK, lw=0.3, alpha=0.4)
    axes.tick_params(axis="y", length=0)
    light_grid(axes, "x")
