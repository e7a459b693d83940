"""Report of a comparison: predictive density of each candidate against the reference."""

from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.inference.importance.pareto import MAX_PARETO_K
from needlefit.reporting import document
from needlefit.reporting.analyses.page import AnalysisPage, FigurePaths
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, is_synthetic, label_origin, plot
from needlefit.reporting.labels import CANDIDATE_NAMES, GREY, INK, METHOD_COLOURS
from needlefit.reporting.number_format import format_mm, format_number, typeset
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.schemas.analyses import ComparisonRecord
from needlefit.validation.analyses.runner import AnalysisResult

_VERDICT_COLOURS = {
    "ahead": METHOD_COLOURS["constant_curvature"],
    "behind": METHOD_COLOURS["hand_tuned"],
    "tie": GREY,
}


def draw_candidates(result: AnalysisResult, path: Path) -> Path:
    """Draw one row for each candidate except the reference."""
    frame = result.frames["group_differences"].assign(held_out=name_held_out(result), origin=result.origin)
    return plot(path, frame, _paint_candidates)


def name_held_out(result: AnalysisResult) -> str:
    """Return the name of the unit held out together: a group of repeats if there are any, else a needle."""
    differences = result.frames["differences"]
    return (
        "group of repeats"
        if differences["group"].nunique() < differences["insertion"].nunique()
        else "needle"
    )


def _paint_candidates(frame: pd.DataFrame) -> Figure:
    rows = list(dict.fromkeys(frame["candidate"]))
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.9 + 0.36 * len(rows)))
    axes = figure.add_subplot()
    axes.axvline(0, color=INK, lw=0.8)
    for y, name in enumerate(rows):
        _paint_candidate(axes, y, to_records(frame[frame["candidate"] == name]))
    axes.set_xscale("symlog", linthresh=1.0)
    _set_ticks(axes)
    axes.set_xlabel(
        f"log predictive density less the reference’s, each {frame['held_out'].iloc[0]} (symmetric logarithm)"
    )
    axes.set_yticks(range(len(rows)), [CANDIDATE_NAMES[name] for name in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    draw_grid(axes, "x")
    label_origin(figure, is_synthetic(frame))
    return figure


def _paint_candidate(axes: Axes, y: int, rows: list[Row]) -> None:
    """Draw needles or groups, and their mean with two standard errors."""
    (mean,) = (row for row in rows if row["group"] == "mean")
    colour = _VERDICT_COLOURS[mean["verdict"]]
    each = [row["difference"] for row in rows if row["group"] != "mean"]
    axes.plot(each, [y + 0.2] * len(each), "o", ms=2.5, color=GREY, alpha=0.7, mec="none")
    axes.plot([mean["low"], mean["high"]], [y, y], color=colour, lw=1.6)
    axes.plot(mean["difference"], y, "D", ms=5, color=colour, mec="white", mew=0.5, zorder=4)
    axes.annotate(
        mean["verdict"], (1.0, y), xycoords=("axes fraction", "data"), xytext=(4, 0),
        textcoords="offset points", va="center", color=colour,
    )  # fmt: skip


def _set_ticks(axes: Axes) -> None:
    """Write plain numbers at powers of ten."""
    low, high = axes.get_xlim()
    powers = [10.0**k for k in range(6)]
    ticks = [t for t in (*(-p for p in powers[::-1]), 0.0, *powers) if low <= t <= high]
    axes.set_xticks(ticks, [f"{tick:g}".replace("-", "−") for tick in ticks])
    axes.set_xticks([], minor=True)


_VERDICT_NAMES = {"behind": "behind it", "tie": "not significantly different from it", "ahead": "ahead of it"}


def summarize(result: AnalysisResult) -> list[str]:
    """Return sentences: which candidates predict better than others, and what that means."""
    rows = to_records(result.frames["comparison"])
    own = next(row for row in rows if row["verdict"] == "reference")
    others = [row for row in rows if row["verdict"] != "reference"]
    return [
        _describe_ranking(own, others, name_held_out(result)),
        _describe_laws(own, others),
        _describe_errors(own, others),
        _describe_limits(own, result),
    ]


def _describe_ranking(own: Row, others: list[Row], one: str) -> str:
    parts = []
    for verdict, words in _VERDICT_NAMES.items():
        found = [row for row in others if row["verdict"] == verdict]
        if found:
            parts.append(
                f"{words}: "
                + ", ".join(f"{_name_candidate(row)} ({_format_difference(row)})" for row in found)
            )
    return (
        f"Log predictive density of {own['insertions']} held-out needles against the {_name_candidate(own)}, "
        f"± "
        f"standard error over {own['groups']} {_pluralize(one)}; {'; '.join(parts)}."
    )


def _describe_laws(own: Row, others: list[Row]) -> str:
    """Return whether the law of the tissue makes a difference."""
    by = {row["candidate"]: row["verdict"] for row in others}
    laws = [by[name] for name in ("linear", "neo_hookean") if name in by]
    if not laws or own["candidate"] != "ogden":
        return f"The reference is {_name_candidate(own)}."
    if all(one == "behind" for one in laws):
        return "The nonlinear tissue earns its place here: Ogden’s law is ahead of every other law."
    if all(one == "tie" for one in laws):
        return "The nonlinear tissue earns no place here: the laws of the tissue cannot be told apart."
    return "The nonlinear tissue earns no clear place here: Ogden’s law is not ahead of every other law."


def _describe_errors(own: Row, others: list[Row]) -> str:
    digits = 3
    parts = [f"{_name_candidate(row)} {format_mm(row['te_mm'], digits)}" for row in (own, *others)]
    floor = own["floor_te_mm"]
    known = "" if floor is None else f"; noise floor {format_mm(floor, digits)}"
    return f"Mean held-out tip error, mm: {', '.join(parts)}{known}."


def _describe_limits(own: Row, result: AnalysisResult) -> str:
    record = result.record
    assert isinstance(record, ComparisonRecord)
    return (
        f"A difference of less than two standard errors is called a tie. The {own['groups']} "
        f"{_pluralize(name_held_out(result))} share the fits of {record.folds} folds, and are few, so that "
        f"the "
        "standard error is rather too small."
    )


def _pluralize(one: str) -> str:
    return "groups of repeats" if one == "group of repeats" else f"{one}s"


def _name_candidate(row: Row) -> str:
    return CANDIDATE_NAMES[row["candidate"]]


def _format_difference(row: Row) -> str:
    if row["difference"] is None:
        return "no density"
    digits = 1 if abs(row["difference"]) < 1000 else 0
    return f"{row['difference']:+.{digits}f} ± {row['difference_se']:.{digits}f}".replace("-", "−")


def lay_out_tables(result: AnalysisResult) -> list[TableLayout]:
    """Return a table with one row for each candidate."""
    rows = to_records(result.frames["comparison"])
    columns = (
        *(
            text_column("Candidate"),
            TableColumn("Δ log density"),
            text_column("Verdict"),
            TableColumn("Draws’ error"),
        ),
        *(
            TableColumn("TE", "mm"),
            TableColumn("IPE", "mm"),
            TableColumn("Noise factor"),
            TableColumn("Pareto k"),
        ),
    )
    cells = tuple(_candidate_cells(row) for row in rows)
    strong = tuple(n for n, row in enumerate(rows) if row["verdict"] == "reference")
    te, ipe = (format_mm(rows[0][f"floor_{name}_mm"], 3) for name in ("te", "ipe_mean"))
    notes = (
        "“Δ log density”: summed over held-out needles, less the reference’s, ± its standard error over "
        f"{_pluralize(name_held_out(result))}, the draws’ in it. “Draws’ error” is what the draws of both "
        f"evidences "
        "leave open of a candidate’s own sum; “Pareto k” is the largest of their weights’, and up to "
        f"{MAX_PARETO_K} that error can be trusted. TE and IPE are those of each candidate’s best curve "
        f"along "
        f"the planned path; noise floor: TE {te}, IPE {ipe} mm. “Noise factor” multiplies the stated errors "
        "of points and pose: what a candidate misses.",
    )
    caption = "Every candidate on needles that it was not fitted to."
    return [TableLayout("comparison", caption, columns, cells, (), strong, notes)]


def _candidate_cells(row: Row) -> tuple[str, ...]:
    reference = row["verdict"] == "reference"
    return (
        _name_candidate(row),
        "0" if reference else _format_difference(row),
        row["verdict"],
        format_mm(row["draws_se"], 2),
        format_mm(row["te_mm"], 3),
        format_mm(row["ipe_mean_mm"], 3),
        typeset(format_number(row["noise_scale"])),
        format_mm(row["worst_pareto_k"]),
    )


def draw_figures(result: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the differences of each group and their mean; the frame `comparison` contains the drawn values."""
    return {"group_differences": draw_candidates(result, folder / "group_differences.pdf")}


def compose_sections(result: AnalysisResult, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: figure, table and method."""
    (table,) = lay_out_tables(result)
    caption = (
        f"Log predictive density of each held-out {name_held_out(result)} less the reference’s (dots), and "
        f"their "
        "mean with two standard errors (diamonds), on a scale that is linear between −1 and 1 and "
        "logarithmic beyond. Left of zero the reference predicts better."
    )
    return [
        document.heading("Comparison"),
        document.figure(figures["group_differences"], caption, result.synthetic),
        document.table(table, result.synthetic),
        document.heading("What was done"),
        document.text(
            "Every candidate was fitted to all folds but one and predicted that one: by the density of all "
            "points of a needle together, averaged over its posterior, with the stated errors of points, "
            "pose and depths, through the layers that its fit meets on the planned path. The average is the "
            "evidence of the fitted needles with the one held out, divided by that of the fitted ones alone; "
            "each is an integral by importance about its own peaks. Stated errors "
            "of points and pose are multiplied by one factor that each candidate estimates, so that what it "
            "misses costs it the same way. Alignment of free shapes takes the same degrees of freedom from "
            "all."
        ),
    ]


PAGE = AnalysisPage(summarize, lay_out_tables, draw_figures, compose_sections)
