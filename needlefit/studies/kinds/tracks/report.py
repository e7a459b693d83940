"""The report of a study of tip tracks: tables, sentences, figure."""

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from needlefit.inference.baselines import BASELINES
from needlefit.project.result_warnings import ResultWarning
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.labels import medium_name, method_name
from needlefit.reporting.number_format import choose_printed_unit
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.csv_tables import TableSchema
from needlefit.studies.kinds.tracks.figures import draw_tracks
from needlefit.studies.kinds.tracks.results import list_track_methods
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.run_differences import Difference, TableComparison, compare_means
from needlefit.studies.verdict import Status, Verdict

_MEASURE_HEADINGS = {"rms_mm": "Error", "aligned_rms_mm": "Shape"}
"""The measures of `summary.MEASURES` that the table of scores shows."""

_PARAMETER_NOTES = (
    "Percentiles of the posterior. “SD ratio”: posterior SD / prior SD, in ln; near 1 the percentiles are "
    "those of the prior.",
    "Determined: a small SD of the draws that stays small with ties loosened and a model error, no bound "
    "reached, and all equally good starts agree.",
    "Moduli are for the needle stiffness that the dataset assumes: the runs determine μ / EI.",
)
_SCORE_NOTES = (
    "“Error”: root mean square error of the predictive median over the scored readings, mean over runs. The "
    "pose of each run in the tracker’s frame comes from its own readings up to {placed:g} mm and from the "
    "slopes of the fitted runs, for all baselines alike.",
    "“Shape”: the error after the best shift and slope of the scored readings are removed; errors of the "
    "frame do not count.",
    "Δ: method minus fit; brackets: 95 % confidence interval over runs (Student). Runs into one phantom "
    "share a fit: the interval is for further runs into it.",
)
_COVERAGE_NOTES = (
    "Share of runs whose last reading lies inside its predictive interval, and whose whole track lies inside "
    "its band. Brackets: 95 % confidence interval of the share (Wilson); over all media, with phantoms as "
    "trials.",
)


def lay_out_parameters(results: Run) -> TableLayout:
    """Return the estimate of each parameter from the fitted runs."""
    rows = [
        {**_scale_row(row), "verdict": _judge_parameter(row)}
        for row in to_records(results.frames["parameters"])
    ]
    columns = ("fit", "parameter", "p2_5", "p50", "p97_5", "sd_ratio", "verdict")
    caption = "Parameters: posterior of the fitted runs."
    return Table("parameters", caption, rows, columns, notes=_PARAMETER_NOTES).lay_out()


def _judge_parameter(row: Row) -> str:
    if row["determined"]:
        return "determined"
    return str(row["condition"] or "not determined")


def _scale_row(row: Row) -> Row:
    """Return a row of a parameter in the unit in which it is printed."""
    label, unit = choose_printed_unit(str(row["parameter"]), [row["p50"]])
    scaled = {name: None if row[name] is None else row[name] / unit for name in ("p2_5", "p50", "p97_5")}
    return {**row, **scaled, "parameter": label}


def lay_out_scores(results: Run) -> TableLayout:
    """Return the prediction errors of every method on the same runs."""
    rows = [
        {
            **row,
            "method": _name_method(row["method"]),
            "metric": _MEASURE_HEADINGS[row["metric"]],
            **({"difference": "", "better": ""} if row["method"] == "fitted" else {}),
        }
        for row in to_records(results.frames["paired"])
        if row["metric"] in _MEASURE_HEADINGS
    ]
    measures = (
        part(key, metric=heading)
        for heading in _MEASURE_HEADINGS.values()
        for key in ("track_error", "track_difference", "better_runs")
    )
    columns = ("medium", "runs", "method", *measures)
    methods = pivot(rows, ["medium", "method"], ["metric"])
    notes = (_SCORE_NOTES[0].format(placed=results.record.registration_depth_mm), *_SCORE_NOTES[1:])
    return Table(
        "scores",
        "Errors of predicted runs.",
        methods,
        columns,
        groups=("medium",),
        strong="groups",
        notes=notes,
    ).lay_out()


def lay_out_depths(results: Run) -> TableLayout:
    """Return how prediction errors grow with depth."""
    table = results.frames["depths"]
    depth_ranges = sorted(set(zip(table["low_mm"], table["high_mm"], strict=True)))
    known = table.set_index(["medium", "method", "low_mm"])["error_mm"].to_dict()
    rows = [
        {
            "medium": medium,
            "method": _name_method(method),
            "depth_interval": f"{low:g}–{high:g}",
            "error_mm": known.get((medium, method, low)),
        }
        for medium in table["medium"].unique()
        for method in list_track_methods()
        for low, high in depth_ranges
    ]
    methods = pivot(rows, ["medium", "method"], ["depth_interval"])
    errors = (part("depth_error", depth_interval=f"{low:g}–{high:g}") for low, high in depth_ranges)
    columns = ("medium", "method", *errors)
    caption = "Mean absolute error of the predictive median, by depth."
    return Table("depths", caption, methods, columns, groups=("medium",), strong="groups").lay_out()


def lay_out_coverage(results: Run) -> TableLayout:
    """Return the coverage of predictive intervals: of last readings, and of whole tracks (a run is one
    trial).
    """
    rows = [
        {"medium": medium, "method": _name_method(str(method))}
        | {f"{row['quantity']}_in_{row['level']:g}": _format_share(row) for row in to_records(group)}
        for (medium, method), group in results.frames["coverage"].groupby(["medium", "method"], sort=False)
    ]
    columns = ("medium", "method", "end_in_50", "end_in_95", "track_in_50", "track_in_95")
    return Table(
        *("coverage", "Coverage of the predictive intervals.", rows, columns),
        groups=("medium",),
        strong="groups",
        notes=_COVERAGE_NOTES,
    ).lay_out()


def _format_share(row: Row) -> str:
    return f"{row['covered']} of {row['runs']} ({100 * row['low']:.0f}–{100 * row['high']:.0f} %)"


def _name_method(method: str) -> str:
    known = BASELINES.get(method)
    return known.track_label if known and known.track_label else method_name(method)


_MEASURE_NAMES = {"rms_mm": "predicted", "aligned_rms_mm": "in shape"}


def summarize_tracks(results: Run) -> list[str]:
    """Return one sentence per medium: the fit compared with the baselines; then the runs left out."""
    paired = results.frames["paired"]
    found = [_summarize_medium(str(medium), group) for medium, group in paired.groupby("medium", sort=False)]
    return [*found, *results.run["dataset"]["remarks"]]


def judge(results: Run) -> list[Verdict]:
    """Return for each medium how the predicted tips compare with the baselines."""
    paired = results.frames["paired"].query("metric == 'rms_mm'")
    return [_judge_medium(str(medium), group) for medium, group in paired.groupby("medium", sort=False)]


def _judge_medium(medium: str, group: pd.DataFrame) -> Verdict:
    others = group[group["method"] != "fitted"]
    worse, better = bool((others["high"] < 0).any()), bool((others["low"] > 0).all())
    status: Status = "fail" if worse else "pass" if better else "warn"
    name = medium_name(medium)
    return Verdict(f"Predicted tips on {name}: {_compare_methods(group)}", status, name)


def _summarize_medium(medium: str, group: pd.DataFrame) -> str:
    parts = [
        f"{_MEASURE_NAMES[one]}, {_compare_methods(group[group['metric'] == one])}"
        for one in _MEASURE_HEADINGS
    ]
    return f"{medium_name(medium)}: {'; '.join(parts)}."


def _compare_methods(group: pd.DataFrame) -> str:
    """Return the comparison of the fit with each method: better or worse if the interval excludes 0."""
    verdicts: dict[str, list[str]] = {}
    for row in to_records(group[group["method"] != "fitted"]):
        low, high = row["low"], row["high"]
        word = "better than" if low > 0 else "worse than" if high < 0 else "not significantly different from"
        verdicts.setdefault(word, []).append(f"the {_name_method(str(row['method']))}")
    return "the fit is " + ", ".join(f"{word} {' and '.join(names)}" for word, names in verdicts.items())


def warn(results: Run) -> Iterator[ResultWarning]:
    """Yield, by medium, the closest curve without a model, if it is significantly closer than the fit."""
    rows = [row for row in to_records(results.frames["paired"]) if row["metric"] == "rms_mm"]
    for medium in dict.fromkeys(row["medium"] for row in rows):
        better = [row for row in rows if row["medium"] == medium and (row["high"] or 0) < 0]
        if better:
            best = min(better, key=lambda row: float(row["value"]))
            error, fit = best["value"], best["value"] - best["difference"]
            yield ResultWarning(
                "worse_than_baseline",
                f"the {_name_method(str(best['method']))} is closer to the predicted tips on "
                f"{medium_name(medium)} than the fitted model (mean error {error:.2f} mm against "
                f"{fit:.2f} mm)",
                fix="do not rely on this model there; fit to runs with guide moves like those predicted",
            )


_READINGS_CAPTION = (
    "Tip readings (points; hollow: used for the pose in the tracker’s frame) and predictions: median of the "
    "fitted model with 50 and 95 % bands (blue), straight lines (grey; dark: with the slope of similar "
    "runs), a parabola (green) and a response to the guide (purple). Below each: position of the guide, mm. "
    "Bands may extend beyond the panels."
)


def lay_out_tables(results: Run) -> list[TableLayout]:
    """Return the tables of scores, depths, coverage and parameters."""
    return [
        lay_out_scores(results),
        lay_out_depths(results),
        lay_out_coverage(results),
        lay_out_parameters(results),
    ]


def draw_figures(results: Run, folder: Path) -> dict[str, Path]:
    """Draw every predicted run."""
    readings = results.frames["readings"].assign(origin=results.origin)
    return {"readings": draw_tracks(readings, folder / "readings.pdf")}


def compose_sections(results: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: predictions, what was learned, what was assumed."""
    tables = {table.name: document.table(table) for table in lay_out_tables(results)}
    notes = results.run["dataset"]["notes"]
    return [
        document.heading("Predictions"),
        *(tables[name] for name in ("scores", "depths", "coverage")),
        document.figure(figures["readings"], _READINGS_CAPTION),
        document.heading("Parameters"),
        tables["parameters"],
        *([document.heading("Assumptions"), document.bullets(notes)] if notes else []),
    ]


def tracks_to_json(results: Run) -> dict[str, object]:
    """Return how methods compare, run by run."""
    return {"paired": to_records(results.frames["paired"])}


def _compare_tracks(before: pd.DataFrame, after: pd.DataFrame) -> Iterator[Difference]:
    """Yield how errors of runs predicted changed, by role and method."""
    keys = ["fit", "role", "run", "method"]
    one, two = (frame.drop_duplicates(keys) for frame in (before, after))
    both = one.merge(two, validate="1:1", on=keys, suffixes=("_a", "_b"), sort=False)
    for (role, method), rows in both.groupby(["role", "method"], sort=False):
        for column, words in (("rms_mm", "error"), ("crps_mm", "CRPS"), ("aligned_rms_mm", "shape")):
            yield from compare_means(f"{words} of runs, {method}, {role}", rows, column)


_RUNS = TableSchema(
    ("fit", "role", "run", "method", "quantity", "level"), numbers=("rms_mm", "crps_mm", "aligned_rms_mm")
)


REPORT = StudyReport(
    summarize=summarize_tracks,
    lay_out=lay_out_tables,
    draw=draw_figures,
    compose=compose_sections,
    to_json=tracks_to_json,
    judge=judge,
    warn=warn,
    comparisons={"runs": TableComparison(_RUNS, _compare_tracks)},
)
