"""Write a predicted insertion: its table, its files, its figure."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from needlefit.inference.predictive_distribution import (
    INTERVAL_PROBABILITIES,
    PredictiveMixture,
    interval,
    quantile,
)
from needlefit.project.atomic_write import replace_folder
from needlefit.project.input_files import convert_stored_errors
from needlefit.project.json_values import to_json_values
from needlefit.project.run_file import require_schema
from needlefit.reporting.figures.style import (
    TEXT_WIDTH_IN,
    choose_vertical_scale,
    fit_height,
    is_synthetic,
    label_origin,
    plot,
)
from needlefit.reporting.labels import GREY, INK, METHOD_COLOURS
from needlefit.reporting.number_format import format_mm
from needlefit.reporting.table_files import write_json
from needlefit.reporting.table_layout import TableColumn, TableLayout, text_column
from needlefit.schemas.result_files import PredictionTable
from needlefit.validation.forecast import Forecast
from needlefit.validation.packing import RESULTS_FILE, pack, pack_frame, unpack_frame

_MARGIN_FRACTION = 0.2  # share of the bands' height left free above and below
_FIGURE_HEIGHT_IN = 2.6  # inches


def draw_forecast(table: pd.DataFrame, title: str, depth: float, path: Path) -> None:
    """Draw median, 50 and 95 % bands of the needle, and the 95 % band of its measurement, mm."""
    plot(path, table, lambda frame: _paint_forecast(frame, title, depth))


def _paint_forecast(table: pd.DataFrame, title: str, depth: float) -> Figure:
    x, colour = table["x_mm"], METHOD_COLOURS["fitted"]
    low, high = table["measured_95_low_mm"].min(), table["measured_95_high_mm"].max()
    room = _MARGIN_FRACTION * (high - low) + 0.05
    figure = Figure(figsize=(TEXT_WIDTH_IN, _FIGURE_HEIGHT_IN))
    axes = figure.add_subplot()
    factor = choose_vertical_scale(1.1 * depth, high - low + 2 * room)
    axes.set_aspect(factor)
    axes.set(xlim=(-0.02 * depth, 1.12 * depth), ylim=(low - room, high + room))
    axes.axhline(0.0, color=GREY, lw=0.5, ls=(0, (4, 3)))
    for name in ("measured_95_low_mm", "measured_95_high_mm"):
        axes.plot(x, table[name], color=INK, lw=0.6, ls=(0, (1, 1.5)))
    for level, alpha in ((95, 0.2), (50, 0.35)):
        ends = table[f"needle_{level}_low_mm"], table[f"needle_{level}_high_mm"]
        axes.fill_between(x, *ends, color=colour, alpha=alpha, lw=0)
    axes.plot(x, table["needle_median_mm"], color=colour, lw=1.4)
    last = table.iloc[-1]
    for name, summary, ink in (
        ("measured_95_high_mm", "95 % of measurements", INK),
        ("needle_median_mm", f"tip {last['needle_median_mm']:+z.2f} mm", colour),
    ):
        axes.annotate(
            summary.replace("-", "−"), (last["x_mm"], last[name]), xytext=(4, 0), textcoords="offset points",
            va="center", color=ink, fontsize=6.5,
        )  # fmt: skip
    axes.set_title(f"{title}: median, 50 and 95 % of needles", loc="left")
    axes.set_xlabel("x along the entry (mm)")
    axes.set_ylabel("y (mm)" + ("" if factor == 1 else f",\ndrawn {factor}× as large as x"))
    label_origin(figure, is_synthetic(table))
    fit_height(figure)
    return figure


FORECAST_KIND = "forecast"
"""Of what a run stores."""

_BAND_NAMES = {"needle": "where the needle is", "measured": "where it would be measured"}


def tabulate_forecast(forecast: Forecast) -> pd.DataFrame:
    """Return one row per station: s and x, then median and ends of the bands of y, all mm."""
    columns = {"s_mm": forecast.s, "x_mm": forecast.x}
    for name in _BAND_NAMES:
        mixture: PredictiveMixture = getattr(forecast, name)
        columns[f"{name}_median_mm"] = quantile(mixture, 0.5)
        for level in INTERVAL_PROBABILITIES:
            low, high = interval(mixture, level)
            columns[f"{name}_{100 * level:.0f}_low_mm"] = low
            columns[f"{name}_{100 * level:.0f}_high_mm"] = high
    return pd.DataFrame(columns)


def summarize_tip(forecast: Forecast) -> dict[str, Any]:
    """Return the tip's row and the basis of the prediction, as JSON values."""
    row = {name: float(value) for name, value in tabulate_forecast(forecast).iloc[-1].items()}
    draws = len(forecast.needle.means)
    source = {"draw_source": forecast.source, "draws": draws, "failed_solves": forecast.failed}
    source["outside_validity"] = forecast.outside
    return {"tip": row, **source, "not_converged": list(forecast.faults)}


def describe_convergence(forecast: Forecast) -> str:
    """Return why the posterior of a prediction has not converged; empty if it has."""
    return f"NOT CONVERGED: {'; '.join(forecast.faults)}" if forecast.faults else ""


def lay_out_forecast(forecast: Forecast, title: str, synthetic: bool) -> TableLayout:
    """Return the tip's table for the screen."""
    row = tabulate_forecast(forecast).iloc[-1]
    columns = [text_column("Tip's y"), TableColumn("Median", "mm")]
    columns += [TableColumn(f"{100 * level:.0f} %", "mm") for level in INTERVAL_PROBABILITIES]
    cells = []
    for name, summary in _BAND_NAMES.items():
        ends = [
            (row[f"{name}_{100 * p:.0f}_low_mm"], row[f"{name}_{100 * p:.0f}_high_mm"])
            for p in INTERVAL_PROBABILITIES
        ]
        shown = [f"{format_mm(low)} to {format_mm(high)}" for low, high in ends]
        cells.append((summary, format_mm(row[f"{name}_median_mm"]), *shown))
    source = {
        "posterior": "draws of the sampled posterior",
        "importance": "importance-weighted draws about the fit",
    }[forecast.source]
    failures = f", {forecast.failed} draws without a solution left out" if forecast.failed else ""
    notes = (
        f"From {len(forecast.needle.means)} {source}{failures}. What the model misses is not in it.",
        *(("The fitted data are synthetic.",) if synthetic else ()),
        *(
            (f"The posterior has {describe_convergence(forecast)}: the bands are not final.",)
            if forecast.faults
            else ()
        ),
    )
    caption = f"{_mark_title(title, forecast)}, {forecast.s[-1]:g} mm deep, across the entry axis"
    return TableLayout("forecast", caption, tuple(columns), tuple(cells), notes=notes)


@dataclass(frozen=True)
class StoredForecast:
    """The contents of all files of a prediction: title, table with plot marks, `run.json`."""

    title: str
    table: pd.DataFrame
    run: dict[str, Any]


def write_forecast(
    forecast: Forecast, folder: Path, title: str, run: dict[str, Any], synthetic: bool
) -> None:
    """Write `forecast.csv`, `forecast.pdf`, `run.json` and the stored inputs of `needlefit report` to
    `folder`.

    Whole or not at all.
    """
    marks = {"origin": "synthetic" if synthetic else "measured", "converged": not forecast.faults}
    table = tabulate_forecast(forecast).assign(**marks)
    write_stored_forecast(
        StoredForecast(_mark_title(title, forecast), table, run | summarize_tip(forecast)), folder
    )


def write_stored_forecast(stored: StoredForecast, folder: Path) -> None:
    """Write the files of a stored prediction; see `write_forecast`."""
    table = stored.table
    with replace_folder(folder) as new:
        draw_forecast(table, stored.title, float(table["s_mm"].max()), new / "forecast.pdf")
        packs = {"title": stored.title, "table": pack_frame(table), "run": to_json_values(stored.run)}
        pack({"kind": FORECAST_KIND, **packs}, new)
        write_json(new / "run.json", stored.run)


def restore_forecast(table: Mapping[str, Any], folder: Path) -> StoredForecast:
    """Return the prediction that a run stored as `table` in `folder`; DataError if it is damaged."""
    require_schema(table, PredictionTable, str(folder / RESULTS_FILE))
    with convert_stored_errors(folder / RESULTS_FILE):
        return StoredForecast(table["title"], unpack_frame(table["table"]), table["run"])


def _mark_title(title: str, forecast: Forecast) -> str:
    return f"{title} (NOT CONVERGED)" if forecast.faults else title
