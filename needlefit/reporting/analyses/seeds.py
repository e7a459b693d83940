"""Report of the studies repeated on many synthetic datasets."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pandas as pd

from needlefit.reporting import document
from needlefit.reporting.analyses.page import AnalysisPage, FigurePaths
from needlefit.reporting.document import Block
from needlefit.reporting.figures.seeds import draw_cells, draw_comparisons, draw_pattern
from needlefit.reporting.labels import METHOD_NAMES, medium_name
from needlefit.reporting.number_format import (
    MISSING,
    format_mm,
    format_number,
    format_percent,
    format_signed_mm,
    format_symbol,
    typeset,
)
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.reporting.tables import Row, to_records
from needlefit.schemas.analyses import SeedsRecord
from needlefit.validation.analyses.runner import AnalysisResult
from needlefit.validation.analyses.seeds.run import UNEXPLAINED

_TABLES = {
    "validation": "Errors on held-out insertions",
    "tuning_by_layers": "In-sample errors by number of layers",
    "tuning_by_media": "In-sample errors by medium",
}
_METRICS = {
    "median_err_mm": "Median",
    "ipe_mean_mm": "IPE",
    "ipe_std_mm": "sd IPE",
    "ipe_max_mm": "Max IPE",
    "te_mm": "TE",
    "edp_percent": "EDP",
}
_ERRORS = {"ipe_mean_mm": "mean IPE", "te_mm": "TE"}


def summarize(result: AnalysisResult) -> list[str]:
    """Return sentences: whether the paper's pattern holds, and which methods the fit is better than."""
    return [
        _describe_pattern(result),
        *_describe_studies(result),
        _describe_comparisons(result),
        _describe_losses(result),
        _describe_limits(result),
    ]


def lay_out_tables(result: AnalysisResult) -> list[TableLayout]:
    """Return tables of every cell over the datasets, the parameters, the comparisons, and the failures."""
    cells = [_lay_out_cells(result, name) for name in _TABLES]
    return [*cells, _lay_out_parameters(result), _lay_out_comparisons(result), _lay_out_losses(result)]


def study_name(name: str) -> str:
    """Return the printed name of a study or fit."""
    return medium_name(name).capitalize()


def _describe_pattern(result: AnalysisResult) -> str:
    record, frame = result.record, result.frames["pattern"]
    assert isinstance(record, SeedsRecord)
    agrees = (frame["generalises"] == frame["generalises_in_paper"]).groupby(frame["seed"]).all()
    *others, last = (study_name(name).lower() for name in record.generalization_studies)
    generalizing = " and ".join([*([", ".join(others)] if others else []), last])
    return (
        f"The paper’s pattern, that {generalizing} generalise and no other does, holds on {agrees.sum()} of "
        f"{len(agrees)} twins: mean IPE below {frame['threshold_mm'].iloc[0]:.2f} mm, half way (by ratio) "
        "between the paper’s two groups of studies."
    )


def _describe_studies(result: AnalysisResult) -> Iterator[str]:
    for name, rows in result.frames["pattern"].groupby("study", sort=False):
        low, middle, high = rows["ipe_mean_mm"].quantile([0.05, 0.5, 0.95])
        yield (
            f"{study_name(str(name))}: mean IPE {middle:.2f} mm (5 to 95 % of twins: {low:.2f} to "
            f"{high:.2f}), noise floor {rows['floor_ipe_mean_mm'].mean():.2f} mm; generalises on "
            f"{rows['generalises'].sum()} of {len(rows)} twins, in the paper it does"
            f"{'' if rows['generalises_in_paper'].all() else ' not'}."
        )


def _describe_comparisons(result: AnalysisResult) -> str:
    parts = []
    for method, rows in result.frames["comparisons"].groupby("method", sort=False):
        won, losses = ((rows["verdict"] == verdict).sum() for verdict in ("wins", "loses"))
        parts.append(f"{METHOD_NAMES[str(method)]} {won} won, {losses} lost, {len(rows) - won - losses} open")
    return f"Held out, in pairs, by mean IPE and TE of every group, the fit against: {'; '.join(parts)}."


def _describe_losses(result: AnalysisResult) -> str:
    losses = result.frames["comparisons"].query("verdict == 'loses'")
    unexplained = int((losses["explanation"] == UNEXPLAINED).sum())
    return (
        f"Lost comparisons: {len(losses)}, {len(losses) - unexplained} of them with a reason that the data "
        f"bear "
        f"out; not explained, and listed so: {unexplained}."
    )


def _describe_limits(result: AnalysisResult) -> str:
    return (
        "This is the twin’s consistency, not evidence for the model. All twins share their plan of "
        "insertions; media, needle, noise and registration are drawn anew for each."
    )


def _lay_out_cells(result: AnalysisResult, table: str) -> TableLayout:
    frame = result.frames["cells"].query("table == @table")
    heads = (
        text_column("Study" if table == "validation" else "Fit of"),
        text_column("Medium"),
        TableColumn("Layers"),
    )
    columns = (*heads, TableColumn("n"), text_column("Row"), *(_metric_column(name) for name in _METRICS))
    rows: list[tuple[str, ...]] = []
    breaks, strong = [], []
    for key, group in frame.groupby(["study", "medium", "layers"], sort=False):
        breaks += [len(rows)] if rows else []
        strong.append(len(rows))
        by_metric = {row["metric"]: row for row in to_records(group)}
        study, medium, layers = key
        head = (study_name(str(study)), medium_name(str(medium)), str(layers or "all"))
        count = str(by_metric["te_mm"]["insertions"])
        for i, (name, cell) in enumerate(_ROW_FORMATS.items()):
            first = (*head, count) if i == 0 else ("",) * 4
            rows.append((*first, name, *(cell(by_metric[metric], metric) for metric in _METRICS)))
    notes = (
        "“Median” and “5 to 95 %” are over twins; a cell is the mean over insertions. “Noise floor” is what "
        "perfect parameters would still show. “Paper” is of its own needles. “Below paper” counts twins.",
    )
    caption = f"{_TABLES[table]}, over {frame['seeds'].max()} twins."
    return TableLayout(table, caption, columns, tuple(rows), tuple(breaks), tuple(strong), notes)


def _metric_column(metric: str) -> TableColumn:
    return TableColumn(_METRICS[metric], "%" if metric == "edp_percent" else "mm")


def _format_value(value: float | None, metric: str) -> str:
    return format_percent(value) if metric == "edp_percent" else format_mm(value)


def _format_range(row: Row, metric: str) -> str:
    ends = [_format_value(row[quantile], metric) for quantile in ("q05", "q95")]
    return " to ".join(ends)


_ROW_FORMATS: Mapping[str, Callable[[Row, str], str]] = {
    "median": lambda row, metric: _format_value(row["q50"], metric),
    "5 to 95 %": _format_range,
    "noise floor": lambda row, metric: _format_value(row["floor"], metric),
    "paper": lambda row, metric: _format_value(row["paper"], metric),
    "below paper": lambda row, metric: MISSING if row["paper"] is None else str(row["seeds_below_paper"]),
}


def _lay_out_parameters(result: AnalysisResult) -> TableLayout:
    columns = (
        *(
            text_column("Fit of"),
            text_column("Parameter"),
            TableColumn("median"),
            TableColumn("5 %"),
            TableColumn("95 %"),
        ),
        *(TableColumn("paper"), TableColumn("to truth"), TableColumn("5 %"), TableColumn("95 %")),
    )
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for study, group in result.frames["parameter_cells"].groupby("study", sort=False):
        breaks += [len(rows)] if rows else []
        for i, row in enumerate(to_records(group)):
            values = (typeset(format_number(row[key])) for key in ("q50", "q05", "q95", "paper"))
            ratios = (format_mm(row[f"ratio_to_true_{key}"]) for key in ("q50", "q05", "q95"))
            middle, low, high, paper = values
            head = study_name(str(study)) if i == 0 else ""
            rows.append((head, format_symbol(row["parameter"]), middle, low, high, paper, *ratios))
    notes = (
        "“To truth” is the ratio to the twin’s own value, the geometric mean over the specimens, layers and "
        "bevels that a fit learns from. Moduli and b lie on a ridge: neither is known apart.",
    )
    caption = "Fitted parameters over twins, beside the paper’s (Pa and mm)."
    return TableLayout("parameter_cells", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _lay_out_comparisons(result: AnalysisResult) -> TableLayout:
    columns = (
        *(
            text_column("Study"),
            text_column("Held out"),
            TableColumn("Layers"),
            text_column("Method"),
            text_column("Error"),
        ),
        *(
            TableColumn("fit", "mm"),
            TableColumn("method", "mm"),
            TableColumn("fit − method", "mm"),
            TableColumn("95 %", "mm"),
        ),
        *(TableColumn("Better on", "twins"), text_column("The fit")),
    )
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for key, group in result.frames["comparisons"].groupby(["study", "medium", "layers"], sort=False):
        breaks += [len(rows)] if rows else []
        ordered = group.sort_values(
            "method", key=_method_order, kind="stable"
        )  # its two metrics stay together
        for i, row in enumerate(to_records(ordered)):
            head = _group_cells(key) if i == 0 else ("",) * 3
            method = METHOD_NAMES[row["method"]] if i % 2 == 0 else ""
            means = (format_mm(row["fitted_mm"]), format_mm(row["method_mm"]))
            wins = f"{row['twins_better']} of {row['twins']}"
            rows.append(
                (*head, method, _ERRORS[row["metric"]], *means, *_difference_cells(row), wins, row["verdict"])
            )
    notes = (
        "A pair is one held-out insertion of one twin. Intervals are of 95 %: twins drawn again with "
        "replacement, and of each its insertions. “Open” is an interval that holds 0.",
    )
    caption = "The automatic fit against each method, in pairs."
    return TableLayout("comparisons", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _method_order(methods: "pd.Series[str]") -> "pd.Series[int]":
    return methods.map(list(METHOD_NAMES).index)


def _difference_cells(row: Row) -> tuple[str, str]:
    low, middle, high = (format_signed_mm(row[key]) for key in ("low_mm", "difference_mm", "high_mm"))
    return middle, f"{low} to {high}"


def _group_cells(key: object) -> tuple[str, str, str]:
    assert isinstance(key, tuple)
    study, medium, layers = key
    return study_name(str(study)), medium_name(str(medium)), str(layers)


def _lay_out_losses(result: AnalysisResult) -> TableLayout:
    losses = result.frames["comparisons"].query("verdict == 'loses'")
    order = losses.assign(known=losses["explanation"] != UNEXPLAINED).sort_values("known", kind="stable")
    rows = tuple(
        (
            *_group_cells((row["study"], row["medium"], row["layers"])),
            METHOD_NAMES[row["method"]],
            _ERRORS[row["metric"]],
            _difference_cells(row)[0],
            row["explanation"],
        )
        for row in to_records(_sort_truth_last(order))
    )
    columns = (
        *(
            text_column("Study"),
            text_column("Held out"),
            TableColumn("Layers"),
            text_column("Method"),
            text_column("Error"),
        ),
        *(TableColumn("fit − method", "mm"), text_column("Why", wide=True)),
    )
    return TableLayout("losses", "What the fit loses, and why, where the data say so.", columns, rows)


def _sort_truth_last(losses: pd.DataFrame) -> pd.DataFrame:
    """Return the losses, those against the truth last: they are expected."""
    return losses.assign(last=losses["method"] == "truth").sort_values("last", kind="stable")


def draw_figures(result: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the pattern, the comparisons and every cell."""
    return {
        "generalising": draw_pattern(result, folder / "generalising.pdf"),
        "comparisons": draw_comparisons(result, folder / "comparisons.pdf"),
        "cells": draw_cells(result, folder / "cells.pdf"),
    }


def compose_sections(result: AnalysisResult, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: the pattern, comparisons and failures, then every cell and the
    parameters.
    """
    tables = {table.name: document.table(table, result.synthetic) for table in lay_out_tables(result)}

    def figure(name: str, caption: str) -> list[Block]:
        return [document.figure(figures[name], caption, result.synthetic)] if name in figures else []

    return [
        document.heading("Who generalises"),
        *figure("generalising", _PATTERN_CAPTION),
        document.heading("Against the other methods"),
        *figure("comparisons", _COMPARISONS_CAPTION),
        tables["losses"],
        document.heading("Every cell"),
        *figure("cells", _CELLS_CAPTION),
        *(tables[name] for name in _TABLES),
        tables["parameter_cells"],
        document.heading("Every comparison"),
        tables["comparisons"],
    ]


_PATTERN_CAPTION = (
    "Mean IPE of what each study holds out, a dot per twin, the bar their median; diamonds are the paper’s "
    "groups. Left of the line a study generalises."
)
_COMPARISONS_CAPTION = (
    "Error of the fit less that of a method, mean over held-out insertions of all twins, with its 95 % "
    "interval. Left of 0 the fit errs less. The scale is logarithmic beyond ±0.1 mm."
)
_CELLS_CAPTION = (
    "Every cell over twins: median and 5 to 95 %. Diamonds: the paper’s cell, on its own needles; dashes: "
    "the noise floor."
)
PAGE = AnalysisPage(summarize, lay_out_tables, draw_figures, compose_sections)
