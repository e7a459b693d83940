"""Report of a cross-validation: insertions and specimens left out in turn."""

from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.reporting import document
from needlefit.reporting.analyses.page import AnalysisPage, FigurePaths
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, is_synthetic, label_origin, plot
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS, medium_name
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.score_tables import COVERAGE_COLUMNS, format_coverage
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.validation.analyses.runner import AnalysisResult


def draw_left_out(result: AnalysisResult, path: Path) -> Path:
    """Draw mean IPE and TE in sample and left out, with the noise floor and the constant-curvature
    baseline.
    """
    return plot(path, result.frames["summary"].assign(origin=result.origin), _paint_left_out)


def _paint_left_out(frame: pd.DataFrame) -> Figure:
    rows = [row for row in to_records(frame) if not row["note"]]
    figure = Figure(figsize=(TEXT_WIDTH_IN, 1.0 + 0.36 * len(rows)))
    left, right = figure.subplots(1, 2, sharey=True)
    for axes, metric, words in ((left, "ipe_mean", "mean in-plane error"), (right, "te", "tip error")):
        for y, row in enumerate(rows):
            _paint_pair(axes, y, row, metric, direct=y == 0)
        axes.set_xlabel(f"{words}, mean over insertions (mm)")
        axes.set_xlim(0, None)
        draw_grid(axes, "x")
        axes.tick_params(axis="y", length=0)
    labels = [f"{medium_name(row['fit'])}, {row['left_out']}s ({row['groups']})" for row in rows]
    left.set_yticks(range(len(rows)), labels)
    left.set_ylim(len(rows) - 0.5, -1.1)
    label_origin(figure, is_synthetic(frame))
    return figure


def _paint_pair(axes: Axes, y: int, row: Row, metric: str, direct: bool) -> None:
    """Draw one row: noise floor, in sample, left out, and the curve without a tissue model."""
    floor, sample = row[f"floor_{metric}_mm"], row[f"in_sample_{metric}_mm"]
    error_left_out, curve = row[f"{metric}_mm"], row[f"curve_{metric}_mm"]
    axes.plot([sample, error_left_out], [y, y], color=METHOD_COLOURS["fitted"], lw=1.0, zorder=2)
    axes.plot(sample, y, "o", ms=5, mfc="white", mec=METHOD_COLOURS["fitted"], zorder=3)
    axes.plot(error_left_out, y, "o", ms=5, color=METHOD_COLOURS["fitted"], zorder=4)
    axes.plot(curve, y, "^", ms=4.5, color=METHOD_COLOURS["constant_curvature"], zorder=3)
    if floor is not None:
        axes.vlines(floor, y - 0.35, y + 0.35, color=INK, lw=0.9, ls=(0, (2, 1.5)))
    if direct:
        _label_pair(axes, y, row, metric)


def _label_pair(axes: Axes, y: int, row: Row, metric: str) -> None:
    """Name the marks of the first row, the middle ones above it, the outer ones higher still."""
    blue = METHOD_COLOURS["fitted"]
    marks = [("in sample", row[f"in_sample_{metric}_mm"], 7, "right", blue)]
    marks += [("left out", row[f"{metric}_mm"], 7, "left", blue)]
    marks += [("constant curvature", row[f"curve_{metric}_mm"], 15, "center", GREY)]
    if row[f"floor_{metric}_mm"] is not None:
        marks += [("floor", row[f"floor_{metric}_mm"], 15, "center", INK)]
    for words, x, above, side, colour in marks:
        style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 6.5, "ha": side, "color": colour}
        axes.annotate(words, (x, y), xytext=(0, above), **style)


_GROUP_NAMES = {"insertion": "each insertion left out", "specimen": "each specimen left out"}


def summarize(result: AnalysisResult) -> list[str]:
    """Return, for every fit, how much larger the error of left-out insertions is."""
    return [_summarize_fit(row) for row in to_records(result.frames["summary"])]


def lay_out_tables(result: AnalysisResult) -> list[TableLayout]:
    """Return left-out errors beside in-sample errors, and how well left-out insertions were predicted."""
    return [_lay_out_errors(result), _lay_out_coverage(result)]


def _summarize_fit(row: Row) -> str:
    group = f"{medium_name(row['fit']).capitalize()}, {_GROUP_NAMES[row['left_out']]}"
    if row["note"]:
        return f"{group}: {row['note']}."
    return (
        f"{group} ({row['groups']} fits): mean IPE and TE {format_mm(row['ipe_mean_mm'])} and "
        f"{format_mm(row['te_mm'])} mm, in sample {format_mm(row['in_sample_ipe_mean_mm'])} and "
        f"{format_mm(row['in_sample_te_mm'])} mm; noise floor {format_mm(row['floor_ipe_mean_mm'])} and "
        f"{format_mm(row['floor_te_mm'])} mm; a constant curvature, fitted to the same insertions, "
        f"{format_mm(row['curve_ipe_mean_mm'])} and {format_mm(row['curve_te_mm'])} mm."
    )


def _lay_out_errors(result: AnalysisResult) -> TableLayout:
    headings = ("Left out", "In sample", "Gap", "Planned", "Curve", "Floor")
    heads = (
        text_column("Fit"),
        text_column("Left out"),
        TableColumn("Fits"),
        TableColumn("n"),
        text_column("Error"),
    )
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for row in to_records(result.frames["summary"]):
        breaks += [len(rows)] if rows else []
        rows += _fit_rows(row)
    notes = (
        "“Gap” is the error left out minus that in sample, of the same insertions, ± its standard error over "
        "what was left out. “Planned” is left out, with layers from the planned path instead of the measured "
        "crossings. “Curve” is a constant curvature fitted to the same insertions. “Floor” is what perfect "
        "parameters would still show. Pareto k is the largest of all fits.",
    )
    columns = (*heads, *(TableColumn(scoring, "mm") for scoring in headings), TableColumn("Pareto k"))
    caption = "Errors on what was left out, beside those in sample (mean over insertions)."
    return TableLayout("left_out", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _fit_rows(row: Row) -> list[tuple[str, ...]]:
    """Return the lines of one kind of group: IPE and TE, or why there are none."""
    head = (medium_name(row["fit"]), row["left_out"], str(row["groups"]), str(row["insertions"]))
    if row["note"]:
        return [(*head, row["note"], *("",) * 7)]
    k = f"{row['worst_pareto_k']:.2f}"
    k += f" ({row['folds_sampled']} sampled)" if row["folds_sampled"] else ""
    return [
        (*head, "mean IPE", *_error_cells(row, "ipe_mean"), k),
        ("", "", "", "", "TE", *_error_cells(row, "te"), ""),
    ]


def _error_cells(row: Row, metric: str) -> tuple[str, ...]:
    stem = metric.removesuffix("_mean")
    gap = f"{row[f'{stem}_gap_mm']:+.3f} ± {row[f'{stem}_gap_se_mm']:.3f}".replace("-", "−")
    headings = (format_mm(row[f"{scoring}_{metric}_mm"]) for scoring in ("planned", "curve", "floor"))
    return (format_mm(row[f"{metric}_mm"]), format_mm(row[f"in_sample_{metric}_mm"]), gap, *headings)


def _lay_out_coverage(result: AnalysisResult) -> TableLayout:
    rows = []
    for (fit, group), predictions in result.frames["predictive"].groupby(["fit", "left_out"], sort=False):
        rows.append((medium_name(str(fit)), str(group), *format_coverage(predictions)))
    columns = (text_column("Fit"), text_column("Left out"), *COVERAGE_COLUMNS)
    notes = (
        "Tips and whole shapes that fell into the interval predicted for them, by draws of the posterior; in "
        "brackets the 95 % interval of that share. Pareto k of those draws is beside the errors: where it is "
        "above 0.7 the posterior was sampled instead.",
    )
    caption = "How well what was left out was predicted."
    return TableLayout("coverage", caption, columns, tuple(rows), notes=notes)


def draw_figures(result: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the errors in sample and left out, unless nothing could be left out."""
    if (result.frames["summary"]["note"] != "").all():
        return {}
    return {"summary": draw_left_out(result, folder / "summary.pdf")}


def compose_sections(result: AnalysisResult, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the figure, both tables and the method."""
    errors, coverage = lay_out_tables(result)
    caption = (
        "Errors in sample (hollow) and of what was left out (filled), with a constant curvature fitted to "
        "the same insertions (triangles) and the noise floor (dashed)."
    )
    drawn = [document.figure(figures["summary"], caption, result.synthetic)] if "summary" in figures else []
    return [
        document.heading("Errors"),
        *drawn,
        document.table(errors, result.synthetic),
        document.heading("Prediction"),
        document.table(coverage, result.synthetic),
    ]


PAGE = AnalysisPage(summarize, lay_out_tables, draw_figures, compose_sections)
