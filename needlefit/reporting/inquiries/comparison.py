"""What is told of a comparison: by how much each candidate foretells better or worse than the reference."""

from pathlib import Path

from needlefit.inference.importance.pareto import MAX_PARETO_K
from needlefit.reporting import document
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block
from needlefit.reporting.figures.candidates import draw_candidates, held_out
from needlefit.reporting.inquiries.page import Figures, Page
from needlefit.reporting.names import CANDIDATE_NAMES
from needlefit.reporting.numbers import fixed, number, typeset
from needlefit.reporting.tables import Row, records
from needlefit.schemas.analyses import ComparisonRecord
from needlefit.validation.analyses.runner import AnalysisResult

_STANDS = {"behind": "behind it", "tie": "not told apart from it", "ahead": "ahead of it"}


def said(answer: AnalysisResult) -> list[str]:
    """Return who foretells better than whom, and what it means."""
    rows = records(answer.frames["comparison"])
    own = next(row for row in rows if row["verdict"] == "reference")
    others = [row for row in rows if row["verdict"] != "reference"]
    return [
        _ranked(own, others, held_out(answer)),
        _tissue(own, others),
        _errors(own, others),
        _limits(own, answer),
    ]


def _ranked(own: Row, others: list[Row], one: str) -> str:
    parts = []
    for verdict, words in _STANDS.items():
        found = [row for row in others if row["verdict"] == verdict]
        if found:
            parts.append(f"{words}: " + ", ".join(f"{_name(row)} ({_difference(row)})" for row in found))
    return (
        f"Log predictive density of {own['insertions']} held-out needles against the {_name(own)}, ± "
        f"standard error over {own['groups']} {_plural(one)}; {'; '.join(parts)}."
    )


def _tissue(own: Row, others: list[Row]) -> str:
    """Return whether the law of the tissue makes a difference."""
    by = {row["candidate"]: row["verdict"] for row in others}
    laws = [by[name] for name in ("linear", "neo_hookean") if name in by]
    if not laws or own["candidate"] != "ogden":
        return f"The reference is {_name(own)}."
    if all(one == "behind" for one in laws):
        return "The nonlinear tissue earns its place here: Ogden’s law is ahead of every other law."
    if all(one == "tie" for one in laws):
        return "The nonlinear tissue earns no place here: the laws of the tissue cannot be told apart."
    return "The nonlinear tissue earns no clear place here: Ogden’s law is not ahead of every other law."


def _errors(own: Row, others: list[Row]) -> str:
    digits = 3
    parts = [f"{_name(row)} {fixed(row['te_mm'], digits)}" for row in (own, *others)]
    floor = own["floor_te_mm"]
    known = "" if floor is None else f"; noise floor {fixed(floor, digits)}"
    return f"Mean held-out tip error, mm: {', '.join(parts)}{known}."


def _limits(own: Row, answer: AnalysisResult) -> str:
    record = answer.record
    assert isinstance(record, ComparisonRecord)
    return (
        f"A difference of less than two standard errors is called a tie. The {own['groups']} "
        f"{_plural(held_out(answer))} share the fits of {record.folds} folds, and are few, so that the "
        "standard error is rather too small."
    )


def _plural(one: str) -> str:
    return "groups of repeats" if one == "group of repeats" else f"{one}s"


def _name(row: Row) -> str:
    return CANDIDATE_NAMES[row["candidate"]]


def _difference(row: Row) -> str:
    if row["difference"] is None:
        return "no density"
    digits = 1 if abs(row["difference"]) < 1000 else 0
    return f"{row['difference']:+.{digits}f} ± {row['difference_se']:.{digits}f}".replace("-", "−")


def layouts(answer: AnalysisResult) -> list[Display]:
    """Return one row for each candidate."""
    rows = records(answer.frames["comparison"])
    columns = (
        *(text("Candidate"), Column("Δ log density"), text("Verdict"), Column("Draws’ error")),
        *(Column("TE", "mm"), Column("IPE", "mm"), Column("Noise factor"), Column("Pareto k")),
    )
    cells = tuple(_cells(row) for row in rows)
    strong = tuple(n for n, row in enumerate(rows) if row["verdict"] == "reference")
    te, ipe = (fixed(rows[0][f"floor_{name}_mm"], 3) for name in ("te", "ipe_mean"))
    notes = (
        "“Δ log density”: summed over held-out needles, less the reference’s, ± its standard error over "
        f"{_plural(held_out(answer))}, the draws’ in it. “Draws’ error” is what the draws of both evidences "
        "leave open of a candidate’s own sum; “Pareto k” is the largest of their weights’, and up to "
        f"{MAX_PARETO_K} that error can be trusted. TE and IPE are those of each candidate’s best curve "
        f"along "
        f"the planned path; noise floor: TE {te}, IPE {ipe} mm. “Noise factor” multiplies the stated errors "
        "of points and pose: what a candidate misses.",
    )
    caption = "Every candidate on needles that it was not fitted to."
    return [Display("against", caption, columns, cells, (), strong, notes)]


def _cells(row: Row) -> tuple[str, ...]:
    reference = row["verdict"] == "reference"
    return (
        _name(row),
        "0" if reference else _difference(row),
        row["verdict"],
        fixed(row["draws_se"], 2),
        fixed(row["te_mm"], 3),
        fixed(row["ipe_mean_mm"], 3),
        typeset(number(row["noise_scale"])),
        fixed(row["worst_pareto_k"]),
    )


def draw_figures(answer: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the differences, group by group and their mean; the frame `contest` holds what is drawn."""
    return {"group_differences": draw_candidates(answer, folder / "group_differences.pdf")}


def story(answer: AnalysisResult, figures: Figures) -> list[Block]:
    """Return figure, table and what was done."""
    (table,) = layouts(answer)
    caption = (
        f"Log predictive density of each held-out {held_out(answer)} less the reference’s (dots), and their "
        "mean with two standard errors (diamonds), on a scale that is linear between −1 and 1 and "
        "logarithmic beyond. Left of zero the reference foretells better."
    )
    return [
        document.heading("Comparison"),
        document.figure(figures["group_differences"], caption, answer.synthetic),
        document.table(table, answer.synthetic),
        document.heading("What was done"),
        document.text(
            "Every candidate was fitted to all folds but one and foretold that one: by the density of all "
            "points of a needle together, averaged over its posterior, with the stated errors of points, "
            "pose and depths, through the layers that its fit meets on the planned path. The average is the "
            "evidence of the fitted needles with the one held out, divided by that of the fitted ones alone; "
            "each is an integral by importance about its own peaks. Stated errors "
            "of points and pose are multiplied by one factor that each candidate estimates, so that what it "
            "misses costs it the same way. Alignment of free shapes takes the same degrees of freedom from "
            "all."
        ),
    ]


PAGE = Page(said, layouts, draw_figures, story)
