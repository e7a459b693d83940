"""The report of a study of tip tracks: tables, sentences, figure."""

from collections.abc import Iterator
from pathlib import Path

import pandas as pd

from needlefit.datasets.tip_tracks import GUIDE_STILL_MM
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.labels import medium_name
from needlefit.reporting.number_format import choose_printed_unit
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.csv_tables import TableSchema
from needlefit.studies.kinds.tracks.figures import draw_tracks
from needlefit.studies.kinds.tracks.results import list_track_methods, name_track_method
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
_POSITION_NOTES = (
    "Relative to the first reading. The interval includes parameters, bevel, pose in the tracker’s frame and "
    "readings, not model error; a fit whose draws are not certified or not converged has none.",
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
    label, unit = choose_printed_unit(str(row["parameter"]), [row["p97_5"]])
    scaled = {name: None if row[name] is None else row[name] / unit for name in ("p2_5", "p50", "p97_5")}
    return {**row, **scaled, "parameter": label}


def lay_out_scores(results: Run) -> TableLayout:
    """Return the prediction errors of every method on the same runs."""
    rows = [
        {
            **row,
            "method": name_track_method(row["method"]),
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


def lay_out_positions(results: Run) -> TableLayout:
    """Return where the tip was predicted at the last reading of each run, with its 95 % interval."""
    readings = results.frames["readings"]
    fitted = readings[readings["method"] == "fitted"]
    rows = []
    for _, run in fitted.groupby(["fit", "run"], sort=False):
        moved = run["guide_mm"].max() - run["guide_mm"].min() > GUIDE_STILL_MM
        last = to_records(run.tail(1))[0]
        ends = {f"95_{end}_mm": last[f"{end}_95_mm"] for end in ("low", "high")}
        rows.append({**last, **ends, "guide_state": "moved" if moved else "at rest"})
    columns = ("medium", "run", "guide_state", "depth_mm", "measured_mm", "median_mm", "range_95_mm")
    caption = "Predicted position of the tip at the last reading: median and 95 % interval."
    return Table("positions", caption, rows, columns, groups=("medium",), notes=_POSITION_NOTES).lay_out()


def lay_out_depths(results: Run) -> TableLayout:
    """Return how prediction errors grow with depth."""
    table = results.frames["depths"]
    depth_ranges = sorted(set(zip(table["low_mm"], table["high_mm"], strict=True)))
    known = table.set_index(["medium", "method", "low_mm"])["error_mm"].to_dict()
    rows = [
        {
            "medium": medium,
            "method": name_track_method(method),
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
        {"medium": medium, "method": name_track_method(str(method))}
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
        word = _compare_intervals(row["low"], row["high"])
        verdicts.setdefault(word, []).append(f"the {name_track_method(str(row['method']))}")
    return "the fit is " + ", ".join(f"{word} {' and '.join(names)}" for word, names in verdicts.items())


def _compare_intervals(low: float | None, high: float | None) -> str:
    if low is None or high is None:  # a single run has no scatter
        return "on one run, without an interval, compared with"
    return "better than" if low > 0 else "worse than" if high < 0 else "not significantly different from"


_READINGS_CAPTION = (
    "Tip readings (points; hollow: used for the pose in the tracker’s frame) and predictions: median of the "
    "fitted model with 50 and 95 % bands (blue), straight lines (grey; dark: with the slope of similar "
    "runs), a parabola (green) and a response to the guide (purple). Below each: position of the guide, mm. "
    "Bands may extend beyond the panels."
)
_NO_BANDS = "A fit whose draws are not certified or not converged has no bands."


def _caption_readings(results: Run) -> str:
    return f"{_READINGS_CAPTION} {_NO_BANDS}" if results.faults else _READINGS_CAPTION


def lay_out_tables(results: Run) -> list[TableLayout]:
    """Return the tables of scores, positions, depths, coverage and parameters."""
    return [
        lay_out_scores(results),
        lay_out_positions(results),
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
        *(tables[name] for name in ("scores", "positions", "depths", "coverage")),
        document.figure(figures["readings"], _caption_readings(results)),
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
    lay_out_first=lambda results: [lay_out_scores(results), lay_out_positions(results)],
    comparisons={"runs": TableComparison(_RUNS, _compare_tracks)},
)
