"""Report of a cross-validation: insertions and specimens left out in turn."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needlefit.inference.baselines import BASELINES
from needlefit.metrics import METRICS, headline_metrics
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, plot
from needlefit.reporting.labels import GREEN, GREY, INK, METHOD_COLOURS, medium_name, method_name
from needlefit.reporting.number_format import join_metrics, join_words
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.coverage import COVERAGE_COLUMNS, tabulate_coverage
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.verdict import BestBaseline, Verdict, judge_errors


def draw_left_out(result: Run, path: Path) -> Path:
    """Draw mean IPE and TE in sample and left out, with the noise floor and the constant-curvature
    baseline.
    """
    return plot(path, result.frames["summary"].assign(origin=result.origin), _paint_left_out)


def _paint_left_out(frame: pd.DataFrame) -> Figure:
    metrics = [one for one in headline_metrics() if (frame["metric"] == one.name).any()]
    shown = frame[frame["note"].fillna("") == ""]
    figure = Figure(figsize=(TEXT_WIDTH_IN, 1.0 + 0.36 * len(shown) / len(metrics)))
    panels = np.atleast_1d(figure.subplots(1, len(metrics), sharey=True))
    left = panels[0]
    for axes, metric in zip(panels, metrics, strict=True):
        rows = to_records(shown[shown["metric"] == metric.name])
        for y, row in enumerate(rows):
            _paint_pair(axes, y, row, direct=y == 0)
        axes.set_xlabel(f"{metric.label}, mean over insertions ({metric.unit})")
        axes.set_xlim(0, None)
        draw_grid(axes, "x")
        axes.tick_params(axis="y", length=0)
    labels = [f"{medium_name(row['fit'])}, {row['left_out']}s ({row['groups']})" for row in rows]
    left.set_yticks(range(len(rows)), labels)
    left.set_ylim(len(rows) - 0.5, -1.1)
    return figure


def _paint_pair(axes: Axes, y: int, row: Row, direct: bool) -> None:
    """Draw one row: noise floor, in sample, left out, and the curve without a tissue model."""
    floor, sample, error_left_out, curve = (
        row[name] for name in ("floor", "in_sample", "value", "baseline_value")
    )
    axes.plot([sample, error_left_out], [y, y], color=METHOD_COLOURS["fitted"], lw=1.0, zorder=2)
    axes.plot(sample, y, "o", ms=5, mfc="white", mec=METHOD_COLOURS["fitted"], zorder=3)
    axes.plot(error_left_out, y, "o", ms=5, color=METHOD_COLOURS["fitted"], zorder=4)
    axes.plot(curve, y, "^", ms=4.5, color=GREEN, zorder=3)
    if floor is not None:
        axes.vlines(floor, y - 0.35, y + 0.35, color=INK, lw=0.9, ls=(0, (2, 1.5)))
    if direct:
        _label_pair(axes, y, row)


def _label_pair(axes: Axes, y: int, row: Row) -> None:
    """Name the marks of the first row, the middle ones above it, the outer ones higher still."""
    blue = METHOD_COLOURS["fitted"]
    marks = [("in sample", row["in_sample"], 7, "right", blue)]
    marks += [("left out", row["value"], 7, "left", blue)]
    marks += [("constant curvature", row["baseline_value"], 15, "center", GREY)]
    if row["floor"] is not None:
        marks += [("floor", row["floor"], 15, "center", INK)]
    for words, x, above, side, colour in marks:
        style: dict[str, Any] = {"textcoords": "offset points", "fontsize": 6.5, "ha": side, "color": colour}
        axes.annotate(words, (x, y), xytext=(0, above), **style)


_TE = "te_mm"
_GROUP_NAMES = {"insertion": "each insertion left out", "specimen": "each specimen left out"}


def summarize(result: Run) -> list[str]:
    """Return, for every fit, how much larger the error of left-out insertions is."""
    return [_summarize_fit(rows) for rows in _list_fits(result)]


def judge(result: Run) -> list[Verdict]:
    """Return a verdict for every fit and kind of group left out, beside the best baseline."""
    return [_judge_fit(result, rows) for rows in _list_fits(result)]


def _judge_fit(result: Run, rows: list[Row]) -> Verdict:
    group = f"{medium_name(rows[0]['fit'])}, {_GROUP_NAMES[rows[0]['left_out']]}"
    if rows[0]["note"]:
        return Verdict(f"{group.capitalize()}: {rows[0]['note']}", "warn", group)
    row = next(row for row in rows if row["metric"] == _TE)
    ratio = row["value"] / row["floor"] if row["floor"] else None
    numbers = {_TE: row["value"], "floor_te_mm": row["floor"], "te_over_floor": ratio}
    numbers |= {"in_sample_te_mm": row["in_sample"], "insertions": row["insertions"]}
    best = _compare_best(result, row)
    numbers |= {"baseline_te_mm": best.error_mm if best else None}
    count = int(row["insertions"])
    found = judge_errors(group, row["value"], ratio, best, count, reliable=result.reliable)
    return replace(found, group=group, numbers=numbers)


def _compare_best(result: Run, row: Row) -> BestBaseline | None:
    """Return the baseline with the smallest error left out, and its paired difference from the fit."""
    paired = [
        one
        for one in to_records(result.frames["paired"])
        if all(one[key] == row[key] for key in ("fit", "left_out", "metric")) and one["method"] in BASELINES
    ]
    best = min(paired, key=lambda one: float(one["value"]), default=None)
    if best is None or best["low"] is None:
        return None
    verdict: Literal["better", "worse", "tie"] = (
        "worse" if best["low"] > 0 else "better" if best["high"] < 0 else "tie"
    )
    return BestBaseline(BASELINES[best["method"]].description, best["value"], verdict)


def _list_fits(result: Run) -> list[list[Row]]:
    """Return the rows of every fit and kind of group: one for each metric."""
    return [to_records(rows) for _, rows in result.frames["summary"].groupby(["fit", "left_out"], sort=False)]


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return errors left out and in sample, of the fit and of curves, and how well what is left out was
    predicted.
    """
    return [_lay_out_errors(result), _lay_out_paired(result), _lay_out_coverage(result)]


def _summarize_fit(rows: list[Row]) -> str:
    row = rows[0]
    group = f"{medium_name(row['fit']).capitalize()}, {_GROUP_NAMES[row['left_out']]}"
    if row["note"]:
        return f"{group}: {row['note']}."

    def join(column: str) -> str:
        return join_metrics({one["metric"]: one[column] for one in rows})

    names = join_words([METRICS[one["metric"]].label for one in rows])
    return (
        f"{group} ({row['groups']} fits): mean {names} {join('value')}, in sample {join('in_sample')}; noise "
        f"floor {join('floor')}; a constant curvature, fitted to the same insertions, "
        f"{join('baseline_value')}."
    )


def _lay_out_errors(result: Run) -> TableLayout:
    rows = [one for fit in _list_fits(result) for one in _describe_fit(fit)]
    columns = (
        *("fit", "left_out", "groups", "insertions", "metric", "error_left_out", "in_sample", "gap_left_out"),
        *("planned", "baseline_value", "floor", "pareto_k_sampled"),
    )
    notes = (
        "“Gap”: left-out error minus in-sample error of the same insertions, ± standard error over groups. "
        "“Planned”: left-out error with layer depths along the planned path instead of the measured "
        "crossings. “Curve”: constant curvature fitted to the same insertions. “Floor”: noise floor, the "
        "error of perfect parameters. “Pareto k”: the largest of all fits.",
    )
    caption = "Errors of left-out insertions beside in-sample errors (mean over insertions)."
    table = Table("left_out", caption, rows, columns, groups=("fit", "left_out"), heads=4, notes=notes)
    return table.lay_out()


_ERRORS = (
    *("error_left_out", "in_sample", "difference", "difference_se", "planned", "baseline_value", "floor"),
    *("pareto_k", "sampled"),
)


def _describe_fit(rows: list[Row]) -> Iterator[Row]:
    """Yield the lines of one kind of group: one for each metric, or why there are none."""
    about = {"fit": medium_name(rows[0]["fit"])}
    if rows[0]["note"]:
        yield {**rows[0], **dict.fromkeys(_ERRORS, ""), **about, "metric": rows[0]["note"]}
        return
    for number, row in enumerate(rows):
        once = {"pareto_k": row["pareto_k"] if not number else "", "sampled": row["sampled"] or None}
        yield {**row, **about, **once, "error_left_out": row["value"]}


def _lay_out_paired(result: Run) -> TableLayout:
    rows = [
        {
            **row,
            **{"fit": medium_name(row["fit"]), "method": method_name(row["method"])},
            **{"error_left_out": row["value"]},
            **({"low": None, "high": None, "better": ""} if row["method"] == "fitted" else {}),
        }
        for row in to_records(result.frames["paired"])
        if row["metric"] == headline_metrics()[0].name
    ]
    columns = ("fit", "left_out", "method", "groups", "metric", "error_left_out", "difference_range")
    notes = (
        "“95 %”: confidence interval of the method’s error minus that of the fit (Student); each left-out "
        "group is one trial.",
    )
    caption = "Errors of left-out insertions: the fit and the baselines."
    return Table("paired", caption, rows, columns, groups=("fit", "left_out"), heads=4, notes=notes).lay_out()


def _lay_out_coverage(result: Run) -> TableLayout:
    rows = [
        {"fit": medium_name(str(fit)), "left_out": group, **tabulate_coverage(predictions)}
        for (fit, group), predictions in result.frames["predictive"].groupby(["fit", "left_out"], sort=False)
    ]
    notes = (
        "Number of left-out insertions whose tip (whole shape) lies inside its predictive interval (band). "
        "Brackets: 95 % confidence interval of the share. Width: median width of the 95 % intervals of tips. "
        "Where Pareto k is above 0.7, the posterior was sampled.",
    )
    caption = "Coverage of the predictive intervals on left-out insertions."
    return Table("coverage", caption, rows, ("fit", "left_out", *COVERAGE_COLUMNS), notes=notes).lay_out()


def draw_figures(result: Run, folder: Path) -> dict[str, Path]:
    """Draw the errors in sample and left out, unless nothing could be left out."""
    if (result.frames["summary"]["note"] != "").all():
        return {}
    return {"summary": draw_left_out(result, folder / "summary.pdf")}


def compose_sections(result: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the figure, both tables and the method."""
    errors, paired, coverage = lay_out_tables(result)
    caption = (
        "In-sample errors (hollow), left-out errors (filled), constant curvature fitted to the same "
        "insertions (triangles), noise floor (dashed)."
    )
    drawn = [document.figure(figures["summary"], caption)] if "summary" in figures else []
    return [
        document.heading("Errors"),
        *drawn,
        document.table(errors),
        document.table(paired),
        document.heading("Prediction"),
        document.table(coverage),
    ]


REPORT = StudyReport(summarize, lay_out_tables, draw_figures, compose_sections, judge=judge)
