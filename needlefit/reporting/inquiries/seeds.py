"""What is told of the studies on many twins."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pandas as pd

from needlefit.reporting import document
from needlefit.reporting.display import Column, Display, text
from needlefit.reporting.document import Block
from needlefit.reporting.figures.seeds import draw_cells, draw_contests, draw_pattern
from needlefit.reporting.inquiries.page import Figures, Page
from needlefit.reporting.names import METHOD_NAMES, medium_name
from needlefit.reporting.numbers import MISSING, fixed, number, percent, signed, symbol, typeset
from needlefit.reporting.tables import Row, records
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


def said(answer: AnalysisResult) -> list[str]:
    """Return whether the paper's pattern holds, and whom the fit beats, or not."""
    return [_pattern(answer), *_studies(answer), _contests(answer), _losses(answer), _limits(answer)]


def layouts(answer: AnalysisResult) -> list[Display]:
    """Return every cell over twins, the parameters, the contests, and what was lost."""
    cells = [_cells(answer, name) for name in _TABLES]
    return [*cells, _parameters(answer), _contest_table(answer), _lost(answer)]


def study_name(name: str) -> str:
    """Return a study or fit as print has it."""
    return medium_name(name).capitalize()


def _pattern(answer: AnalysisResult) -> str:
    record, frame = answer.record, answer.frames["pattern"]
    assert isinstance(record, SeedsRecord)
    holds = (frame["generalises"] == frame["generalises_in_paper"]).groupby(frame["seed"]).all()
    *most, last = (study_name(name).lower() for name in record.generalization_studies)
    kept = " and ".join([*([", ".join(most)] if most else []), last])
    return (
        f"The paper’s pattern, that {kept} generalise and no other does, holds on {holds.sum()} of "
        f"{len(holds)} twins: mean IPE below {frame['threshold_mm'].iloc[0]:.2f} mm, half way (by ratio) "
        "between the paper’s two groups of studies."
    )


def _studies(answer: AnalysisResult) -> Iterator[str]:
    for name, rows in answer.frames["pattern"].groupby("study", sort=False):
        low, middle, high = rows["ipe_mean_mm"].quantile([0.05, 0.5, 0.95])
        yield (
            f"{study_name(str(name))}: mean IPE {middle:.2f} mm (5 to 95 % of twins: {low:.2f} to "
            f"{high:.2f}), noise floor {rows['floor_ipe_mean_mm'].mean():.2f} mm; generalises on "
            f"{rows['generalises'].sum()} of {len(rows)} twins, in the paper it does"
            f"{'' if rows['generalises_in_paper'].all() else ' not'}."
        )


def _contests(answer: AnalysisResult) -> str:
    parts = []
    for method, rows in answer.frames["comparisons"].groupby("method", sort=False):
        won, lost = ((rows["verdict"] == verdict).sum() for verdict in ("wins", "loses"))
        parts.append(f"{METHOD_NAMES[str(method)]} {won} won, {lost} lost, {len(rows) - won - lost} open")
    return f"Held out, in pairs, by mean IPE and TE of every group, the fit against: {'; '.join(parts)}."


def _losses(answer: AnalysisResult) -> str:
    lost = answer.frames["comparisons"].query("verdict == 'loses'")
    unexplained = int((lost["explanation"] == UNEXPLAINED).sum())
    return (
        f"Lost contests: {len(lost)}, {len(lost) - unexplained} of them with a reason that the data bear "
        f"out; not explained, and listed so: {unexplained}."
    )


def _limits(answer: AnalysisResult) -> str:
    return (
        "This is the twin’s consistency, not evidence for the model. All twins share their plan of "
        "insertions; media, needle, noise and registration are drawn anew for each."
    )


def _cells(answer: AnalysisResult, table: str) -> Display:
    frame = answer.frames["cells"].query("table == @table")
    heads = (text("Study" if table == "validation" else "Fit of"), text("Medium"), Column("Layers"))
    columns = (*heads, Column("n"), text("Row"), *(_column(name) for name in _METRICS))
    rows: list[tuple[str, ...]] = []
    breaks, strong = [], []
    for key, group in frame.groupby(["study", "medium", "layers"], sort=False):
        breaks += [len(rows)] if rows else []
        strong.append(len(rows))
        by = {row["metric"]: row for row in records(group)}
        study, medium, layers = key
        head = (study_name(str(study)), medium_name(str(medium)), str(layers or "all"))
        count = str(by["te_mm"]["insertions"])
        for i, (name, cell) in enumerate(_WAYS.items()):
            first = (*head, count) if i == 0 else ("",) * 4
            rows.append((*first, name, *(cell(by[metric], metric) for metric in _METRICS)))
    notes = (
        "“Median” and “5 to 95 %” are over twins; a cell is the mean over insertions. “Noise floor” is what "
        "perfect parameters would still show. “Paper” is of its own needles. “Below paper” counts twins.",
    )
    caption = f"{_TABLES[table]}, over {frame['seeds'].max()} twins."
    return Display(table, caption, columns, tuple(rows), tuple(breaks), tuple(strong), notes)


def _column(metric: str) -> Column:
    return Column(_METRICS[metric], "%" if metric == "edp_percent" else "mm")


def _value(value: float | None, metric: str) -> str:
    return percent(value) if metric == "edp_percent" else fixed(value)


def _range(row: Row, metric: str) -> str:
    ends = [_value(row[quantile], metric) for quantile in ("q05", "q95")]
    return " to ".join(ends)


_WAYS: Mapping[str, Callable[[Row, str], str]] = {
    "median": lambda row, metric: _value(row["q50"], metric),
    "5 to 95 %": _range,
    "noise floor": lambda row, metric: _value(row["floor"], metric),
    "paper": lambda row, metric: _value(row["paper"], metric),
    "below paper": lambda row, metric: MISSING if row["paper"] is None else str(row["seeds_below_paper"]),
}


def _parameters(answer: AnalysisResult) -> Display:
    columns = (
        *(text("Fit of"), text("Parameter"), Column("median"), Column("5 %"), Column("95 %")),
        *(Column("paper"), Column("to truth"), Column("5 %"), Column("95 %")),
    )
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for study, group in answer.frames["parameter_cells"].groupby("study", sort=False):
        breaks += [len(rows)] if rows else []
        for i, row in enumerate(records(group)):
            values = (typeset(number(row[key])) for key in ("q50", "q05", "q95", "paper"))
            ratios = (fixed(row[f"ratio_to_true_{key}"]) for key in ("q50", "q05", "q95"))
            middle, low, high, paper = values
            head = study_name(str(study)) if i == 0 else ""
            rows.append((head, symbol(row["parameter"]), middle, low, high, paper, *ratios))
    notes = (
        "“To truth” is the ratio to the twin’s own value, the geometric mean over the specimens, layers and "
        "bevels that a fit learns from. Moduli and b lie on a ridge: neither is known apart.",
    )
    caption = "Fitted parameters over twins, beside the paper’s (Pa and mm)."
    return Display("parameter_cells", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _contest_table(answer: AnalysisResult) -> Display:
    columns = (
        *(text("Study"), text("Held out"), Column("Layers"), text("Method"), text("Error")),
        *(Column("fit", "mm"), Column("method", "mm"), Column("fit − method", "mm"), Column("95 %", "mm")),
        *(Column("Better on", "twins"), text("The fit")),
    )
    rows: list[tuple[str, ...]] = []
    breaks: list[int] = []
    for key, group in answer.frames["comparisons"].groupby(["study", "medium", "layers"], sort=False):
        breaks += [len(rows)] if rows else []
        ordered = group.sort_values("method", key=_place, kind="stable")  # its two metrics stay together
        for i, row in enumerate(records(ordered)):
            head = _group(key) if i == 0 else ("",) * 3
            method = METHOD_NAMES[row["method"]] if i % 2 == 0 else ""
            means = (fixed(row["fitted_mm"]), fixed(row["method_mm"]))
            wins = f"{row['twins_better']} of {row['twins']}"
            rows.append((*head, method, _ERRORS[row["metric"]], *means, *_gap(row), wins, row["verdict"]))
    notes = (
        "A pair is one held-out insertion of one twin. Intervals are of 95 %: twins drawn again with "
        "replacement, and of each its insertions. “Open” is an interval that holds 0.",
    )
    caption = "The automatic fit against each method, in pairs."
    return Display("comparisons", caption, columns, tuple(rows), tuple(breaks), notes=notes)


def _place(rivals: "pd.Series[str]") -> "pd.Series[int]":
    return rivals.map(list(METHOD_NAMES).index)


def _gap(row: Row) -> tuple[str, str]:
    low, middle, high = (signed(row[key]) for key in ("low_mm", "difference_mm", "high_mm"))
    return middle, f"{low} to {high}"


def _group(key: object) -> tuple[str, str, str]:
    assert isinstance(key, tuple)
    study, medium, layers = key
    return study_name(str(study)), medium_name(str(medium)), str(layers)


def _lost(answer: AnalysisResult) -> Display:
    lost = answer.frames["comparisons"].query("verdict == 'loses'")
    order = lost.assign(known=lost["explanation"] != UNEXPLAINED).sort_values("known", kind="stable")
    rows = tuple(
        (
            *_group((row["study"], row["medium"], row["layers"])),
            METHOD_NAMES[row["method"]],
            _ERRORS[row["metric"]],
            _gap(row)[0],
            row["explanation"],
        )
        for row in records(_together(order))
    )
    columns = (
        *(text("Study"), text("Held out"), Column("Layers"), text("Method"), text("Error")),
        *(Column("fit − method", "mm"), text("Why", wide=True)),
    )
    return Display("lost", "What the fit loses, and why, where the data say so.", columns, rows)


def _together(lost: pd.DataFrame) -> pd.DataFrame:
    """Return the losses, those against the truth last: they are expected."""
    return lost.assign(last=lost["method"] == "truth").sort_values("last", kind="stable")


def draw_all(answer: AnalysisResult, folder: Path) -> dict[str, Path]:
    """Draw the pattern, the contests and every cell."""
    return {
        "generalising": draw_pattern(answer, folder / "generalising.pdf"),
        "comparisons": draw_contests(answer, folder / "comparisons.pdf"),
        "cells": draw_cells(answer, folder / "cells.pdf"),
    }


def story(answer: AnalysisResult, figures: Figures) -> list[Block]:
    """Return the pattern, the contests and their losses, then every cell and the parameters."""
    tables = {table.name: document.table(table, answer.synthetic) for table in layouts(answer)}

    def shown(name: str, caption: str) -> list[Block]:
        return [document.figure(figures[name], caption, answer.synthetic)] if name in figures else []

    return [
        document.heading("Who generalises"),
        *shown("generalising", _PATTERN),
        document.heading("Against its rivals"),
        *shown("comparisons", _CONTESTS),
        tables["lost"],
        document.heading("Every cell"),
        *shown("cells", _CELLS),
        *(tables[name] for name in _TABLES),
        tables["parameter_cells"],
        document.heading("Every contest"),
        tables["comparisons"],
    ]


_PATTERN = (
    "Mean IPE of what each study holds out, a dot per twin, the bar their median; diamonds are the paper’s "
    "groups. Left of the line a study generalises."
)
_CONTESTS = (
    "Error of the fit less that of a method, mean over held-out insertions of all twins, with its 95 % "
    "interval. Left of 0 the fit errs less. The scale is logarithmic beyond ±0.1 mm."
)
_CELLS = (
    "Every cell over twins: median and 5 to 95 %. Diamonds: the paper’s cell, on its own needles; dashes: "
    "the noise floor."
)
PAGE = Page(said, layouts, draw_all, story)
