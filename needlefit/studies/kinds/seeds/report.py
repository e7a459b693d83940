"""Report of the studies repeated on many synthetic datasets."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pandas as pd

from needlefit.metrics import METRICS, Metric, list_metrics
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.labels import medium_name, method_name
from needlefit.reporting.number_format import (
    MISSING,
    choose_printed_unit,
    format_metric,
)
from needlefit.reporting.table import Table, part, pivot
from needlefit.reporting.table_files import Row, to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.kinds.seeds.figures import draw_cells, draw_comparisons, draw_pattern
from needlefit.studies.kinds.seeds.one_twin import TRUTH
from needlefit.studies.kinds.seeds.run import UNEXPLAINED
from needlefit.studies.kinds.seeds.schema import SeedsRecord
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.score import list_methods
from needlefit.studies.verdict import Status

_TABLES = {
    "validation": "Errors on held-out insertions",
    "tuning_by_layers": "In-sample errors by number of layers",
    "tuning_by_media": "In-sample errors by medium",
}


def summarize(result: Run) -> list[str]:
    """Return sentences: whether the paper's pattern holds, and which methods the fit is better than."""
    return [
        _describe_pattern(result),
        *_describe_studies(result),
        _describe_comparisons(result),
        _describe_losses(result),
        _describe_limits(result),
    ]


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return tables of every cell over the datasets, the parameters, the comparisons, and the failures."""
    cells = [_lay_out_cells(result, name) for name in _TABLES]
    return [*cells, _lay_out_parameters(result), _lay_out_comparisons(result), _lay_out_losses(result)]


def study_name(name: str) -> str:
    """Return the printed name of a study or fit."""
    return medium_name(name).capitalize()


def _describe_pattern(result: Run) -> str:
    record, frame = result.record, result.frames["pattern"]
    assert isinstance(record, SeedsRecord)
    agrees = (frame["generalises"] == frame["generalises_in_paper"]).groupby(frame["seed"]).all()
    *others, last = (study_name(name).lower() for name in record.generalization_studies)
    generalizing = " and ".join([*([", ".join(others)] if others else []), last])
    return (
        f"The paper’s pattern ({generalizing} generalise, the others do not) holds on {agrees.sum()} of "
        f"{len(agrees)} synthetic datasets; criterion: mean IPE below {frame['limit_mm'].iloc[0]:.2f} mm, "
        "the geometric mean of the paper’s two groups of studies."
    )


def rate(result: Run) -> Status:
    """Return "warn" if the paper's pattern fails on some dataset."""
    frame = result.frames["pattern"]
    return "pass" if (frame["generalises"] == frame["generalises_in_paper"]).all() else "warn"


def _describe_studies(result: Run) -> Iterator[str]:
    for name, rows in result.frames["pattern"].groupby("study", sort=False):
        low, middle, high = rows["ipe_mean_mm"].quantile([0.05, 0.5, 0.95])
        yield (
            f"{study_name(str(name))}: mean IPE {middle:.2f} mm (5th to 95th percentile {low:.2f} to "
            f"{high:.2f}), noise floor {rows['floor_ipe_mean_mm'].mean():.2f} mm; generalises on "
            f"{rows['generalises'].sum()} of {len(rows)} synthetic datasets (paper: "
            f"{'yes' if rows['generalises_in_paper'].all() else 'no'})."
        )


def _describe_comparisons(result: Run) -> str:
    parts = []
    for method, rows in result.frames["comparisons"].groupby("method", sort=False):
        won, losses = ((rows["verdict"] == verdict).sum() for verdict in ("wins", "loses"))
        parts.append(f"{method_name(str(method))} {won}, {losses}, {len(rows) - won - losses}")
    return (
        "Paired comparisons on held-out insertions (mean IPE and TE of every group): the fit is better, "
        f"worse, not significantly different: {'; '.join(parts)}."
    )


def _describe_losses(result: Run) -> str:
    losses = result.frames["comparisons"].query("verdict == 'loses'")
    unexplained = int((losses["note"] == UNEXPLAINED).sum())
    return (
        f"The fit is worse in {len(losses)} comparisons; the data explain {len(losses) - unexplained} of "
        f"them, {unexplained} are not explained."
    )


def _describe_limits(result: Run) -> str:
    return (
        "This tests the consistency of the synthetic data and is no evidence for the model. All datasets "
        "share the plan of insertions; media, needle, noise and registration are drawn anew for each."
    )


def _lay_out_cells(result: Run, table: str) -> TableLayout:
    frame = result.frames["cells"].query("grouping == @table")
    rows = [
        {**row, "row": name, "twin_statistic": write(row, METRICS[row["metric"]])}
        for row in _name_rows(frame)
        for name, write in _ROW_FORMATS.items()
    ]
    metrics = (part("twin_statistic", metric=one.name) for one in list_metrics())
    columns = (*_GROUP, "insertions", "row", *metrics)
    cells = pivot(rows, [*_GROUP, "row"], ["metric"])
    notes = (
        "“Median” and “5 to 95 %”: over datasets; a cell is the mean over insertions. “Noise floor”: error "
        "of perfect parameters. “Paper”: on its own needles. “Below paper”: number of datasets.",
    )
    caption = f"{_TABLES[table]}, over {frame['replicates'].max()} synthetic datasets."
    return Table(
        table, caption, cells, columns, groups=_GROUP, heads=4, strong="groups", notes=notes
    ).lay_out()


_GROUP = ("study", "medium", "layers")


def _name_rows(frame: pd.DataFrame) -> list[Row]:
    return [
        {**row, "study": study_name(str(row["study"])), "layers": row.get("layers") or "all"}
        for row in to_records(frame)
    ]


def _format_range(row: Row, metric: Metric) -> str:
    return " to ".join(format_metric(metric, row[quantile]) for quantile in ("q05", "q95"))


_ROW_FORMATS: Mapping[str, Callable[[Row, Metric], str]] = {
    "median": lambda row, metric: format_metric(metric, row["q50"]),
    "5 to 95 %": _format_range,
    "noise floor": lambda row, metric: format_metric(metric, row["floor"]),
    "paper": lambda row, metric: format_metric(metric, row["paper"]),
    "below paper": lambda row, metric: MISSING if row["paper"] is None else str(row["seeds_below_paper"]),
}


def _lay_out_parameters(result: Run) -> TableLayout:
    quantiles = ("q50", "q05", "q95")
    columns = ("study", "parameter", *quantiles, "paper", *(f"ratio_to_true_{key}" for key in quantiles))
    notes = (
        "“÷ truth”: ratio to the true value, the geometric mean over the fitted specimens, layers and "
        "bevels. Moduli and b lie on a ridge: the data determine combinations of them.",
    )
    caption = "Fitted parameters over synthetic datasets, beside the paper’s."
    rows = [_scale_row(row) for row in _name_rows(result.frames["parameter_cells"])]
    return Table("parameter_cells", caption, rows, columns, groups=("study",), heads=1, notes=notes).lay_out()


def _scale_row(row: Row) -> Row:
    """Return a row of a parameter in the unit in which it is printed."""
    label, unit = choose_printed_unit(str(row["parameter"]), [row["q95"]])
    columns = ("q50", "q05", "q95", "paper")
    scaled = {name: None if row[name] is None else row[name] / unit for name in columns}
    return {**row, **scaled, "parameter": label}


def _lay_out_comparisons(result: Run) -> TableLayout:
    frame = result.frames["comparisons"]
    ordered = pd.concat(
        [
            group.sort_values("method", key=_method_order, kind="stable")  # its metrics stay together
            for _, group in frame.groupby(list(_GROUP), sort=False)
        ]
    )
    first = ordered["metric"].iloc[0]
    rows = [
        {**row, "method": method_name(row["method"]) if row["metric"] == first else ""}
        for row in _name_rows(ordered)
    ]
    columns = (
        *(*_GROUP, "method", "metric", "fit_error", "method_error", "fit_less_method", "difference_range"),
        *("twins_better", "verdict"),
    )
    notes = (
        "A pair is one held-out insertion of one dataset. Intervals: 95 %, by bootstrap over datasets and "
        "their insertions. “Open”: the interval contains 0.",
    )
    caption = "Paired comparison of the automatic fit with each method."
    return Table("comparisons", caption, rows, columns, groups=_GROUP, heads=3, notes=notes).lay_out()


def _method_order(methods: "pd.Series[str]") -> "pd.Series[int]":
    return methods.map([*list_methods(), TRUTH].index)


def _lay_out_losses(result: Run) -> TableLayout:
    losses = result.frames["comparisons"].query("verdict == 'loses'")
    order = losses.assign(known=losses["note"] != UNEXPLAINED).sort_values("known", kind="stable")
    columns = (*_GROUP, "method", "metric", "fit_less_method", "note")
    caption = "Comparisons in which the fit is worse, and the reason where the data show one."
    return Table("losses", caption, _name_rows(_sort_truth_last(order)), columns).lay_out()


def _sort_truth_last(losses: pd.DataFrame) -> pd.DataFrame:
    """Return the losses, those against the truth last: they are expected."""
    return losses.assign(last=losses["method"] == "truth").sort_values("last", kind="stable")


def draw_figures(result: Run, folder: Path) -> dict[str, Path]:
    """Draw the pattern, the comparisons and every cell."""
    return {
        "generalising": draw_pattern(result, folder / "generalising.pdf"),
        "comparisons": draw_comparisons(result, folder / "comparisons.pdf"),
        "cells": draw_cells(result, folder / "cells.pdf"),
    }


def compose_sections(result: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the pattern, comparisons and failures, then every cell and the
    parameters.
    """
    tables = {table.name: document.table(table) for table in lay_out_tables(result)}

    def figure(name: str, caption: str) -> list[Block]:
        return [document.figure(figures[name], caption)] if name in figures else []

    return [
        document.heading("Generalisation"),
        *figure("generalising", _PATTERN_CAPTION),
        document.heading("Comparison with other methods"),
        *figure("comparisons", _COMPARISONS_CAPTION),
        tables["losses"],
        document.heading("All cells"),
        *figure("cells", _CELLS_CAPTION),
        *(tables[name] for name in _TABLES),
        tables["parameter_cells"],
        document.heading("All comparisons"),
        tables["comparisons"],
    ]


_PATTERN_CAPTION = (
    "Mean IPE on the held-out insertions of each study. Dots: datasets; bars: medians; diamonds: the paper’s "
    "groups. Left of the line a study generalises."
)
_COMPARISONS_CAPTION = (
    "Error of the fit minus that of a method, mean over the held-out insertions of all datasets, with its "
    "95 % interval. Left of 0 the fit is better. The scale is logarithmic beyond ±0.1 mm."
)
_CELLS_CAPTION = (
    "All cells over datasets: median and 5 to 95 %. Diamonds: the paper’s cell, on its own needles. Dashes: "
    "noise floor."
)
REPORT = StudyReport(summarize, lay_out_tables, draw_figures, compose_sections, rate=rate)
