"""What is told of insertions and specimens left out in turn."""

from pathlib import Path

from needlefit.reporting import document
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block
from needlefit.reporting.figures.left_out import draw_left_out
from needlefit.reporting.foretold import TOLD, told_cells
from needlefit.reporting.inquiries.page import Figures, Page
from needlefit.reporting.names import medium_name
from needlefit.reporting.numbers import fixed
from needlefit.reporting.tables import Row, records
from needlefit.validation.analyses.runner import AnalysisResult

_NAMES = {"insertion": "each insertion left out", "specimen": "each specimen left out"}


def said(answer: AnalysisResult) -> list[str]:
    """Return, for every fit, what leaving out added to the error."""
    return [_said(row) for row in records(answer.frames["summary"])]


def layouts(answer: AnalysisResult) -> list[Display]:
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


def _errors(answer: AnalysisResult) -> Display:
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


def _foretold(answer: AnalysisResult) -> Display:
    rows = []
    for (fit, what), told in answer.frames["predictive"].groupby(["fit", "left_out"], sort=False):
        rows.append((medium_name(str(fit)), str(what), *told_cells(told)))
    columns = (text("Fit"), text("Left out"), *TOLD)
    notes = (
        "Tips and whole shapes that fell into the interval foretold for them, by draws of the posterior; in "
        "brackets the 95 % interval of that share. Pareto k of those draws is beside the errors: where it is "
        "above 0.7 the posterior was sampled instead.",
    )
    caption = "How well what was left out was foretold."
    return Display("foretold", caption, columns, tuple(rows), notes=notes)


def _draw(answer: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the errors in sample and left out, if anything could be left out."""
    if (answer.frames["summary"]["note"] != "").all():
        return {}
    return {"summary": draw_left_out(answer, folder / "summary.pdf")}


def story(answer: AnalysisResult, figures: Figures) -> list[Block]:
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


PAGE = Page(said, layouts, _draw, story)
