"""Report of a comparison: predictive density of each candidate against the reference."""

from pathlib import Path

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.inference.sampling.importance import MAX_PARETO_K
from needlefit.mechanics.laws import LAWS
from needlefit.metrics import headline_metrics
from needlefit.reporting import document
from needlefit.reporting.columns import DIGITS
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, plot
from needlefit.reporting.labels import GREEN, GREY, INK, METHOD_COLOURS, candidate_name
from needlefit.reporting.number_format import (
    format_mm,
    join_metrics,
    join_words,
)
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.comparison.schema import ComparisonRecord
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.verdict import Verdict, headline_fault

_VERDICT_COLOURS = {
    "ahead": GREEN,
    "behind": METHOD_COLOURS["hand_tuned"],
    "tie": GREY,
}


def draw_candidates(result: Run, path: Path) -> Path:
    """Draw one row for each candidate except the reference."""
    frame = result.frames["group_differences"].assign(held_out=name_held_out(result), origin=result.origin)
    return plot(path, frame, _paint_candidates)


def name_held_out(result: Run) -> str:
    """Return the name of the unit held out together: a group of repeats if there are any, else a needle."""
    differences = result.frames["differences"]
    return (
        "group of repeats"
        if differences["group"].nunique() < differences["insertion"].nunique()
        else "needle"
    )


def _paint_candidates(frame: pd.DataFrame) -> Figure:
    rows = list(dict.fromkeys(frame["method"]))
    figure = Figure(figsize=(TEXT_WIDTH_IN, 0.9 + 0.36 * len(rows)))
    axes = figure.add_subplot()
    axes.axvline(0, color=INK, lw=0.8)
    for y, name in enumerate(rows):
        _paint_candidate(axes, y, to_records(frame[frame["method"] == name]))
    axes.set_xscale("symlog", linthresh=1.0)
    _set_ticks(axes)
    axes.set_xlabel(
        f"log predictive density minus that of the reference, each {frame['held_out'].iloc[0]} (symmetric "
        "logarithm)"
    )
    axes.set_yticks(range(len(rows)), [candidate_name(name) for name in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    draw_grid(axes, "x")
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


def summarize(result: Run) -> list[str]:
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


_VERDICT_OPENINGS = {
    "ahead": "worse than",
    "behind": "better than",
    "tie": "no significant difference from",
}


def judge(result: Run) -> list[Verdict]:
    """Return how the reference predicts held-out needles beside every other candidate."""
    rows = to_records(result.frames["comparison"])
    own = next(row for row in rows if row["verdict"] == "reference")
    names = {
        verdict: [_name_candidate(row) for row in rows if row["verdict"] == verdict]
        for verdict in _VERDICT_OPENINGS
    }
    parts = [
        f"{words} {join_words(names[verdict])}"
        for verdict, words in _VERDICT_OPENINGS.items()
        if names[verdict]
    ]
    numbers = {"te_mm": own["te_mm"], "floor_te_mm": own["floor_te_mm"], "insertions": own["insertions"]}
    name = _name_candidate(own)
    sentence = f"{name[:1].upper()}{name[1:]} on {own['insertions']} held-out insertions: {'; '.join(parts)}"
    return [Verdict(sentence, "warn" if names["ahead"] else "pass", "", numbers)]


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
        f"Log predictive density of {own['insertions']} held-out needles minus that of the "
        f"{_name_candidate(own)}, ± standard error over {own['groups']} {_pluralize(one)}; "
        f"{'; '.join(parts)}."
    )


def _describe_laws(own: Row, others: list[Row]) -> str:
    """Return whether the law of the tissue makes a difference."""
    by = {row["method"]: row["verdict"] for row in others}
    laws = [by[name] for name in by if name in LAWS]
    if not laws or own["method"] != "ogden":
        return f"The reference is {_name_candidate(own)}."
    if all(one == "behind" for one in laws):
        return "The nonlinear tissue law is needed here: Ogden’s law predicts better than every other law."
    if all(one == "tie" for one in laws):
        return "The nonlinear tissue law is not needed here: the tissue laws do not differ significantly."
    return (
        "The need for the nonlinear tissue law is not shown: Ogden’s law is not better than every other law."
    )


def _describe_errors(own: Row, others: list[Row]) -> str:
    digits = 3
    parts = [f"{_name_candidate(row)} {format_mm(row['te_mm'], digits)}" for row in (own, *others)]
    floor = own["floor_te_mm"]
    known = "" if floor is None else f"; noise floor {format_mm(floor, digits)}"
    return f"Mean held-out tip error, mm: {', '.join(parts)}{known}."


def _describe_limits(own: Row, result: Run) -> str:
    record = result.record
    assert isinstance(record, ComparisonRecord)
    return (
        f"A difference below two standard errors is not significant. The {own['groups']} "
        f"{_pluralize(name_held_out(result))} are few and share the fits of {record.folds} folds, so the "
        "standard error is too small."
    )


def _pluralize(one: str) -> str:
    return "groups of repeats" if one == "group of repeats" else f"{one}s"


def _name_candidate(row: Row) -> str:
    return candidate_name(row["method"])


def _format_difference(row: Row) -> str:
    if row["difference"] is None:
        return "no density"
    digits = 1 if abs(row["difference"]) < 1000 else 0
    return f"{row['difference']:+z.{digits}f} ± {row['difference_se']:.{digits}f}".replace("-", "−")


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return a table with one row for each candidate."""
    rows = to_records(result.frames["comparison"])
    errors = (metric.name for metric in headline_metrics())
    columns = ("method", "density_difference", "verdict", "draws_se", *errors, "noise_scale", "pareto_k")
    cells = [
        {
            **row,
            "method": _name_candidate(row),
            "reference": row["verdict"] == "reference",
            "density_difference": "0" if row["verdict"] == "reference" else _format_difference(row),
            DIGITS: 3,
        }
        for row in rows
    ]
    floors = {one.name: rows[0][f"floor_{one.name}"] for one in headline_metrics() if one.has_floor}
    names = join_words([one.label for one in headline_metrics()])
    notes = (
        "“Δ log density”: sum over held-out needles minus that of the reference, ± its standard error over "
        f"{_pluralize(name_held_out(result))}, with the Monte Carlo error. “Draws’ error”: Monte Carlo "
        "error of a candidate’s own sum. “Pareto k”: the largest of the importance weights; up to "
        f"{MAX_PARETO_K} that error is reliable. {names}: of each candidate’s posterior mode along the "
        f"planned path; noise floor: {join_metrics(floors, 3)}. “Noise factor” multiplies the stated errors "
        "of points and pose; a factor above 1 is model error.",
    )
    caption = "Candidates on held-out needles."
    return [Table("comparison", caption, cells, columns, strong="reference", notes=notes).lay_out()]


def draw_figures(result: Run, folder: Path) -> dict[str, Path]:
    """Draw the differences of each group and their mean; the frame `comparison` contains the drawn values."""
    return {"group_differences": draw_candidates(result, folder / "group_differences.pdf")}


def compose_sections(result: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: figure, table and method."""
    (table,) = lay_out_tables(result)
    caption = (
        f"Log predictive density of each held-out {name_held_out(result)} minus that of the reference "
        "(dots), and mean ± two standard errors (diamonds). The scale is linear between −1 and 1 and "
        "logarithmic outside. Left of zero the reference predicts better."
    )
    return [
        document.heading("Comparison"),
        document.figure(figures["group_differences"], caption),
        document.table(table),
        document.heading("Method"),
        document.text(
            "Each candidate was fitted to all folds but one and predicted that one. The score is the joint "
            "density of all points of a needle, averaged over the posterior, with the stated errors of "
            "points, pose and depths and the layers along the planned path. This average is the marginal "
            "likelihood of the fitted needles with the held-out one, divided by that of the fitted ones "
            "alone; both are computed by importance sampling about their modes. Each candidate estimates "
            "one factor of the stated errors of points and pose, so that model error is penalised alike. "
            "Alignment of free shapes takes the same degrees of freedom from all."
        ),
    ]


def headline(fault: str) -> str:
    """Return the headline of a fault."""
    return "CONTROL NOT DETECTED" if "is not found ahead of" in fault else headline_fault(fault)


REPORT = StudyReport(
    summarize, lay_out_tables, draw_figures, compose_sections, judge=judge, headline=headline
)
