"""Report of a cohort: parameters and errors over specimens, and what could not be fitted."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from needlefit.inference.identifiability.precision import format_sd
from needlefit.inference.parameters import is_logarithmic
from needlefit.metrics import headline_metrics
from needlefit.project.locate import join_names
from needlefit.reporting import document
from needlefit.reporting.document import Block
from needlefit.reporting.figures.style import TEXT_WIDTH_IN, draw_grid, plot
from needlefit.reporting.labels import METHOD_COLOURS
from needlefit.reporting.number_format import (
    choose_printed_unit,
    format_quantity,
    format_quantity_range,
    format_symbol,
    join_metrics,
)
from needlefit.reporting.table import Table
from needlefit.reporting.table_files import to_records
from needlefit.reporting.table_layout import TableLayout
from needlefit.studies.columnar import read_columns
from needlefit.studies.report import FigurePaths, StudyReport
from needlefit.studies.run import Run
from needlefit.studies.verdict import Verdict

MAX_LISTED = 20
"""Failures that the report lists; `failures.csv` has all."""

MAX_NAMED = 3
"""Failures that the first sentence names."""

MAX_BINS = 40
"""Bins of a histogram."""


def summarize(result: Run) -> list[str]:
    """Return sentences: how many were fitted, the median of each parameter, and the errors."""
    metrics = [metric.name for metric in headline_metrics()]
    errors = read_columns(result.frames, "errors", ("dataset", "insertions", *metrics))
    parts = [_format_median(name, rows) for name, rows in _by_parameter(result)]
    typical = {name: float(errors[name].median()) for name in metrics}
    return [
        f"Fitted {len(errors)} specimens of {errors['dataset'].nunique()} datasets "
        f"({int(errors['insertions'].sum())} insertions); {_name_failures(result)}.",
        f"Median over specimens: {'; '.join(parts)}.",
        f"Median in-sample error: {join_metrics(typical)}.",
    ]


def _name_failures(result: Run) -> str:
    """Return how many could not be fitted, the first of them, and the file that has them all."""
    failures = read_columns(result.frames, "failures", ("dataset", "specimen"))
    if failures.empty:
        return "0 could not be fitted"
    pairs = failures[["dataset", "specimen"]].itertuples(index=False)
    names = [f"{dataset} ({specimen})" if specimen else str(dataset) for dataset, specimen in pairs]
    return f"{len(names)} could not be fitted: {join_names(names, MAX_NAMED)} (see failures.csv)"


def _format_median(name: str, rows: pd.DataFrame) -> str:
    """Return a parameter's symbol and its median over specimens."""
    return f"{_symbol(name)} {format_quantity(name, float(rows['value'].median()))}"


def _symbol(name: str) -> str:
    """Return the symbol of a parameter without its unit, which stands with the values."""
    return format_symbol(name).partition(" (")[0]


def judge(result: Run) -> list[Verdict]:
    """Return the first sentence; failures and open searches make it a warning."""
    failures = len(read_columns(result.frames, "failures", ("dataset",)))
    whole = not failures and bool(read_columns(result.frames, "errors", ("converged",))["converged"].all())
    sentence = summarize(result)[0].rstrip(".")
    return [Verdict(sentence, "pass" if whole else "warn", numbers={"failures": failures})]


def _by_parameter(result: Run, columns: Sequence[str] = ("value",)) -> Iterator[tuple[str, pd.DataFrame]]:
    """Yield some columns of the fits, parameter by parameter."""
    fits = read_columns(result.frames, "fits", ("parameter", *columns))
    for name in fits["parameter"].unique():  # a `groupby` would take three times the memory
        yield str(name), fits.loc[fits["parameter"] == name, list(columns)]


def lay_out_tables(result: Run) -> list[TableLayout]:
    """Return the parameters over specimens, and what could not be fitted."""
    return [_lay_out_parameters(result), *_lay_out_failures(result)]


def _lay_out_parameters(result: Run) -> TableLayout:
    rows = []
    for name, found in _by_parameter(result, ("value", "sd", "at_bound")):
        low, high = np.quantile(found["value"], [0.05, 0.95]).tolist()
        rows.append(
            {
                "parameter": _symbol(name),
                "specimens": len(found),
                "specimen_median": format_quantity(name, float(found["value"].median())),
                "specimen_range": format_quantity_range(name, low, high),
                "sd": format_sd(float(found["sd"].median()), is_logarithmic(name)),
                "specimens_at_bound": int(found["at_bound"].astype(bool).sum()),
            }
        )
    notes = (
        "SD: standard deviation of one fit, relative (in % or as a factor) but for α; median over specimens.",
    )
    columns = ("parameter", "specimens", "specimen_median", "specimen_range", "sd", "specimens_at_bound")
    return Table("parameters", "Parameters over specimens.", rows, columns, notes=notes).lay_out()


def _lay_out_failures(result: Run) -> list[TableLayout]:
    failures = read_columns(result.frames, "failures", ("dataset", "specimen", "note"))
    if failures.empty:
        return []
    caption = f"What could not be fitted ({min(len(failures), MAX_LISTED)} of {len(failures)})."
    rows = to_records(failures.head(MAX_LISTED))
    return [Table("failures", caption, rows, ("dataset", "specimen", "note")).lay_out()]


def draw_figures(result: Run, folder: Path) -> dict[str, Path]:
    """Draw a histogram of each parameter over specimens."""
    return {"parameters": plot(folder / "distributions.pdf", _count(result), _paint)}


def _count(result: Run) -> pd.DataFrame:
    """Return the histograms: edges of bins in the units of files, and counts."""
    found = []
    for name, rows in _by_parameter(result):
        values = rows["value"].to_numpy(dtype=np.float64)
        scale, back = (np.log, np.exp) if is_logarithmic(name) else (np.asarray, np.asarray)
        edges = np.histogram_bin_edges(scale(values), bins=min(MAX_BINS, 5 + len(values) // 5))
        counts, _ = np.histogram(scale(values), edges)
        low, high = back(edges[:-1]), back(edges[1:])
        found.append(pd.DataFrame({"parameter": name, "low": low, "high": high, "specimens": counts}))
    return pd.concat(found, ignore_index=True).assign(origin=result.origin)


def _paint(frame: pd.DataFrame) -> Figure:
    names = list(dict.fromkeys(frame["parameter"]))
    figure = Figure(figsize=(TEXT_WIDTH_IN, 1.9), layout="constrained")
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(names), sharey=True)), names, strict=True):
        rows = frame[frame["parameter"] == name]
        label, unit = choose_printed_unit(name, rows["high"])
        edges = np.append(rows["low"], rows["high"].iloc[-1]) / unit
        axes.stairs(rows["specimens"], edges, fill=True, color=METHOD_COLOURS["fitted"])
        wide = is_logarithmic(name) and edges[-1] > 10 * edges[0]
        axes.set_xscale("log" if wide else "linear")
        axes.set_xlabel(label)
        draw_grid(axes, "y")
    figure.axes[0].set_ylabel("specimens")
    return figure


def compose_sections(result: Run, figures: FigurePaths) -> list[Block]:
    """Return the report's sections: parameters, errors, failures."""
    caption = "Fitted parameters over specimens (histograms)."
    return [
        document.heading("Parameters"),
        document.figure(figures["parameters"], caption),
        *(document.table(one) for one in lay_out_tables(result)),
    ]


REPORT = StudyReport(summarize, lay_out_tables, draw_figures, compose_sections, judge=judge)
