"""What is told of insertions and specimens left out in turn."""

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.datasets.independent import groups
from needlefit.reporting import document
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import WIDTH, draw, label_origin, light_grid
from needlefit.reporting.foretold import said_of
from needlefit.reporting.inquiries.page import Figures, Page
from needlefit.reporting.names import GREY, INK, RIVAL_COLOURS, medium_name
from needlefit.reporting.numbers import fixed
from needlefit.reporting.tables import Row, records
from needlefit.validation.coverage import share
from needlefit.validation.inquiries.answer import Answer

_NAMES = {"insertion": "each insertion left out", "specimen": "each specimen left out"}


def said(answer: Answer) -> list[str]:
    """Return, for every fit, what leaving out added to the error."""
    return [_said(row) for row in records(answer.frames["summary"])]


def layouts(answer: Answer) -> list[Display]:
    """Return the errors left out beside those in sample, and how what was left out was foretold."""
    return [_errors(answer), _foretold(answer)]


def _said(row: Row) -> str:
    what = f"{medium_name(row['fit']).capitalize()}, {_NAMES[row['left_out']]}"
    if row["note"]:
        return f"{what}: {row['note']}."
    return (
        f"{what} ({row['groups']} fits): mean IPE and TE {fixed(row['ipe_mean_mm'])} and "
        f"{fixed(row['te_mm'])} mm, in sample {fixed(row['in_sample_ipe_mean_mm'])} and "
        f"{fixed(row['in_sample_te_mm'])} mm; noise floor {fixed(row['floor_ipe_mean_mm'])} and "
        f"{fixed(row['floor_te_mm'])} mm; a constant curvature, fitted to the same insertions, "
        f"{fixed(row['curve_ipe_mean_mm'])} and {fixed(row['curve_te_mm'])} mm."
    )


def _errors(answer: Answer) -> Display:
    ways = ("Left out", "In sample", "Gap", "Planned", "Curve", "Floor")
    heads = (text("Fit"), text("Left out"), Column("Fits"), Column("n"), text("Error"))
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for row in records(answer.frames["summary"]):
        breaks += [len(rows)] if rows else []
        rows += _lines(row)
    notes = (
        "“Gap” is the error left out minus that in sample, of the same insertions, ± its standard error over "
        "what was left out. “Planned” is left out, with layers from the planned path instead of the measured "
        "crossings. “Curve” is a constant curvature fitted to the same insertions. “Floor” is what perfect "
        "parameters would still show. Pareto k is the largest of all fits.",
    )
    columns = (*heads, *(Column(way, "mm") for way in ways), Column("Pareto k"))
    caption = "Errors on what was left out, beside those in sample (mean over insertions)."
    return Display("left_out", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _lines(row: Row) -> list[tuple[str, ...]]:
    """Return the lines of one kind of group: IPE and TE, or why there are none."""
    head = (medium_name(row["fit"]), row["left_out"], str(row["groups"]), str(row["insertions"]))
    if row["note"]:
        return [(*head, row["note"], *("",) * 7)]
    k = f"{row['worst_pareto_k']:.2f}"
    k += f" ({row['folds_sampled']} sampled)" if row["folds_sampled"] else ""
    return [
        (*head, "mean IPE", *_cells(row, "ipe_mean"), k),
        ("", "", "", "", "TE", *_cells(row, "te"), ""),
    ]


def _cells(row: Row, metric: str) -> tuple[str, ...]:
    stem = metric.removesuffix("_mean")
    gap = f"{row[f'{stem}_gap_mm']:+.3f} ± {row[f'{stem}_gap_se_mm']:.3f}".replace("-", "−")
    ways = (fixed(row[f"{way}_{metric}_mm"]) for way in ("planned", "curve", "floor"))
    return (fixed(row[f"{metric}_mm"]), fixed(row[f"in_sample_{metric}_mm"]), gap, *ways)


def _foretold(answer: Answer) -> Display:
    rows = []
    for (fit, what), told in answer.frames["predictive"].groupby(["fit", "left_out"], sort=False):
        together = groups(list(told["insertion"]), list(told["specimen"]))
        held = (f"{part}_in_{level}" for part in ("tip", "shape") for level in (50, 95))
        shares = (said_of(share(list(told[column]), together)) for column in held)
        scores = (fixed(told[f"{part}_crps_mm"].mean(), 3) for part in ("tip", "shape"))
        rows.append((medium_name(str(fit)), str(what), *shares, *scores))
    columns = (
        *(text("Fit"), text("Left out")),
        *(Column(f"{part} in", f"{level} %") for part in ("Tips", "Shapes") for level in (50, 95)),
        *(Column("Tip CRPS", "mm"), Column("Shape CRPS", "mm")),
    )
    notes = (
        "Tips and whole shapes that fell into the interval foretold for them, by draws of the posterior; in "
        "brackets the 95 % interval of that share. Pareto k of those draws is beside the errors: where it is "
        "above 0.7 the posterior was sampled instead.",
    )
    caption = "How well what was left out was foretold."
    return Display("foretold", caption, columns, tuple(rows), notes=notes)


def draw_errors(answer: Answer, folder: Path) -> dict[str, Path]:
    """Draw TE in sample and left out, fit by fit."""
    rows = [row for row in records(answer.frames["summary"]) if not row["note"]]
    if not rows:
        return {}
    return {"summary": draw(folder / "summary.pdf", lambda: _paint(rows, answer.synthetic))}


def _paint(rows: list[Row], synthetic: bool) -> Figure:
    figure = Figure(figsize=(WIDTH, 0.9 + 0.34 * len(rows)))
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, metric, words in ((left, "ipe_mean", "mean in-plane error"), (right, "te", "tip error")):
        for y, row in enumerate(rows):
            _pair(axes, y, row, metric, direct=y == 0)
        axes.set_xlabel(f"{words}, mean over insertions (mm)")
        axes.set_xlim(0, None)
        light_grid(axes, "x")
        axes.tick_params(axis="y", length=0)
    labels = [f"{medium_name(row['fit'])}, {row['left_out']}s ({row['groups']})" for row in rows]
    left.set_yticks(range(len(rows)), labels)
    left.set_ylim(len(rows) - 0.5, -0.9)
    label_origin(figure, synthetic)
    return figure


def _pair(axes: Axes, y: int, row: Row, metric: str, direct: bool) -> None:
    """Draw one row: floor, in sample, left out, and the curve that knows no tissue."""
    floor, sample = row[f"floor_{metric}_mm"], row[f"in_sample_{metric}_mm"]
    held, curve = row[f"{metric}_mm"], row[f"curve_{metric}_mm"]
    axes.plot([sample, held], [y, y], color=RIVAL_COLOURS["fitted"], lw=1.0, zorder=2)
    axes.plot(sample, y, "o", ms=5, mfc="white", mec=RIVAL_COLOURS["fitted"], zorder=3)
    axes.plot(held, y, "o", ms=5, color=RIVAL_COLOURS["fitted"], zorder=4)
    axes.plot(curve, y, "^", ms=4.5, color=RIVAL_COLOURS["constant_curvature"], zorder=3)
    if floor is not None:
        axes.vlines(floor, y - 0.35, y + 0.35, color=INK, lw=0.9, ls=(0, (2, 1.5)))
    if direct:
        above: dict[str, Any] = {"xytext": (0, 7), "textcoords": "offset points", "fontsize": 6.5}
        axes.annotate("left out", (held, y), ha="left", color=RIVAL_COLOURS["fitted"], **above)
        axes.annotate("in sample", (sample, y), ha="right", color=RIVAL_COLOURS["fitted"], **above)
        axes.annotate("constant curvature", (curve, y), ha="left", color=GREY, **above)
        if floor is not None:
            axes.annotate("floor", (floor, y), ha="right", color=INK, **above)


def story(answer: Answer, figures: Figures) -> list[Block]:
    """Return the figure, both tables and what was done."""
    errors, foretold = layouts(answer)
    caption = (
        "Errors in sample (hollow) and of what was left out (filled), with a constant curvature fitted to "
        "the same insertions (triangles) and the noise floor (dashed)."
    )
    drawn = [document.figure(figures["summary"], caption, answer.synthetic)] if "summary" in figures else []
    return [
        document.heading("Errors"),
        *drawn,
        document.table(errors, answer.synthetic),
        document.heading("Prediction"),
        document.table(foretold, answer.synthetic),
    ]


PAGE = Page(said, layouts, draw_errors, story)
